//! `cargo xtask test`: all checks for a change.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use anyhow::{Result, bail};

use crate::build::{self, Extent, build_for_tests};
use crate::generated::test_environment;
use crate::lint;
use crate::nextest;
use crate::onnxruntime;
use crate::packages::Purpose;
use crate::process;
use crate::python_packages::{NUMPY, PEERS, PEERS_VARIABLE};
use crate::sanitizer::{self, Sanitizer};
use crate::setup;
use crate::tally::Tally;
use crate::time::{self, timed};
use crate::tool;
use crate::workspace::Workspace;

/// If a failure leaves less free space than this, the full disk is its probable reason, which compilers do not report.
const MIN_FREE_MIB: u64 = 2048;

/// Packages with examples in their documentation.
const WITH_EXAMPLES: &[&str] = &["panoscope-editor-model", "panoscope-graph", "panoscope-testing"];

/// Packages whose tests need only plugins, not the program.
const BELOW_PROGRAM: &[&str] = &[
    "panoscope-abi",
    "panoscope-base",
    "panoscope-node",
    "panoscope-node-derive",
    "panoscope-graph",
    "panoscope-engine",
    "panoscope-imaging",
    "panoscope-gpu",
    "panoscope-data",
    "panoscope-arm-core",
    "xtask",
];

/// A named part of the tests.
struct Suite {
    name: &'static str,
    lints: bool,
    /// Packages whose tests run; default: all.
    packages: &'static [&'static str],
    /// Filter expression of nextest; default: all tests.
    filter: &'static str,
    /// Environment of its tests, unless the caller sets it.
    env: &'static [(&'static str, &'static str)],
    /// Sanitizer of its build, which needs the nightly compiler.
    sanitizer: Option<Sanitizer>,
}

/// Packages that the sanitizers check: those that run graphs, without plugins that use external libraries.
const SANITIZED: &[&str] =
    &["panoscope-base", "panoscope-graph", "panoscope-engine", "panoscope-host", "panoscope-record"];

const ALL: Suite = Suite { name: "all", lints: true, packages: &[], filter: "", env: &[], sanitizer: None };

/// A campaign: a test that draws cases from a seed. `test` runs a few cases of each, `test NAME` and `test campaign`
/// the number given here.
const fn campaign(
    name: &'static str,
    packages: &'static [&'static str],
    filter: &'static str,
    env: &'static [(&'static str, &'static str)],
) -> Suite {
    Suite { name, packages, filter, env, lints: false, sanitizer: None }
}

/// Parts of the tests that are not campaigns.
static SUITES: &[Suite] = &[
    ALL,
    Suite { name: "lint", ..ALL },
    Suite { name: "code", lints: false, ..ALL },
    // The runtime without foreign libraries, built with a sanitizer. Both have a heap of their own, so the counters of the C library's are not tested.
    Suite {
        name: "asan",
        lints: false,
        packages: SANITIZED,
        filter: "not test(heap::tests)",
        env: &[("ASAN_OPTIONS", sanitizer::ASAN_OPTIONS)],
        sanitizer: Some(Sanitizer::Address),
    },
    Suite {
        name: "tsan",
        lints: false,
        packages: SANITIZED,
        filter: "not test(heap::tests)",
        env: &[("PANOSCOPE_FAULT_CASES", "20")],
        sanitizer: Some(Sanitizer::Thread),
    },
];

