//! Motions whose measures are known in closed form, sampled as by cameras, to check all measures.

use std::f64::consts::{PI, TAU};

use super::measures::FIGURES;
use super::movement::EDGE;
use super::smoothness::{SPARC_AMPLITUDE, SPARC_HIGHEST_HZ};
use super::{Sample, Session, Settings};

/// Timing of the images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Timing {
    /// 30 times a second.
    Even,
    /// As [`Self::Even`], with times off by up to 40 % of the interval.
    Uneven,
    /// As [`Self::Uneven`], with a seventh of the images lost.
    Lossy,
}

impl Timing {
    /// All timings.
    pub const ALL: [Self; 3] = [Self::Even, Self::Uneven, Self::Lossy];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Even => "even",
            Self::Uneven => "uneven",
            Self::Lossy => "lossy",
        }
    }

    /// Times of images over a length, s.
    pub fn times_s(self, length_s: f64) -> Vec<f64> {
        let mut random = panoscope_base::random::SplitMix64(0x9e37_79b9_7f4a_7c15);
        let mut chance = || random.bits() as f64 / u64::MAX as f64;
        let count = (length_s * 30.0).round() as usize;
        let mut times = Vec::new();
        for k in 0..=count {
            let (shift, loss) = (0.8 * (chance() - 0.5), chance());
            let is_end = k == 0 || k == count;
            let shift = if self == Self::Even || is_end { 0.0 } else { shift };
            if self != Self::Lossy || is_end || loss > 1.0 / 7.0 {
                times.push((k as f64 + shift) / 30.0);
            }
        }
        times
    }
}

type Path = Box<dyn Fn(f64) -> Option<[f64; 3]>>;

/// A motion of one or two tools.
pub struct Motion {
    /// Name in tables.
    pub name: &'static str,
    /// Duration, s.
    pub length_s: f64,
    /// Position of each tool at a time, mm; `None` while it is out of view.
    pub paths: Vec<Path>,
    /// Distance to the tissue of all tools at a time.
    pub tissue_mm: fn(f64) -> f64,
    /// Measures of the first tool, or of the pair (`overlap`, `correlation`), with their known values.
    pub known: Vec<(&'static str, f64)>,
}

/// A known measure and its measured value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checked {
    /// Name of the measure.
    pub measure: &'static str,
    /// Known value.
    pub known: f64,
    /// Value that the session measured.
    pub measured: f64,
}

impl Checked {
    /// Relative error; absolute if the known value is zero.
    pub fn error(&self) -> f64 {
        let off = (self.measured - self.known).abs();
        if self.known == 0.0 { off } else { off / self.known.abs() }
    }
}

/// Place on a minimum-jerk reach from 0 to 1 (Flash and Hogan 1985), `t` from 0 to 1.
fn reach(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (10.0 - t * (15.0 - 6.0 * t))
}

/// When (0..0.5) the speed of a reach passes `speed`, both as shares of length and duration.
fn edge_of_reach(speed: f64) -> f64 {
    // 30 (t (1 - t))^2 = speed.
    0.5 - (0.25 - (speed / 30.0).sqrt()).max(0.0).sqrt()
}

/// Spectral arc length of a speed profile by plain quadrature.
fn arc_length(length_s: f64, speed: impl Fn(f64) -> f64) -> f64 {
    const PARTS: usize = 800;
    let step_hz = 0.004 / length_s.min(1.0);
    let values: Vec<f64> = (0..=PARTS).map(|k| speed(length_s * k as f64 / PARTS as f64)).collect();
    let amplitude = |hz: f64| {
        let (mut re, mut im) = (0.0, 0.0);
        for (k, v) in values.iter().enumerate() {
            let weight = if k == 0 || k == PARTS { 1.0 } else { [2.0, 4.0][k % 2] };
            let (s, c) = (TAU * hz * length_s * k as f64 / PARTS as f64).sin_cos();
            (re, im) = (re + weight * v * c, im + weight * v * s);
        }
        re.hypot(im)
    };
    let spectrum: Vec<f64> =
        (0..=(SPARC_HIGHEST_HZ / step_hz) as usize).map(|k| amplitude(step_hz * k as f64)).collect();
    let last = spectrum.iter().rposition(|a| *a >= SPARC_AMPLITUDE * spectrum[0]).unwrap_or(0).max(1);
    -(0..last).map(|k| (1.0 / last as f64).hypot((spectrum[k + 1] - spectrum[k]) / spectrum[0])).sum::<f64>()
}

