//! Counts tests from what `cargo test` prints.

use std::collections::BTreeMap;

/// The sum over all test programs of one `cargo test -- --show-output`.
///
/// A test that lacks its data prints a line `skipped: <reason>` and returns; libtest calls that passed, here it is
/// skipped. Ignored tests are skipped as well.
#[derive(Debug, Default)]
pub struct Tally {
    passed: usize,
    failed: usize,
    ignored: usize,
    /// Reasons by test; the name of a test may occur in several programs.
    skips: BTreeMap<(usize, String), Vec<String>>,
    failures: Vec<String>,
    /// Number of `test result` lines so far, which is the number of the current program.
    programs: usize,
    /// The test whose output is being listed.
    section: Option<String>,
    in_successes: bool,
}

impl Tally {
    /// Takes one line of output; false for the listed output of tests that passed, which only clutters.
    pub fn read(&mut self, line: &str) -> bool {
        if let Some(counts) = line.strip_prefix("test result: ") {
            self.end_program(counts);
            return true;
        }
        match line {
            "successes:" => (self.in_successes, self.section) = (true, None),
            "failures:" => (self.in_successes, self.section) = (false, None),
            _ => {}
        }
        let test = line.strip_prefix("---- ").and_then(|rest| rest.strip_suffix(" stdout ----"));
        if let Some(test) = test {
            self.section = Some(test.to_owned());
        } else if let Some(reason) = line.trim_start().strip_prefix("skipped:") {
            let test = self.section.clone().unwrap_or_default();
            self.skips.entry((self.programs, test)).or_default().push(reason.trim().to_owned());
        } else if let Some(test) = line.strip_prefix("test ").and_then(|rest| rest.strip_suffix(" ... FAILED")) {
            self.failures.push(test.to_owned());
        }
        !self.in_successes
    }

    /// Reads such as `ok. 3 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.01s`.
    fn end_program(&mut self, counts: &str) {
        let (_, counts) = counts.split_once(". ").unwrap_or(("", counts));
        for count in counts.split("; ") {
            let Some((number, what)) = count.split_once(' ') else { continue };
            let Ok(number) = number.parse::<usize>() else { continue };
            match what {
                "passed" => self.passed += number,
                "failed" => self.failed += number,
                "ignored" => self.ignored += number,
                _ => {}
            }
        }
        self.programs += 1;
        (self.in_successes, self.section) = (false, None);
    }

    /// Counts a step that is no test, such as the format check or a test program that crashed.
    pub fn count_failed_step(&mut self, step: &str) {
        self.failed += 1;
        self.failures.push(step.to_owned());
    }

    /// Tests and steps that failed.
    pub fn failed(&self) -> usize {
        self.failed
    }

    /// Every reason a test was skipped for and every failure, one a line.
    pub fn details(&self) -> Vec<String> {
        let skips = self.skips.iter().flat_map(|((_, test), reasons)| {
            reasons.iter().map(move |reason| match test.as_str() {
                "" => format!("skipped: {reason}"),
                test => format!("skipped: {test}: {reason}"),
            })
        });
        skips.chain(self.failures.iter().map(|failure| format!("failed: {failure}"))).collect()
    }

    /// `N passed, N failed, N skipped`.
    pub fn summary(&self) -> String {
        // A test that failed after it reported a skip is only a failure.
        let reported: usize =
            self.skips.keys().filter(|(_, test)| !test.is_empty() && !self.failures.contains(test)).count();
        let reported = reported.min(self.passed);
        format!("{} passed, {} failed, {} skipped", self.passed - reported, self.failed, self.ignored + reported)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OUTPUT: &str = "
running 3 tests
test a::one ... ok
test a::two ... ok
test slow ... ignored

successes:

---- a::two stdout ----
looking for data
skipped: the leuven pair is not installed
skipped: the graf pair is not installed


successes:
    a::one
    a::two

test result: ok. 2 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.00s


running 2 tests
test a::two ... ok
test b ... FAILED

successes:

successes:
    a::two

failures:

---- b stdout ----

thread 'b' (7) panicked at tests/b.rs:3:5:
no

failures:
    b

test result: FAILED. 1 passed; 1 failed; 0 ignored; 0 measured; 0 filtered out; finished in 0.00s


running 12 tests
test result: ok. 12 passed; 0 failed; 0 ignored; 0 measured; 0 filtered out; finished in 1.20s; merged doctests
";

    #[test]
    fn counts_are_summed_and_skips_are_no_passes() {
        let mut tally = Tally::default();
        let shown: Vec<&str> = OUTPUT.lines().filter(|line| tally.read(line)).collect();
        assert_eq!(tally.summary(), "14 passed, 1 failed, 2 skipped");
        assert_eq!(
            tally.details(),
            [
                "skipped: a::two: the leuven pair is not installed",
                "skipped: a::two: the graf pair is not installed",
                "failed: b"
            ]
        );
        assert!(shown.contains(&"test a::one ... ok") && shown.contains(&"no"), "failures stay visible");
        assert!(!shown.contains(&"looking for data"), "the output of tests that passed is left out");
        assert_eq!(shown.iter().filter(|line| line.starts_with("test result")).count(), 3);
    }

    #[test]
    fn a_failed_step_counts() {
        let mut tally = Tally::default();
        tally.count_failed_step("cargo fmt");
        assert_eq!((tally.failed(), tally.summary().as_str()), (1, "0 passed, 1 failed, 0 skipped"));
        assert_eq!(tally.details(), ["failed: cargo fmt"]);
    }

    #[test]
    fn a_failure_is_not_hidden_behind_a_skip_line() {
        let mut tally = Tally::default();
        let text = "test c ... FAILED\n\nfailures:\n\n---- c stdout ----\nskipped: half of it\n\n\
                    failures:\n    c\n\ntest result: FAILED. 4 passed; 1 failed; 0 ignored; 0 measured; 0 filtered out";
        text.lines().for_each(|line| {
            tally.read(line);
        });
        assert_eq!(tally.summary(), "4 passed, 1 failed, 0 skipped");
    }
}
