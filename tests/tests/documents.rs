//! The commands in the documents: every block is marked, every command and option exists, and blocks that are marked to run do run.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use panoscope_tests::{DOCUMENTS, document, named_program, root, scratch};

/// Mark in the comment on the line before a block.
#[derive(Clone, Debug, PartialEq)]
enum Mark {
    None,
    Run,
    NotRun,
    /// The reader saves the block under this name.
    File(String),
}

/// A fenced block.
#[derive(Clone, Debug)]
struct Block {
    language: String,
    mark: Mark,
    text: String,
    /// Line of the opening fence, from 1.
    line: usize,
}

impl Block {
    /// Command lines of a shell block, without comments; lines joined by `&&` are split.
    fn commands(&self) -> impl Iterator<Item = &str> {
        let lines = self.text.lines().map(|line| line.split(" #").next().unwrap_or_default());
        lines.flat_map(|line| line.split("&&")).map(str::trim).filter(|c| !c.is_empty() && !c.starts_with('#'))
    }
}

fn mark(comment: &str) -> Result<Mark, String> {
    let Some(words) = comment.strip_prefix("<!--").and_then(|rest| rest.strip_suffix("-->")).map(str::trim) else {
        return Ok(Mark::None);
    };
    match words.split_once(':') {
        None if words == "run" => Ok(Mark::Run),
        Some(("not run", reason)) if !reason.trim().is_empty() => Ok(Mark::NotRun),
        Some(("file", name)) if !name.trim().is_empty() => Ok(Mark::File(name.trim().to_owned())),
        _ => Err(format!("unknown mark: {comment}")),
    }
}

/// The fenced blocks of a document, or what is wrong with one of them.
fn blocks(text: &str) -> Result<Vec<Block>, String> {
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    let mut before = "";
    for (index, line) in text.lines().enumerate() {
        let at = |why: String| format!("line {}: {why}", index + 1);
        match (&mut open, line.strip_prefix("```")) {
            (Some(_), Some("")) => blocks.extend(open.take()),
            (Some(_), Some(_)) => return Err(at("a block opens inside a block".to_owned())),
            (Some(block), None) => block.text += &format!("{line}\n"),
            (None, Some(language)) => {
                let (language, mark) = (language.trim().to_owned(), mark(before.trim()).map_err(at)?);
                let line = index + 1;
                let shell = language == "sh";
                if language.is_empty() {
                    return Err(at("a block has no language; commands are `sh`, output is `text`".to_owned()));
                }
                if shell != matches!(mark, Mark::Run | Mark::NotRun) {
                    let why = "`sh` blocks need `<!-- run -->` or `<!-- not run: REASON -->`, others neither";
                    return Err(at(why.to_owned()));
                }
                open = Some(Block { language, mark, text: String::new(), line });
            }
            (None, None) => {}
        }
        before = line;
    }
    if let Some(block) = open {
        return Err(format!("line {}: the block does not end", block.line));
    }
    for block in blocks.iter().filter(|block| block.language != "sh") {
        let is_command = |line: &&str| ["panoscope ", "cargo ", "$ "].iter().any(|c| line.starts_with(c));
        if let Some(command) = block.text.lines().find(is_command) {
            return Err(format!("line {}: `{command}` is a command in a block that is not `sh`", block.line));
        }
    }
    Ok(blocks)
}

fn blocks_of(name: &str) -> Vec<Block> {
    blocks(&document(name)).unwrap_or_else(|why| panic!("{name}: {why}"))
}