/// Known measures of a reach over `length` mm in `s` seconds, between the edges of its movement: log dimensionless
/// jerk, spectral arc length, root mean square of the jerk.
fn known_reach(length: f64, s: f64, settings: &Settings) -> [f64; 3] {
    let peak = 1.875 * length / s;
    let edge = edge_of_reach((EDGE * peak).max(settings.rest_mm_s) * s / length);
    // Integral of (1 - 6 t + 6 t^2)^2.
    let integral = |t: f64| t - 6.0 * t.powi(2) + 16.0 * t.powi(3) - 18.0 * t.powi(4) + 7.2 * t.powi(5);
    let squared = 3600.0 * (integral(1.0 - edge) - integral(edge)) * length * length / s.powi(5);
    let duration = s * (1.0 - 2.0 * edge);
    let ldlj = -(duration.powi(3) / (peak * peak) * squared).ln();
    let sparc = arc_length(duration, |t| {
        let u = edge + t / s;
        30.0 * (u * (1.0 - u)).powi(2)
    });
    [ldlj, sparc, (squared / duration).sqrt()]
}

fn nothing_near(_: f64) -> f64 {
    f64::NAN
}

/// All motions.
pub fn all(settings: &Settings) -> Vec<Motion> {
    vec![line(), reaches(settings), circle(), knot(), rest(), leave(), hands(settings)]
}

/// Direction of straight motions.
const ASIDE: [f64; 3] = [2.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0];

/// The point after `way` mm of a straight motion, mm.
fn along(way: f64) -> [f64; 3] {
    [10.0 + way * ASIDE[0], -5.0 + way * ASIDE[1], 60.0 + way * ASIDE[2]]
}

/// A straight line at constant speed.
fn line() -> Motion {
    Motion {
        name: "line",
        length_s: 5.0,
        paths: vec![Box::new(move |t| Some(along(20.0 * t)))],
        tissue_mm: nothing_near,
        known: vec![
            ("time_s", 5.0),
            ("path_mm", 100.0),
            ("mean_speed_mm_s", 20.0),
            ("peak_speed_mm_s", 20.0),
            ("economy", 1.0),
            ("idle_share", 0.0),
            ("out_of_view_s", 0.0),
            ("depth_path_mm", 200.0 / 3.0),
            ("depth_range_mm", 200.0 / 3.0),
            ("sparc", arc_length(5.0, |_| 1.0)),
            ("movements", 1.0),
        ],
    }
}

/// Reaches there and back with rests between them.
fn reaches(settings: &Settings) -> Motion {
    let (length, s, rest, count) = (60.0, 1.2, 0.8, 6.0);
    let [ldlj, sparc, jerk] = known_reach(length, s, settings);
    let slow = edge_of_reach(settings.rest_mm_s * s / length);
    Motion {
        name: "reaches",
        length_s: count * (s + rest) + rest,
        paths: vec![Box::new(move |t| {
            let t = (t - rest).max(0.0);
            let turn = (t / (s + rest)).floor();
            let part = reach((t - turn * (s + rest)) / s);
            Some(along(length * if turn % 2.0 == 0.0 { part } else { 1.0 - part }))
        })],
        tissue_mm: nothing_near,
        known: vec![
            ("time_s", count * (s + rest) + rest),
            // By definition a reach excludes what it covers below the speed of rest.
            ("path_mm", count * length * (1.0 - 2.0 * reach(slow))),
            ("peak_speed_mm_s", 1.875 * length / s),
            ("economy", 1.0),
            ("movements", count),
            ("moving_s", count * s * (1.0 - 2.0 * slow)),
            ("idle_share", 1.0 - count * s * (1.0 - 2.0 * slow) / (count * (s + rest) + rest)),
            ("ldlj", ldlj),
            ("sparc", sparc),
            ("jerk_rms_mm_s3", jerk),
            ("depth_range_mm", length * ASIDE[2]),
            ("depth_path_mm", count * length * (1.0 - 2.0 * reach(slow)) * ASIDE[2]),
        ],
    }
}

/// Circles at constant speed.
fn circle() -> Motion {
    let (radius, turns) = (12.0, 2.5);
    let omega = TAU / 5.0;
    Motion {
        name: "circle",
        length_s: 5.0 * turns,
        paths: vec![Box::new(move |t| Some([radius * (omega * t).cos(), radius * (omega * t).sin(), 60.0]))],
        tissue_mm: nothing_near,
        known: vec![
            ("path_mm", TAU * radius * turns),
            ("mean_speed_mm_s", omega * radius),
            ("economy", 2.0 * radius / (TAU * radius * turns)),
            // Jerk r w^3 all the time: (w T)^4.
            ("ldlj", -4.0 * (TAU * turns).ln()),
            ("jerk_rms_mm_s3", radius * omega.powi(3)),
            ("sparc", arc_length(5.0 * turns, |_| 1.0)),
            ("box_x_mm", 2.0 * radius),
            ("box_y_mm", 2.0 * radius),
            ("depth_path_mm", 0.0),
            ("idle_share", 0.0),
        ],
    }
}

