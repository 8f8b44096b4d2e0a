//! Results of tests, from the JUnit file that `cargo nextest` writes.

use std::time::Duration;

use anyhow::{Context, Result};
use roxmltree::{Document, Node};

/// Result of one test.
#[derive(Debug, Clone, PartialEq)]
pub struct TestResult {
    /// The test program, such as `panoscope-engine::tests`.
    pub program: String,
    pub name: String,
    pub time: Duration,
    pub failed: bool,
    /// Reasons that it printed as `skipped: <reason>`.
    pub skips: Vec<String>,
}

/// All results of a run.
///
/// A test that lacks its data prints a line `skipped: <reason>` and returns; nextest counts that as passed, here it
/// counts as skipped.
#[derive(Debug, Default)]
pub struct Tally {
    pub results: Vec<TestResult>,
    /// Steps that are not tests, such as the format check.
    failed_steps: Vec<String>,
}

impl Tally {
    /// Adds the results of a run.
    ///
    /// # Errors
    /// The text is not a JUnit report.
    pub fn read(&mut self, junit: &str) -> Result<()> {
        let document = Document::parse(junit).context("the report of the tests is not XML")?;
        for suite in document.descendants().filter(|node| node.has_tag_name("testsuite")) {
            let program = suite.attribute("name").unwrap_or_default();
            let cases = suite.children().filter(|node| node.has_tag_name("testcase"));
            self.results.extend(cases.map(|case| test_result(program, case)));
        }
        Ok(())
    }

    /// Counts a step that is not a test, such as the format check or a build.
    pub fn count_failed_step(&mut self, step: &str) {
        self.failed_steps.push(step.to_owned());
    }

    /// Number of tests and steps that failed.
    pub fn failed(&self) -> usize {
        self.failed_steps.len() + self.results.iter().filter(|result| result.failed).count()
    }

    /// Every reason for a skipped test and every failure, one per line.
    pub fn details(&self) -> Vec<String> {
        let skips = self.results.iter().flat_map(|result| {
            result.skips.iter().map(move |reason| format!("skipped: {} {}: {reason}", result.program, result.name))
        });
        let failures = self.results.iter().filter(|result| result.failed);
        let failures = failures.map(|result| format!("failed: {} {}", result.program, result.name));
        skips.chain(failures).chain(self.failed_steps.iter().map(|step| format!("failed: {step}"))).collect()
    }

    /// `N passed, N failed, N skipped`.
    pub fn summary(&self) -> String {
        // A test that failed after it reported a skip is only a failure.
        let skipped = self.results.iter().filter(|result| !result.failed && !result.skips.is_empty()).count();
        let passed = self.results.iter().filter(|result| !result.failed).count() - skipped;
        format!("{passed} passed, {} failed, {skipped} skipped", self.failed())
    }

    /// The `count` slowest tests, slowest first, and the `count` programs with the longest total time of tests.
    pub fn slowest(&self, count: usize) -> (Vec<&TestResult>, Vec<(&str, Duration)>) {
        let mut tests: Vec<&TestResult> = self.results.iter().collect();
        tests.sort_by_key(|result| std::cmp::Reverse(result.time));
        tests.truncate(count);
        let mut programs: Vec<(&str, Duration)> = Vec::new();
        for result in &self.results {
            match programs.iter_mut().find(|(program, _)| *program == result.program) {
                Some((_, time)) => *time += result.time,
                None => programs.push((&result.program, result.time)),
            }
        }
        programs.sort_by_key(|(_, time)| std::cmp::Reverse(*time));
        programs.truncate(count);
        (tests, programs)
    }
}

fn test_result(program: &str, case: Node) -> TestResult {
    let output = case.children().filter(|node| node.has_tag_name("system-out")).filter_map(|node| node.text());
    let skips = output.flat_map(str::lines).filter_map(|line| line.trim_start().strip_prefix("skipped:"));
    let skips = skips.map(|reason| reason.trim().to_owned()).collect();
    let seconds = case.attribute("time").and_then(|time| time.parse().ok()).unwrap_or_default();
    TestResult {
        program: program.to_owned(),
        name: case.attribute("name").unwrap_or_default().to_owned(),
        time: Duration::try_from_secs_f64(seconds).unwrap_or_default(),
        failed: case.children().any(|node| node.has_tag_name("failure") || node.has_tag_name("error")),
        skips,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REPORT: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<testsuites name="nextest-run" tests="4" failures="1" errors="0" time="3.1">
  <testsuite name="panoscope-a::tests" tests="3" disabled="0" errors="0" failures="1">
    <testcase name="one" classname="panoscope-a::tests" time="0.5"><system-out>
running 1 test
skipped: the leuven pair is not installed
skipped: the graf pair is not installed
test one ... ok
</system-out><system-err>skipped: one: the leuven pair is not installed</system-err></testcase>
    <testcase name="two" classname="panoscope-a::tests" time="1.25"><system-out>skipped: half of it</system-out>
      <failure message="no" type="test failure">panicked</failure></testcase>
    <testcase name="three" classname="panoscope-a::tests" time="0.25"/>
  </testsuite>
  <testsuite name="panoscope-b" tests="1" disabled="0" errors="0" failures="0">
    <testcase name="one" classname="panoscope-b" time="1.5"/>
  </testsuite>
</testsuites>"#;

    #[test]
    fn skips_are_not_passes_and_a_failure_is_not_hidden_behind_one() {
        let mut tally = Tally::default();
        tally.read(REPORT).unwrap();
        assert_eq!(tally.summary(), "2 passed, 1 failed, 1 skipped");
        assert_eq!(
            tally.details(),
            [
                "skipped: panoscope-a::tests one: the leuven pair is not installed",
                "skipped: panoscope-a::tests one: the graf pair is not installed",
                "skipped: panoscope-a::tests two: half of it",
                "failed: panoscope-a::tests two"
            ]
        );
        let (tests, programs) = tally.slowest(2);
        assert_eq!(tests.iter().map(|test| test.name.as_str()).collect::<Vec<_>>(), ["one", "two"]);
        assert_eq!(programs[0], ("panoscope-a::tests", Duration::from_secs(2)));
        assert!(tally.read("no report").is_err());
    }

    #[test]
    fn a_failed_step_counts() {
        let mut tally = Tally::default();
        tally.count_failed_step("format");
        assert_eq!((tally.failed(), tally.summary().as_str()), (1, "0 passed, 1 failed, 0 skipped"));
        assert_eq!(tally.details(), ["failed: format"]);
    }
}
