//! `cargo xtask time`: shows the times of the last `cargo xtask test`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::tally::Tally;
use crate::workspace::Workspace;

/// Number of listed packages, programs and tests.
const LISTED: usize = 20;

/// Seconds of each step of this process, in order.
static STEPS: Mutex<Vec<(&'static str, f64)>> = Mutex::new(Vec::new());

/// Runs a step, prints its duration and prefixes an error with its name.
pub fn timed<T>(step: &'static str, run: impl FnOnce() -> Result<T>) -> Result<T> {
    let start = Instant::now();
    let outcome = run();
    let seconds = start.elapsed().as_secs_f64();
    println!("[{step}: {seconds:.1} s]");
    if let Ok(mut steps) = STEPS.lock() {
        steps.push((step, seconds));
    }
    outcome.context(step)
}

fn file(workspace: &Workspace) -> PathBuf {
    workspace.target.join("test_times.json")
}

/// Folder of the reports that `cargo build --timings` writes.
fn reports(workspace: &Workspace) -> PathBuf {
    workspace.target.join("cargo-timings")
}

/// Removes the reports of earlier builds.
pub fn forget_builds(workspace: &Workspace) {
    let _ = fs::remove_dir_all(reports(workspace));
}

/// Saves the times of this run for `cargo xtask time`.
///
/// # Errors
/// The file cannot be written.
pub fn record(workspace: &Workspace, tally: &Tally) -> Result<()> {
    let (tests, programs) = tally.slowest(LISTED);
    let steps = STEPS.lock().map(|steps| steps.clone()).unwrap_or_default();
    let record = json!({
        "steps": steps,
        "packages": compile_times(&reports(workspace).join("cargo-timing.html")),
        "programs": programs.iter().map(|(name, time)| (name, time.as_secs_f64())).collect::<Vec<_>>(),
        "tests": tests.iter().map(|test| (format!("{} {}", test.program, test.name), test.time.as_secs_f64())).collect::<Vec<_>>(),
    });
    let file = file(workspace);
    fs::write(&file, record.to_string()).with_context(|| format!("cannot write {}", file.display()))
}

/// Compile times of the packages of a build, s, over all targets of each; longest first. Empty if nothing was compiled.
fn compile_times(report: &Path) -> Vec<(String, f64)> {
    let text = fs::read_to_string(report).unwrap_or_default();
    let units = text.split_once("const UNIT_DATA = ").and_then(|(_, rest)| rest.split_once("];"));
    let units: Vec<Value> =
        units.and_then(|(list, _)| serde_json::from_str(&format!("{list}]")).ok()).unwrap_or_default();
    let mut times: BTreeMap<String, f64> = BTreeMap::new();
    for unit in &units {
        let (Some(name), Some(duration)) = (unit["name"].as_str(), unit["duration"].as_f64()) else { continue };
        *times.entry(name.to_owned()).or_default() += duration;
    }
    let mut times: Vec<(String, f64)> = times.into_iter().collect();
    times.sort_by(|a, b| b.1.total_cmp(&a.1));
    times.truncate(LISTED);
    times
}

/// Prints the seconds of each step of the last run, and of the slowest packages, test programs and tests.
///
/// # Errors
/// No run was recorded.
pub fn time(workspace: &Workspace) -> Result<()> {
    let text = fs::read_to_string(file(workspace)).context("no times yet: run `cargo xtask test` first")?;
    let record: Value = serde_json::from_str(&text).context("the recorded times are not JSON")?;
    let titles = [
        ("steps", "Steps, s"),
        ("packages", "Packages, s of one core to compile, all targets"),
        ("programs", "Test programs, s over all tests"),
        ("tests", "Tests, s"),
    ];
    for (key, title) in titles {
        println!("{title}");
        for entry in record[key].as_array().into_iter().flatten() {
            println!("{:9.1}  {}", entry[1].as_f64().unwrap_or_default(), entry[0].as_str().unwrap_or_default());
        }
        println!();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_times_of_a_build_are_summed_by_package() {
        let folder = std::env::temp_dir().join(format!("xtask_time_{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let report = folder.join("r.html");
        let units =
            r#"[{"name":"a","duration":1.5,"target":""},{"name":"b","duration":4},{"name":"a","duration":3.0}]"#;
        fs::write(&report, format!("<script>\nconst UNIT_DATA = {units};\nconst CONCURRENCY_DATA = [];")).unwrap();
        assert_eq!(compile_times(&report), [("a".to_owned(), 4.5), ("b".to_owned(), 4.0)]);
        fs::write(&report, "<html>").unwrap();
        assert_eq!(compile_times(&report), []);
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_step_puts_its_name_before_its_error() {
        let error = timed("build", || -> Result<()> { anyhow::bail!("no space") }).unwrap_err();
        assert_eq!(format!("{error:#}"), "build: no space");
    }
}
