//! `cargo xtask test`: everything that must hold before a change goes in.

use std::path::Path;
use std::process::{Command, ExitCode};
use std::time::Instant;

use anyhow::{Context, Result, bail};

use crate::build::{Extent, Profile, build_for_tests};
use crate::generated::test_environment;
use crate::lint;
use crate::onnxruntime;
use crate::packages::Purpose;
use crate::process;
use crate::python_packages::{NUMPY, PEERS, PEERS_VARIABLE};
use crate::sanitizer::{self, Sanitizer};
use crate::setup;
use crate::tally::Tally;
use crate::workspace::Workspace;

/// With less free space after a failure, the full disk is the probable reason: compilers do not say so.
const LEAST_FREE_MIB: u64 = 2048;

/// A named part of the tests.
struct Suite {
    name: &'static str,
    lints: bool,
    tests: bool,
    /// Arguments of `cargo test` that pick its tests.
    only: &'static [&'static str],
    /// Environment of its tests, where the caller has not set it.
    env: &'static [(&'static str, &'static str)],
    /// Built with a sanitizer of the nightly compiler.
    sanitizer: Option<Sanitizer>,
}

/// Packages that the sanitizers judge: those that run graphs, without plugins of foreign libraries.
const SANITIZED: &[&str] = &[
    "-p",
    "panoscope-base",
    "-p",
    "panoscope-graph",
    "-p",
    "panoscope-engine",
    "-p",
    "panoscope-isolate",
    "-p",
    "panoscope-loader",
    "-p",
    "panoscope-record",
    "--lib",
    "--tests",
];

/// Tests that `cargo test` runs with these arguments.
const fn tests(
    name: &'static str,
    only: &'static [&'static str],
    env: &'static [(&'static str, &'static str)],
) -> Suite {
    Suite { name, lints: false, tests: true, only, env, sanitizer: None }
}

static SUITES: &[Suite] = &[
    Suite { name: "all", lints: true, tests: true, only: &[], env: &[], sanitizer: None },
    Suite { name: "lint", lints: true, tests: false, only: &[], env: &[], sanitizer: None },
    tests("code", &[], &[]),
    // PANOSCOPE_FAULT_CASES and PANOSCOPE_FAULT_SEED choose how many cases and which.
    tests("faults", &["-p", "panoscope-engine", "--test", "campaign"], &[]),
    // PANOSCOPE_HOSTILE_CASES and PANOSCOPE_HOSTILE_SEED, the same.
    tests(
        "hostile-models",
        &["-p", "panoscope-tools", "--test", "hostile_campaign"],
        &[("PANOSCOPE_HOSTILE_CASES", "200")],
    ),
    // Disk full, I/O errors and kills at every operation on files; PANOSCOPE_DISK_TICKS chooses how many ticks each case has.
    tests(
        "disk",
        &["-p", "panoscope-sinks", "-p", "panoscope-record", "--test", "disk"],
        &[("PANOSCOPE_DISK_TICKS", "12")],
    ),
    // PANOSCOPE_DAMAGE_CASES and PANOSCOPE_DAMAGE_SEED choose how many damaged videos and which.
    tests(
        "damaged-streams",
        &["-p", "panoscope-capture", "--test", "damaged_streams"],
        &[("PANOSCOPE_DAMAGE_CASES", "1000")],
    ),
    // PANOSCOPE_DEATH_CASES and PANOSCOPE_DEATH_SEED, the same for processes of nodes that die.
    tests("deaths", &["-p", "panoscope-tests", "--test", "deaths"], &[("PANOSCOPE_DEATH_CASES", "500")]),
    // PANOSCOPE_NETWORK_FAULTS and PANOSCOPE_NETWORK_SEED, for faults of the network between two machines.
    tests("network", &["-p", "panoscope-tests", "--test", "machines"], &[("PANOSCOPE_NETWORK_FAULTS", "1000")]),
    // Killed while saving, keeping a still, recording a clip; graphs in which everything fails.
    tests("kill", &["-p", "panoscope-editor", "--test", "kill"], &[]),
    // The runtime without foreign libraries, built with a sanitizer.
    Suite {
        sanitizer: Some(Sanitizer::Address),
        ..tests("asan", SANITIZED, &[("ASAN_OPTIONS", sanitizer::ASAN_OPTIONS)])
    },
    Suite { sanitizer: Some(Sanitizer::Thread), ..tests("tsan", SANITIZED, &[("PANOSCOPE_FAULT_CASES", "20")]) },
    // PANOSCOPE_ARM_CASES, PANOSCOPE_ARM_SEED and PANOSCOPE_ARM_BESIDE choose how many cases, which, and how many at a time.
    tests("arm", &["-p", "panoscope-arm-guard", "--test", "campaign"], &[("PANOSCOPE_ARM_CASES", "10000")]),
    // PANOSCOPE_SIM_CASES and PANOSCOPE_SIM_SEED choose how many cases of the simulator and the first seed.
    tests("sim", &["-p", "panoscope-sim", "--test", "simulation"], &[("PANOSCOPE_SIM_CASES", "10000")]),
];

/// What the command line asks for.
struct Request<'a> {
    suite: &'static Suite,
    /// For cargo.
    cargo_args: &'a [String],
    /// For the test programs.
    test_args: &'a [String],
}

