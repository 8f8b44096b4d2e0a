//! `bench stitch --plot`: times of each frame, as the thesis's figures 2.11 (registration), 2.12 (seam) and 4.9 (the
//! whole) draw them.
//!
//! One tick runs at a time. A stage lasts from its input packets to its output packet: registration from the pair to
//! the homography (disparity included), the composite from there to the panorama. Our composite reports the time of the
//! seam, the sampling of the overlap included; OpenCV's does not: there it is the additional time over the same frame
//! without a seam.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use panoscope_engine::text_table::table;
use panoscope_engine::{Listener, NumberListener};

use super::method::{Method, Seam, text_of};
use crate::error::Result;
use crate::inputs::Folder;
use crate::inputs::pairs::Pairs;
use crate::plot::{self, Chart, Series, Style};
use crate::run::{self, Pace, Plan, Watchers};
use crate::session::Session;

/// Pairs that are rendered and figures; a second and a half of the camera, and three.
const FRAMES: (u64, u64) = (48, 96);
const SIZE: (u32, u32) = (640, 480);
const THREADS: usize = 2;

/// Stages of a tick: pair, homography, panorama.
const STAGES: [(&str, &str); 3] = [("files", "right"), ("register", "homography"), ("wide", "panorama")];

/// Times of one method on every frame, ms; NaN where a frame has none.
#[derive(Clone, Debug, PartialEq)]
struct Curve {
    registration: Vec<f64>,
    /// Time of the composite with a seam in this frame, ms.
    composite: Vec<f64>,
    seam: Vec<f64>,
}

impl Curve {
    fn whole(&self) -> Vec<f64> {
        self.registration.iter().zip(&self.composite).map(|(a, b)| a + b).collect()
    }
}

/// Completion time of each stage of each tick.
type Moments = Vec<[Option<Instant>; 3]>;

/// Times recorded while a graph runs.
struct StageTimes {
    moments: Moments,
    /// Time of the seam in each tick as the composite reports it, ms; NaN where it reports none.
    seam: Vec<f64>,
}

/// Time between two stages of each tick, ms.
fn between(moments: &Moments, from: usize, to: usize) -> Vec<f64> {
    let ms = |tick: &[Option<Instant>; 3]| match (tick[from], tick[to]) {
        (Some(from), Some(to)) => to.saturating_duration_since(from).as_secs_f64() * 1e3,
        _ => f64::NAN,
    };
    moments.iter().map(ms).collect()
}

/// Keeps the minimum time of each frame, because other load only adds time.
fn least(best: &mut Vec<f64>, other: Vec<f64>) {
    if best.is_empty() {
        *best = other;
        return;
    }
    best.iter_mut().zip(other).for_each(|(best, other)| *best = best.min(other));
}

fn lock(heard: &Mutex<StageTimes>) -> MutexGuard<'_, StageTimes> {
    heard.lock().unwrap_or_else(PoisonError::into_inner)
}

fn run(session: &dyn Session, pairs: &Pairs, method: Method, seam: Seam, frames: u64) -> Result<StageTimes> {
    let text = text_of(pairs, SIZE.0, method, seam, THREADS);
    let count = frames as usize;
    let heard = Arc::new(Mutex::new(StageTimes { moments: vec![[None; 3]; count], seam: vec![f64::NAN; count] }));
    let listen = STAGES.iter().enumerate().map(|(stage, (node, output))| {
        let heard = Arc::clone(&heard);
        let hear = Arc::new(move |packet: &panoscope_engine::memory::FrameRef| {
            let now = Instant::now();
            if let Some(tick) = lock(&heard).moments.get_mut(packet.tick().seq as usize) {
                tick[stage] = Some(now);
            }
        });
        Listener { node: (*node).to_owned(), output: (*output).to_owned(), hear }
    });
    let told = Arc::clone(&heard);
    let hear = move |tick: &panoscope_abi::Tick, name: &str, value: f64| {
        if name == "seam_ms"
            && let Some(seam) = lock(&told).seam.get_mut(tick.seq as usize)
        {
            *seam = value;
        }
    };
    let numbers = NumberListener { node: "wide".to_owned(), hear: Arc::new(hear) };
    let pool = if method.is_opencv() { 1 } else { THREADS };
    let plan = Plan {
        text: &text,
        path: Path::new("bench.toml"),
        frames: Some(frames),
        threads: pool,
        ports: &[],
        pace: Pace::Alone,
    };
    run::run_watched(session, &plan, Watchers { listen: listen.collect(), numbers: vec![numbers], tracer: None })?;
    let mut heard = lock(&heard);
    Ok(StageTimes { moments: std::mem::take(&mut heard.moments), seam: std::mem::take(&mut heard.seam) })
}

fn curve(session: &dyn Session, pairs: &Pairs, method: Method, frames: u64, rounds: usize) -> Result<Curve> {
    let [mut registration, mut composite, mut seam] = [Vec::new(), Vec::new(), Vec::new()];
    for _ in 0..rounds {
        let every = run(session, pairs, method, Seam::EveryFrame, frames)?;
        least(&mut registration, between(&every.moments, 0, 1));
        least(&mut composite, between(&every.moments, 1, 2));
        let told = if method.is_opencv() {
            let without = between(&run(session, pairs, method, Seam::Once, frames)?.moments, 1, 2);
            between(&every.moments, 1, 2).iter().zip(&without).map(|(with, without)| with - without).collect()
        } else {
            every.seam
        };
        least(&mut seam, told);
    }
    // The first frame reserves memory.
    [&mut registration, &mut composite, &mut seam].into_iter().for_each(|all| all[0] = f64::NAN);
    Ok(Curve { registration, composite, seam })
}

