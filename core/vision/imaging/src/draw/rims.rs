//! Cleans the edges of surfaces: removes corners between two surfaces, islands and ragged rims.

use crate::pieces;

/// Position of a corner in the camera's frame, mm; NaN where unknown.
pub type Position = [f32; 3];

const UNKNOWN: Position = [f32::NAN; 3];

/// Number of spans over which slopes are measured per row of corners. Matching and smoothing turn a step of depth into
/// a ramp of up to 2.5 % of the view's width.
const SPANS_PER_ROW: usize = 40;
const MIN_REACH: usize = 2;
/// Minimum gradient over a span that counts as a ramp between two surfaces, as a share of the limit between neighbours.
const RAMP_SHARE: f32 = 0.2;
const RAMP_END_SHARE: f32 = 0.083;
/// Directions of spans.
const ROW: u8 = 1;
const COLUMN: u8 = 2;
/// Maximum change of depth per distance across the line of sight (76 degrees) of a surface. At a smaller angle a view
/// shows almost nothing of a surface, and distant tissue has gradients below the other limits.
const GRAZING_SLOPE: f32 = 4.0;
/// Smallest piece of a surface, as a share of all corners.
const MIN_PIECE: f32 = 0.004;
/// Maximum gradient at a rim, as a share of the limit between neighbours; seen from the side, a step of one corner is a
/// long tooth.
const RIM_SHARE: f32 = 0.2;
const RIM_ROUNDS: usize = 6;
/// Minimum number of the eight neighbours of a corner at a rim.
const MIN_NEIGHBOURS: usize = 4;
const MIN_AROUND: u8 = 12;
/// Number of strips along the image's edge per row of corners; a surface extends further inward than one strip.
const STRIPS_PER_ROW: usize = 53;
const MIN_STRIP: usize = 2;
/// Number of smoothing passes.
const ROUNDS: usize = 3;

/// Cleans rims; with reusable buffers.
#[derive(Default)]
pub struct Rims {
    is_out: Vec<bool>,
    is_seed: Vec<bool>,
    /// Directions in which the span through a corner is slanted.
    slants: Vec<u8>,
    is_visited: Vec<bool>,
    piece: Vec<usize>,
    /// Corners on ramps.
    ramps: Vec<usize>,
    /// Known corners of five in a row.
    across: Vec<u8>,
    ramp_corners: usize,
}

fn is_known(point: &Position) -> bool {
    !point[0].is_nan()
}

/// Separates neighbouring points of different surfaces by a limit of the disparity gradient, the change of disparity
/// per distance across the image.
///
/// A limit of slopes is unsuitable, because one step of disparity is steeper for more distant tissue and a smaller
/// baseline. Human vision fuses gradients up to about 1 (Burt and Julesz, 1980).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GradientLimit {
    /// Largest change of disparity between neighbours of one surface, px by px.
    pub max_gradient: f32,
    /// Distance between the cameras, mm.
    pub baseline_mm: f32,
}

impl GradientLimit {
    /// Largest gradient of surfaces.
    pub const USUAL_GRADIENT: f32 = 1.5;
    /// Baseline without a calibration, mm: that of narrow scopes, for which the fewest surfaces are cut.
    pub const USUAL_BASELINE_MM: f32 = 5.0;

    /// Whether two points in the camera's frame (mm, z forward) lie on different surfaces.
    ///
    /// Off the camera's axis points on one line of sight differ in x and y too. This is not a distance across:
    /// otherwise a step in depth near the image's edge would pass for a slope.
    pub fn parts(self, a: Position, b: Position) -> bool {
        // Both sides multiplied by the depths: disparity is baseline / z, a place in the picture (x, y) / z.
        let [x, y] = [0, 1].map(|k| b[k] * a[2] - a[k] * b[2]);
        let step = self.baseline_mm * (b[2] - a[2]);
        step * step > self.max_gradient * self.max_gradient * (x * x + y * y).max(1e-9)
    }

    /// Whether two points next to a rim lie on different surfaces. A smaller limit applies there, because it may be the
    /// rest of a ramp.
    pub fn parts_at_rim(self, a: Position, b: Position) -> bool {
        self.parts(a, b) || self.is_ramp(a, b)
    }

