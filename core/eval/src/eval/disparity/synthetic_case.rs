//! The synthetic pairs, condition by condition, through the matchers with the search that nodes have.

use panoscope_base::Threads;

use super::chains;
use super::data::Picture;
use super::edges::{FAR_PX, edge_errors, near_edges, near_objects};
use super::judge::Judge;
use super::picture;
use super::stated::Stated;
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
    /// Known disparities, and those of them that are more than [`FAR_PX`] wrong: skin where there is nothing.
    far: [usize; 2],
    /// Pixels near edges of depth that both cameras see, and those of them that are unknown or more than 2 px wrong.
    edges: [usize; 2],
    /// Sum of the absolute errors near edges, px, and their number.
    edge_errors: (f64, usize),
    /// As `edges`, of the near side of edges alone: thin objects, and rims of large ones.
    objects: [usize; 2],
}

impl Errors {
    fn add(&mut self, SyntheticPair([left, _]): &SyntheticPair, found: &[f32]) {
        let edges = near_edges(&left.disparity, left.size);
        let objects = near_objects(&left.disparity, left.size);
        let (sum, count) = edge_errors(&edges, found, &left.disparity, |index| left.visible[index] != 0);
        self.edge_errors = (self.edge_errors.0 + sum, self.edge_errors.1 + count);
        for (index, (found, truth)) in found.iter().zip(&left.disparity).enumerate() {
            let off_px = (found - truth).abs();
            if off_px.is_finite() {
                self.far[0] += 1;
                self.far[1] += usize::from(off_px > FAR_PX);
            }
            for (is_in, count) in [(edges[index], &mut self.edges), (objects[index], &mut self.objects)] {
                if is_in && left.visible[index] != 0 {
                    count[0] += 1;
                    // NaN is not right.
                    let is_right = off_px <= 2.0;
                    count[1] += usize::from(!is_right);
                }
            }
        }
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
            ("edge_error", self.edge_errors.0 / self.edge_errors.1 as f64, "px"),
            ("unknown", percent(missing, self.pixels), "%"),
            ("bad2_at_edges", percent(self.edges[1], self.edges[0]), "%"),
            ("bad2_of_objects", percent(self.objects[1], self.objects[0]), "%"),
            ("far_of_known", percent(self.far[1], self.far[0]), "%"),
            ("hidden_known", percent(self.hidden[1], self.hidden[0]), "%"),
        ]
    }
}

impl Judge<'_> {
    /// All conditions with these seeds.
    pub fn synthetic(&mut self, case: &str, seeds: &[u64]) -> Result<()> {
        let pool = Threads::new(2);
        let mut all = Stated::default();
        for condition in &synthetic::CONDITIONS {
            check_cancelled(self.session)?;
            for (chain, stated) in self.condition(case, condition, seeds, &pool)? {
                // The chain that lengths are measured on.
                if chain == "depth" {
                    all = all.joined(stated);
                }
            }
        }
        for (measure, value, unit) in all.figures() {
            let input =
                format!("all conditions; {} depths, {} lengths", all.depths.matched.len(), all.lengths.matched.len());
            self.add(format!("{measure}/{case}/depth"), value, unit, &input);
        }
        if let Some(folder) = self.pictures {
            all.plot(&folder.join(format!("{case}_stated_errors.png")))?;
        }
        Ok(())
    }

    fn condition(
        &mut self,
        case: &str,
        condition: &Condition,
        seeds: &[u64],
        pool: &Threads,
    ) -> Result<Vec<(&'static str, Stated)>> {
        let name = condition.name;
        let mut all: Vec<(&'static str, Errors, Stated)> = Vec::new();
        let mut view_size = (0, 0);
        for seed in seeds {
            let pair = synthetic::render(condition, *seed, pool);
            let SyntheticPair([left, right]) = &pair;
            let size @ (width, height) = left.size;
            view_size = size;
            let views = [left, right].map(|view| Picture::new(width, height, view.bgr.clone()));
            let own = self.own_graph(&views[0], &views[1])?;
            for made in chains::search(&views[0], &views[1], pool)?.into_iter().chain(own) {
                if let Some(folder) = self.pictures {
                    let file = |kind: &str| folder.join(format!("{case}_{name}_{seed}_{}{kind}.png", made.chain));
                    picture::map(&file(""), size, &made.disparity)?;
                    let counts = |index: usize| left.visible[index] != 0;
                    picture::errors(&file("_error"), size, &made.disparity, &left.disparity, counts)?;
                }
                let index = all.iter().position(|(chain, ..)| *chain == made.chain).unwrap_or_else(|| {
                    all.push((made.chain, Errors::default(), Stated::default()));
                    all.len() - 1
                });
                all[index].1.add(&pair, &made.disparity);
                all[index].2.add(left, &made, *seed);
            }
            if let Some(folder) = self.pictures {
                picture::view(&folder.join(format!("{case}_{name}_{seed}_left.png")), size, left.bgr.clone())?;
                picture::map(&folder.join(format!("{case}_{name}_{seed}_truth.png")), size, &left.disparity)?;
            }
        }
        for (chain, errors, stated) in &mut all {
            let seeds: Vec<String> = seeds.iter().map(u64::to_string).collect();
            let input = format!(
                "{name} {}x{}, seeds {}: {} px that both cameras see, {} hidden",
                view_size.0,
                view_size.1,
                seeds.join(", "),
                errors.pixels,
                errors.hidden[0]
            );
            for (measure, value, unit) in errors.figures() {
                self.add(format!("{measure}/{case}_{name}/{chain}"), value, unit, &input);
            }
            let input =
                format!("{input}; {} depths, {} lengths", stated.depths.matched.len(), stated.lengths.matched.len());
            for (measure, value, unit) in stated.figures() {
                self.add(format!("{measure}/{case}_{name}/{chain}"), value, unit, &input);
            }
        }
        Ok(all.into_iter().map(|(chain, _, stated)| (chain, stated)).collect())
    }
}
