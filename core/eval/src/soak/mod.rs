//! Soak test: growth of memory, threads and open files of a running graph over minutes.

mod disturb;

use std::fmt::Write as _;
use std::time::Instant;

use panoscope_engine::Engine;
use panoscope_engine::memory::memory;

use crate::system;
pub use disturb::{Disturbances, Disturber, Done, EditRefused};

/// State of the process at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Seconds since the first sample.
    pub seconds: f64,
    /// Resident memory of the process, MB.
    pub rss_mb: f64,
    /// Frames so far.
    pub frames: u64,
    /// Frame memory in use, MB.
    pub pool_mb: f64,
    /// Frames dropped so far.
    pub dropped: u64,
    /// Faults so far.
    pub faults: u64,
    /// Threads of the process.
    pub threads: usize,
    /// Open files of the process.
    pub open_files: usize,
    /// Resident memory of the processes of isolated nodes, MB.
    pub isolated_mb: f64,
    /// Processes of isolated nodes started so far.
    pub processes: u64,
}

/// Number of samples of a run that is long enough.
const RUN_SAMPLES: f64 = 300.0;

/// Samples of a run at regular times.
#[derive(Clone, Debug)]
pub struct Soak {
    samples: Vec<Sample>,
    period_s: f64,
    began: Option<Instant>,
}

/// Growth of memory after the warm-up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Growth {
    /// End of the warm-up, seconds since the first sample.
    pub from_seconds: f64,
    /// Slope of the straight line through the means of each second.
    pub mb_per_hour: f64,
    /// Standard error of the slope.
    pub error_mb_per_hour: f64,
    /// Resident memory in the last sample.
    pub resident_mb: f64,
    /// Maximum tolerated growth: noise of a run of this length, or 5 % of the resident memory per hour.
    pub tolerated_mb_per_hour: f64,
}

impl Growth {
    /// Whether memory grows by more than is tolerated.
    pub fn is_leak(&self) -> bool {
        self.mb_per_hour > self.tolerated_mb_per_hour
    }
}

/// A count before and after a run, without its warm-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// Median of the first tenth of the samples after the warm-up.
    pub from: usize,
    /// Median of the last tenth of the samples.
    pub to: usize,
}

impl Change {
    /// Whether it grew by more than 5 % and more than two.
    pub fn is_leak(&self) -> bool {
        self.to > self.from + (self.from / 20).max(2)
    }
}

impl Soak {
    /// Of a run of `seconds`: 10 samples per second if it is short, at least one per second.
    pub fn new(seconds: f64) -> Self {
        Self { samples: Vec::new(), period_s: (seconds / RUN_SAMPLES).clamp(0.1, 1.0), began: None }
    }

    /// Takes a sample if it is due. Returns the seconds since the first sample.
    pub fn observe(&mut self, engine: &Engine) -> f64 {
        let since = *self.began.get_or_insert_with(Instant::now);
        if since.elapsed().as_secs_f64() >= self.samples.len() as f64 * self.period_s {
            self.samples.push(sample(engine, since));
        }
        since.elapsed().as_secs_f64()
    }

    /// All samples.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// All samples as CSV.
    pub fn csv(&self) -> String {
        let mut text = String::from(
            "seconds,resident_mb,frames,frame_memory_mb,dropped,faults,threads,open_files,isolated_mb,processes\n",
        );
        for sample in &self.samples {
            let Sample { seconds, rss_mb, frames, pool_mb, dropped, faults, .. } = sample;
            let Sample { threads, open_files, isolated_mb, processes, .. } = sample;
            let _ = write!(text, "{seconds:.2},{rss_mb:.3},{frames},{pool_mb:.3},{dropped},{faults},");
            let _ = writeln!(text, "{threads},{open_files},{isolated_mb:.3},{processes}");
        }
        text
    }

    /// Memory over time as rows of text with bars.
    pub fn curve(&self) -> String {
        curve(&self.samples)
    }

