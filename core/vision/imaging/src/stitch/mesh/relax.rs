//! Extrapolation of the mesh beyond the overlap: smooth, so that lengths are preserved.
//!
//! At the border of the reference view the mesh has the folds of the tissue that the border cuts. Where only the other
//! view is visible, they are unknown, and any continuation stretches the image. So the displacement there is constant
//! outwards, and along the border as smooth as the allowed stretch requires. The mesh changes to it inside the overlap,
//! before the border, where the composite shows only the other view: its perspective changes there from the reference
//! view's to the other one's, which is not visible as a break.

use super::Lattice;
use super::border::Border;
use crate::geometry::{Homography, Point};

/// Range of the smoothness that is searched, in units of the weight of one line of vertices, and steps of the search.
const SMOOTHNESS: [f64; 2] = [1e-3, 1e5];
const SEARCH_STEPS: usize = 32;

/// Parameters of the extrapolation beyond a border.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Continuation {
    /// Width of the transition before the border, px.
    pub zone_px: f64,
    /// Largest relative change of a length beyond the border.
    pub max_stretch: f64,
}

/// Reusable buffers of an extrapolation.
#[derive(Clone, Debug, Default)]
pub struct Relax {
    mean: Vec<Point>,
    smooth: Vec<Point>,
    trial: Vec<Point>,
    pivots: Vec<f64>,
}

impl Relax {
    /// Continues positions of vertices in the other view, row after row of the lattice, beyond one border.
    ///
    /// `plane`: from the other view to the reference plane, and back. Displacements are relative to the reference
    /// plane.
    pub fn apply(
        &mut self,
        source: &mut [Point],
        lattice: &Lattice,
        border: &Border,
        how: &Continuation,
        [there, back]: [&Homography; 2],
    ) {
        let zone = border.zone_px(how.zone_px);
        if zone <= 0.0 {
            return;
        }
        let (across, along) =
            if border.axis == 0 { (lattice.columns, lattice.rows) } else { (lattice.rows, lattice.columns) };
        let index = |i: usize, line: usize| {
            if border.axis == 0 { line * lattice.columns + i } else { i * lattice.columns + line }
        };
        let position = |i: usize, line: usize| {
            if border.axis == 0 { lattice.position(i, line) } else { lattice.position(line, i) }
        };
        // From 0 where the zone begins to 1 on the border and beyond.
        let outside_px = |i: usize| border.outwards * (position(i, 0)[border.axis] - border.at_px);
        let share = |i: usize| (1.0 + outside_px(i) / zone).clamp(0.0, 1.0);
        let is_outside = |i: usize| outside_px(i) > 0.5 * lattice.cell_px as f64;
        self.mean.clear();
        for line in 0..along {
            let (mut sum, mut count) = ([0.0; 2], 0.0);
            for i in (0..across).filter(|i| share(*i) > 0.0 && !is_outside(*i)) {
                let (at, drawn) = (position(i, line), there.map(source[index(i, line)]));
                (sum, count) = ([0, 1].map(|k| sum[k] + drawn[k] - at[k]), count + 1.0);
            }
            if count == 0.0 {
                return;
            }
            self.mean.push(sum.map(|v| v / count));
        }
        self.smooth_out(border.axis, how.max_stretch * lattice.cell_px as f64);
        for i in (0..across).filter(|i| share(*i) > 0.0) {
            let t = share(i);
            let kept = 1.0 - t * t * (3.0 - 2.0 * t);
            for line in 0..along {
                let (at, smooth) = (position(i, line), self.smooth[line]);
                let wanted = back.map([at[0] + smooth[0], at[1] + smooth[1]]);
                let here = &mut source[index(i, line)];
                *here = [0, 1].map(|k| wanted[k] + kept * (here[k] - wanted[k]));
            }
        }
    }