/// A figure in space that touches the tissue five times.
fn knot() -> Motion {
    let omega = TAU / 8.0;
    Motion {
        name: "knot",
        length_s: 16.0,
        paths: vec![Box::new(move |t| {
            let (a, b) = ((omega * t).sin(), (omega * t).cos());
            Some([10.0 * a, 10.0 * b, 80.0 + 5.0 * (2.0 * omega * t).sin()])
        })],
        // Five touches of 0.8 s: a cosine below its half for a third of each of its periods.
        tissue_mm: |t| if t < 12.0 { 3.0 + 3.0 * (TAU * t / 2.4).cos() } else { 6.0 },
        known: vec![
            ("box_cm3", 4.0),
            ("ellipsoid_cm3", 4e-3 / 3.0 * PI * 7.814_727_9_f64.powf(1.5) * (50.0_f64 * 50.0 * 12.5).sqrt()),
            ("depth_path_mm", 80.0),
            ("depth_range_mm", 10.0),
            ("contacts", 5.0),
        ],
    }
}

/// An instrument that does not move.
fn rest() -> Motion {
    Motion {
        name: "rest",
        length_s: 4.0,
        paths: vec![Box::new(move |_| Some(along(0.0)))],
        tissue_mm: nothing_near,
        known: vec![("idle_share", 1.0), ("path_mm", 0.0), ("movements", 0.0), ("time_s", 4.0), ("box_cm3", 0.0)],
    }
}

/// A line that leaves the image for 10 s.
fn leave() -> Motion {
    Motion {
        name: "leave",
        length_s: 18.0,
        paths: vec![Box::new(move |t| (!(4.0..14.0).contains(&t)).then(|| along(10.0 * t)))],
        tissue_mm: nothing_near,
        known: vec![
            ("out_of_view_s", 10.0),
            ("seen_s", 8.0),
            ("departures", 1.0),
            ("path_mm", 80.0),
            ("movements", 2.0),
        ],
    }
}

/// Two instruments that reach for 4 s each, the second 2 s later: together from 2 s on.
fn hands(settings: &Settings) -> Motion {
    let (length, s) = (80.0, 4.0);
    let slow = s * edge_of_reach(settings.rest_mm_s * s / length);
    let speed = move |t: f64| if (0.0..s).contains(&t) { (t / s * (1.0 - t / s)).powi(2) } else { 0.0 };
    let (mut n, mut sums) = (0.0, [0.0; 5]);
    for k in 0..80_000 {
        let t = f64::from(k) * 1e-4;
        let (a, b) = (speed(t - 1.0), speed(t - 3.0));
        n += 1.0;
        sums.iter_mut().zip([a, b, a * a, b * b, a * b]).for_each(|(sum, v)| *sum += v);
    }
    let [a, b, aa, bb, ab] = sums;
    let path = move |start: f64, at: [f64; 3]| -> Path {
        Box::new(move |t| Some(std::array::from_fn(|k| at[k] + length * reach((t - start) / s) * ASIDE[k])))
    };
    Motion {
        name: "hands",
        length_s: 8.0,
        paths: vec![path(1.0, [0.0; 3]), path(3.0, [40.0, 0.0, 50.0])],
        tissue_mm: nothing_near,
        known: vec![
            ("overlap", (2.0 - 2.0 * slow) / (6.0 - 2.0 * slow)),
            ("correlation", (n * ab - a * b) / ((n * aa - a * a) * (n * bb - b * b)).sqrt()),
        ],
    }
}

/// Samples a motion, measures it, and returns known and measured values.
pub fn check(motion: &Motion, timing: Timing, settings: &Settings) -> Vec<Checked> {
    let mut session = Session::new(*settings);
    for t in timing.times_s(motion.length_s) {
        for (key, path) in motion.paths.iter().enumerate() {
            let tool = session.tool(key as u64, || format!("tool {key}"));
            if let (Some(tool), Some(place_mm)) = (tool, path(t)) {
                let tissue_mm = (motion.tissue_mm)(t);
                session.observe(tool, Sample { at_s: t, place_mm, depth_mm: place_mm[2], tissue_mm });
            }
        }
        session.advance(t);
    }
    session.finish();
    let measured = |name: &str| match name {
        "overlap" => session.pairs().next().map_or(f64::NAN, |(_, _, pair, _)| pair.overlap()),
        "correlation" => session.pairs().next().map_or(f64::NAN, |(_, _, pair, _)| pair.correlation()),
        name => {
            let figure = FIGURES.iter().find(|figure| figure.name == name);
            figure.zip(session.tools().next()).map_or(f64::NAN, |(figure, tool)| (figure.of)(tool.total))
        }
    };
    let known = motion.known.iter();
    known.map(|(measure, known)| Checked { measure, known: *known, measured: measured(measure) }).collect()
}