impl<'a> Request<'a> {
    fn parse(args: &'a [String]) -> Result<Self> {
        let (suite, passed_on) = split_at_dashes(args);
        let (cargo_args, test_args) = split_at_dashes(passed_on);
        let name = match suite {
            [] => "all",
            [name] => name.as_str(),
            [_, other, ..] => bail!("unexpected argument `{other}`; put arguments of `cargo test` after `--`"),
        };
        let suite = SUITES.iter().find(|suite| suite.name == name).with_context(|| {
            let known: Vec<&str> = SUITES.iter().map(|suite| suite.name).collect();
            format!("there is no test suite `{name}`; there are: {}", known.join(", "))
        })?;
        Ok(Self { suite, cargo_args, test_args })
    }

    fn names_packages(&self) -> bool {
        self.cargo_args.iter().any(|arg| arg.starts_with("-p") || arg.starts_with("--package"))
    }
}

fn split_at_dashes(args: &[String]) -> (&[String], &[String]) {
    match args.iter().position(|arg| arg == "--") {
        Some(at) => (&args[..at], &args[at + 1..]),
        None => (args, &[]),
    }
}

/// Runs a suite. The last line of standard output is `N passed, N failed, N skipped`; a step that fails ends the
/// run and counts as failed.
pub fn test(workspace: &Workspace, args: &[String]) -> Result<ExitCode> {
    let request = Request::parse(args)?;
    let mut tally = Tally::default();
    if let Err(error) = steps(workspace, &request, &mut tally) {
        eprintln!("error: {error:#}");
        if let Some(mib) = free_mib(&workspace.target).filter(|mib| *mib < LEAST_FREE_MIB) {
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
    timed("set-up", || setup::ensure(&[Purpose::Build, Purpose::Test]).map(drop))?;
    if let Err(error) = setup::ensure(&[Purpose::Screens]) {
        println!("Tests that open windows skip: {error:#}");
    }
    // Tests of models name what they skipped without it.
    if let Err(error) = onnxruntime::fetch(workspace) {
        println!("ONNX Runtime was not fetched: {error:#}");
    }
    let numpy = NUMPY.folder(workspace);
    if request.suite.lints {
        timed("format", || lint::format(workspace))?;
        timed("clippy", || lint::clippy(workspace))?;
    }
    if request.suite.tests {
        let is_whole = !request.names_packages() && request.suite.only.is_empty();
        let extent = if is_whole { Extent::Workspace } else { Extent::Product };
        let built = timed("build", || build_for_tests(workspace, Profile::Dev, extent))?;
        let mut cargo = match request.suite.sanitizer {
            None => workspace.cargo(),
            Some(sanitizer) => sanitizer.cargo(workspace)?,
        };
        test_environment(&mut cargo, workspace, &built)?;
        if let Some(folder) = &numpy {
            cargo.env("PYTHONPATH", folder);
        }
        // Only all tests together have some that need them.
        if request.suite.only.is_empty()
            && request.suite.sanitizer.is_none()
            && let Some(folder) = PEERS.folder(workspace)
        {
            cargo.env(PEERS_VARIABLE, folder);
        }
        for (name, value) in request.suite.env.iter().filter(|(name, _)| std::env::var_os(name).is_none()) {
            cargo.env(name, value);
        }
        cargo.args(["test", "--no-fail-fast"]);
        if let Some(sanitizer) = request.suite.sanitizer {
            cargo.args(sanitizer.arguments());
        }
        cargo.args(request.suite.only);
        if is_whole {
            cargo.arg("--workspace");
        }
        // Without it libtest hides the output of passing tests, which has the reasons of skips.
        cargo.args(request.cargo_args).args(["--", "--show-output"]).args(request.test_args);
        if request.suite.sanitizer.is_some() {
            cargo.args(Sanitizer::test_arguments());
        }
        timed("tests", || {
            let status = process::filter(&mut cargo, |line| tally.read(line))?;
            process::check(&cargo, status)
        })?;
    }
    Ok(())
}

/// Free space of the disk with a folder, MiB. None where it cannot be told.
fn free_mib(folder: &Path) -> Option<u64> {
    let text = process::capture(Command::new("df").args(["--block-size=1M", "--output=avail"]).arg(folder)).ok()?;
    text.lines().nth(1)?.trim().parse().ok()
}

/// Runs a step, prints how long it took and puts its name before its error.
fn timed<T>(step: &'static str, run: impl FnOnce() -> Result<T>) -> Result<T> {
    let start = Instant::now();
    let outcome = run();
    println!("[{step}: {:.1} s]", start.elapsed().as_secs_f64());
    outcome.context(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn arguments_go_to_cargo_and_to_the_test_programs() {
        let args = words("code -- -p panoscope-graph cycle -- --nocapture");
        let request = Request::parse(&args).unwrap();
        assert_eq!(request.suite.name, "code");
        assert_eq!(request.cargo_args, words("-p panoscope-graph cycle"));
        assert_eq!(request.test_args, words("--nocapture"));
        assert!(request.names_packages());
        assert_eq!(Request::parse(&[]).unwrap().suite.name, "all");
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
            "there is no test suite `fualts`; there are: all, lint, code, faults, hostile-models, disk, damaged-streams, deaths, network, kill, asan, tsan, arm, sim"
        );
        let args = words("code filter");
        assert!(Request::parse(&args).err().unwrap().to_string().contains("after `--`"));
    }
}
