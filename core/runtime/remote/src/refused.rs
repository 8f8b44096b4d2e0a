//! Lines about connections that were refused, which zenoh writes only to its own log.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use panoscope_engine::sync::lock;

/// Minimum time between two lines; further ones are counted.
const QUIET: Duration = Duration::from_secs(1);
/// Modules of zenoh that accept connections.
const TARGETS: [&str; 3] = ["zenoh_link_tls", "zenoh_link_tcp", "zenoh_transport::unicast::establishment::accept"];

/// Lines that were written, and those that were not.
#[derive(Default)]
struct Written {
    at: Option<Instant>,
    left_out: u64,
}

impl Written {
    /// The line for a message of zenoh, if it is about a refused connection and enough time has passed.
    fn line(&mut self, message: &str, now: Instant) -> Option<String> {
        let reason = reason(message)?;
        if self.at.is_some_and(|at| now.duration_since(at) < QUIET) {
            self.left_out += 1;
            return None;
        }
        self.at = Some(now);
        Some(match std::mem::take(&mut self.left_out) {
            0 => format!("a connection was refused: {reason}"),
            more => format!("{} connections were refused, the last one: {reason}", more + 1),
        })
    }
}

/// The reason of a refusal, without zenoh's internal details. `None` for connections that were closed before any data:
/// a host first checks whether anything listens.
fn reason(message: &str) -> Option<&str> {
    let words = message.split(". Hint: ").next().unwrap_or(message);
    let words = words.split(" at /").next().unwrap_or(words).trim();
    let is_probe = words.to_ascii_lowercase().contains("eof") || words.contains("reset by peer");
    (!is_probe && !words.is_empty() && !words.starts_with("Accepted ")).then_some(words)
}

/// Passes lines about refused connections to `write`. Only the first call has an effect.
pub fn log(write: impl Fn(&str) + Send + Sync + 'static) {
    let written = Mutex::new(Written::default());
    zenoh_util::init_log_with_callback(
        |about| TARGETS.iter().any(|target| about.target().starts_with(target)),
        move |record| {
            let is_worth_a_line = record.level.as_str() != "TRACE";
            let message = record.message.filter(|_| is_worth_a_line).unwrap_or_default();
            let line = lock(&written).line(&message, Instant::now());
            if let Some(line) = line {
                write(&line);
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_line_a_second_counts_the_others() {
        let (mut written, now) = (Written::default(), Instant::now());
        let corrupt = "received corrupt message of type InvalidContentType. Hint: increase the system open file limit.";
        let first = written.line(corrupt, now);
        assert_eq!(
            first.as_deref(),
            Some("a connection was refused: received corrupt message of type InvalidContentType")
        );
        (0..5).for_each(|_| assert_eq!(written.line(corrupt, now), None));
        assert_eq!(
            written.line("tls handshake eof. Hint: increase", now + QUIET),
            None,
            "a host looks whether anything listens"
        );
        let other = written.line("Received invalid message at /root/zenoh/accept.rs:200.", now + QUIET);
        assert_eq!(other.as_deref(), Some("6 connections were refused, the last one: Received invalid message"));
    }
}
