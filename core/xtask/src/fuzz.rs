//! `cargo xtask fuzz`: runs the fuzz targets of `tests/fuzz` with cargo-fuzz and the nightly toolchain, and prints
//! their findings.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

use crate::coverage::{self, nightly};
use crate::process;
use crate::workspace::Workspace;

/// Default time for each target, s.
const SECONDS: u64 = 60;
/// Maximum time for one input, s.
const TIMEOUT_S: u32 = 20;
/// Maximum size of an allocation and of the memory of the process, MB. Compressed images need much more memory than
/// bytes.
const MALLOC_MB: u32 = 64;
const MALLOC_PICTURE_MB: u32 = 600;
const RSS_MB: u32 = 2048;
/// Maximum length of an input, bytes.
const MAX_LEN: u32 = 16 << 10;
/// Maximum number of files and bytes of a corpus in the repository.
const MAX_FILES: usize = 60;
const MAX_BYTES: u64 = 100 << 10;

/// Arguments of the command.
#[derive(Debug, Default, PartialEq, Eq)]
struct Request {
    target: Option<String>,
    seconds: u64,
    /// Copies a minimized selection of the new inputs into the repository.
    keep: bool,
    /// Only shows the share of the parsers' lines that the corpora reach.
    coverage: bool,
    /// With `coverage`: also shows the lines that they do not reach.
    missed: bool,
}

impl Request {
    fn parse(args: &[String]) -> Result<Self> {
        let mut request = Self { seconds: SECONDS, ..Self::default() };
        let mut words = args.iter();
        while let Some(word) = words.next() {
            match word.as_str() {
                "--seconds" => {
                    let number = words.next().context("--seconds needs a number")?;
                    request.seconds = number.parse().with_context(|| format!("--seconds {number}"))?;
                }
                "--keep" => request.keep = true,
                "--coverage" => request.coverage = true,
                "--missed" => (request.coverage, request.missed) = (true, true),
                name if request.target.is_none() && !name.starts_with('-') => request.target = Some(name.to_owned()),
                other => bail!("unexpected argument `{other}`"),
            }
        }
        Ok(request)
    }
}

/// Figures of libFuzzer for one target.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Figures {
    inputs: u64,
    /// Edges of the program reached by the initial inputs, and at the end.
    coverage: (u64, u64),
    /// Number of inputs that reached new edges.
    found: u64,
}

impl Figures {
    /// Reads the output of libFuzzer.
    fn of(output: &str) -> Self {
        let mut figures = Self::default();
        for line in output.lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            let after = |name: &str| {
                let at = words.iter().position(|word| *word == name)?;
                words.get(at + 1)?.parse::<u64>().ok()
            };
            if let Some(edges) = after("cov:") {
                figures.coverage.1 = edges;
                if words.contains(&"INITED") {
                    figures.coverage.0 = edges;
                }
            }
            figures.inputs = after("stat::number_of_executed_units:").unwrap_or(figures.inputs);
            figures.found = after("stat::new_units_added:").unwrap_or(figures.found);
        }
        figures
    }
}

/// Folders and tools of a run.
struct Fuzzing<'a> {
    workspace: &'a Workspace,
    /// Sources and committed corpora.
    source: PathBuf,
    /// Files that are not committed.
    work: PathBuf,
    /// Search path with cargo-fuzz on it.
    path: std::ffi::OsString,
}

/// Runs the fuzz targets, one after the other, and prints a table.
pub fn fuzz(workspace: &Workspace, args: &[String]) -> Result<bool> {
    let request = Request::parse(args)?;
    let work = workspace.target.join("fuzz");
    if request.coverage {
        return coverage::coverage(workspace, &work, request.missed);
    }
    let source = workspace.root.join("tests/fuzz");
    let mut targets = targets(&source.join("fuzz_targets"))?;
    if let Some(name) = &request.target {
        if !targets.contains(name) {
            bail!("there is no fuzz target `{name}`; there are: {}", targets.join(", "));
        }
        targets = vec![name.clone()];
    }
    let path = tools(&work)?;
    let fuzzing = Fuzzing { workspace, source, work, path };
    fuzzing.build(request.target.as_deref())?;
    println!("{:<14} {:>12} {:>14} {:>6} {:>8}", "target", "inputs", "coverage", "new", "crashes");
    let mut crashes = Vec::new();
    for name in &targets {
        let (figures, new) = fuzzing.run(name, request.seconds)?;
        let Figures { inputs, coverage: (before, after), found } = figures;
        println!("{name:<14} {inputs:>12} {:>14} {found:>6} {:>8}", format!("{before}->{after}"), new.len());
        crashes.extend(new);
        if request.keep {
            fuzzing.keep(name)?;
        }
    }
    for file in &crashes {
        println!("{}", file.display());
    }
    Ok(crashes.is_empty())
}