/// The campaigns with their full numbers of cases. Each also reads a seed from the environment, such as
/// `PANOSCOPE_FAULT_SEED`.
static CAMPAIGNS: &[Suite] = &[
    campaign("faults", &["panoscope-engine"], "test(/^campaign::/)", &[("PANOSCOPE_FAULT_CASES", "2000")]),
    campaign(
        "hostile-models",
        &["panoscope-tools"],
        "test(/^hostile_campaign::/)",
        &[("PANOSCOPE_HOSTILE_CASES", "200")],
    ),
    // Disk full, I/O errors and kills at every operation on files.
    campaign("disk", &["panoscope-sinks", "panoscope-record"], "test(/^disk::/)", &[("PANOSCOPE_DISK_TICKS", "12")]),
    campaign(
        "damaged-streams",
        &["panoscope-capture"],
        "test(/^damaged_streams::/)",
        &[("PANOSCOPE_DAMAGE_CASES", "1000")],
    ),
    // Edits of running graphs; processes of nodes that die; programs that are killed, put to sleep, run twice, or find the disk full.
    campaign(
        "losses",
        &["panoscope-engine", "panoscope-tests"],
        "test(/^(edit_campaign|deaths|losses)::/)",
        &[("PANOSCOPE_EDIT_CASES", "300"), ("PANOSCOPE_DEATH_CASES", "300"), ("PANOSCOPE_LOSS_CASES", "400")],
    ),
    // Ticks of more than twelve hours.
    campaign("soak", &["panoscope-tests"], "test(/^soak::/)", &[("PANOSCOPE_SOAK_MINUTES", "10")]),
    // A study whose driver and runs are killed.
    campaign(
        "batches",
        &["panoscope-tests"],
        "test(/^batches::/)",
        &[("PANOSCOPE_BATCH_KILLS", "50"), ("PANOSCOPE_BATCH_RUNS", "100")],
    ),
    // Many runs in one process of Python.
    campaign("leaks", &["panoscope-tests"], "test(/^python_host::runs_and/)", &[("PANOSCOPE_LEAK_RUNS", "500")]),
    // Faults of the network between two machines.
    campaign("network", &["panoscope-tests"], "test(/^machines::/)", &[("PANOSCOPE_NETWORK_FAULTS", "1000")]),
    // Killed while saving, keeping a still, recording a clip; graphs in which everything fails.
    campaign("kill", &["panoscope-editor"], "test(/^kill::/)", &[]),
    // What the theatre shows while cameras stop, slip, swap and return and processes die.
    campaign("pictures", &["panoscope-theatre"], "test(/^campaign::/)", &[("PANOSCOPE_PICTURE_CASES", "1000")]),
    // PANOSCOPE_ARM_BESIDE chooses how many cases run at a time.
    campaign("arm", &["panoscope-arm-guard"], "test(/^campaign::/)", &[("PANOSCOPE_ARM_CASES", "10000")]),
    campaign("sim", &["panoscope-sim"], "test(/^simulation::/)", &[("PANOSCOPE_SIM_CASES", "10000")]),
];

/// All campaigns together.
const CAMPAIGN: &str = "campaign";

/// Names of all suites, for messages.
fn names() -> String {
    let suites = SUITES.iter().chain(CAMPAIGNS).map(|suite| suite.name);
    suites.chain([CAMPAIGN]).collect::<Vec<_>>().join(", ")
}

/// Arguments of the command.
struct Request<'a> {
    suites: Vec<&'static Suite>,
    /// Arguments for `cargo nextest run`.
    arguments: &'a [String],
}

impl<'a> Request<'a> {
    fn parse(args: &'a [String]) -> Result<Self> {
        let (suite, arguments) = match args.iter().position(|arg| arg == "--") {
            Some(at) => (&args[..at], &args[at + 1..]),
            None => (args, &[][..]),
        };
        let name = match suite {
            [] => "all",
            [name] => name.as_str(),
            [_, other, ..] => bail!("unexpected argument `{other}`; put arguments of `cargo nextest run` after `--`"),
        };
        let suites: Vec<&Suite> = match name {
            CAMPAIGN => CAMPAIGNS.iter().collect(),
            name => SUITES.iter().chain(CAMPAIGNS).filter(|suite| suite.name == name).collect(),
        };
        if suites.is_empty() {
            bail!("there is no test suite `{name}`; there are: {}", names());
        }
        Ok(Self { suites, arguments })
    }

    fn lints(&self) -> bool {
        self.suites.iter().any(|suite| suite.lints)
    }

    fn tests(&self) -> bool {
        self.suites.iter().any(|suite| suite.name != "lint")
    }

    fn sanitizer(&self) -> Option<Sanitizer> {
        self.suites.iter().find_map(|suite| suite.sanitizer)
    }

