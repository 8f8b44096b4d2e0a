//! Small holes of a depth map, filled with the surface around them: a match leaves some at highlights and where tissue has no texture.
//!
//! A hole is filled when what is around it is one surface, close to a plane of disparity. Steps of depth stay open.

use std::ops::Range;

use crate::View;
use crate::stereo::runs::{Runs, Tally};

/// Largest distance of the pixels around a hole from their plane, px of disparity in a view of [`USUAL_WIDTH`].
const MAX_DEVIATION_PX: f32 = 1.0;
const USUAL_WIDTH: f32 = 640.0;
/// Largest slope of that plane, depth by the distance across the line of sight: 76 degrees.
const MAX_SLOPE: f32 = 4.0;
/// By how much a hole that was filled in the last map may exceed the limits, so that it does not flicker.
const HELD: f32 = 1.5;
/// How many of the pixels around a hole say, at most, how a filled pixel deviates from their plane.
const MAX_SAMPLES: usize = 32;
/// Pixels of a row that are looked at together.
const GRAIN_PX: usize = 32;

/// Whether a piece of unknown pixels reaches the edge of the map: then it is no hole.
#[derive(Clone, Copy, Default)]
struct IsOpen(bool);

impl Tally for IsOpen {
    fn add(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

/// A value that is linear in column and row.
#[derive(Clone, Copy)]
struct Plane {
    middle: [f32; 2],
    value: f32,
    slope: [f32; 2],
}

impl Plane {
    fn at(&self, [x, y]: [f32; 2]) -> f32 {
        self.value + self.slope[0] * (x - self.middle[0]) + self.slope[1] * (y - self.middle[1])
    }

    /// Least squares; `None` where all positions are on one line.
    fn fit(samples: &[Sample]) -> Option<Self> {
        let count = samples.len() as f32;
        let sums = samples.iter().fold([0.0; 3], |s, p| [s[0] + p.at[0], s[1] + p.at[1], s[2] + p.disparity_px]);
        let [mx, my, mean] = sums.map(|sum| sum / count);
        let [mut xx, mut xy, mut yy, mut xv, mut yv] = [0.0; 5];
        for sample in samples {
            let (x, y, v) = (sample.at[0] - mx, sample.at[1] - my, sample.disparity_px - mean);
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
            (xv, yv) = (xv + x * v, yv + y * v);
        }
        let determinant = xx * yy - xy * xy;
        let slope = [(xv * yy - yv * xy) / determinant, (yv * xx - xv * xy) / determinant];
        (determinant > 1e-3 * xx * yy).then_some(Self { middle: [mx, my], value: mean, slope })
    }
}

/// A known pixel beside a hole.
#[derive(Clone, Copy)]
struct Sample {
    at: [f32; 2],
    disparity_px: f32,
    /// Distance from the plane of all of them.
    off_px: f32,
}

/// A hole that is small enough: the indices of its runs and of the pixels around it in their lists, and by how much it may
/// exceed the limits.
#[derive(Clone)]
struct Hole {
    pieces: Range<usize>,
    around: Range<usize>,
    factor: f32,
}

/// Fills small holes; keeps its memory.
#[derive(Default)]
pub struct SmallHoles {
    runs: Runs<IsOpen>,
    /// Root and index of the runs of small pieces, by root.
    pieces: Vec<(usize, usize)>,
    holes: Vec<Hole>,
    /// Indices of the known pixels around the holes, hole after hole, and their depths.
    around: Vec<usize>,
    depths: Vec<f32>,
    samples: Vec<Sample>,
    filled: Vec<(usize, f32)>,
    was_filled: Vec<bool>,
}

impl SmallHoles {
    /// Index (row x width + column) and depth in mm of what can be filled in a map of depths, NaN where unknown. Holes of more than `max_share` of all
    /// pixels stay open. `focal_px` and `baseline_mm` are those of the rectified views.
    pub fn find(&mut self, depth: View<'_, f32>, focal_px: f32, baseline_mm: f32, max_share: f32) -> &[(usize, f32)] {
        let width = depth.width;
        self.find_holes((width, depth.height), max_share, |row, add| unknown(depth.row(row), add));
        self.add_around(width, |x, y| !depth.row(y)[x].is_nan());
        self.depths.clear();
        self.depths.extend(self.around.iter().map(|at| depth.row(at / width)[at % width]));
        self.fill_holes(width, focal_px, baseline_mm);
        &self.filled
    }

    /// As [`Self::find`] in a map of `width` x `height` of which only this is here: `unknown` has one bit for each pixel, from the lowest one on, in
    /// whole words for each row. `read` writes the depths of the pixels of some indices.
    ///
    /// # Errors
    /// Those of `read`.
    pub fn find_elsewhere<E>(
        &mut self,
        (width, height): (usize, usize),
        unknown: &[u32],
        (focal_px, baseline_mm): (f32, f32),
        max_share: f32,
        read: impl FnOnce(&[usize], &mut Vec<f32>) -> Result<(), E>,
    ) -> Result<&[(usize, f32)], E> {
        let words = width.div_ceil(32);
        let row_of = |row: usize| &unknown[row * words..][..words];
        self.find_holes((width, height), max_share, |row, add| unknown_bits(row_of(row), width, add));
        self.add_around(width, |x, y| row_of(y)[x / 32] >> (x % 32) & 1 == 0);
        self.depths.clear();
        if !self.around.is_empty() {
            read(&self.around, &mut self.depths)?;
        }
        self.fill_holes(width, focal_px, baseline_mm);
        Ok(&self.filled)
    }

    /// Finds the holes that are small enough; `unknown` gives the runs of unknown pixels of a row.
    fn find_holes(
        &mut self,
        (width, height): (usize, usize),
        max_share: f32,
        unknown: impl Fn(usize, &mut dyn FnMut(Range<usize>)),
    ) {
        let pixels = width * height;
        if self.was_filled.len() != pixels {
            self.was_filled.clear();
            self.was_filled.resize(pixels, false);
            self.filled.clear();
        }
        self.filled.iter().for_each(|(at, _)| self.was_filled[*at] = true);
        self.find_pieces((width, height), HELD * max_share * pixels as f32, unknown);
        self.holes.clear();
        let mut start = 0;
        for piece in self.pieces.chunk_by(|(a, _), (b, _)| a == b) {
            let area = self.runs.get(piece[0].0).area();
            let held: usize = piece
                .iter()
                .map(|(_, index)| {
                    let run = self.runs.get(*index);
                    self.was_filled[run.row() * width..][run.columns()].iter().filter(|was| **was).count()
                })
                .sum();
            let factor = if 2 * held > area { HELD } else { 1.0 };
            if area as f32 <= factor * max_share * pixels as f32 {
                self.holes.push(Hole { pieces: start..start + piece.len(), around: 0..0, factor });
            }
            start += piece.len();
        }
        self.filled.iter().for_each(|(at, _)| self.was_filled[*at] = false);
    }

    /// Finds the pieces of unknown pixels of at most `max_area` that do not reach the edge.
    fn find_pieces(
        &mut self,
        (width, height): (usize, usize),
        max_area: f32,
        unknown: impl Fn(usize, &mut dyn FnMut(Range<usize>)),
    ) {
        let runs = &mut self.runs;
        runs.clear();
        for row in 0..height {
            let is_rim = row == 0 || row + 1 == height;
            unknown(row, &mut |columns| {
                let is_open = is_rim || columns.start == 0 || columns.end == width;
                runs.push(row, columns, IsOpen(is_open));
            });
            runs.end_row(|_| true);
        }
        self.pieces.clear();
        for run in 0..runs.len() {
            let root = runs.root(run);
            let piece = runs.get(root);
            if !piece.tally.0 && piece.area() as f32 <= max_area {
                self.pieces.push((root, run));
            }
        }
        self.pieces.sort_unstable();
    }

    /// Lists the known pixels around each hole.
    fn add_around(&mut self, width: usize, is_known: impl Fn(usize, usize) -> bool) {
        self.around.clear();
        for hole in &mut self.holes {
            let first = self.around.len();
            for (_, run) in &self.pieces[hole.pieces.clone()] {
                let run = self.runs.get(*run);
                let (row, columns) = (run.row(), run.columns());
                self.around.extend([row * width + columns.start - 1, row * width + columns.end]);
                for row in [row - 1, row + 1] {
                    self.around.extend(columns.clone().filter(|x| is_known(*x, row)).map(|x| row * width + x));
                }
            }
            let own = &mut self.around[first..];
            own.sort_unstable();
            let mut kept = 0;
            for at in 0..own.len() {
                if kept == 0 || own[at] != own[kept - 1] {
                    own[kept] = own[at];
                    kept += 1;
                }
            }
            self.around.truncate(first + kept);
            hole.around = first..first + kept;
        }
    }

    fn fill_holes(&mut self, width: usize, focal_px: f32, baseline_mm: f32) {
        self.filled.clear();
        let holes = std::mem::take(&mut self.holes);
        holes.iter().for_each(|hole| self.fill(width, hole, focal_px, focal_px * baseline_mm));
        self.holes = holes;
    }

    /// Fills one hole if one surface is around it. `scale` is disparity by depth, px mm.
    fn fill(&mut self, width: usize, hole: &Hole, focal_px: f32, scale: f32) {
        self.samples.clear();
        let around = self.around[hole.around.clone()].iter().zip(&self.depths[hole.around.clone()]);
        self.samples.extend(around.map(|(at, z_mm)| {
            let (x, y) = (at % width, at / width);
            Sample { at: [x as f32, y as f32], disparity_px: scale / z_mm, off_px: 0.0 }
        }));
        let Some(plane) = Plane::fit(&self.samples) else { return };
        self.samples.iter_mut().for_each(|sample| sample.off_px = sample.disparity_px - plane.at(sample.at));
        let largest = self.samples.iter().map(|sample| sample.off_px.abs()).fold(0.0, f32::max);
        let is_grazing = plane.slope[0].hypot(plane.slope[1]) * focal_px > MAX_SLOPE * plane.value;
        let is_bent = largest > hole.factor * MAX_DEVIATION_PX * width as f32 / USUAL_WIDTH;
        if is_grazing || is_bent || !plane.value.is_finite() {
            return;
        }
        let step = self.samples.len().div_ceil(MAX_SAMPLES);
        for (_, run) in &self.pieces[hole.pieces.clone()] {
            let run = self.runs.get(*run);
            let row = run.row();
            for x in run.columns() {
                let here = [x as f32, row as f32];
                // The plane, and what the pixels around deviate from it, the nearer the more.
                let (mut total, mut off) = (0.0, 0.0);
                for sample in self.samples.iter().step_by(step) {
                    let weight = 1.0 / ((here[0] - sample.at[0]).powi(2) + (here[1] - sample.at[1]).powi(2));
                    total += weight;
                    off += weight * sample.off_px;
                }
                let disparity_px = plane.at(here) + off / total;
                if disparity_px > 0.0 {
                    self.filled.push((row * width + x, scale / disparity_px));
                }
            }
        }
    }
}

/// Calls `add` with the columns of each run of unknown pixels in a row.
fn unknown(row: &[f32], add: &mut dyn FnMut(Range<usize>)) {
    let mut open = None;
    for (k, grain) in row.chunks(GRAIN_PX).enumerate() {
        let count = grain.iter().map(|z| usize::from(z.is_nan())).sum::<usize>();
        let is_same = if open.is_some() { count == grain.len() } else { count == 0 };
        if is_same {
            continue;
        }
        for (x, z) in grain.iter().enumerate() {
            match (open, z.is_nan()) {
                (None, true) => open = Some(k * GRAIN_PX + x),
                (Some(from), false) => {
                    add(from..k * GRAIN_PX + x);
                    open = None;
                }
                _ => {}
            }
        }
    }
    if let Some(from) = open {
        add(from..row.len());
    }
}

/// As [`unknown`] for a row of `width` pixels whose unknown ones are set bits.
fn unknown_bits(row: &[u32], width: usize, add: &mut dyn FnMut(Range<usize>)) {
    let mut open = None;
    for (k, word) in row.iter().enumerate() {
        let mut at = 0;
        while at < 32 {
            // The next bit that ends the run, or begins one.
            let rest = if open.is_some() { !word } else { *word } >> at;
            at += rest.trailing_zeros();
            if at >= 32 {
                break;
            }
            let x = 32 * k + at as usize;
            match open.take() {
                Some(from) => add(from..x),
                None => open = Some(x),
            }
        }
    }
    if let Some(from) = open {
        add(from..width);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 80;
    const FOCAL_PX: f32 = 94.0;
    const BASELINE_MM: f32 = 5.0;
    const SHARE: f32 = 0.0015;

    fn found(holes: &mut SmallHoles, depth: impl Fn(usize, usize) -> f32) -> Vec<(usize, f32)> {
        let map: Vec<f32> = (0..SIDE * SIDE).map(|at| depth(at % SIDE, at / SIDE)).collect();
        let filled = holes.find(View::new(&map, SIDE, SIDE, 1), FOCAL_PX, BASELINE_MM, SHARE).to_vec();
        assert!(filled.iter().all(|(at, _)| map[*at].is_nan()), "only holes are filled");
        filled
    }

    #[test]
    fn a_map_that_is_elsewhere_gets_the_same_fillings() {
        let (mut here, mut there) = (SmallHoles::default(), SmallHoles::default());
        for (number, (width, height)) in
            [(80_usize, 60_usize), (33, 40), (96, 31), (80, 60), (80, 60)].into_iter().enumerate()
        {
            let mut next = number as u32;
            let map: Vec<f32> = (0..width * height)
                .map(|at| {
                    next = next.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    let is_hole = next >> 24 < 40 || (at % width).abs_diff(40) < 34 && at / width == 9;
                    if is_hole { f32::NAN } else { 60.0 + 0.1 * (at % width) as f32 }
                })
                .collect();
            let mut bits = vec![0; width.div_ceil(32) * height];
            for at in (0..map.len()).filter(|at| map[*at].is_nan()) {
                bits[at / width * width.div_ceil(32) + at % width / 32] |= 1 << (at % width % 32);
            }
            let expected = here.find(View::new(&map, width, height, 1), FOCAL_PX, BASELINE_MM, 0.004);
            let read = |places: &[usize], depths: &mut Vec<f32>| {
                depths.extend(places.iter().map(|at| map[*at]));
                Ok::<_, std::convert::Infallible>(())
            };
            let optics = (FOCAL_PX, BASELINE_MM);
            let Ok(found) = there.find_elsewhere((width, height), &bits, optics, 0.004, read);
            assert!(expected.len() > 20, "{}", expected.len());
            assert_eq!(found, expected, "{width}x{height}");
        }
        let fails = |_: &[usize], _: &mut Vec<f32>| Err("no");
        let bits = [0, 0b110, 0, 0];
        assert_eq!(there.find_elsewhere((20, 4), &bits, (FOCAL_PX, BASELINE_MM), 0.5, fails), Err("no"));
    }

    /// A slanted surface with a hole of a width, next to a step of a height in mm that begins at its middle.
    fn holed(width: usize, step_mm: f32) -> impl Fn(usize, usize) -> f32 {
        move |x, y| {
            let is_hole = (20..20 + width).contains(&x) && (20..23).contains(&y);
            let behind = if x > 20 + width / 2 { step_mm } else { 0.0 };
            if is_hole { f32::NAN } else { 60.0 + 0.1 * x as f32 + behind }
        }
    }

    #[test]
    fn a_small_hole_is_filled_with_the_surface_around_it() {
        let filled = found(&mut SmallHoles::default(), holed(3, 0.0));
        assert_eq!(filled.len(), 9);
        for (at, z) in filled {
            assert!((z - 60.0 - 0.1 * (at % SIDE) as f32).abs() < 0.05, "{z} mm at {at}");
        }
    }

    #[test]
    fn steps_large_holes_and_what_lies_at_the_edge_stay_open() {
        let open = |depth: &dyn Fn(usize, usize) -> f32| found(&mut SmallHoles::default(), depth).is_empty();
        assert!(open(&holed(3, 100.0)), "a step");
        assert!(open(&holed(12, 0.0)), "a large hole");
        assert!(open(&|x, y| if x < 2 && y == 20 { f32::NAN } else { 60.0 }), "at the left edge");
        assert!(open(&|x, y| if x == 20 && y > 77 { f32::NAN } else { 60.0 }), "at the lower edge");
        assert!(open(&|x, _| if x > 30 { f32::NAN } else { 60.0 }), "half of it");
        assert!(open(&|_, _| f32::NAN), "all of it");
    }

    #[test]
    fn a_hole_that_is_bent_is_one_hole() {
        // A horseshoe whose arms meet in the last row only: 4 + 4 + 1 pixels, and with longer arms too many.
        let horseshoe = |length: usize| {
            move |x: usize, y: usize| {
                let is_arm = (x == 40 || x == 42) && (30..30 + length).contains(&y);
                let is_bend = x == 41 && y == 29 + length;
                if is_arm || is_bend { f32::NAN } else { 60.0 }
            }
        };
        assert_eq!(found(&mut SmallHoles::default(), horseshoe(4)).len(), 9);
        assert!(found(&mut SmallHoles::default(), horseshoe(5)).is_empty());
    }

    #[test]
    fn a_hole_that_was_filled_stays_filled_while_it_is_a_little_larger() {
        let mut holes = SmallHoles::default();
        // 9 pixels are within the limit, 12 are not.
        let mut is_filled = |width: usize| !found(&mut holes, holed(width, 0.0)).is_empty();
        assert!(!is_filled(4));
        assert!(is_filled(3) && is_filled(4));
        assert!(!is_filled(12) && !is_filled(4));
    }
}