/// A figure of the thesis: its title, what it shows, and one line per method.
struct Figure {
    title: &'static str,
    lines: Vec<(&'static str, Vec<f64>)>,
}

fn figures(conventional: &Curve, roi: &Curve, grid: &Curve, peer: &Curve) -> [Figure; 3] {
    let of = |name: &'static str, values: &[f64]| (name, values.to_vec());
    [
        Figure {
            title: "2.11: registration of each frame",
            lines: vec![
                of("OpenCV", &peer.registration),
                of("conventional", &conventional.registration),
                of("proposed (ROI)", &roi.registration),
            ],
        },
        Figure {
            title: "2.12: seam of each frame",
            lines: vec![
                of("OpenCV", &peer.seam),
                of("conventional", &conventional.seam),
                of("proposed (ROI)", &roi.seam),
            ],
        },
        Figure {
            title: "4.9: whole stitching of each frame",
            lines: vec![("SURF (ROI)", roi.whole()), ("grid", grid.whole())],
        },
    ]
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    known.sort_by(f64::total_cmp);
    known
}

fn charts(all: &[Figure]) -> Vec<Chart> {
    let line = |(color, (name, values)): (usize, &(&'static str, Vec<f64>))| Series {
        name: (*name).to_owned(),
        style: Style::Line,
        color,
        points: values.iter().enumerate().map(|(frame, ms)| (frame as f64, *ms)).collect(),
    };
    let chart = |figures: &Figure| {
        let medians: Vec<f64> = figures.lines.iter().filter_map(|(_, v)| sorted(v).get(v.len() / 2).copied()).collect();
        let (low, high) = medians.iter().fold((f64::MAX, 0.0f64), |(a, b), v| (a.min(*v), b.max(*v)));
        let log = high > 8.0 * low;
        Chart {
            title: format!("Figure {}", figures.title),
            x_label: "frame".to_owned(),
            y_label: if log { "time, ms (logarithmic)".to_owned() } else { "time, ms".to_owned() },
            series: figures.lines.iter().enumerate().map(line).collect(),
            from_zero: true,
            log,
            ..Chart::default()
        }
    };
    all.iter().map(chart).collect()
}

fn rows(all: &[Figure]) -> String {
    let mut rows = vec![["figure, ms", "least", "median", "most"].map(str::to_owned).to_vec()];
    for figures in all {
        for (name, values) in &figures.lines {
            let known = sorted(values);
            let at = |index: usize| known.get(index).map_or_else(|| "-".to_owned(), |ms| format!("{ms:.2}"));
            let figure = figures.title.split(':').next().unwrap_or_default();
            rows.push(vec![format!("{figure} {name}"), at(0), at(known.len() / 2), at(known.len().saturating_sub(1))]);
        }
    }
    table(&rows)
}

/// Measures every frame and draws the three figures.
pub fn plot(session: &dyn Session, folder: &Folder, quick: bool, path: &Path) -> Result<()> {
    let (frames, rounds) = if quick { (FRAMES.0, 3) } else { (FRAMES.1, 5) };
    let scope = format!("width = {}, height = {}", SIZE.0, SIZE.1);
    let pairs = Pairs::of(session, folder, "curves", &scope, frames)?;
    let [conventional, roi, grid] =
        [Method::Conventional, Method::Roi, Method::Grid].map(|method| curve(session, &pairs, method, frames, rounds));
    // Half a second a frame.
    let peer = curve(session, &pairs, Method::OpencvFull, frames / 4, 1)?;
    let all = figures(&conventional?, &roi?, &grid?, &peer);
    session.table(&format!("Figures 2.11, 2.12 and 4.9: times of {frames} frames, a seam in each\n{}\n", rows(&all)));
    plot::save(path, &charts(&all))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_stage_takes_from_what_it_needs_to_what_it_makes() {
        let start = Instant::now();
        let at = |ms: u64| Some(start + Duration::from_millis(ms));
        let moments = vec![[at(0), at(5), at(7)], [at(10), None, None], [at(20), at(21), at(50)]];
        let registration = between(&moments, 0, 1);
        assert_eq!((registration[0], registration[2]), (5.0, 1.0));
        assert!(registration[1].is_nan(), "a frame that is lost has no time");
        assert_eq!(between(&moments, 1, 2)[2], 29.0);
        let mut best = Vec::new();
        least(&mut best, vec![3.0, f64::NAN, 2.0]);
        least(&mut best, vec![1.0, 4.0, 9.0]);
        assert_eq!(best, [1.0, 4.0, 2.0]);
    }

    #[test]
    fn a_figure_is_logarithmic_where_one_curve_is_far_above_the_other() {
        let curve = |registration: f64, seam: f64| Curve {
            registration: vec![f64::NAN, registration, registration],
            composite: vec![f64::NAN, seam + 1.0, seam + 2.0],
            seam: vec![f64::NAN, seam, seam + 1.0],
        };
        let all = figures(&curve(20.0, 60.0), &curve(1.0, 0.5), &curve(1.5, 0.5), &curve(90.0, 600.0));
        let charts = charts(&all);
        assert_eq!(charts.iter().map(|chart| chart.log).collect::<Vec<_>>(), [true, true, false]);
        assert!(charts[1].y_label.contains("ms") && charts[1].title.contains("2.12"), "{charts:?}");
        assert_eq!(charts[2].series[1].points[2].1, 1.5 + 2.5);
        let text = rows(&all);
        let line = text.lines().find(|line| line.contains("2.12 conventional")).unwrap_or_else(|| panic!("{text}"));
        assert_eq!(line.split_whitespace().rev().take(3).collect::<Vec<_>>(), ["61.00", "61.00", "60.00"]);
    }
}