#[test]
fn every_block_is_marked() {
    let (mut run, mut not_run) = (0, 0);
    for name in DOCUMENTS {
        for block in blocks_of(name) {
            run += usize::from(block.mark == Mark::Run);
            not_run += usize::from(block.mark == Mark::NotRun);
        }
    }
    assert!(run >= 10 && not_run >= 5, "{run} blocks run, {not_run} do not");
    for (text, why) in [
        ("```sh\npanoscope list\n```", "need"),
        ("<!-- run -->\n\n```sh\npanoscope list\n```", "need"),
        ("<!-- not run: -->\n```sh\npanoscope list\n```", "unknown mark"),
        ("<!-- run -->\n```toml\na = 1\n```", "others neither"),
        ("<!-- file: a.sh -->\n```sh\na\n```", "need"),
        ("```\na\n```", "no language"),
        ("```text\npanoscope list\n```", "is a command"),
        ("<!-- run -->\n```sh\npanoscope list", "does not end"),
    ] {
        let error = blocks(text).expect_err(text);
        assert!(error.contains(why), "{text}: {error}");
    }
}

/// The `--help` of commands; each is run once.
struct Help {
    program: PathBuf,
    known: BTreeMap<Vec<String>, Option<String>>,
}

impl Help {
    fn of(&mut self, words: &[&str]) -> Option<&str> {
        let key: Vec<String> = words.iter().map(|w| (*w).to_owned()).collect();
        let program = &self.program;
        let entry = self.known.entry(key).or_insert_with(|| {
            let help = |program: &Path, words: &[&str]| {
                let output = Command::new(program).args(words).arg("--help").current_dir(root()).output();
                let output = output.unwrap_or_else(|error| panic!("{}: {error}", program.display()));
                output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
            };
            let own = help(program, words)?;
            // These hand their arguments to a program of their own, which `cargo test --workspace` has built.
            let window = match words {
                ["edit"] => program.with_file_name("panoscope-editor"),
                ["theatre"] => program.with_file_name("panoscope-theatre"),
                _ => return Some(own),
            };
            if !window.exists() {
                panoscope_testing::skipped!("options of `{}`: there is no {}", words[0], window.display());
                return None;
            }
            Some(own + &help(&window, &[]).unwrap_or_else(|| panic!("{} has no --help", window.display())))
        });
        entry.as_deref()
    }

    /// What is wrong with the commands and options of a command line.
    fn mistake(&mut self, command: &str) -> Option<String> {
        let words: Vec<&str> = command.split_whitespace().skip(1).collect();
        let first = words.first().filter(|w| !w.starts_with('-'))?;
        let nested = NESTED.contains(first) && words.get(1).is_some_and(|w| is_word(w));
        let path = &words[..1 + usize::from(nested)];
        let is_window = matches!(path, ["edit"] | ["theatre"]);
        let Some(help) = self.of(path) else {
            return (!is_window).then(|| format!("there is no command `{}`", path.join(" ")));
        };
        let mut known = options_in(help);
        // A graph that ships adds options of its own, and so does an overlay.
        let files: Vec<&str> =
            words.iter().filter(|w| w.ends_with(".toml") && root().join(w).exists()).copied().collect();
        if let Some((graph, overlays)) = files.split_first() {
            let with = overlays.iter().flat_map(|file| ["--with", file]);
            let asked: Vec<&str> = path.iter().copied().chain([*graph]).chain(with).collect();
            known.extend(self.of(&asked).map(options_in).unwrap_or_default());
        }
        let options = words.iter().filter(|w| w.starts_with("--"));
        let mut unknown = options.map(|w| w.split('=').next().unwrap_or(w)).filter(|w| !known.contains(*w));
        unknown.next().map(|option| format!("`{}` takes no {option}", path.join(" ")))
    }
}

/// Commands with subcommands.
const NESTED: [&str; 4] = ["bench", "dicom", "eval", "new"];

/// The words of a `--help`, including options.
fn options_in(help: &str) -> BTreeSet<String> {
    help.split(|c: char| !(c.is_alphanumeric() || c == '-')).map(str::to_owned).collect()
}

fn is_word(word: &str) -> bool {
    word.chars().all(|c| c.is_ascii_lowercase() || c == '_' || c == '-') && !word.starts_with('-')
}

