//! Log lines of nodes while a graph runs, without flooding the terminal.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use panoscope_engine::log::{Level, LogFn};
use serde::Serialize;

/// Format of lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// Text for the terminal.
    Text,
    /// One JSON object per line.
    Json,
}

/// Minimum time between equal messages of the same node.
const QUIET: Duration = Duration::from_secs(1);

/// Maximum number of messages that are remembered.
const MAX_REMEMBERED: usize = 1000;

struct Seen {
    shown: Instant,
    left_out: u64,
}

/// A line as JSON.
#[derive(Serialize)]
struct JsonLine<'l> {
    /// Milliseconds since 1970, wall clock.
    unix_ms: u64,
    level: &'static str,
    node: &'l str,
    message: &'l str,
    /// Repetitions of the message since it was last written.
    #[serde(skip_serializing_if = "is_zero")]
    repeated: u64,
}

fn is_zero(number: &u64) -> bool {
    *number == 0
}

fn word(level: Level) -> &'static str {
    match level {
        Level::Error => "error",
        Level::Warn => "warning",
        Level::Info => "info",
        Level::Debug => "debug",
    }
}

fn json(level: Level, node: &str, message: &str, repeated: u64) -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let unix_ms = u64::try_from(since.as_millis()).unwrap_or(u64::MAX);
    // Numbers and texts alone: nothing that JSON cannot hold.
    serde_json::to_string(&JsonLine { unix_ms, level: word(level), node, message, repeated }).unwrap_or_default()
}

/// A line of the command itself as JSON: the prefix `error: ` or `warning: ` sets its level; all others are
/// information.
pub fn json_of_message(text: &str) -> String {
    let levels = [("error", Level::Error), ("warning", Level::Warn), ("note", Level::Info)];
    let split = levels.iter().find_map(|(word, level)| Some((*level, text.strip_prefix(word)?)));
    match split {
        Some((level, rest)) if rest.starts_with(": ") => json(level, "", &rest[2..], 0),
        // A diagnostic begins with its code.
        Some((level, rest)) if rest.starts_with('[') => json(level, "", text, 0),
        _ => json(Level::Info, "", text, 0),
    }
}

/// Formats a line for the terminal.
fn render(color: bool, level: Level, node: &str, words: &str, left_out: u64) -> String {
    let word = word(level);
    let style = match level {
        Level::Error => "\x1b[1;31m",
        Level::Warn => "\x1b[1;33m",
        Level::Info => "\x1b[1;32m",
        Level::Debug => "\x1b[2m",
    };
    let again = if left_out > 0 { format!(" (and {left_out} times more)") } else { String::new() };
    if color {
        format!("{style}{word}\x1b[0m [{node}] {words}{again}")
    } else {
        format!("{word} [{node}] {words}{again}")
    }
}

/// A log that passes lines to `show`; debug lines only with `verbose`.
pub fn sink(verbose: bool, format: LogFormat, color: bool, show: impl Fn(&str) + Send + Sync + 'static) -> Box<LogFn> {
    let seen: Mutex<HashMap<String, Seen>> = Mutex::new(HashMap::new());
    Box::new(move |level, node, words| {
        if level == Level::Debug && !verbose {
            return;
        }
        let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
        if seen.len() >= MAX_REMEMBERED {
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
        let words = panoscope_host::loader::sealed::readable(words);
        show(&match format {
            LogFormat::Text => render(color, level, node, &words, left_out),
            LogFormat::Json => json(level, node, &words, left_out),
        });
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
        let log = sink(false, LogFormat::Text, false, move |line| into.lock().unwrap().push(line.to_owned()));
        for _ in 0..100 {
            log(Level::Error, "stitch", "no memory");
        }
        log(Level::Error, "stitch", "other words");
        log(Level::Debug, "stitch", "details");
        assert_eq!(*lines.lock().unwrap(), ["error [stitch] no memory", "error [stitch] other words"]);
    }

    #[test]
    fn a_line_is_one_json_object() {
        let line = json(Level::Warn, "a", "two\nlines and \"quotes\"", 2);
        assert!(!line.contains('\n'));
        let value: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!((value["level"].as_str(), value["node"].as_str()), (Some("warning"), Some("a")));
        assert_eq!(
            (value["message"].as_str(), value["repeated"].as_u64()),
            (Some("two\nlines and \"quotes\""), Some(2))
        );
        assert!(value["unix_ms"].as_u64().unwrap() > 1_700_000_000_000);
    }

    #[test]
    fn lines_of_the_command_have_levels() {
        for (text, level, message) in [
            ("error: it \"failed\"", "error", "it \"failed\""),
            ("warning: a\nb", "warning", "a\nb"),
            ("error[unknown-param]: x", "error", "error[unknown-param]: x"),
            ("errors are rare", "info", "errors are rare"),
            ("serves http://127.0.0.1:1", "info", "serves http://127.0.0.1:1"),
        ] {
            let value: serde_json::Value = serde_json::from_str(&json_of_message(text)).unwrap();
            assert_eq!((value["level"].as_str(), value["message"].as_str()), (Some(level), Some(message)));
        }
    }

    #[test]
    fn colour_is_left_out_where_it_is_not_wanted() {
        assert_eq!(render(false, Level::Warn, "a", "b", 3), "warning [a] b (and 3 times more)");
        assert!(render(true, Level::Warn, "a", "b", 0).contains("\x1b["));
    }
}
