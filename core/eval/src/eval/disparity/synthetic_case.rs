//! The synthetic pairs, condition by condition, through the matchers with the search that nodes have.

use panoscope_base::Threads;
use panoscope_imaging::stereo::SurfacePoint;
use panoscope_imaging::stereo::length::{self, Errors as Errors95, Noise};

use super::chains;
use super::data::Picture;
use super::edges::edge_errors;
use super::judge::Judge;
use super::picture;
use super::synthetic::{self, Condition, SyntheticPair};
use crate::error::Result;
use crate::session::check_cancelled;

/// Errors of one chain over the pairs of a condition.
#[derive(Default)]
struct Errors {
    /// Pixels that both cameras see.
    pixels: usize,
    /// Absolute error of those with a disparity, px.
    known_px: Vec<f32>,
    /// Sum of their relative errors of depth.
    depth: f64,
    /// Pixels that the right camera does not see, and those of them that have a disparity all the same.
    hidden: [usize; 2],
    /// Sum of the absolute errors near edges, px, and their number.
    edges: (f64, usize),
}

impl Errors {
    fn add(&mut self, SyntheticPair([left, _]): &SyntheticPair, found: &[f32]) {
        let (sum, count) = edge_errors(found, &left.disparity, synthetic::SIZE.0, |index| left.visible[index] != 0);
        self.edges = (self.edges.0 + sum, self.edges.1 + count);
        for ((found, truth), visible) in found.iter().zip(&left.disparity).zip(&left.visible) {
            if *visible == 0 {
                self.hidden[0] += 1;
                self.hidden[1] += usize::from(found.is_finite());
                continue;
            }
            self.pixels += 1;
            if found.is_finite() {
                self.known_px.push((found - truth).abs());
                // Depth is inverse to disparity.
                self.depth += f64::from((truth / found.max(1.0) - 1.0).abs());
            }
        }
    }

    /// Name, value and unit of each figure.
    fn figures(&mut self) -> Vec<(&'static str, f64, &'static str)> {
        let known = &mut self.known_px;
        known.sort_by(f32::total_cmp);
        let missing = self.pixels - known.len();
        let percent = |count: usize, of: usize| if of == 0 { f64::NAN } else { 100.0 * count as f64 / of as f64 };
        let above = |limit: f32| known.len() - known.partition_point(|error| *error <= limit);
        let at =
            |share: f64| known.get((known.len().max(1) as f64 * share) as usize).map_or(f64::NAN, |v| f64::from(*v));
        let mean = |sum: f64| if known.is_empty() { f64::NAN } else { sum / known.len() as f64 };
        vec![
            ("bad1", percent(missing + above(1.0), self.pixels), "%"),
            ("bad2", percent(missing + above(2.0), self.pixels), "%"),
            ("bad2_of_known", percent(above(2.0), known.len()), "%"),
            ("mean_error", mean(known.iter().map(|error| f64::from(*error)).sum()), "px"),
            ("median_error", at(0.5), "px"),
            ("p95_error", at(0.95), "px"),
            ("depth_error_pct", mean(100.0 * self.depth), "%"),
            ("edge_error", if self.edges.1 == 0 { f64::NAN } else { self.edges.0 / self.edges.1 as f64 }, "px"),
            ("unknown", percent(missing, self.pixels), "%"),
            ("hidden_known", percent(self.hidden[1], self.hidden[0]), "%"),
        ]
    }
}

/// Points that are measured are this far apart, px.
const POINTS_PX: usize = 24;
/// Steps of points, across and down, from one end of a measured length to the other.
const LENGTH_STEPS: (usize, usize) = (4, 2);
/// Radius of the surface around a point, px: that of the node `measure`.
const RADIUS_PX: usize = 4;

/// Depths and lengths measured on one chain's maps, as the node `measure` does, and whether their stated errors hold.
#[derive(Default)]
struct Stated {
    depths: [usize; 2],
    lengths: [usize; 2],
    length_error: f64,
    stated: f64,
}