    /// Whether a ramp continues from one point to the other.
    fn is_ramp(self, a: Position, b: Position) -> bool {
        self.scaled(RAMP_END_SHARE).parts(a, b) && is_grazing(a, b)
    }

    /// A limit of this share.
    fn scaled(self, share: f32) -> Self {
        Self { max_gradient: share * self.max_gradient, ..self }
    }
}

impl Default for GradientLimit {
    fn default() -> Self {
        Self { max_gradient: Self::USUAL_GRADIENT, baseline_mm: Self::USUAL_BASELINE_MM }
    }
}

/// Whether a surface through two points is seen at such a small angle that it is rather a step between two surfaces.
fn is_grazing(a: Position, b: Position) -> bool {
    let [x, y] = [0, 1].map(|k| b[k] * a[2] - a[k] * b[2]);
    let depth = b[2] - a[2];
    depth * depth * a[2] * b[2] > GRAZING_SLOPE * GRAZING_SLOPE * (x * x + y * y)
}

/// The index `step` from `at`. The image's border is not a rim, so indices beyond it are mirrored.
fn mirrored(at: isize, step: isize, end: usize) -> usize {
    let to = at + step;
    let inside = if (0..end as isize).contains(&to) { to } else { at - step };
    inside.clamp(0, end as isize - 1) as usize
}

/// Corners that share a triangle's edge with a corner, and the direction of that edge; 0 across both.
fn linked(at: usize, (width, height): (usize, usize)) -> impl Iterator<Item = (usize, u8)> {
    let column = at % width;
    let (left, right) = (column > 0, column + 1 < width);
    let (above, below) = (at >= width, at / width + 1 < height);
    let edges = [
        left.then(|| (at - 1, ROW)),
        right.then(|| (at + 1, ROW)),
        above.then(|| (at - width, COLUMN)),
        below.then(|| (at + width, COLUMN)),
        (above && right).then(|| (at - width + 1, 0)),
        (below && left).then(|| (at + width - 1, 0)),
    ];
    edges.into_iter().flatten()
}

impl Rims {
    /// Removes corners of a grid of `width` that do not belong to a surface: those on a ramp between two depths, pieces
    /// that are too small, and teeth of rims. Holes stay holes.
    pub fn clean(&mut self, corners: &mut [Position], width: usize, limit: GradientLimit) {
        self.cut_edges(corners, width, limit);
        self.part(corners, width, limit);
        for _ in 0..ROUNDS {
            self.cut_teeth(corners, width);
        }
        self.cut_islands(corners, width, limit);
    }

    /// Removes only the corners between surfaces.
    pub fn part(&mut self, corners: &mut [Position], width: usize, limit: GradientLimit) {
        self.cut_ramps(corners, width, limit);
        self.cut_steep_rims(corners, width, limit);
    }

    /// Number of ramp corners that the last call removed, where the surface is unknown.
    pub fn ramp_corners(&self) -> usize {
        self.ramp_corners
    }

    fn take_out(&mut self, corners: &mut [Position]) {
        corners.iter_mut().zip(&self.is_out).filter(|(_, out)| **out).for_each(|(corner, _)| *corner = UNKNOWN);
    }

    /// Removes narrow strips along the image's edge, where a filter spreads depths.
    fn cut_edges(&mut self, corners: &mut [Position], width: usize, limit: GradientLimit) {
        let height = corners.len() / width;
        let strip = (width / STRIPS_PER_ROW).max(MIN_STRIP);
        self.is_out.clear();
        self.is_out.resize(corners.len(), false);
        // From the edge inward: `start`, a step and the number of corners.
        let mut cut = |start: usize, step: isize, count: usize| {
            let at = |k: usize| start.wrapping_add_signed(step * k as isize);
            let is_linked = |k: usize| {
                let (a, b) = (&corners[at(k - 1)], &corners[at(k)]);
                is_known(a) && is_known(b) && !limit.parts(*a, *b)
            };
            let run = 1 + (1..count).take_while(|k| is_linked(*k)).count();
            if run < strip.min(count) {
                (0..run).for_each(|k| self.is_out[at(k)] = true);
            }
        };
        for y in 0..height {
            cut(y * width, 1, width);
            cut(y * width + width - 1, -1, width);
        }
        for x in 0..width {
            cut(x, width as isize, height);
            cut((height - 1) * width + x, -(width as isize), height);
        }
        self.take_out(corners);
    }

