//! Progress of a run: a bar on a terminal, plain lines elsewhere.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use panoscope_engine::Report;

use crate::terminal::{finished_error_line, log};

const PLAIN_EVERY: Duration = Duration::from_secs(2);
/// Minimum time without frames of a lost source; a shorter time counts as slow.
const MIN_STALL: Duration = Duration::from_secs(2);

/// Shows progress.
pub struct Progress {
    bar: Option<ProgressBar>,
    plain: Plain,
    rate: Rate,
    wanted: Option<u64>,
}

struct Plain {
    last: Instant,
}

/// Recent frames per second, not since the start.
struct Rate {
    at: Instant,
    frames: u64,
    fps: f64,
    /// When the last frame was noticed.
    newest: Instant,
}

impl Rate {
    fn update(&mut self, frames: u64, now: Instant) -> f64 {
        let seconds = now.duration_since(self.at).as_secs_f64();
        if seconds >= 0.5 {
            let fresh = frames.saturating_sub(self.frames) as f64 / seconds;
            let is_smooth = self.fps != 0.0 && fresh != 0.0;
            self.fps = if is_smooth { 0.5 * self.fps + 0.5 * fresh } else { fresh };
            if frames > self.frames {
                self.newest = now;
            }
            (self.at, self.frames) = (now, frames);
        }
        self.fps
    }

    /// Time without a frame, if the rate is 0.
    fn stalled(&self, now: Instant) -> Option<Duration> {
        (self.fps == 0.0).then(|| now.duration_since(self.newest)).filter(|stalled| *stalled >= MIN_STALL)
    }
}

impl Progress {
    /// Progress of a run of `wanted` frames (unknown: `None`); a bar if `bar` is set and standard error is a terminal.
    pub fn new(name: &str, wanted: Option<u64>, bar: bool) -> Self {
        let bar = (bar && std::io::stderr().is_terminal()).then(|| {
            let (bar, template) = match wanted {
                Some(frames) => (ProgressBar::new(frames), "{prefix} {bar:30} {pos}/{len}  {msg}"),
                None => (ProgressBar::no_length(), "{prefix} {elapsed} {pos} frames  {msg}"),
            };
            bar.set_draw_target(ProgressDrawTarget::stderr_with_hz(10));
            if let Ok(style) = ProgressStyle::with_template(template) {
                bar.set_style(style);
            }
            bar.set_prefix(name.to_owned());
            bar
        });
        let now = Instant::now();
        Self { bar, plain: Plain { last: now }, rate: Rate { at: now, frames: 0, fps: 0.0, newest: now }, wanted }
    }

    /// A function that prints a line without disturbing the bar; may be called from any thread.
    pub fn line_writer(&self) -> impl Fn(&str) + Send + Sync + 'static + use<> {
        let bar = self.bar.clone();
        move |line| match &bar {
            Some(bar) => bar.suspend(|| finished_error_line(line)),
            None => finished_error_line(line),
        }
    }

    /// Shows the progress.
    pub fn update(&mut self, report: &Report) {
        let now = Instant::now();
        let fps = self.rate.update(report.frames, now);
        let age_ms = report.paths.values().map(|p| p.age_p50_ms).fold(0.0, f64::max);
        let dropped: u64 = report.nodes.values().map(|n| n.dropped).sum();
        let faults: u64 = report.nodes.values().map(|n| n.faults).sum();
        // Ages are those of all frames so far.
        let age = match self.rate.stalled(now) {
            Some(stalled) => format!("no frame for {:.0} s", stalled.as_secs_f64()),
            None => format!("age {age_ms:.1} ms"),
        };
        let mut words = format!("{fps:.1} fps, {age}, {dropped} dropped");
        if faults > 0 {
            words.push_str(&format!(", {faults} faults"));
        }
        match &self.bar {
            Some(bar) => {
                bar.set_position(report.frames);
                bar.set_message(words);
            }
            None if now.duration_since(self.plain.last) >= PLAIN_EVERY => {
                self.plain.last = now;
                let of = self.wanted.map_or_else(String::new, |n| format!("/{n}"));
                log!("{}{of} frames, {words}", report.frames);
            }
            None => {}
        }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_without_frames_has_no_rate() {
        let start = Instant::now();
        let at = |seconds: f64| start + Duration::from_secs_f64(seconds);
        let mut rate = Rate { at: start, frames: 0, fps: 0.0, newest: start };
        assert_eq!((rate.update(20, at(1.0)), rate.stalled(at(1.0))), (20.0, None));
        assert_eq!((rate.update(50, at(2.0)), rate.stalled(at(2.0))), (25.0, None), "half of the new rate");
        assert_eq!((rate.update(50, at(3.0)), rate.stalled(at(3.0))), (0.0, None), "not long ago");
        assert_eq!((rate.update(50, at(5.0)), rate.stalled(at(5.0))), (0.0, Some(Duration::from_secs(3))));
        assert_eq!((rate.update(60, at(6.0)), rate.stalled(at(6.0))), (10.0, None), "it is back");
    }
}
