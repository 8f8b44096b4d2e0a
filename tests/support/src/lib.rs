//! What tests of every crate share. Depends on nothing, so that any crate can use it as a dev-dependency.

#![forbid(unsafe_code)]

use std::fmt::Arguments;
use std::io::Write;

/// Reports that the current test was skipped, with the reason as in `println!`. The test returns afterwards.
///
/// ```
/// if !std::path::Path::new("/no/such/data").exists() {
///     return panoscope_testing::skipped!("there is no {}", "/no/such/data");
/// }
/// ```
#[macro_export]
macro_rules! skipped {
    ($($reason:tt)*) => { $crate::report_skip(format_args!($($reason)*)) };
}

/// Prints `skipped: REASON` as the test's own output, which `cargo xtask test` counts, and `skipped: TEST: REASON` to
/// standard error.
///
/// libtest hides the output of a test that passes. It captures `println!` but not what is written to the handle of
/// standard error, so plain `cargo test` shows that line.
pub fn report_skip(reason: Arguments<'_>) {
    println!("skipped: {reason}");
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    // A closed standard error hides the line; the test is skipped all the same.
    let _ = writeln!(std::io::stderr(), "skipped: {test}: {reason}");
}