    /// Samples after the warm-up: the first third of the run, in which threads, pools and files settle, is excluded.
    fn settled(&self) -> &[Sample] {
        &self.samples[self.samples.len() / 3..]
    }

    /// Threads of the process after the warm-up.
    pub fn threads(&self) -> Change {
        self.change(|sample| sample.threads)
    }

    /// Open files of the process after the warm-up.
    pub fn open_files(&self) -> Change {
        self.change(|sample| sample.open_files)
    }

    fn change(&self, of: impl Fn(&Sample) -> usize) -> Change {
        let settled = self.settled();
        let tenth = settled.len().div_ceil(10);
        let median = |samples: &[Sample]| {
            let mut values: Vec<usize> = samples.iter().map(&of).collect();
            values.sort_unstable();
            values.get(values.len() / 2).copied().unwrap_or(0)
        };
        Change { from: median(&settled[..tenth]), to: median(&settled[settled.len() - tenth..]) }
    }

    /// Growth of the memory after the warm-up.
    pub fn growth(&self) -> Growth {
        let settled = self.settled();
        let (mb_per_hour, error_mb_per_hour) = slope(&memory_by_second(settled));
        let resident_mb = settled.last().map_or(0.0, |s| s.rss_mb);
        Growth {
            from_seconds: settled.first().map_or(0.0, |s| s.seconds),
            mb_per_hour,
            error_mb_per_hour,
            resident_mb,
            tolerated_mb_per_hour: (resident_mb * TOLERATED_SHARE).max(3.0 * error_mb_per_hour),
        }
    }
}

fn sample(engine: &Engine, since: Instant) -> Sample {
    let report = engine.report();
    Sample {
        seconds: since.elapsed().as_secs_f64(),
        rss_mb: system::resident_mb(),
        frames: report.frames,
        pool_mb: memory().in_use_bytes() as f64 / 1e6,
        dropped: report.nodes.values().map(|n| n.dropped).sum(),
        faults: report.nodes.values().map(|n| n.faults).sum(),
        threads: system::threads(),
        open_files: system::open_files(),
        isolated_mb: report.groups.values().filter_map(|g| g.process_id).map(system::resident_mb_of).sum(),
        processes: report.groups.values().map(|g| g.processes).sum(),
    }
}

/// Mean time and mean memory of each second. Samples closer together depend on each other: the standard error of their
/// slope would be too small.
fn memory_by_second(samples: &[Sample]) -> Vec<(f64, f64)> {
    let mean = |samples: &[Sample], of: fn(&Sample) -> f64| samples.iter().map(of).sum::<f64>() / samples.len() as f64;
    let seconds = samples.chunk_by(|a, b| a.seconds as u64 == b.seconds as u64);
    seconds.map(|second| (mean(second, |s| s.seconds), mean(second, |s| s.rss_mb))).collect()
}

/// Growth in MB per hour and its standard error: a straight line through the points by least squares.
fn slope(points: &[(f64, f64)]) -> (f64, f64) {
    let n = points.len() as f64;
    if n < 3.0 {
        return (0.0, f64::INFINITY);
    }
    let mean_x = points.iter().map(|(x, _)| x).sum::<f64>() / n;
    let mean_y = points.iter().map(|(_, y)| y).sum::<f64>() / n;
    let sxx: f64 = points.iter().map(|(x, _)| (x - mean_x).powi(2)).sum();
    let sxy: f64 = points.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    let slope = sxy / sxx.max(f64::MIN_POSITIVE);
    let rest: f64 = points.iter().map(|(x, y)| (y - mean_y - slope * (x - mean_x)).powi(2)).sum();
    (slope * 3600.0, (rest / (n - 2.0) / sxx.max(f64::MIN_POSITIVE)).sqrt() * 3600.0)
}