#[test]
fn commands_and_options_exist() {
    let Some(program) = named_program() else { return };
    let mut help = Help { program, known: BTreeMap::new() };
    assert_eq!(help.mistake("panoscope run a.toml --frames 3"), None);
    assert!(help.mistake("panoscope run a.toml --framse 3").is_some_and(|why| why.contains("--framse")));
    assert!(help.mistake("panoscope rnu a.toml").is_some_and(|why| why.contains("rnu")));
    let mut count = 0;
    for name in DOCUMENTS {
        let text = document(name);
        let mut commands: Vec<String> = Vec::new();
        for block in blocks_of(name).iter().filter(|block| block.language == "sh") {
            commands.extend(block.commands().map(str::to_owned));
        }
        // In running text and tables a command is between backquotes; a placeholder is no option.
        let prose = text.split("```").step_by(2).collect::<String>();
        commands.extend(prose.split('`').skip(1).step_by(2).map(str::to_owned));
        let whole = |c: &&String| c.starts_with("panoscope ") && !c.contains("...") && !c.contains("COMMAND");
        for command in commands.iter().filter(whole) {
            // Brackets mark what may be left out.
            let command = command.replace(['[', ']'], " ");
            if let Some(why) = help.mistake(&command) {
                panic!("{name}: `{command}`: {why}");
            }
            count += 1;
        }
    }
    assert!(count > 80, "{count} commands were looked at");
}

#[test]
fn the_table_of_commands_has_each_command_and_its_options() {
    let Some(program) = named_program() else { return };
    let mut help = Help { program, known: BTreeMap::new() };
    let text = document("core/cli/README.md");
    let table = text.split("\n## ").find(|section| section.starts_with("Commands")).expect("a table of commands");
    let all = help.of(&[]).expect("--help").to_owned();
    let commands =
        all.split("Commands:").nth(1).and_then(|rest| rest.split("\n\n").next()).expect("commands in --help");
    let mut count = 0;
    for command in commands.lines().filter_map(|line| line.split_whitespace().next()) {
        let row = table.lines().find(|line| {
            line.split('|').nth(1).is_some_and(|cell| {
                cell.split('`').skip(1).step_by(2).any(|c| {
                    let mut words = c.split_whitespace();
                    words.next() == Some("panoscope") && words.next() == Some(command)
                })
            })
        });
        let row = row.unwrap_or_else(|| panic!("core/cli/README.md has no row for `panoscope {command}`"));
        // Options that the description of a single command names.
        let named: Vec<&str> = row.split('`').skip(1).step_by(2).filter(|c| c.starts_with('-')).collect();
        count += 1;
        let Some(mut own) = help.of(&[command]).map(str::to_owned) else {
            assert!(["edit", "theatre"].contains(&command), "`panoscope {command}` has no --help");
            continue;
        };
        if NESTED.contains(&command) {
            for below in row.split('`').skip(1).step_by(2).filter_map(|c| c.split_whitespace().nth(2)) {
                own.push_str(help.of(&[command, below]).unwrap_or_default());
            }
        }
        for option in named.iter().filter_map(|c| c.split_whitespace().next()) {
            assert!(own.contains(option), "core/cli/README.md: `panoscope {command}` takes no {option}");
        }
    }
    assert!(count > 15, "{count} commands in --help");
}

/// A folder as the reader has it: a copy of the graphs, next to the plugins and their models.
fn reader_folder(name: &str) -> PathBuf {
    let folder = scratch(&format!("documents-{}", name.replace('/', "-")));
    for graphs in ["graphs", "graphs/parts", "graphs/sources", "graphs/machines"] {
        std::fs::create_dir_all(folder.join(graphs)).expect("a folder");
        for entry in std::fs::read_dir(root().join(graphs)).expect("graphs").flatten() {
            if entry.path().extension().is_some_and(|e| e == "toml") {
                std::fs::copy(entry.path(), folder.join(graphs).join(entry.file_name())).expect("a copy");
            }
        }
    }
    for part in ["plugins", "core", "tests"] {
        std::os::unix::fs::symlink(root().join(part), folder.join(part)).expect("a link");
    }
    folder
}

