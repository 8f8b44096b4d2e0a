//! Lines that nodes say while a graph runs, without drowning the terminal.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use panoscope_engine::log::{Level, LogFn};

/// The same words of the same node are shown once in this time.
const QUIET: Duration = Duration::from_secs(1);

/// Different words that are remembered.
const MOST_REMEMBERED: usize = 1000;

struct Seen {
    shown: Instant,
    left_out: u64,
}

/// Formats a line.
fn render(color: bool, level: Level, node: &str, words: &str, left_out: u64) -> String {
    let (word, style) = match level {
        Level::Error => ("error", "\x1b[1;31m"),
        Level::Warn => ("warning", "\x1b[1;33m"),
        Level::Info => ("info", "\x1b[1;32m"),
        Level::Debug => ("debug", "\x1b[2m"),
    };
    let again = if left_out > 0 { format!(" (and {left_out} times more)") } else { String::new() };
    if color {
        format!("{style}{word}\x1b[0m [{node}] {words}{again}")
    } else {
        format!("{word} [{node}] {words}{again}")
    }
}

/// A log that hands lines to `show`; debug lines only with `verbose`.
pub fn sink(verbose: bool, color: bool, show: impl Fn(&str) + Send + Sync + 'static) -> Box<LogFn> {
    let seen: Mutex<HashMap<String, Seen>> = Mutex::new(HashMap::new());
    Box::new(move |level, node, words| {
        if level == Level::Debug && !verbose {
            return;
        }
        let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
        if seen.len() >= MOST_REMEMBERED {
            seen.clear();
        }
        let now = Instant::now();
        let mut left_out = 0;
        if let Some(earlier) = seen.get_mut(&format!("{node}\n{words}")) {
            if now.duration_since(earlier.shown) < QUIET {
                earlier.left_out += 1;
                return;
            }
            left_out = std::mem::take(&mut earlier.left_out);
            earlier.shown = now;
        } else {
            seen.insert(format!("{node}\n{words}"), Seen { shown: now, left_out: 0 });
        }
        show(&render(color, level, node, &panoscope_loader::sealed::readable(words), left_out));
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[test]
    fn repeated_words_are_shown_once() {
        let lines = Arc::new(Mutex::new(Vec::new()));
        let into = Arc::clone(&lines);
        let log = sink(false, false, move |line| into.lock().unwrap().push(line.to_owned()));
        for _ in 0..100 {
            log(Level::Error, "stitch", "no memory");
        }
        log(Level::Error, "stitch", "other words");
        log(Level::Debug, "stitch", "details");
        assert_eq!(*lines.lock().unwrap(), ["error [stitch] no memory", "error [stitch] other words"]);
    }

    #[test]
    fn colour_is_left_out_where_it_is_not_wanted() {
        assert_eq!(render(false, Level::Warn, "a", "b", 3), "warning [a] b (and 3 times more)");
        assert!(render(true, Level::Warn, "a", "b", 0).contains("\x1b["));
    }
}