/// Memory over time as rows of a text.
fn curve(samples: &[Sample]) -> String {
    const ROWS: usize = 30;
    let (low, high) = samples.iter().fold((f64::MAX, 0.0f64), |(l, h), s| (l.min(s.rss_mb), h.max(s.rss_mb)));
    let mut text = String::from("seconds  resident MB  frame MB   frames  dropped  faults  threads  files\n");
    for row in 0..ROWS.min(samples.len()) {
        let sample = &samples[row * (samples.len() - 1) / (ROWS.min(samples.len()) - 1).max(1)];
        let bar = ((sample.rss_mb - low) / (high - low).max(0.1) * 30.0) as usize;
        let Sample { seconds, rss_mb, frames, pool_mb, dropped, faults, threads, open_files, .. } = *sample;
        let _ = write!(text, "{seconds:7.0}  {rss_mb:11.1}  {pool_mb:8.1}  {frames:7}  {dropped:7}  {faults:6}");
        let _ = writeln!(text, "  {threads:7}  {open_files:5}  {}", "#".repeat(bar));
    }
    text
}

/// Growth that is tolerated, as a share of the resident memory per hour.
const TOLERATED_SHARE: f64 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;

    fn soak(rss_mb: impl Fn(f64) -> f64) -> Soak {
        soak_of(300.0, rss_mb)
    }

    fn soak_of(run_s: f64, rss_mb: impl Fn(f64) -> f64) -> Soak {
        let soak = Soak::new(run_s);
        let sample = |k: u32| {
            let seconds = f64::from(k) * soak.period_s;
            let (rss_mb, open_files) = (rss_mb(seconds), 40 + k as usize / 50);
            Sample { seconds, rss_mb, threads: 9, open_files, ..Sample::default() }
        };
        Soak { samples: (0..(run_s / soak.period_s).round() as u32).map(sample).collect(), ..soak }
    }

    #[test]
    fn steady_growth_is_a_leak_and_a_warm_up_is_not() {
        let leak = soak(|seconds| 100.0 + seconds / 3600.0 * 60.0).growth();
        assert!(leak.is_leak() && (leak.mb_per_hour - 60.0).abs() < 1e-6, "{leak:?}");
        let warm_up = soak(|seconds| 100.0 + seconds.min(60.0) + 0.1 * (seconds % 2.0)).growth();
        assert!(!warm_up.is_leak() && warm_up.mb_per_hour.abs() < 1.0, "{warm_up:?}");
        assert_eq!(warm_up.from_seconds, 100.0);
    }

    #[test]
    fn short_runs_have_more_samples_and_a_heap_that_shrinks_again_is_no_leak() {
        let samples = [3.0, 9.0, 60.0, 300.0, 3600.0].map(|run_s| soak_of(run_s, |_| 100.0).samples().len());
        assert_eq!(samples, [30, 90, 300, 300, 3600]);
        // A heap that grows for three seconds and shrinks: no sample of a second says more than another.
        let saw = soak_of(9.0, |seconds| 100.0 + f64::from(seconds as u32 % 3)).growth();
        assert!(!saw.is_leak() && saw.mb_per_hour > 800.0, "{saw:?}");
    }

    #[test]
    fn a_file_opened_every_fifty_seconds_is_a_leak_and_steady_threads_are_none() {
        let soak = soak(|_| 100.0);
        assert_eq!(soak.threads(), Change { from: 9, to: 9 });
        assert_eq!(soak.open_files(), Change { from: 42, to: 45 });
        assert!(soak.open_files().is_leak() && !soak.threads().is_leak());
    }

    #[test]
    fn a_curve_and_a_csv_have_the_samples() {
        let soak = soak(|seconds| 100.0 + seconds);
        assert_eq!((soak.csv().lines().count(), soak.curve().lines().count()), (301, 31));
        assert!(soak.curve().lines().last().is_some_and(|line| line.ends_with(&"#".repeat(30))), "{}", soak.curve());
    }
}