impl Stated {
    fn add(&mut self, SyntheticPair([left, _]): &SyntheticPair, found: &[f32], trust: Option<&[f32]>) {
        let (size, per_px) = (synthetic::SIZE, 1.0 / (synthetic::FOCAL_PX * synthetic::BASELINE_MM));
        let errors = Errors95::of(synthetic::FOCAL_PX, synthetic::BASELINE_MM, f64::NAN, &Noise::USUAL);
        let ray = |x: usize, y: usize| {
            [
                (x as f64 - synthetic::CENTRE.0) / synthetic::FOCAL_PX,
                (y as f64 - synthetic::CENTRE.1) / synthetic::FOCAL_PX,
            ]
        };
        let sample = |map: &[f32], x: usize, y: usize| {
            let d = map[y * size.0 + x];
            let [u, v] = ray(x, y);
            (d > 0.0).then(|| [u, v, f64::from(d) * per_px])
        };
        let mut work = Vec::new();
        let mut at = |x: usize, y: usize| {
            let is_seen = x < size.0 && y < size.1 && left.visible[y * size.0 + x] != 0;
            let point = SurfacePoint::at(size, [x as f64, y as f64], RADIUS_PX, &mut work, |x, y| sample(found, x, y));
            let [u, v, inverse] = is_seen.then(|| sample(&left.disparity, x, y))??;
            // What is measured is the surface under the pixel: no point where the map has none.
            sample(found, x, y)?;
            let point = point.map(|point| trust.map_or(point, |trust| point.trusted(trust[y * size.0 + x])));
            Some((point?, [u / inverse, v / inverse, 1.0 / inverse]))
        };
        for y in (POINTS_PX..size.1).step_by(POINTS_PX) {
            for x in (POINTS_PX..size.0).step_by(POINTS_PX) {
                let Some((point, truth)) = at(x, y) else { continue };
                let (depth, stated) = length::with_error(&[point], Some(&errors), length::depth);
                self.depths[0] += 1;
                self.depths[1] += usize::from((depth - truth[2]).abs() <= stated);
                self.stated += stated / depth;
                let end = (x + LENGTH_STEPS.0 * POINTS_PX, y + LENGTH_STEPS.1 * POINTS_PX);
                let Some((other, other_truth)) = (end.0 < size.0 && end.1 < size.1).then(|| at(end.0, end.1)).flatten()
                else {
                    continue;
                };
                let (found_mm, stated) = length::with_error(&[point, other], Some(&errors), length::distance);
                let true_mm = length::distance(&[truth, other_truth]);
                self.lengths[0] += 1;
                self.lengths[1] += usize::from((found_mm - true_mm).abs() <= stated);
                self.length_error += (found_mm - true_mm).abs() / true_mm;
            }
        }
    }

    fn figures(&self) -> [(&'static str, f64, &'static str); 4] {
        let percent = |sum: f64, count: usize| if count == 0 { f64::NAN } else { 100.0 * sum / count as f64 };
        [
            ("depth_within_stated", percent(self.depths[1] as f64, self.depths[0]), "%"),
            ("depth_stated_pct", percent(self.stated, self.depths[0]), "%"),
            ("length_within_stated", percent(self.lengths[1] as f64, self.lengths[0]), "%"),
            ("length_error_pct", percent(self.length_error, self.lengths[0]), "%"),
        ]
    }
}

impl Judge<'_> {
    /// All conditions with these seeds.
    pub fn synthetic(&mut self, case: &str, seeds: &[u64]) -> Result<()> {
        let pool = Threads::new(2);
        for condition in &synthetic::CONDITIONS {
            check_cancelled(self.session)?;
            self.condition(case, condition, seeds, &pool)?;
        }
        Ok(())
    }

    fn condition(&mut self, case: &str, condition: &Condition, seeds: &[u64], pool: &Threads) -> Result<()> {
        let name = condition.name;
        let mut all: Vec<(&'static str, Errors, Stated)> = Vec::new();
        for seed in seeds {
            let pair = synthetic::render(condition, *seed, pool);
            let SyntheticPair([left, right]) = &pair;
            let (width, height) = synthetic::SIZE;
            let views = [left, right].map(|view| Picture::new(width, height, view.bgr.clone()));
            let own = self.own_graph(&views[0], &views[1])?;
            for made in chains::search(&views[0], &views[1], pool)?.into_iter().chain(own) {
                if let Some(folder) = self.pictures {
                    let file = |kind: &str| folder.join(format!("{case}_{name}_{seed}_{}{kind}.png", made.chain));
                    picture::map(&file(""), synthetic::SIZE, &made.disparity)?;
                    let counts = |index: usize| left.visible[index] != 0;
                    picture::errors(&file("_error"), synthetic::SIZE, &made.disparity, &left.disparity, counts)?;
                }
                let index = all.iter().position(|(chain, ..)| *chain == made.chain).unwrap_or_else(|| {
                    all.push((made.chain, Errors::default(), Stated::default()));
                    all.len() - 1
                });
                all[index].1.add(&pair, &made.disparity);
                all[index].2.add(&pair, &made.disparity, made.confidence.as_deref());
            }
            if let Some(folder) = self.pictures {
                picture::view(&folder.join(format!("{case}_{name}_{seed}_left.png")), synthetic::SIZE, &left.bgr)?;
                picture::map(
                    &folder.join(format!("{case}_{name}_{seed}_truth.png")),
                    synthetic::SIZE,
                    &left.disparity,
                )?;
            }
        }
        for (chain, mut errors, stated) in all {
            let seeds: Vec<String> = seeds.iter().map(u64::to_string).collect();
            let input = format!(
                "{name} {}x{}, seeds {}: {} px that both cameras see, {} hidden",
                synthetic::SIZE.0,
                synthetic::SIZE.1,
                seeds.join(", "),
                errors.pixels,
                errors.hidden[0]
            );
            for (measure, value, unit) in errors.figures() {
                self.add(format!("{measure}/{case}_{name}/{chain}"), value, unit, &input);
            }
            let input = format!("{input}; {} depths, {} lengths", stated.depths[0], stated.lengths[0]);
            for (measure, value, unit) in stated.figures() {
                self.add(format!("{measure}/{case}_{name}/{chain}"), value, unit, &input);
            }
        }
        Ok(())
    }
}
