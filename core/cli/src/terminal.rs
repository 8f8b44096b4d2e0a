//! Terminal output: colour only on a terminal, and a closed pipe is not an error.

use std::fmt::Arguments;
use std::io::{IsTerminal, Write};
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

/// Writes a line to standard output, without the secrets of addresses in it.
pub fn line(text: Arguments<'_>) {
    let _ = writeln!(std::io::stdout().lock(), "{}", redact(&text.to_string()));
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
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Writes text unchanged to standard output.
pub fn raw(text: &str) {
    let _ = std::io::stdout().lock().write_all(text.as_bytes());
}

fn color_wanted() -> bool {
    std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty())
}

/// Whether standard output takes colour.
pub fn stdout_color() -> bool {
    std::io::stdout().is_terminal() && color_wanted()
}

/// Whether standard error takes colour.
pub fn stderr_color() -> bool {
    std::io::stderr().is_terminal() && color_wanted() && !JSON_LINES.load(Ordering::Relaxed)
}

/// Leaves the process at once: destructors of C++ libraries loaded by plugins may crash.
pub fn leave(code: i32) -> ! {
    let _ = std::io::stdout().flush();
    let _ = std::io::stderr().flush();
    panoscope_engine::ending::leave(code)
}
