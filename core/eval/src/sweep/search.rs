//! Searches values by the results of earlier runs: the tree-structured Parzen estimator (Bergstra et al. 2011).

use std::collections::BTreeMap;

use rand::SeedableRng;
use rand::rngs::StdRng;
use tpe::TpeOptimizer;

use super::axis::{Axis, AxisValue};

/// An axis of the optimizer.
struct Dimension {
    optimizer: TpeOptimizer,
    /// Number of values, for axes with a list; the optimizer's number is then a position.
    values: usize,
}

/// A search over all axes.
pub(super) struct Search {
    dimensions: Vec<Dimension>,
    random: StdRng,
    /// The optimizer's numbers for runs without a result yet.
    open: BTreeMap<usize, Vec<f64>>,
}

impl Search {
    /// A search that begins with random values; `None` if an axis has zero width.
    pub fn new(axes: &[Axis], seed: u64) -> Option<Self> {
        let dimension = |axis: &Axis| {
            let (estimator, range) = match axis.range {
                Some((from, to)) => (tpe::parzen_estimator(), tpe::range(from.min(to), from.max(to))),
                None if axis.has_words => (tpe::histogram_estimator(), tpe::categorical_range(axis.values.len())),
                None => (tpe::parzen_estimator(), tpe::range(0.0, axis.values.len() as f64)),
            };
            Some(Dimension { optimizer: TpeOptimizer::new(estimator, range.ok()?), values: axis.values.len() })
        };
        let dimensions: Option<Vec<Dimension>> = axes.iter().map(dimension).collect();
        Some(Self { dimensions: dimensions?, random: StdRng::seed_from_u64(seed), open: BTreeMap::new() })
    }

    /// The values of run `number`.
    pub fn ask(&mut self, axes: &[Axis], number: usize) -> Vec<AxisValue> {
        let (mut values, mut asked) = (Vec::new(), Vec::new());
        for (axis, dimension) in axes.iter().zip(&mut self.dimensions) {
            // It fails only where a weight is not a number, which a finite result does not make: the first value is as good then.
            let at =
                dimension.optimizer.ask(&mut self.random).unwrap_or(axis.range.map_or(0.0, |(from, to)| from.min(to)));
            values.push(match axis.range {
                Some(_) => axis.number(at),
                None => axis.values[(at.max(0.0) as usize).min(dimension.values - 1)].clone(),
            });
            asked.push(at);
        }
        self.open.insert(number, asked);
        values
    }

    /// Receives the result of a run, smaller being better; NaN for a failed run.
    pub fn tell(&mut self, number: usize, result: Option<f64>) {
        let Some(asked) = self.open.remove(&number) else { return };
        let Some(result) = result.filter(|v| v.is_finite()) else { return };
        for (at, dimension) in asked.into_iter().zip(&mut self.dimensions) {
            // Refused are only numbers outside the range, which none of those asked for is.
            let _ = dimension.optimizer.tell(at, result);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::axis::AxisRequest;
    use super::*;
    use panoscope_graph::ParamKind;

    #[test]
    fn a_search_comes_nearer_than_chance_and_repeats_with_its_seed() {
        let float = ParamKind::Float { default: 0.0, min: Some(-5.0), max: Some(5.0), step: None };
        let request = AxisRequest::parse("a.gain").expect("an axis");
        let words: Vec<String> = ["far", "near", "wrong"].map(str::to_owned).to_vec();
        let axes =
            [Axis::of_range(&request, &float, "", 9, true).expect("a range"), Axis::of_list("a.kind", "", &words)];
        let cost = |values: &[AxisValue]| (values[0].1 - 2.0).powi(2) + [3.0, 0.0, 9.0][values[1].1 as usize];
        let run = |seed: u64| {
            let mut search = Search::new(&axes, seed).expect("a search");
            let mut costs = Vec::new();
            for number in 0..80 {
                let values = search.ask(&axes, number);
                assert!((-5.0..=5.0).contains(&values[0].1), "{values:?}");
                costs.push(cost(&values));
                search.tell(number, Some(cost(&values)));
            }
            costs
        };
        let costs = run(3);
        assert_eq!(costs, run(3));
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        // By chance the mean is above 12.
        assert!(mean(&costs[60..]) < 0.5 * mean(&costs[..20]), "{costs:?}");
        assert!(costs.iter().copied().fold(f64::INFINITY, f64::min) < 0.1);
        let mut search = Search::new(&axes, 1).expect("a search");
        search.ask(&axes, 0);
        search.tell(0, Some(f64::NAN));
        search.tell(0, None);
        search.tell(7, Some(1.0));
    }
}
