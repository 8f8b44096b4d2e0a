//! Depths and lengths measured on a map as the node `measure` does, with the errors that it states, beside the truth.
//!
//! A rendering's calibration is exact, a user's is not. So each point is measured by calibrations that are wrong by what [`Noise`] says, too: bounds that hold
//! for a match alone say nothing of those that people see.

use std::path::Path;

use panoscope_base::random::SplitMix64;
use panoscope_imaging::stereo::SurfacePoint;
use panoscope_imaging::stereo::length::{self, Errors, Noise};

use super::chains::ChainOutput;
use super::synthetic::{BASELINE_MM, FOCAL_PX, SyntheticView, centre};
use crate::error::Result;
use crate::plot::{self, Chart, Series, Style};
use crate::statistics::percentile;

/// Points that are measured are this far apart, px.
const POINTS_PX: usize = 24;
/// Steps of points, across and down, from one end of a measured length to the other.
const LENGTH_STEPS: (usize, usize) = (4, 2);
/// Radius of the surface around a point, px: that of the node `measure`.
const RADIUS_PX: usize = 4;
/// Calibrations by which each point is measured.
const CALIBRATIONS: usize = 32;
/// Fewest measurements of a part of the reliability plot.
const MIN_PART: usize = 20;

/// One measurement.
#[derive(Clone, Copy, Debug)]
pub struct Bounded {
    /// True value, mm.
    true_mm: f64,
    /// Distance from it, mm.
    error_mm: f64,
    /// The stated 95 % bound, mm.
    bound_mm: f64,
}

/// All measurements of one kind: depths, or lengths.
#[derive(Clone, Debug, Default)]
pub struct Measurements {
    /// By calibrations that are as wrong as [`Noise::USUAL`] says, with the whole bound.
    pub whole: Vec<Bounded>,
    /// By the exact calibration, with the bound of the match alone.
    pub matched: Vec<Bounded>,
}

/// All measurements on the maps of one chain.
#[derive(Clone, Debug, Default)]
pub struct Stated {
    pub depths: Measurements,
    pub lengths: Measurements,
}

/// Share of the errors within `factor` times their bound, percent.
fn within(all: &[Bounded], factor: f64) -> f64 {
    let count = all.iter().filter(|m| m.error_mm <= factor * m.bound_mm).count();
    if all.is_empty() { f64::NAN } else { 100.0 * count as f64 / all.len() as f64 }
}

fn quantile(all: &[Bounded], share: f64, of: fn(&Bounded) -> f64) -> f64 {
    percentile(&all.iter().map(of).collect::<Vec<_>>(), share)
}

/// What a calibration says of the rig.
#[derive(Clone, Copy)]
struct Rig {
    focal_px: f64,
    baseline_mm: f64,
    /// Of all disparities.
    offset_px: f64,
}

impl Rig {
    const EXACT: Self = Self { focal_px: FOCAL_PX, baseline_mm: BASELINE_MM, offset_px: 0.0 };

    /// As a calibration with these errors has it.
    fn draw(noise: &Noise, random: &mut SplitMix64) -> Self {
        // The sum of twelve even numbers is nearly normal, of standard deviation 1.
        let mut normal = || (0..12).map(|_| (random.bits() >> 11) as f64 / (1u64 << 53) as f64).sum::<f64>() - 6.0;
        Self {
            focal_px: FOCAL_PX * (1.0 + normal() * noise.focal_percent / 100.0),
            baseline_mm: BASELINE_MM + normal() * noise.baseline_mm,
            offset_px: normal() * noise.offset_px,
        }
    }

    /// A point of the exact rig, as this one has it.
    fn sees(&self, point: &SurfacePoint) -> SurfacePoint {
        let per_px = 1.0 / (self.focal_px * self.baseline_mm);
        let scale = per_px * FOCAL_PX * BASELINE_MM;
        SurfacePoint {
            ray: point.ray.map(|part| part * FOCAL_PX / self.focal_px),
            inverse_depth: point.inverse_depth * scale + self.offset_px * per_px,
            scatter: point.scatter * scale,
            ..*point
        }
    }
}

/// A point of the exact rig, and where it truly is, mm.
type Known = (SurfacePoint, [f64; 3]);

impl Measurements {
    /// Measures what the points show.
    fn add(&mut self, known: &[Known], rigs: &[Rig], noise: &Noise, measure: fn(&[[f64; 3]]) -> f64) {
        let truth: Vec<[f64; 3]> = known.iter().map(|(_, truth)| *truth).collect();
        let bounded = |rig: &Rig, noise: &Noise| {
            let points: Vec<SurfacePoint> = known.iter().map(|(point, _)| rig.sees(point)).collect();
            let errors = Errors::of(rig.focal_px, rig.baseline_mm, f64::NAN, None, noise);
            let (found_mm, bound_mm) = length::with_error(&points, Some(&errors), measure);
            let true_mm = measure(&truth);
            Bounded { true_mm, error_mm: (found_mm - true_mm).abs(), bound_mm }
        };
        let exact = Noise { offset_px: 0.0, baseline_mm: 0.0, focal_percent: 0.0, ..*noise };
        self.matched.push(bounded(&Rig::EXACT, &exact));
        self.whole.extend(rigs.iter().map(|rig| bounded(rig, noise)));
    }

