//! Terminal output: colour only on a terminal. A closed pipe is not an error, a full disk is.

use std::fmt::Arguments;
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use panoscope_base::secret::redact;

use crate::log_lines;

/// Writes a line to standard output.
#[macro_export]
macro_rules! out {
    ($($argument:tt)*) => { $crate::terminal::line(format_args!($($argument)*)) };
}

/// Writes a line to standard error.
#[macro_export]
macro_rules! log {
    ($($argument:tt)*) => { $crate::terminal::error_line(format_args!($($argument)*)) };
}

pub use {log, out};

/// Why standard output could not be written the first time.
static LOST: OnceLock<io::Error> = OnceLock::new();

/// Records what could not be written, for [`leave`]. A reader that has gone away has read what it wanted.
fn written(outcome: io::Result<()>) {
    if let Err(error) = outcome
        && error.kind() != ErrorKind::BrokenPipe
    {
        let _ = LOST.set(error);
    }
}

/// Writes a line to standard output, without the secrets of addresses in it.
pub fn line(text: Arguments<'_>) {
    written(writeln!(io::stdout().lock(), "{}", redact(&text.to_string())));
}

/// Whether lines on standard error are JSON objects.
static JSON_LINES: AtomicBool = AtomicBool::new(false);

/// Makes each further line on standard error a JSON object, also those of signals and crashes, and there is no colour.
pub fn write_json_lines() {
    JSON_LINES.store(true, Ordering::Relaxed);
    panoscope_engine::ending::write_json_lines();
}

/// Writes a line to standard error, without the secrets of addresses in it.
pub fn error_line(text: Arguments<'_>) {
    let text = text.to_string();
    let text = redact(&text);
    match JSON_LINES.load(Ordering::Relaxed) {
        true => finished_error_line(&log_lines::json_of_message(&text)),
        false => finished_error_line(&text),
    }
}

/// Writes a line of a log to standard error unchanged.
pub fn finished_error_line(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Writes text unchanged to standard output.
pub fn raw(text: &str) {
    written(io::stdout().lock().write_all(text.as_bytes()));
}

fn color_wanted() -> bool {
    std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty())
}

/// Whether standard output takes colour.
pub fn stdout_color() -> bool {
    io::stdout().is_terminal() && color_wanted()
}

/// Whether standard error takes colour.
pub fn stderr_color() -> bool {
    io::stderr().is_terminal() && color_wanted() && !JSON_LINES.load(Ordering::Relaxed)
}

/// Leaves the process at once: destructors of C++ libraries loaded by plugins may crash. Success becomes 1 if standard output could not be written.
pub fn leave(code: i32) -> ! {
    written(io::stdout().flush());
    let lost = LOST.get();
    if let Some(error) = lost {
        log!("error: standard output cannot be written: {error}");
    }
    let _ = io::stderr().flush();
    panoscope_engine::ending::leave(if lost.is_some() && code == 0 { 1 } else { code })
}
