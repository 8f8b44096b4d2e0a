//! `cargo xtask interlock`: measures how thoroughly the interlock is tested, by branch coverage and mutants: small
//! changes of its code that a test must detect.

use std::process::Command;

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::process;
use crate::tool;
use crate::workspace::Workspace;

const PACKAGE: &str = "panoscope-arm-core";
/// The measured files, relative to the workspace's root.
const FILES: &str = "core/robot/arm/src/interlock/";
/// Their tests.
const TESTS: &str = "interlock/tests/";
/// Minimum share of mutants that the tests detect, percent.
const MIN_SCORE: f64 = 90.0;
/// Branch coverage needs the nightly compiler.
const TOOLCHAIN: &str = "+nightly";

/// Measurements to make.
#[derive(Debug, PartialEq, Eq)]
struct Parts {
    coverage: bool,
    mutants: bool,
}

impl Parts {
    fn parse(args: &[String]) -> Result<Self> {
        match args.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
            [] => Ok(Self { coverage: true, mutants: true }),
            ["--coverage"] => Ok(Self { coverage: true, mutants: false }),
            ["--mutants"] => Ok(Self { coverage: false, mutants: true }),
            other => bail!("unknown argument `{}`: give `--coverage`, `--mutants` or nothing", other.join(" ")),
        }
    }
}

/// Measures the tests; fails below full coverage and below [`MIN_SCORE`].
///
/// # Errors
/// A tool cannot be installed or fails, or the tests miss too much, which the message lists.
pub fn interlock(workspace: &Workspace, args: &[String]) -> Result<()> {
    let parts = Parts::parse(args)?;
    if parts.coverage {
        coverage(workspace)?;
    }
    if parts.mutants {
        mutants(workspace)?;
    }
    Ok(())
}

fn coverage(workspace: &Workspace) -> Result<()> {
    let tools = tool::ensure(workspace, "cargo-llvm-cov")?;
    // `cargo` may be one compiler's own; the one in PATH chooses by toolchain.
    let mut cargo = Command::new("cargo");
    cargo.current_dir(&workspace.root).args([
        TOOLCHAIN,
        "llvm-cov",
        "--branch",
        "--json",
        "--package",
        PACKAGE,
        "--lib",
    ]);
    cargo.args(["--", "interlock"]);
    cargo
        .env("CARGO_TARGET_DIR", workspace.target.join("interlock"))
        .env_remove("RUSTUP_TOOLCHAIN")
        .env_remove("CARGO");
    tools.put_into(&mut cargo)?;
    println!("{}", process::shown(&cargo));
    let text = process::capture(&mut cargo).context(
        "branch coverage needs the nightly compiler and its LLVM tools: run `rustup toolchain install nightly --component llvm-tools`",
    )?;
    let files = covered(&text)?;
    let mut missed = Vec::new();
    for file in &files {
        println!(
            "{}: {} of {} branches, {} of {} lines",
            file.name, file.branches.0, file.branches.1, file.lines.0, file.lines.1
        );
        if file.branches.0 < file.branches.1 || file.lines.0 < file.lines.1 {
            missed.push(file.name.as_str());
        }
    }
    if files.is_empty() {
        bail!("cargo llvm-cov reports no file in {FILES}");
    }
    if !missed.is_empty() {
        bail!("the tests do not cover all lines and branches of {}", missed.join(", "));
    }
    Ok(())
}

/// Numbers of covered and of all branches and lines of a file.
#[derive(Debug, PartialEq, Eq)]
struct Covered {
    name: String,
    branches: (u64, u64),
    lines: (u64, u64),
}

/// Reads the report of `cargo llvm-cov --json`.
fn covered(text: &str) -> Result<Vec<Covered>> {
    let report: Value = serde_json::from_str(text).context("cargo llvm-cov wrote no JSON")?;
    let files = report["data"][0]["files"].as_array().context("cargo llvm-cov lists no files")?;
    let judged = files.iter().filter_map(|file| {
        let path = file["filename"].as_str()?;
        let name = &path[path.find(FILES)?..];
        let pair = |of: &str| {
            let part = &file["summary"][of];
            Some((part["covered"].as_u64()?, part["count"].as_u64()?))
        };
        (!name.contains(TESTS)).then_some(())?;
        Some(Covered { name: name.to_owned(), branches: pair("branches")?, lines: pair("lines")? })
    });
    Ok(judged.collect())
}