    /// Removes the corners on ramps between two depths.
    fn cut_ramps(&mut self, corners: &mut [Position], width: usize, limit: GradientLimit) {
        let height = corners.len() / width;
        let reach = (width / (2 * SPANS_PER_ROW)).max(MIN_REACH);
        let steep = limit.scaled(RAMP_SHARE);
        self.slants.clear();
        self.slants.resize(corners.len(), 0);
        self.is_seed.clear();
        self.is_seed.resize(corners.len(), false);
        // What is on no ramp counts as visited.
        self.is_visited.clear();
        self.is_visited.resize(corners.len(), true);
        for at in (0..corners.len()).filter(|at| is_known(&corners[*at])) {
            let (x, y) = (at % width, at / width);
            for (step, before, after) in [(1, x, width - 1 - x), (width, y, height - 1 - y)] {
                // From the farthest corner on one side to that on the other, up to holes.
                let back = (1..=before.min(reach)).take_while(|k| is_known(&corners[at - k * step])).count();
                let forth = (1..=after.min(reach)).take_while(|k| is_known(&corners[at + k * step])).count();
                let touches_hole = (back == 0 && before > 0) || (forth == 0 && after > 0);
                self.is_seed[at] |= touches_hole;
                let (a, b) = (corners[at - back * step], corners[at + forth * step]);
                // Short spans show the noise of the match.
                if back + forth >= reach && limit.is_ramp(a, b) {
                    self.is_visited[at] = false;
                    self.slants[at] |= if step == 1 { ROW } else { COLUMN };
                    self.is_seed[at] |= steep.parts(a, b);
                }
            }
        }
        self.is_out.clear();
        self.is_out.resize(corners.len(), false);
        self.ramps.clear();
        for start in 0..corners.len() {
            if self.is_seed[start] && !self.is_visited[start] {
                pieces::grow(start, (width, height), &mut self.is_visited, &mut self.piece, |_, _| true);
                self.piece.iter().for_each(|at| self.is_out[*at] = true);
                self.ramps.extend_from_slice(&self.piece);
            }
        }
        self.put_back(corners, width, limit);
        let falls = |at: &&usize| {
            linked(**at, (width, height)).any(|(to, edge)| edge > 0 && limit.is_ramp(corners[**at], corners[to]))
        };
        self.ramp_corners = self.ramps.iter().filter(falls).count();
        self.take_out(corners);
    }

    /// Restores corners to which a surface extends, because spans are longer than ramps: from neighbour to neighbour
    /// along each slanted direction. A corner that would join two surfaces stays removed.
    fn put_back(&mut self, corners: &[Position], width: usize, limit: GradientLimit) {
        let size = (width, corners.len() / width);
        let mut count = usize::MAX;
        // From one side and from the other in turn.
        self.ramps.sort_unstable();
        while self.ramps.len() < count {
            count = self.ramps.len();
            let (is_out, slants) = (&mut self.is_out, &self.slants);
            self.ramps.retain(|&at| {
                let (mut reached, mut joins) = (0, false);
                for (to, direction) in linked(at, size).filter(|(to, _)| is_known(&corners[*to]) && !is_out[*to]) {
                    reached |= direction;
                    joins |= limit.is_ramp(corners[at], corners[to]);
                }
                is_out[at] = joins || slants[at] & !reached != 0;
                is_out[at]
            });
            self.ramps.reverse();
        }
    }

    /// Removes the corners of a rim where the surface falls away steeply.
    fn cut_steep_rims(&mut self, corners: &mut [Position], width: usize, limit: GradientLimit) {
        let height = corners.len() / width;
        let limit = limit.scaled(RIM_SHARE);
        for _ in 0..RIM_ROUNDS {
            self.is_out.clear();
            self.is_out.resize(corners.len(), false);
            for at in (0..corners.len()).filter(|at| is_known(&corners[*at])) {
                let (x, y) = (at % width, at / width);
                // Both neighbours along a row, along a column; the picture's edge is no rim.
                let lines = [
                    (x > 0 && x + 1 < width).then(|| [at - 1, at + 1]),
                    (y > 0 && y + 1 < height).then(|| [at - width, at + width]),
                ];
                self.is_out[at] = lines.into_iter().flatten().any(|[a, b]| {
                    let of = |known: usize, gone: usize| {
                        is_known(&corners[known])
                            && !is_known(&corners[gone])
                            && limit.parts(corners[at], corners[known])
                    };
                    of(a, b) || of(b, a)
                });
            }
            if !self.is_out.contains(&true) {
                return;
            }
            self.take_out(corners);
        }
    }

