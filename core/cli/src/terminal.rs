//! Writing for people: colour only on a terminal, and a closed pipe is no reason to fail.

use std::fmt::Arguments;
use std::io::{IsTerminal, Write};

/// Writes a line to standard output.
macro_rules! say {
    ($($argument:tt)*) => { $crate::terminal::line(format_args!($($argument)*)) };
}

/// Writes a line to standard error.
macro_rules! tell {
    ($($argument:tt)*) => { $crate::terminal::error_line(format_args!($($argument)*)) };
}

pub(crate) use {say, tell};

/// Writes a line to standard output.
pub fn line(text: Arguments<'_>) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// Writes a line to standard error.
pub fn error_line(text: Arguments<'_>) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Writes text as it is to standard output.
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
    std::io::stderr().is_terminal() && color_wanted()
}

/// Leaves the process at once: destructors of C++ libraries that plugins loaded are not to be trusted.
pub fn leave(code: i32) -> ! {
    let _ = std::io::stdout().flush();
    let _ = std::io::stderr().flush();
    panoscope_engine::ending::leave(code)
}

/// Lays out rows in columns: the first column to the left, numbers to the right. The first row is the head.
pub fn table(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| rows.iter().filter_map(|r| r.get(column)).map(|c| c.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let mut out = String::new();
    for row in rows {
        let mut line = String::from(" ");
        for (column, cell) in row.iter().enumerate() {
            let pad = " ".repeat(widths[column] - cell.chars().count());
            line.push_str(&if column == 0 { format!(" {cell}{pad}") } else { format!("  {pad}{cell}") });
        }
        out.push_str(line.trim_end());
        out.push('\n');
    }
    out
}

#[cfg(test)]
mod tests {
    #[test]
    fn columns_stand_below_each_other() {
        let rows = [vec!["node".to_owned(), "count".to_owned()], vec!["a".to_owned(), "7".to_owned()]];
        assert_eq!(super::table(&rows), "  node  count\n  a         7\n");
    }
}
