//! Bimanual measures.

use super::CELL_S;

/// Measures of two tools in one phase, or in all.
///
/// Bimanual dexterity as two figures: the share of movement that both make together, and the correlation of their
/// speeds (Hofstad et al. 2013).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Together {
    seen: u64,
    any: u64,
    both: u64,
    sums: [f64; 5],
}

impl Together {
    /// Adds a cell in which both are in view: whether each moves, and how fast, mm/s.
    pub(super) fn add(&mut self, moving: [bool; 2], speed: [f64; 2]) {
        self.seen += 1;
        self.any += u64::from(moving[0] || moving[1]);
        self.both += u64::from(moving[0] && moving[1]);
        let [a, b] = speed;
        self.sums.iter_mut().zip([a, b, a * a, b * b, a * b]).for_each(|(sum, v)| *sum += v);
    }

    /// Time in which both were in view, s.
    pub fn seen_s(&self) -> f64 {
        self.seen as f64 * CELL_S
    }

    /// Time in which both moved, s.
    pub fn both_s(&self) -> f64 {
        self.both as f64 * CELL_S
    }

    /// Share of the time with both in view and at least one moving in which both moved; NaN if none moved.
    pub fn overlap(&self) -> f64 {
        if self.any == 0 { f64::NAN } else { self.both as f64 / self.any as f64 }
    }

    /// Correlation of the two speeds (Pearson), -1 to 1; NaN if one is constant.
    pub fn correlation(&self) -> f64 {
        let n = self.seen as f64;
        let [a, b, aa, bb, ab] = self.sums;
        let (va, vb) = (n * aa - a * a, n * bb - b * b);
        let is_steady = |v: f64, squares: f64| v <= 1e-9 * n * squares;
        if n < 2.0 || is_steady(va, aa) || is_steady(vb, bb) { f64::NAN } else { (n * ab - a * b) / (va * vb).sqrt() }
    }
}