/// Names of the targets, sorted.
fn targets(folder: &Path) -> Result<Vec<String>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut names: Vec<String> =
        entries.flatten().filter_map(|entry| Some(entry.path().file_stem()?.to_str()?.to_owned())).collect();
    names.sort();
    Ok(names)
}

/// Ensures that the nightly toolchain and cargo-fuzz are installed. Returns the search path with cargo-fuzz.
fn tools(work: &Path) -> Result<std::ffi::OsString> {
    if process::capture(nightly("cargo").arg("--version")).is_err() {
        bail!("fuzzing needs the nightly toolchain: install it with `rustup toolchain install nightly`");
    }
    let old = std::env::var_os("PATH").unwrap_or_default();
    if process::find_program("cargo-fuzz").is_some() {
        return Ok(old);
    }
    let root = work.join("tools");
    if !root.join("bin/cargo-fuzz").is_file() {
        println!("Installing cargo-fuzz into {}", root.display());
        process::run(nightly("cargo").args(["install", "--locked", "cargo-fuzz", "--root"]).arg(&root))?;
    }
    let folders = std::iter::once(root.join("bin")).chain(std::env::split_paths(&old));
    std::env::join_paths(folders).context("the search path")
}

impl Fuzzing<'_> {
    fn build_dir(&self) -> PathBuf {
        self.work.join("build")
    }

    /// Builds one target; default: all.
    fn build(&self, target: Option<&str>) -> Result<()> {
        let mut command = nightly("cargo");
        command.env("PATH", &self.path).current_dir(&self.workspace.root).args(["fuzz", "build", "--fuzz-dir"]);
        command.arg(&self.source).arg("--target-dir").arg(self.build_dir()).args(target);
        process::run(&mut command)
    }

    /// Path of a target's program.
    fn program(&self, target: &str) -> Result<PathBuf> {
        let machines = std::fs::read_dir(self.build_dir()).context("nothing was built")?;
        let programs = machines.flatten().map(|entry| entry.path().join("release").join(target));
        // A build without a machine's name has `release` itself here.
        programs.filter(|program| program.is_file()).last().with_context(|| format!("`{target}` was not built"))
    }

    /// A folder for a target, created if it does not exist.
    fn folder(&self, kind: &str, target: &str) -> Result<PathBuf> {
        let folder = self.work.join(kind).join(target);
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        Ok(folder)
    }

    /// A command with the limits of a target.
    fn command(&self, target: &str) -> Result<Command> {
        let malloc = if ["picture", "truth_file"].contains(&target) { MALLOC_PICTURE_MB } else { MALLOC_MB };
        let mut command = Command::new(self.program(target)?);
        command.env("PANOSCOPE_FUZZ_SEEDS", self.folder("seeds", target)?);
        command.env("PANOSCOPE_FUZZ_SCRATCH", self.folder("scratch", target)?);
        command.arg(format!("-timeout={TIMEOUT_S}")).arg(format!("-rss_limit_mb={RSS_MB}"));
        command.arg(format!("-malloc_limit_mb={malloc}"));
        // Seeds and statics live until the end, some behind pointers that the leak check does not follow; memory that grows is limited above.
        command.env("ASAN_OPTIONS", "detect_leaks=0").arg("-detect_leaks=0");
        command.stdin(Stdio::null());
        Ok(command)
    }

    /// Runs a target. Returns its figures and the inputs that made it crash.
    fn run(&self, target: &str, seconds: u64) -> Result<(Figures, Vec<PathBuf>)> {
        let artifacts = self.folder("artifacts", target)?;
        let known = inputs(&artifacts);
        let mut command = self.command(target)?;
        command.arg(format!("-artifact_prefix={}/", artifacts.display()));
        command.arg(format!("-max_total_time={seconds}")).arg(format!("-max_len={MAX_LEN}"));
        // What is found goes to the first folder.
        command.arg("-print_final_stats=1").arg(self.folder("corpus", target)?);
        command.arg(self.folder("seeds", target)?);
        let committed = self.source.join("corpus").join(target);
        if committed.is_dir() {
            command.arg(committed);
        }
        let log = self.work.join(format!("{target}.log"));
        let file = std::fs::File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
        command.stdout(Stdio::null()).stderr(file);
        let status = command.status().with_context(|| format!("cannot start `{}`", process::shown(&command)))?;
        let output = std::fs::read(&log).with_context(|| format!("cannot read {}", log.display()))?;
        let output = String::from_utf8_lossy(&output);
        let new: Vec<PathBuf> = inputs(&artifacts).into_keys().filter(|file| !known.contains_key(file)).collect();
        let _ = std::fs::remove_dir_all(self.work.join("scratch").join(target));
        if !status.success() && new.is_empty() {
            bail!("the fuzzer of `{target}` failed ({status}), see {}\n{}", log.display(), process::tail(&output, 20));
        }
        Ok((Figures::of(&output), new))
    }

    /// Replaces the committed corpus of a target by a small selection of all its inputs. Regression inputs stay.
    fn keep(&self, target: &str) -> Result<()> {
        let committed = self.source.join("corpus").join(target);
        std::fs::create_dir_all(&committed).with_context(|| format!("cannot make {}", committed.display()))?;
        let chosen = self.folder("chosen", target)?;
        inputs(&chosen).keys().try_for_each(std::fs::remove_file)?;
        let mut command = self.command(target)?;
        command.arg("-set_cover_merge=1").arg(&chosen).arg(self.folder("corpus", target)?);
        command.arg(self.folder("seeds", target)?).arg(&committed);
        process::capture(&mut command)?;
        let (mut files, mut bytes) = (0, 0);
        for (file, len) in inputs(&committed) {
            if is_regression(&file) {
                (files, bytes) = (files + 1, bytes + len);
            } else {
                std::fs::remove_file(&file).with_context(|| format!("cannot remove {}", file.display()))?;
            }
        }
        // The smallest first: most of what a parser does is reached by small inputs.
        let mut all: Vec<(u64, PathBuf)> = inputs(&chosen).into_iter().map(|(file, len)| (len, file)).collect();
        all.sort();
        for (len, file) in all {
            if files + 1 > MAX_FILES || bytes + len > MAX_BYTES {
                break;
            }
            let name = file.file_name().context("a file has a name")?;
            std::fs::copy(&file, committed.join(name)).with_context(|| format!("cannot copy {}", file.display()))?;
            (files, bytes) = (files + 1, bytes + len);
        }
        Ok(())
    }
}