    fn extend(&mut self, other: Self) {
        self.whole.extend(other.whole);
        self.matched.extend(other.matched);
    }
}

impl Stated {
    /// Measures on a map of the left view, with the confidence of its filter where there is one. `seed` gives the errors of the calibrations.
    pub fn add(&mut self, left: &SyntheticView, made: &ChainOutput, seed: u64) {
        let mut random = SplitMix64(seed);
        let rigs: Vec<Rig> = (0..CALIBRATIONS).map(|_| Rig::draw(&Noise::USUAL, &mut random)).collect();
        let known = points(left, &made.disparity, made.confidence.as_deref());
        let noise = Noise { disparity_px: made.disparity_noise_px, ..Noise::USUAL };
        let columns = (POINTS_PX..left.size.0).step_by(POINTS_PX).len();
        for (index, point) in known.iter().enumerate() {
            let Some(point) = point else { continue };
            self.depths.add(&[*point], &rigs, &noise, length::depth);
            let is_inside = index % columns + LENGTH_STEPS.0 < columns;
            let end = known.get(index + LENGTH_STEPS.0 + LENGTH_STEPS.1 * columns).copied().flatten();
            if let Some(end) = end.filter(|_| is_inside) {
                self.lengths.add(&[*point, end], &rigs, &noise, length::distance);
            }
        }
    }

    /// The measurements of both.
    pub fn joined(mut self, other: Self) -> Self {
        self.depths.extend(other.depths);
        self.lengths.extend(other.lengths);
        self
    }

    /// Name, value and unit of each figure.
    pub fn figures(&self) -> Vec<(&'static str, f64, &'static str)> {
        let (depths, lengths) = (&self.depths.whole, &self.lengths.whole);
        let (depths_matched, lengths_matched) = (&self.depths.matched, &self.lengths.matched);
        let ratio = |all: &[Bounded]| quantile(all, 0.5, |m| m.bound_mm) / quantile(all, 0.5, |m| m.error_mm);
        let mean = |all: &[Bounded], of: fn(&Bounded) -> f64| {
            100.0 * all.iter().map(|m| of(m) / m.true_mm).sum::<f64>() / all.len() as f64
        };
        vec![
            ("depth_within_stated", within(depths, 1.0), "%"),
            ("depth_stated_pct", mean(depths, |m| m.bound_mm), "%"),
            ("depth_stated_by_median_error", ratio(depths), "1"),
            ("depth_match_within_stated", within(depths_matched, 1.0), "%"),
            ("depth_match_stated_by_median_error", ratio(depths_matched), "1"),
            ("length_within_stated", within(lengths, 1.0), "%"),
            ("length_error_pct", mean(lengths_matched, |m| m.error_mm), "%"),
            ("length_stated_by_median_error", ratio(lengths), "1"),
            ("length_match_within_stated", within(lengths_matched, 1.0), "%"),
            ("length_match_stated_by_median_error", ratio(lengths_matched), "1"),
        ]
    }

    /// Draws how often bounds of other probabilities hold, and what errors the bounds of each size have.
    pub fn plot(&self, path: &Path) -> Result<()> {
        let kinds = [
            ("depths", &self.depths.whole, 0),
            ("lengths", &self.lengths.whole, 1),
            ("depths, match alone", &self.depths.matched, 3),
            ("lengths, match alone", &self.lengths.matched, 4),
        ];
        let line = |name: &str, points: Vec<(f64, f64)>| Series::new(name, Style::Line, 2, points);
        // Share of a normal distribution within so many standard deviations; the bound is two.
        let normal = [(0.674, 50.0), (1.036, 70.0), (1.282, 80.0), (1.645, 90.0), (2.0, 95.45), (2.576, 99.0)];
        let mut held = vec![line("as stated", vec![(50.0, 50.0), (100.0, 100.0)])];
        let mut sizes = vec![line("95 % within", vec![(0.0, 0.0), (4.0, 4.0)])];
        for (name, all, color) in kinds {
            let points = normal.iter().map(|(deviations, share)| (*share, within(all, deviations / 2.0))).collect();
            held.push(Series::new(name, Style::Line, color, points));
            let mut sorted = all.to_vec();
            sorted.sort_by(|a, b| a.bound_mm.total_cmp(&b.bound_mm));
            let parts = sorted.chunks((sorted.len() / 20).max(MIN_PART)).filter(|part| part.len() >= MIN_PART);
            let of = |part: &[Bounded], share: f64| {
                (quantile(part, 0.5, |m| m.bound_mm), quantile(part, share, |m| m.error_mm))
            };
            let part: Vec<&[Bounded]> = parts.collect();
            for (label, share, style) in [("95 %", 0.95, Style::Dots), ("median", 0.5, Style::Line)] {
                let points = part.iter().map(|part| of(part, share)).filter(|(bound, _)| *bound < 4.0).collect();
                sizes.push(Series::new(format!("{label} of {name}"), style, color, points));
            }
        }
        let charts = [
            Chart {
                title: "Bounds: stated and observed".to_owned(),
                x_label: "stated, %".to_owned(),
                y_label: "observed, %".to_owned(),
                series: held,
                ..Chart::default()
            },
            Chart {
                title: "Errors of measurements with the same bound".to_owned(),
                x_label: "stated 95 % bound, mm".to_owned(),
                y_label: "true error, mm".to_owned(),
                series: sizes,
                from_zero: true,
                ..Chart::default()
            },
        ];
        plot::save(path, &charts)
    }
}

