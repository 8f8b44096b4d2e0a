//! Depths and lengths measured on a map as the node `measure` does, with the errors that it states, beside the truth.

use std::path::Path;

use panoscope_imaging::stereo::SurfacePoint;
use panoscope_imaging::stereo::length::{self, Errors, Noise};

use super::synthetic::{BASELINE_MM, CENTRE, FOCAL_PX, SIZE, SyntheticView};
use crate::error::Result;
use crate::plot::{self, Chart, Series, Style};
use crate::statistics::percentile;

/// Points that are measured are this far apart, px.
const POINTS_PX: usize = 24;
/// Steps of points, across and down, from one end of a measured length to the other.
const LENGTH_STEPS: (usize, usize) = (4, 2);
/// Radius of the surface around a point, px: that of the node `measure`.
const RADIUS_PX: usize = 4;
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

/// All measurements on the maps of one chain.
#[derive(Clone, Debug, Default)]
pub struct Stated {
    pub depths: Vec<Bounded>,
    pub lengths: Vec<Bounded>,
}

/// Share of the errors within `factor` times their bound, percent.
fn within(all: &[Bounded], factor: f64) -> f64 {
    let count = all.iter().filter(|m| m.error_mm <= factor * m.bound_mm).count();
    if all.is_empty() { f64::NAN } else { 100.0 * count as f64 / all.len() as f64 }
}

fn quantile(all: &[Bounded], share: f64, of: fn(&Bounded) -> f64) -> f64 {
    percentile(&all.iter().map(of).collect::<Vec<_>>(), share)
}

impl Stated {
    /// Measures on a map of the left view, with the confidence of its filter where there is one.
    pub fn add(&mut self, left: &SyntheticView, found: &[f32], trust: Option<&[f32]>) {
        let per_px = 1.0 / (FOCAL_PX * BASELINE_MM);
        let errors = Errors::of(FOCAL_PX, BASELINE_MM, f64::NAN, &Noise::USUAL);
        let ray = |x: usize, y: usize| [(x as f64 - CENTRE.0) / FOCAL_PX, (y as f64 - CENTRE.1) / FOCAL_PX];
        let sample = |map: &[f32], x: usize, y: usize| {
            let d = map[y * SIZE.0 + x];
            let [u, v] = ray(x, y);
            (d > 0.0).then(|| [u, v, f64::from(d) * per_px])
        };
        let mut work = Vec::new();
        let mut at = |x: usize, y: usize| {
            let is_seen = x < SIZE.0 && y < SIZE.1 && left.visible[y * SIZE.0 + x] != 0;
            let point = SurfacePoint::at(SIZE, [x as f64, y as f64], RADIUS_PX, &mut work, |x, y| sample(found, x, y));
            let [u, v, inverse] = is_seen.then(|| sample(&left.disparity, x, y))??;
            // What is measured is the surface under the pixel: no point where the map has none.
            sample(found, x, y)?;
            let point = point.map(|point| trust.map_or(point, |trust| point.trusted(trust[y * SIZE.0 + x])));
            Some((point?, [u / inverse, v / inverse, 1.0 / inverse]))
        };
        for y in (POINTS_PX..SIZE.1).step_by(POINTS_PX) {
            for x in (POINTS_PX..SIZE.0).step_by(POINTS_PX) {
                let Some((point, truth)) = at(x, y) else { continue };
                self.depths.push(bounded(&[point], &[truth], &errors, length::depth));
                let end = (x + LENGTH_STEPS.0 * POINTS_PX, y + LENGTH_STEPS.1 * POINTS_PX);
                if let Some((other, other_truth)) = at(end.0, end.1) {
                    self.lengths.push(bounded(&[point, other], &[truth, other_truth], &errors, length::distance));
                }
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
        let (depths, lengths) = (&self.depths, &self.lengths);
        let ratio = |all: &[Bounded]| quantile(all, 0.5, |m| m.bound_mm) / quantile(all, 0.5, |m| m.error_mm);
        let mean = |all: &[Bounded], of: fn(&Bounded) -> f64| {
            100.0 * all.iter().map(|m| of(m) / m.true_mm).sum::<f64>() / all.len() as f64
        };
        vec![
            ("depth_within_stated", within(depths, 1.0), "%"),
            ("depth_stated_pct", mean(depths, |m| m.bound_mm), "%"),
            ("depth_stated_by_median_error", ratio(depths), "1"),
            ("length_within_stated", within(lengths, 1.0), "%"),
            ("length_error_pct", mean(lengths, |m| m.error_mm), "%"),
            ("length_stated_by_median_error", ratio(lengths), "1"),
        ]
    }

    /// Draws how often bounds of other probabilities hold, and what errors the bounds of each size have.
    pub fn plot(&self, path: &Path) -> Result<()> {
        let kinds = [("depths", &self.depths, 0), ("lengths", &self.lengths, 1)];
        let line = |name: &str, points: Vec<(f64, f64)>| Series {
            name: name.to_owned(),
            style: Style::Line,
            color: 2,
            points,
        };
        // Share of a normal distribution within so many standard deviations; the bound is two.
        let normal = [(0.674, 50.0), (1.036, 70.0), (1.282, 80.0), (1.645, 90.0), (2.0, 95.45), (2.576, 99.0)];
        let mut held = vec![line("as stated", vec![(50.0, 50.0), (100.0, 100.0)])];
        let mut sizes = vec![line("95 % within", vec![(0.0, 0.0), (4.0, 4.0)])];
        for (name, all, color) in kinds {
            let points = normal.iter().map(|(deviations, share)| (*share, within(all, deviations / 2.0))).collect();
            held.push(Series { name: name.to_owned(), style: Style::Line, color, points });
            let mut sorted = all.to_vec();
            sorted.sort_by(|a, b| a.bound_mm.total_cmp(&b.bound_mm));
            let parts = sorted.chunks((sorted.len() / 20).max(MIN_PART)).filter(|part| part.len() >= MIN_PART);
            let of = |part: &[Bounded], share: f64| {
                (quantile(part, 0.5, |m| m.bound_mm), quantile(part, share, |m| m.error_mm))
            };
            let part: Vec<&[Bounded]> = parts.collect();
            for (label, share, style) in [("95 %", 0.95, Style::Dots), ("median", 0.5, Style::Line)] {
                let points = part.iter().map(|part| of(part, share)).filter(|(bound, _)| *bound < 4.0).collect();
                sizes.push(Series { name: format!("{label} of {name}"), style, color, points });
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

/// Measures points and compares with the same points of the truth.
fn bounded(points: &[SurfacePoint], truth: &[[f64; 3]], errors: &Errors, measure: fn(&[[f64; 3]]) -> f64) -> Bounded {
    let (found_mm, bound_mm) = length::with_error(points, Some(errors), measure);
    let true_mm = measure(truth);
    Bounded { true_mm, error_mm: (found_mm - true_mm).abs(), bound_mm }
}