/// Whether a file of a corpus has a name given by a person; libFuzzer names files by their hash.
fn is_regression(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    name.len() != 40 || !name.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// The files of a folder with their lengths.
fn inputs(folder: &Path) -> BTreeMap<PathBuf, u64> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let files = entries.filter_map(|entry| Some((entry.path(), entry.metadata().ok()?)));
    files.filter(|(_, about)| about.is_file()).map(|(path, about)| (path, about.len())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_choose_target_and_time() {
        let parse = |text: &str| Request::parse(&text.split_whitespace().map(str::to_owned).collect::<Vec<_>>());
        assert_eq!(parse("").unwrap(), Request { seconds: SECONDS, ..Request::default() });
        let graph = Request { target: Some("graph".to_owned()), seconds: 5, keep: true, ..Request::default() };
        assert_eq!(parse("graph --seconds 5 --keep").unwrap(), graph);
        assert!(parse("graph urdf").unwrap_err().to_string().contains("`urdf`"));
        assert!(parse("--seconds").unwrap_err().to_string().contains("a number"));
    }

    #[test]
    fn the_output_of_the_fuzzer_is_read() {
        let output = "INFO: seed corpus: files: 3\n#4\tINITED cov: 120 ft: 130 corp: 3/9b exec/s: 0 rss: 40Mb\n\
                      #900\tNEW    cov: 125 ft: 140 corp: 4/12b\n#1000\tDONE   cov: 131 ft: 150 corp: 5/20b\n\
                      stat::number_of_executed_units: 1000\nstat::average_exec_per_sec:     100\nstat::new_units_added:          2\n";
        assert_eq!(Figures::of(output), Figures { inputs: 1000, coverage: (120, 131), found: 2 });
        assert_eq!(Figures::of("nothing"), Figures::default());
    }

    #[test]
    fn files_with_names_of_their_own_are_regressions() {
        assert!(is_regression(Path::new("corpus/graph/parts_multiply")));
        assert!(!is_regression(Path::new("corpus/graph/0123456789abcdef0123456789abcdef01234567")));
    }

    #[test]
    fn every_target_has_a_file() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/fuzz_targets");
        let names = targets(&folder).unwrap();
        assert!(names.len() > 20 && names.contains(&"graph".to_owned()), "{names:?}");
    }
}
