//! `panoscope soak`: runs a graph for minutes and says whether its memory grows.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use panoscope_engine::Engine;
use panoscope_engine::memory::memory;

use super::run::{self, Ran};
use crate::End;
use crate::judge::Weight;
use crate::terminal::raw;

/// Arguments of `soak`.
#[derive(clap::Args)]
#[group(skip)]
pub struct Arguments {
    #[command(flatten)]
    run: run::Arguments,
    /// How long.
    #[arg(long, default_value_t = 10.0, value_parser = minutes)]
    minutes: f64,
    /// Writes every sample: seconds, memory, frames, frame memory, drops, faults.
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
}

fn minutes(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| format!("{text} is no number of minutes"))?;
    if (0.05..=100_000.0).contains(&number) { Ok(number) } else { Err("0.05 to 100000 minutes".to_owned()) }
}

/// One look at the process.
#[derive(Clone, Copy)]
struct Sample {
    seconds: f64,
    /// Resident memory.
    rss_mb: f64,
    frames: u64,
    /// Frame memory handed out.
    pool_mb: f64,
    dropped: u64,
    faults: u64,
}

fn rss_mb() -> f64 {
    // Pages, as `proc(5)` says; the second number is what is resident.
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages: f64 = text.split_whitespace().nth(1).and_then(|n| n.parse().ok()).unwrap_or(0.0);
    // SAFETY: a plain question to the system.
    let page = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
    pages * page as f64 / 1e6
}

fn look(engine: &Engine, since: Instant) -> Sample {
    let report = engine.report();
    Sample {
        seconds: since.elapsed().as_secs_f64(),
        rss_mb: rss_mb(),
        frames: report.frames,
        pool_mb: memory().in_use_bytes() as f64 / 1e6,
        dropped: report.nodes.values().map(|n| n.dropped).sum(),
        faults: report.nodes.values().map(|n| n.faults).sum(),
    }
}

/// Growth in MB per hour and its standard error: a straight line through the samples by least squares.
fn slope(samples: &[Sample]) -> (f64, f64) {
    let n = samples.len() as f64;
    if n < 3.0 {
        return (0.0, f64::INFINITY);
    }
    let mean_x = samples.iter().map(|s| s.seconds).sum::<f64>() / n;
    let mean_y = samples.iter().map(|s| s.rss_mb).sum::<f64>() / n;
    let sxx: f64 = samples.iter().map(|s| (s.seconds - mean_x).powi(2)).sum();
    let sxy: f64 = samples.iter().map(|s| (s.seconds - mean_x) * (s.rss_mb - mean_y)).sum();
    let slope = sxy / sxx.max(f64::MIN_POSITIVE);
    let rest: f64 = samples.iter().map(|s| (s.rss_mb - mean_y - slope * (s.seconds - mean_x)).powi(2)).sum();
    (slope * 3600.0, (rest / (n - 2.0) / sxx.max(f64::MIN_POSITIVE)).sqrt() * 3600.0)
}

/// Memory over time as rows of a text.
fn curve(samples: &[Sample]) -> String {
    const ROWS: usize = 30;
    let (low, high) = samples.iter().fold((f64::MAX, 0.0f64), |(l, h), s| (l.min(s.rss_mb), h.max(s.rss_mb)));
    let mut text = String::from("seconds  resident MB  frame MB   frames  dropped  faults\n");
    for row in 0..ROWS.min(samples.len()) {
        let sample = &samples[row * (samples.len() - 1) / (ROWS.min(samples.len()) - 1).max(1)];
        let bar = ((sample.rss_mb - low) / (high - low).max(0.1) * 30.0) as usize;
        let Sample { seconds, rss_mb, frames, pool_mb, dropped, faults } = *sample;
        let _ = writeln!(
            text,
            "{seconds:7.0}  {rss_mb:11.1}  {pool_mb:8.1}  {frames:7}  {dropped:7}  {faults:6}  {}",
            "#".repeat(bar)
        );
    }
    text
}

/// Growth that a run of this length can tell from noise, as a share of the resident memory per hour.
const TOLERATED_SHARE: f64 = 0.05;

/// Runs a graph and watches its memory.
pub fn run(arguments: &Arguments) -> Result<End> {
    let mut samples: Vec<Sample> = Vec::new();
    let length = Duration::from_secs_f64(arguments.minutes * 60.0);
    let mut began: Option<Instant> = None;
    let ran = run::run_with(&arguments.run, None, |engine| {
        let since = *began.get_or_insert_with(Instant::now);
        if since.elapsed().as_secs_f64() >= samples.len() as f64 {
            samples.push(look(engine, since));
        }
        if since.elapsed() >= length {
            engine.stop();
        }
    })?;
    let mut verdict = match ran {
        Ran::Not(end) => return Ok(end),
        Ran::Over { verdict, .. } => verdict,
    };
    if samples.is_empty() {
        return Ok(run::conclude(&verdict));
    }
    if let Some(path) = &arguments.csv {
        let mut text = String::from("seconds,resident_mb,frames,frame_memory_mb,dropped,faults\n");
        for Sample { seconds, rss_mb, frames, pool_mb, dropped, faults } in &samples {
            let _ = writeln!(text, "{seconds:.2},{rss_mb:.3},{frames},{pool_mb:.3},{dropped},{faults}");
        }
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    raw(&curve(&samples));
    // Threads, pools and files settle in the first third.
    let settled = &samples[samples.len() / 3..];
    let (growth, error) = slope(settled);
    let last = settled.last().map_or(0.0, |s| s.rss_mb);
    raw(&format!(
        "after warm-up ({:.0} s on): {growth:+.1} MB per hour, standard error {error:.1}, at {last:.1} MB resident\n",
        settled.first().map_or(0.0, |s| s.seconds)
    ));
    let tolerated = (last * TOLERATED_SHARE).max(3.0 * error);
    if growth > tolerated {
        verdict.add(Weight::Error, format!("memory grows: more than {tolerated:.1} MB per hour"));
    } else {
        raw("memory does not grow\n");
    }
    Ok(run::conclude(&verdict))
}