/// The points of a map every [`POINTS_PX`], row by row, `None` where the map, its surface or the right camera has none.
fn points(left: &SyntheticView, found: &[f32], trust: Option<&[f32]>) -> Vec<Option<Known>> {
    let per_px = 1.0 / (FOCAL_PX * BASELINE_MM);
    let (size, middle) = (left.size, centre(left.size));
    let ray = |x: usize, y: usize| [(x as f64 - middle.0) / FOCAL_PX, (y as f64 - middle.1) / FOCAL_PX];
    let sample = |map: &[f32], x: usize, y: usize| {
        let d = map[y * size.0 + x];
        let [u, v] = ray(x, y);
        (d > 0.0).then(|| [u, v, f64::from(d) * per_px])
    };
    let mut work = Vec::new();
    let mut at = |x: usize, y: usize| {
        let index = y * size.0 + x;
        if left.visible[index] == 0 {
            return None;
        }
        // What is measured is the surface under the pixel: no point where the map has none.
        sample(found, x, y)?;
        let here = |x, y| sample(found, x, y);
        let trust = |x: usize, y: usize| trust.map_or(f32::NAN, |trust| trust[y * size.0 + x]);
        let point = SurfacePoint::at(size, [x as f64, y as f64], RADIUS_PX, &mut work, here, trust)?;
        let [u, v, inverse] = sample(&left.disparity, x, y)?;
        Some((point, [u / inverse, v / inverse, 1.0 / inverse]))
    };
    let columns = || (POINTS_PX..size.0).step_by(POINTS_PX);
    let positions = (POINTS_PX..size.1).step_by(POINTS_PX).flat_map(|y| columns().map(move |x| (x, y)));
    positions.map(|(x, y)| at(x, y)).collect()
}

#[cfg(test)]
mod tests {
    use panoscope_base::Threads;

    use super::super::chains;
    use super::super::data::Picture;
    use super::super::synthetic::{self, SyntheticPair};
    use super::*;

    /// What is stated of the depth preset on a pair of a condition, with or without its confidence.
    fn stated(condition: &str, has_confidence: bool) -> Stated {
        let pool = Threads::new(2);
        let condition = synthetic::CONDITIONS.iter().find(|known| known.name == condition).expect("a condition");
        let SyntheticPair([left, right]) = synthetic::render(condition, synthetic::HELD_OUT_SEEDS[0], &pool);
        let (width, height) = left.size;
        let views = [&left, &right].map(|view| Picture::new(width, height, view.bgr.clone()));
        let made = chains::search(&views[0], &views[1], &pool).expect("chains");
        let mut depth = made.into_iter().find(|made| made.chain == "depth").expect("a chain");
        depth.confidence = depth.confidence.filter(|_| has_confidence);
        let mut stated = Stated::default();
        stated.add(&left, &depth, 1);
        stated
    }

    /// Share of the depths within the bound of the match, percent, and the median bound by the median error.
    fn of_match(stated: &Stated) -> (f64, f64) {
        let all = &stated.depths.matched;
        (within(all, 1.0), quantile(all, 0.5, |m| m.bound_mm) / quantile(all, 0.5, |m| m.error_mm))
    }

    #[test]
    fn bounds_of_a_match_hold_and_are_near_its_error() {
        for (condition, most) in [("thin", 6.0), ("faint", 6.5)] {
            let (held, by_error) = of_match(&stated(condition, true));
            assert!(held > 90.0 && by_error < most, "{condition}: {held} % held, {by_error} times the error");
        }
    }

    #[test]
    fn without_a_confidence_bounds_hold_and_are_wide() {
        let (held, by_error) = of_match(&stated("smoke", false));
        assert!(held > 90.0, "{held} % held");
        let (_, trusted) = of_match(&stated("thin", true));
        let (_, unknown) = of_match(&stated("thin", false));
        assert!(unknown > 1.5 * trusted, "{unknown} times the error, {trusted} with the confidence; smoke {by_error}");
    }
}