fn mutants(workspace: &Workspace) -> Result<()> {
    let tools = tool::ensure(workspace, "cargo-mutants")?;
    let output = workspace.target.join("interlock");
    std::fs::create_dir_all(&output)?;
    let mut cargo = workspace.cargo();
    cargo
        .args(["mutants", "--package", PACKAGE, "--file", &format!("{FILES}**"), "--no-shuffle", "--output"])
        .arg(&output);
    // Only the tests of this crate, built with little optimisation: most of the time is compiling.
    cargo.args(["--cargo-arg=--lib", "--cargo-arg=--config=profile.dev.package.panoscope-arm-core.opt-level=1"]);
    cargo.args(["--minimum-test-timeout=20", "--", "interlock"]);
    tools.put_into(&mut cargo)?;
    println!("{}", process::shown(&cargo));
    // Its exit code says that some survived; the score decides here.
    let status = cargo.status().context("cargo mutants cannot be started")?;
    let outcomes = output.join("mutants.out/outcomes.json");
    let text = std::fs::read_to_string(&outcomes)
        .with_context(|| format!("cargo mutants ({status}) wrote no {}", outcomes.display()))?;
    let score = Score::read(&text)?;
    for name in &score.survivors {
        println!("survived: {name}");
    }
    println!(
        "{} of {} mutants found: {:.1} %",
        score.found,
        score.found + score.survivors.len() as u64,
        score.percent()
    );
    if score.percent() < MIN_SCORE {
        bail!("the tests detect {:.1} % of the mutants, but {MIN_SCORE} % are required", score.percent());
    }
    Ok(())
}

/// Result of a run of mutants. Those that do not compile do not count.
#[derive(Debug, PartialEq, Eq)]
struct Score {
    found: u64,
    survivors: Vec<String>,
}

impl Score {
    /// Reads `outcomes.json`.
    fn read(text: &str) -> Result<Self> {
        let report: Value = serde_json::from_str(text).context("cargo mutants wrote no JSON")?;
        let outcomes = report["outcomes"].as_array().context("cargo mutants lists no outcomes")?;
        let name = |outcome: &Value| outcome["scenario"]["Mutant"]["name"].as_str().map(str::to_owned);
        let mutants: Vec<(&str, String)> =
            outcomes.iter().filter_map(|outcome| Some((outcome["summary"].as_str()?, name(outcome)?))).collect();
        let found = mutants.iter().filter(|(summary, _)| ["CaughtMutant", "Timeout"].contains(summary)).count();
        let survivors = mutants.iter().filter(|(summary, _)| *summary == "MissedMutant").map(|(_, name)| name.clone());
        let score = Self { found: found as u64, survivors: survivors.collect() };
        if score.found == 0 {
            bail!("cargo mutants tried nothing: its tests did not pass");
        }
        Ok(score)
    }

    fn percent(&self) -> f64 {
        100.0 * self.found as f64 / (self.found + self.survivors.len() as u64) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_chosen() {
        let parse = |words: &[&str]| Parts::parse(&words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>());
        assert_eq!(parse(&[]).ok(), Some(Parts { coverage: true, mutants: true }));
        assert_eq!(parse(&["--mutants"]).ok(), Some(Parts { coverage: false, mutants: true }));
        assert_eq!(parse(&["--coverage"]).ok(), Some(Parts { coverage: true, mutants: false }));
        assert!(parse(&["all"]).is_err_and(|error| error.to_string().contains("`all`")));
    }

    #[test]
    fn only_the_interlocks_own_files_are_judged() {
        let file = |name: &str, branches: u64| {
            format!(
                r#"{{"filename":"/a/{name}","summary":{{"branches":{{"count":9,"covered":{branches}}},"lines":{{"count":5,"covered":5}}}}}}"#
            )
        };
        let files = [
            file("core/robot/arm/src/interlock/brake.rs", 8),
            file("core/robot/arm/src/interlock/tests/brake.rs", 1),
            file("core/robot/arm/src/line.rs", 2),
        ];
        let text = format!(r#"{{"data":[{{"files":[{}]}}]}}"#, files.join(","));
        let name = "core/robot/arm/src/interlock/brake.rs".to_owned();
        assert_eq!(covered(&text).ok(), Some(vec![Covered { name, branches: (8, 9), lines: (5, 5) }]));
        assert!(covered("{}").is_err());
    }

    #[test]
    fn a_score_counts_what_compiles() {
        let outcome = |name: &str, summary: &str| {
            format!(r#"{{"scenario":{{"Mutant":{{"name":"{name}"}}}},"summary":"{summary}"}}"#)
        };
        let outcomes = [
            r#"{"scenario":"Baseline","summary":"Success"}"#.to_owned(),
            outcome("a", "CaughtMutant"),
            outcome("b", "Timeout"),
            outcome("c", "CaughtMutant"),
            outcome("d", "MissedMutant"),
            outcome("e", "Unviable"),
        ];
        let score = Score::read(&format!(r#"{{"outcomes":[{}]}}"#, outcomes.join(","))).expect("a report");
        assert_eq!((score.found, score.survivors.as_slice()), (3, &["d".to_owned()][..]));
        assert!((score.percent() - 75.0).abs() < 1e-9);
        assert!(Score::read(r#"{"outcomes":[]}"#).is_err());
    }
}