    /// Packages whose tests run; empty: all.
    fn packages(&self) -> Vec<&str> {
        let mut named = self.arguments.iter();
        let mut packages: Vec<&str> = self.suites.iter().flat_map(|suite| suite.packages.iter().copied()).collect();
        while let Some(arg) = named.next() {
            match arg.strip_prefix("--package=").or_else(|| arg.strip_prefix("-p").filter(|name| !name.is_empty())) {
                Some(name) => packages.push(name),
                None if arg == "-p" || arg == "--package" => packages.extend(named.next().map(String::as_str)),
                None => {}
            }
        }
        packages
    }

    /// Filter expression of nextest. `None` if every test of the packages runs.
    fn filter(&self) -> Option<String> {
        let parts = self.suites.iter().filter(|suite| !suite.filter.is_empty()).map(|suite| {
            let packages: Vec<String> = suite.packages.iter().map(|name| format!("package({name})")).collect();
            format!("(({}) and {})", packages.join(" or "), suite.filter)
        });
        let parts: Vec<String> = parts.collect();
        (!parts.is_empty()).then(|| parts.join(" or "))
    }
}

/// Runs a suite. The last line of standard output is `N passed, N failed, N skipped`; a step that fails ends the
/// run and counts as failed.
pub fn test(workspace: &Workspace, args: &[String]) -> Result<ExitCode> {
    let request = Request::parse(args)?;
    let mut tally = Tally::default();
    if let Err(error) = steps(workspace, &request, &mut tally) {
        eprintln!("error: {error:#}");
        if let Some(mib) = free_mib(&workspace.target).filter(|mib| *mib < MIN_FREE_MIB) {
            eprintln!("only {mib} MiB are free in {}: the build needs 15 GiB", workspace.target.display());
        }
        if tally.failed() == 0 {
            // The outermost context is the step's name.
            tally.count_failed_step(&error.to_string());
        }
    }
    for line in tally.details() {
        println!("{line}");
    }
    println!("{}", tally.summary());
    Ok(if tally.failed() == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn steps(workspace: &Workspace, request: &Request, tally: &mut Tally) -> Result<()> {
    timed("set-up", || {
        setup::ensure(&[Purpose::Build, Purpose::Test])?;
        if let Err(error) = setup::ensure(&[Purpose::Screens]) {
            println!("Tests that open windows skip: {error:#}");
        }
        Ok(())
    })?;
    lint::require_clippy(workspace)?;
    if request.lints() {
        timed("format", || lint::format(workspace))?;
    }
    if !request.tests() {
        return timed("lint", || build::check_all(workspace));
    }
    let packages = request.packages();
    let nextest = tool::ensure(workspace, nextest::PROGRAM)?;
    // Downloads take the network, compilers the processors.
    let (fetched, built) = std::thread::scope(|scope| {
        let fetched = scope.spawn(|| Fetched::new(workspace, packages.is_empty() || needs_program(&packages)));
        let built = timed("build", || match packages[..] {
            [] => build_for_tests(workspace, Extent::Workspace),
            _ => build_for_tests(workspace, if needs_program(&packages) { Extent::Product } else { Extent::Plugins }),
        });
        (fetched.join().expect("fetching reports its errors"), built)
    });
    let built = built?;
    let mut cargo = match request.sanitizer() {
        None => workspace.cargo_dev(),
        Some(sanitizer) => sanitizer.cargo(workspace)?,
    };
    test_environment(&mut cargo, workspace, &built)?;
    fetched.put_into(&mut cargo);
    let env = request.suites.iter().flat_map(|suite| suite.env);
    for (name, value) in env.filter(|(name, _)| std::env::var_os(name).is_none()) {
        cargo.env(name, value);
    }
    nextest.put_into(&mut cargo)?;
    nextest::run(&mut cargo)?;
    if let Some(sanitizer) = request.sanitizer() {
        cargo.args(sanitizer.arguments());
    }
    if packages.is_empty() {
        cargo.arg("--workspace").args(build::REST);
    } else {
        cargo.args(build::FEATURES);
        cargo.args(request.suites.iter().flat_map(|suite| suite.packages).flat_map(|name| ["--package", name]));
    }
    if let Some(filter) = request.filter() {
        cargo.args(["--filterset", &filter]);
    }
    cargo.args(request.arguments);
    let tested = timed("tests", || {
        let report = nextest::report_file(workspace, request.sanitizer());
        let _ = std::fs::remove_file(&report);
        let outcome = process::run(&mut cargo);
        // Without a report nothing ran, and the outcome says why.
        if let Ok(text) = std::fs::read_to_string(&report) {
            tally.read(&text)?;
        }
        outcome
    });
    let examples = match packages.is_empty() {
        true => timed("examples in docs", || documented_examples(workspace)),
        false => Ok(()),
    };
    time::record(workspace, tally)?;
    tested.and(examples)
}

/// Runs the examples in the documentation of the packages that have some, which nextest does not run.
fn documented_examples(workspace: &Workspace) -> Result<()> {
    let mut cargo = workspace.cargo_dev();
    cargo.args(["test", "--quiet", "--doc"]).args(build::FEATURES);
    cargo.args(WITH_EXAMPLES.iter().flat_map(|name| ["--package", name]));
    process::capture(&mut cargo).map(drop)
}

/// Whether tests of these packages start the program, which then has to be built first.
fn needs_program(packages: &[&str]) -> bool {
    !packages.iter().all(|name| BELOW_PROGRAM.contains(name))
}

/// Downloads for tests.
struct Fetched {
    numpy: Option<PathBuf>,
    peers: Option<PathBuf>,
}

impl Fetched {
    /// Fetches missing files. Tests that need a file that cannot be fetched are skipped.
    fn new(workspace: &Workspace, with_peers: bool) -> Self {
        // Tests of models name what they skipped without it.
        if let Err(error) = onnxruntime::fetch(workspace) {
            println!("ONNX Runtime was not fetched: {error:#}");
        }
        // Tests of crates below the program need none.
        Self { numpy: NUMPY.folder(workspace), peers: with_peers.then(|| PEERS.folder(workspace)).flatten() }
    }

    fn put_into(&self, cargo: &mut Command) {
        if let Some(folder) = &self.numpy {
            cargo.env("PYTHONPATH", folder);
        }
        if let Some(folder) = &self.peers {
            cargo.env(PEERS_VARIABLE, folder);
        }
    }
}

/// Free space of the disk of a folder, MiB; `None` if unknown.
fn free_mib(folder: &Path) -> Option<u64> {
    let text = process::capture(Command::new("df").args(["--block-size=1M", "--output=avail"]).arg(folder)).ok()?;
    text.lines().nth(1)?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn arguments_go_to_nextest() {
        let args = words("code -- -p panoscope-graph cycle --package=panoscope-node");
        let request = Request::parse(&args).unwrap();
        assert_eq!(request.suites[0].name, "code");
        assert_eq!(request.arguments, words("-p panoscope-graph cycle --package=panoscope-node"));
        assert_eq!(request.packages(), ["panoscope-graph", "panoscope-node"]);
        assert!(!needs_program(&request.packages()) && needs_program(&["panoscope-graph", "panoscope-cli"]));
        assert_eq!(request.filter(), None);
        let all = Request::parse(&[]).unwrap();
        assert!(all.suites[0].name == "all" && all.packages().is_empty());
    }

    #[test]
    fn a_campaign_is_a_filter_over_its_packages() {
        let args = words("disk");
        let request = Request::parse(&args).unwrap();
        let filter = "((package(panoscope-sinks) or package(panoscope-record)) and test(/^disk::/))";
        assert_eq!(request.filter().as_deref(), Some(filter));
        let args = words("campaign");
        let all = Request::parse(&args).unwrap();
        assert_eq!(all.suites.len(), CAMPAIGNS.len());
        assert!(all.filter().unwrap().contains(&format!("{filter} or ")));
    }

    #[test]
    fn free_space_is_told() {
        assert!(free_mib(Path::new("/")).is_some());
        assert_eq!(free_mib(Path::new("/no/such/folder")), None);
    }

    #[test]
    fn an_unknown_suite_lists_the_known_ones() {
        let args = words("fualts");
        let error = Request::parse(&args).err().unwrap().to_string();
        assert_eq!(
            error,
            "there is no test suite `fualts`; there are: all, lint, code, asan, tsan, faults, hostile-models, disk, damaged-streams, losses, soak, batches, leaks, network, kill, pictures, arm, sim, campaign"
        );
        let args = words("code filter");
        assert!(Request::parse(&args).err().unwrap().to_string().contains("after `--`"));
    }
}