    fn cut_teeth(&mut self, corners: &mut [Position], width: usize) {
        let height = corners.len() / width;
        self.is_out.clear();
        self.is_out.resize(corners.len(), false);
        self.across.clear();
        for row in corners.chunks_exact(width) {
            self.across.extend((0..width).map(|x| {
                let five = (-2..=2).map(|step| mirrored(x as isize, step, width));
                five.map(|x| u8::from(is_known(&row[x]))).sum::<u8>()
            }));
        }
        for at in (0..corners.len()).filter(|at| is_known(&corners[*at])) {
            let (x, y) = ((at % width) as isize, (at / width) as isize);
            let around = (-2..=2).map(|step| self.across[mirrored(y, step, height) * width + x as usize]);
            let mut count = 0;
            for (dx, dy) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
                let (x, y) = (mirrored(x, dx, width), mirrored(y, dy, height));
                count += usize::from(is_known(&corners[y * width + x]));
            }
            self.is_out[at] = count < MIN_NEIGHBOURS || around.sum::<u8>() < MIN_AROUND;
        }
        self.take_out(corners);
    }

    fn cut_islands(&mut self, corners: &mut [Position], width: usize, limit: GradientLimit) {
        let height = corners.len() / width;
        let least = (corners.len() as f32 * MIN_PIECE) as usize;
        self.is_visited.clear();
        self.is_visited.resize(corners.len(), false);
        self.is_out.clear();
        self.is_out.resize(corners.len(), false);
        for start in 0..corners.len() {
            if self.is_visited[start] || !is_known(&corners[start]) {
                continue;
            }
            pieces::grow(start, (width, height), &mut self.is_visited, &mut self.piece, |at, to| {
                is_known(&corners[to]) && !limit.parts(corners[at], corners[to])
            });
            if self.piece.len() < least {
                self.piece.iter().for_each(|at| self.is_out[*at] = true);
            }
        }
        self.take_out(corners);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 40;
    /// A slope of 6 at 60 mm.
    const LIMIT: GradientLimit = GradientLimit { max_gradient: 1.5, baseline_mm: 15.0 };

    /// Corners 0.5 mm apart with the given depths, mm; NaN where unknown.
    fn grid(depth: impl Fn(usize, usize) -> f32) -> Vec<Position> {
        (0..SIDE * SIDE)
            .map(|at| {
                let (x, y) = (at % SIDE, at / SIDE);
                let z = depth(x, y);
                if z.is_nan() { UNKNOWN } else { [x as f32 * 0.5, y as f32 * 0.5, z] }
            })
            .collect()
    }

    /// Corners seen by a camera above the middle, 0.01 of their depth apart.
    fn seen(depth: impl Fn(usize, usize) -> f32) -> Vec<Position> {
        let mut corners = grid(depth);
        for (at, corner) in corners.iter_mut().enumerate().filter(|(_, corner)| is_known(corner)) {
            let z = corner[2];
            let across = |k: usize| (k as f32 - SIDE as f32 / 2.0) * 0.01 * z;
            *corner = [across(at % SIDE), across(at / SIDE), z];
        }
        corners
    }

    fn known(corners: &[Position], x: usize, y: usize) -> bool {
        is_known(&corners[y * SIDE + x])
    }

    #[test]
    fn the_ramp_between_two_depths_is_cut_and_both_stay() {
        // 20 mm in 8 corners: each step alone is no steeper than a surface may be.
        let mut corners = seen(|x, _| 50.0 + 2.5 * (x as f32 - 16.0).clamp(0.0, 8.0));
        assert!(!LIMIT.parts(corners[17], corners[18]));
        Rims::default().clean(&mut corners, SIDE, LIMIT);
        assert!((17..24).all(|x| !known(&corners, x, 20)), "the ramp");
        assert!((0..13).all(|x| known(&corners, x, 20)) && (28..SIDE).all(|x| known(&corners, x, 20)));
    }

    /// Tissue before other tissue 70 mm behind it, seen by cameras 5.4 mm apart: the step is 14 px of disparity that
    /// matching and filtering turn into a ramp, whose width differs from row to row. Columns of 2 px.
    fn drawn_out_step() -> Vec<Position> {
        let (columns, rows, focal_px, baseline_mm) = (320, 60, 750.0, 5.4);
        let position = |at: usize| {
            let (x, y) = ((at % columns) as f32, at / columns);
            let ramp_px = [6.0, 14.0, 9.0, 20.0, 12.0, 24.0, 18.0][y / 2 % 7];
            let disparity_px = 38.0 - 14.0 * ((2.0 * x - 300.0) / ramp_px).clamp(0.0, 1.0);
            let z = focal_px * baseline_mm / disparity_px;
            [(2.0 * x - 320.0) / focal_px * z, (2.0 * y as f32 - 60.0) / focal_px * z, z]
        };
        (0..columns * rows).map(position).collect()
    }

    #[test]
    fn no_thread_is_left_across_a_step_whose_ramp_varies() {
        let (mut corners, limit) = (drawn_out_step(), GradientLimit { max_gradient: 1.5, baseline_mm: 5.4 });
        let mut rims = Rims::default();
        rims.clean(&mut corners, 320, limit);
        for (y, row) in corners.chunks_exact(320).enumerate() {
            let depths = row.windows(2).filter(|pair| pair.iter().all(is_known));
            let steepest = depths.map(|pair| (pair[1][2] - pair[0][2]).abs()).fold(0.0, f32::max);
            assert!(steepest < 1.0, "row {y} has a thread that falls by {steepest} mm in 2 px");
            assert!(row[..140].iter().all(is_known) && row[175..].iter().all(is_known), "row {y} of the surfaces");
        }
        // 11 corners wide on average, most of them on the ramp.
        assert!((4 * 60..12 * 60).contains(&rims.ramp_corners()), "{}", rims.ramp_corners());
    }

    #[test]
    fn surfaces_stay_whole_up_to_a_sharp_step() {
        // The step alone is no surface: a corner on one side of it goes, so that nothing joins both.
        let limit = GradientLimit { max_gradient: 1.5, baseline_mm: 5.4 };
        let position = |at: usize| {
            let (x, y) = ((at % 320) as f32, (at / 320) as f32);
            let z = 750.0 * 5.4 / if x < 150.0 + 4.0 * (y / 20.0).sin() { 38.0 } else { 26.0 };
            [(2.0 * x - 320.0) / 750.0 * z, (2.0 * y - 60.0) / 750.0 * z, z]
        };
        let mut corners: Vec<Position> = (0..320 * 60).map(position).collect();
        let mut rims = Rims::default();
        rims.clean(&mut corners, 320, limit);
        for (y, row) in corners.chunks_exact(320).enumerate() {
            let cut = row.iter().filter(|corner| !is_known(corner)).count();
            let joins = row.windows(2).any(|pair| pair.iter().all(is_known) && limit.is_ramp(pair[0], pair[1]));
            assert!(!joins && (1..=2).contains(&cut), "row {y}: {cut} cut, joined: {joins}");
        }
        assert!((50..90).contains(&rims.ramp_corners()), "{}", rims.ramp_corners());
    }

    #[test]
    fn a_rim_that_falls_away_is_cut_back_to_the_flat_surface() {
        // Steeper and steeper towards a gap, but nowhere a ramp.
        let steep = |x: usize| 60.0 + if x > 20 { 0.15 * (x as f32 - 20.0).powi(2) } else { 0.0 };
        let mut corners = seen(|x, _| if x < 26 { steep(x) } else { f32::NAN });
        Rims::default().clean(&mut corners, SIDE, LIMIT);
        assert!((0..21).all(|x| known(&corners, x, 20)), "the flat surface");
        assert!((24..26).all(|x| !known(&corners, x, 20)), "the steep rim");
    }

    #[test]
    fn a_ragged_rim_becomes_smooth() {
        let is_ragged = |x: usize, y: usize| x < 20 + [0, 3, 1, 4, 0, 2][y % 6];
        let mut corners = seen(|x, y| if is_ragged(x, y) { 50.0 } else { f32::NAN });
        Rims::default().clean(&mut corners, SIDE, LIMIT);
        let ends: Vec<usize> = (6..34).map(|y| (0..SIDE).filter(|x| known(&corners, *x, y)).count()).collect();
        let jumps = ends.windows(2).map(|pair| pair[0].abs_diff(pair[1])).max();
        assert!(jumps <= Some(2), "{ends:?}");
        assert!(ends.iter().all(|end| (19..=23).contains(end)), "{ends:?}");
    }

    #[test]
    fn a_slanted_surface_stays_whole() {
        let mut corners = seen(|x, y| 40.0 + 0.8 * x as f32 + 0.3 * y as f32);
        Rims::default().clean(&mut corners, SIDE, LIMIT);
        assert!(corners.iter().all(is_known));
    }

    #[test]
    fn islands_and_teeth_go_and_holes_stay() {
        let is_tooth = |x: usize, y: usize| x == 30 && (4..20).contains(&y);
        let is_island = |x: usize, y: usize| (34..36).contains(&x) && (30..32).contains(&y);
        let is_hole = |x: usize, y: usize| (8..16).contains(&x) && (8..16).contains(&y);
        let mut corners = seen(|x, y| {
            let is_there = (x < 28 && !is_hole(x, y)) || is_tooth(x, y) || is_island(x, y);
            if is_there { 50.0 } else { f32::NAN }
        });
        Rims::default().clean(&mut corners, SIDE, LIMIT);
        assert!(!known(&corners, 30, 10) && !known(&corners, 34, 30) && !known(&corners, 12, 12));
        assert!(known(&corners, 2, 2) && known(&corners, 27, 20) && known(&corners, 18, 12));
    }

    /// Cleans a grid of `columns` columns and 40 rows seen by a camera, and returns which corners remain.
    fn cleaned(columns: usize, depth: impl Fn(usize, usize) -> f32) -> impl Fn(usize, usize) -> bool {
        let position = |at: usize| {
            let (x, y) = (at % columns, at / columns);
            let z = depth(x, y);
            let across = |k: usize, middle: usize| (k as f32 - middle as f32) * 0.01 * z;
            if z.is_nan() { UNKNOWN } else { [across(x, columns / 2), across(y, SIDE / 2), z] }
        };
        let mut corners: Vec<Position> = (0..columns * SIDE).map(position).collect();
        Rims::default().clean(&mut corners, columns, LIMIT);
        move |x, y| is_known(&corners[y * columns + x])
    }

    #[test]
    fn a_strip_along_the_edge_goes_though_it_hangs_on_the_surface() {
        // An instrument leaves the picture; beside it, along the edge, depths fade from the tissue's to its own.
        let is_instrument = |y: usize| (14..26).contains(&y);
        let is_known = cleaned(320, |x, y| match (x, y) {
            (316.., 14..20) => 70.0 - 0.5 * (y - 14) as f32,
            (316.., 20..26) => 70.0 - 0.5 * (26 - y) as f32,
            (300.., y) if is_instrument(y) => 40.0,
            _ => 70.0,
        });
        assert!((17..23).all(|y| !is_known(319, y)), "the strip");
        assert!(is_known(308, 20) && is_known(319, 5) && is_known(319, 34));
    }

    #[test]
    fn the_surface_between_a_hole_and_the_edge_is_no_strip_in_a_coarse_grid() {
        // 4 of 160 corners are as wide as 8 of 320, beyond the width of a strip.
        let is_known = cleaned(160, |x, y| if (90..98).contains(&x) && (4..12).contains(&y) { f32::NAN } else { 60.0 });
        assert!((90..98).all(|x| (0..4).all(|y| is_known(x, y)) && !is_known(x, 8)));
    }

    #[test]
    fn a_step_in_depth_is_steep_wherever_the_picture_has_it() {
        for column in [0.0f32, 0.2, 0.45] {
            for row in [0.0f32, -0.3] {
                // Neighbouring pixels, an instrument before tissue.
                let (front, behind) = ([45.0 * column, 45.0 * row, 45.0], [67.0 * (column + 0.006), 67.0 * row, 67.0]);
                assert!(LIMIT.parts(front, behind) && LIMIT.parts(behind, front), "at {column}, {row}");
                let beside = [45.2 * (column + 0.006), 45.2 * row, 45.2];
                assert!(!LIMIT.parts(front, beside), "at {column}, {row}");
            }
        }
    }
}