    /// Sets `smooth` to the values nearest to `mean` that stretch a cell by at most `max_px`.
    fn smooth_out(&mut self, axis: usize, max_px: f64) {
        self.smooth.clone_from(&self.mean);
        if stretch_px(&self.smooth, axis) <= max_px {
            return;
        }
        let [mut low, mut high] = SMOOTHNESS.map(f64::ln);
        for _ in 0..SEARCH_STEPS {
            let middle = 0.5 * (low + high);
            self.fit(middle.exp());
            if stretch_px(&self.trial, axis) > max_px {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.fit(high.exp());
        self.smooth.clone_from(&self.trial);
    }

    /// Sets `trial` to the least squares of the distances from `mean` plus `smoothness` times the squares of first
    /// differences.
    fn fit(&mut self, smoothness: f64) {
        let count = self.mean.len();
        self.trial.clone_from(&self.mean);
        self.pivots.clear();
        // A symmetric matrix of three diagonals, the outer ones `-smoothness`: Thomas's elimination.
        for line in 0..count {
            let ends = usize::from(line == 0) + usize::from(line + 1 == count);
            let mut pivot = 1.0 + smoothness * (2.0 - ends as f64);
            if line > 0 {
                let factor = smoothness / self.pivots[line - 1];
                pivot -= smoothness * factor;
                let before = self.trial[line - 1];
                let here = &mut self.trial[line];
                *here = [here[0] + factor * before[0], here[1] + factor * before[1]];
            }
            self.pivots.push(pivot);
        }
        for line in (0..count).rev() {
            let after = self.trial.get(line + 1).copied().unwrap_or_default();
            let here = &mut self.trial[line];
            *here = [0, 1].map(|k| (here[k] + smoothness * after[k]) / self.pivots[line]);
        }
    }
}

/// Largest change of the length of a cell by displacements that are constant across the border, px. Displacements along
/// the border shear, and a shear stretches by half of it.
fn stretch_px(shift: &[Point], axis: usize) -> f64 {
    let of = |a: &Point, b: &Point| 0.5 * (b[axis] - a[axis]).abs() + (b[1 - axis] - a[1 - axis]).abs();
    shift.windows(2).map(|pair| of(&pair[0], &pair[1])).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LATTICE: Lattice = Lattice { cell_px: 20, first: [-2, -3], columns: 40, rows: 30 };
    const BORDER: Border = Border { axis: 0, outwards: 1.0, at_px: 400.0, overlap_px: 600.0 };
    const HOW: Continuation = Continuation { zone_px: 80.0, max_stretch: 0.04 };

    /// Applies the continuation to displacements.
    fn apply(shift: &mut [Point], border: &Border, how: &Continuation) {
        let plane = Homography::identity();
        let at = |i: usize| LATTICE.position(i % LATTICE.columns, i / LATTICE.columns);
        let mut source: Vec<Point> =
            (0..shift.len()).map(|i| [at(i)[0] + shift[i][0], at(i)[1] + shift[i][1]]).collect();
        Relax::default().apply(&mut source, &LATTICE, border, how, [&plane, &plane]);
        for (i, (shift, source)) in shift.iter_mut().zip(&source).enumerate() {
            *shift = [source[0] - at(i)[0], source[1] - at(i)[1]];
        }
    }

    /// Whether two displacements differ by rounding alone.
    fn is_same(a: Point, b: Point) -> bool {
        (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9
    }

    fn folds(height_px: f64) -> Vec<Point> {
        let at = |i: usize| LATTICE.position(i % LATTICE.columns, i / LATTICE.columns);
        (0..LATTICE.len()).map(|i| [height_px * (at(i)[1] / 30.0).sin() + at(i)[0] / 50.0, 0.5]).collect()
    }

    #[test]
    fn beyond_the_border_nothing_is_stretched_and_before_the_zone_nothing_changes() {
        let before = folds(10.0);
        let mut shift = before.clone();
        apply(&mut shift, &BORDER, &HOW);
        for row in 0..LATTICE.rows {
            for column in 0..LATTICE.columns {
                let (x, index) = (LATTICE.position(column, row)[0], row * LATTICE.columns + column);
                if x <= 320.0 {
                    assert!(is_same(shift[index], before[index]));
                } else if x >= 400.0 {
                    assert!(is_same(shift[index], shift[row * LATTICE.columns + 22]), "the same all the way out");
                    if row > 0 {
                        let shear = (shift[index][0] - shift[index - LATTICE.columns][0]).abs() / 20.0;
                        assert!(shear < 0.0801, "{shear} at row {row}");
                    }
                    assert!((shift[index][1] - 0.5).abs() < 1e-9);
                }
            }
        }
        // Not smoother than it must be.
        let most = (1..LATTICE.rows).map(|row| (shift[row * 40 + 30][0] - shift[(row - 1) * 40 + 30][0]).abs());
        assert!(most.fold(0.0, f64::max) > 0.07 * 20.0);
    }

    #[test]
    fn what_is_smooth_already_goes_on_as_it_is() {
        let mut shift = folds(0.5);
        let before = shift.clone();
        apply(&mut shift, &BORDER, &HOW);
        for row in 0..LATTICE.rows {
            // The mean of the zone: columns at 340 to 400 px.
            let mean = (19..=22).map(|column| before[row * 40 + column][0]).sum::<f64>() / 4.0;
            let off = shift[row * 40 + 35][0] - mean;
            assert!(off.abs() < 1e-9, "{off}");
        }
    }

    #[test]
    fn a_narrow_overlap_keeps_most_of_itself() {
        let mut shift = folds(10.0);
        let before = shift.clone();
        let narrow = Border { overlap_px: 100.0, ..BORDER };
        apply(&mut shift, &narrow, &HOW);
        let at = |x: usize| 5 * 40 + x / 20 + 2;
        assert!(is_same(shift[at(360)], before[at(360)]));
        assert!(!is_same(shift[at(400)], before[at(400)]));
        let mut shift = before.clone();
        apply(&mut shift, &BORDER, &Continuation { zone_px: 0.0, ..HOW });
        assert!(shift.iter().zip(&before).all(|(a, b)| is_same(*a, *b)));
    }

    #[test]
    fn a_border_above_is_continued_upwards() {
        let at = |i: usize| LATTICE.position(i % LATTICE.columns, i / LATTICE.columns);
        let mut shift: Vec<Point> = (0..LATTICE.len()).map(|i| [0.0, 10.0 * (at(i)[0] / 30.0).sin()]).collect();
        let before = shift.clone();
        let above = Border { axis: 1, outwards: -1.0, at_px: 100.0, overlap_px: 300.0 };
        apply(&mut shift, &above, &HOW);
        for column in 1..LATTICE.columns {
            assert!(is_same(shift[column], shift[LATTICE.columns * 8 + column]), "from row 100 px upwards");
            let shear = (shift[column][1] - shift[column - 1][1]).abs() / 20.0;
            assert!(shear < 0.0801, "{shear}");
            let inner = LATTICE.columns * 12 + column;
            assert!(is_same(shift[inner], before[inner]));
        }
    }

    #[test]
    fn lengths_are_those_of_a_steep_homography() {
        let there = Homography([1.4, 0.1, 20.0, 0.05, 1.2, -5.0, 8e-4, 2e-4, 1.0]);
        let back = there.inverse().expect("an inverse");
        let at = |i: usize| LATTICE.position(i % LATTICE.columns, i / LATTICE.columns);
        let mut source: Vec<Point> =
            (0..LATTICE.len()).map(|i| back.map(at(i))).map(|[x, y]| [x + 40.0 + 3.0 * (y / 30.0).sin(), y]).collect();
        Relax::default().apply(&mut source, &LATTICE, &BORDER, &HOW, [&there, &back]);
        for row in 1..LATTICE.rows {
            for column in 23..LATTICE.columns {
                let drawn = |column: usize, row: usize| there.map(source[row * LATTICE.columns + column]);
                let [here, left, above] = [drawn(column, row), drawn(column - 1, row), drawn(column, row - 1)];
                assert!(is_same([here[0] - left[0], here[1] - left[1]], [20.0, 0.0]));
                let stretch = 0.5 * (here[0] - above[0]).abs() + (here[1] - above[1] - 20.0).abs();
                assert!(stretch < 0.0401 * 20.0, "{stretch} px");
            }
        }
    }
}