/// Runs the marked blocks of a document one after the other in one folder; returns the folder.
fn run_blocks(name: &str, program: &Path) -> PathBuf {
    let folder = reader_folder(name);
    let mut path = vec![program.parent().expect("a folder").to_owned()];
    path.extend(std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default()));
    let has_make = Command::new("make").arg("--version").output().is_ok();
    for block in blocks_of(name) {
        match &block.mark {
            Mark::File(file) => std::fs::write(folder.join(file), &block.text).expect("written"),
            Mark::Run if !has_make && block.commands().any(|c| c.starts_with("make ")) => {
                panoscope_testing::skipped!("{name}, line {}: there is no make", block.line);
            }
            Mark::Run => {
                let mut shell = Command::new("sh");
                shell.args(["-e", "-c", &block.text]).current_dir(&folder);
                shell.env("PATH", std::env::join_paths(&path).expect("folders without colons"));
                shell.env_remove("PANOSCOPE_PLUGIN_PATH").env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY");
                let output = shell.output().expect("sh runs");
                let printed = [output.stdout, output.stderr].concat();
                let printed = String::from_utf8_lossy(&printed);
                assert!(output.status.success(), "{name}, line {}: {}\n{printed}", block.line, output.status);
            }
            Mark::None | Mark::NotRun => {}
        }
    }
    folder
}

/// Runs a document's blocks and checks the files that it promises.
fn runs(name: &str, promised: &[&str], look: impl Fn(&Path)) {
    let Some(program) = named_program() else { return };
    let folder = run_blocks(name, &program);
    for file in promised {
        let bytes = std::fs::metadata(folder.join(file)).map(|f| f.len()).unwrap_or_default();
        assert!(bytes > 0, "{name}: its commands wrote no {file}");
    }
    look(&folder);
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn the_commands_of_the_first_page_run() {
    runs("README.md", &["out/panorama.mkv", "out/panorama.png", "out/depth.png"], |_| {});
}

#[test]
fn the_tutorial_runs_and_measures_what_it_promises() {
    let promised = [
        "scope.yml",
        "board/coverage.png",
        "board/epipolar.png",
        "depth.png",
        "surface.ply",
        "report.json",
        "out/panorama_files.mkv",
        "soften/out/soften_000000.png",
        "second.json",
        "pictures/index.csv",
        "foxglove.mcap",
        "panoscope.schema.json",
    ];
    runs("graphs/README.md", &promised, |folder| {
        let scope = panoscope_data::calibration::read(&[folder.join("scope.yml")]).expect("a calibration");
        assert!(scope.rms_px < 0.1, "{scope:?}");
        assert!((scope.left.fx - 750.0).abs() < 7.5 && (scope.baseline_mm - 15.0).abs() < 0.15, "{scope:?}");
        let table = std::fs::read_to_string(folder.join("length.csv")).expect("a table");
        let last: Vec<f64> = table.lines().last().expect("rows").split(',').filter_map(|v| v.parse().ok()).collect();
        let [.., distance_mm, error_mm] = last[..] else { panic!("{table}") };
        assert!((10.0..40.0).contains(&distance_mm) && (0.01..2.0).contains(&error_mm), "{distance_mm} {error_mm}");
    });
}

#[test]
fn the_commands_of_the_plugins_page_run() {
    runs("plugins/README.md", &["soften/libsoften.so", "skill.html", "skill.json", "out/proximity.csv"], |_| {});
}

#[test]
fn the_commands_of_the_other_pages_run() {
    let others = DOCUMENTS.iter().filter(|name| !["README.md", "graphs/README.md", "plugins/README.md"].contains(name));
    for name in others {
        runs(name, &[], |_| {});
    }
}

#[test]
fn the_first_page_is_short() {
    let lines = document("README.md").lines().count();
    assert!(lines < 200, "README.md has {lines} lines");
}
