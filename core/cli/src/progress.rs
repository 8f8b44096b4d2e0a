//! How a run goes: a bar on a terminal, plain lines elsewhere.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use panoscope_engine::Report;

use crate::terminal::{finished_error_line, log};

const PLAIN_EVERY: Duration = Duration::from_secs(2);

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

/// Frames per second of late, not since the start.
struct Rate {
    at: Instant,
    frames: u64,
    fps: f64,
}

impl Rate {
    fn update(&mut self, frames: u64, now: Instant) -> f64 {
        let seconds = now.duration_since(self.at).as_secs_f64();
        if seconds >= 0.5 {
            let fresh = frames.saturating_sub(self.frames) as f64 / seconds;
            self.fps = if self.fps == 0.0 { fresh } else { 0.5 * self.fps + 0.5 * fresh };
            (self.at, self.frames) = (now, frames);
        }
        self.fps
    }
}

impl Progress {
    /// Progress of a run of `wanted` frames (unknown: `None`); a bar if `bar` is wanted and standard error is a terminal.
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
        Self { bar, plain: Plain { last: now }, rate: Rate { at: now, frames: 0, fps: 0.0 }, wanted }
    }

    /// What shows a line without tearing the bar; may be called from any thread.
    pub fn line_writer(&self) -> impl Fn(&str) + Send + Sync + 'static + use<> {
        let bar = self.bar.clone();
        move |line| match &bar {
            Some(bar) => bar.suspend(|| finished_error_line(line)),
            None => finished_error_line(line),
        }
    }

    /// Shows where the run stands.
    pub fn update(&mut self, report: &Report) {
        let now = Instant::now();
        let fps = self.rate.update(report.frames, now);
        let age_ms = report.paths.values().map(|p| p.age_p50_ms).fold(0.0, f64::max);
        let dropped: u64 = report.nodes.values().map(|n| n.dropped).sum();
        let faults: u64 = report.nodes.values().map(|n| n.faults).sum();
        let mut words = format!("{fps:.1} fps, age {age_ms:.1} ms, {dropped} dropped");
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
