//! Where a surface ends: corners that lie between two surfaces, islands and ragged rims are taken out; and the light on what is left.

use super::corner::{Corner, NOWHERE, is_known};
use crate::pieces;

/// Corners over which a slope and a normal are measured, to each side.
const REACH: usize = 2;
/// Largest gradient over that distance, as a share of the limit between neighbours: smoothing draws a step out into a ramp.
const RAMP_SHARE: f32 = 0.5;
/// Smallest piece of a surface, as a share of all corners.
const MIN_PIECE: f32 = 0.004;
/// Largest gradient at a rim, as a share of the limit between neighbours, and how many corners of a steeper one are cut at most: a step of one
/// corner is a long tooth there when it is seen from the side.
const RIM_SHARE: f32 = 0.2;
const RIM_ROUNDS: usize = 6;
/// Neighbours of eight that a corner of a rim has, and known corners of the 25 around it, its own included: a straight rim has 15.
const MIN_NEIGHBOURS: usize = 4;
const MIN_AROUND: u8 = 13;
/// Corners in a row, from the picture's edge inward, that a surface has at least.
const EDGE: usize = 6;
/// How often rims are smoothed.
const ROUNDS: usize = 3;

/// Cleans rims; keeps its memory.
#[derive(Default)]
pub struct Rims {
    is_out: Vec<bool>,
    is_visited: Vec<bool>,
    piece: Vec<usize>,
    /// Known corners of five in a row.
    across: Vec<u8>,
}

/// Where neighbouring points belong to different surfaces: a limit of the disparity gradient, the change of disparity by the distance across the picture.
///
/// A limit of slopes would not do: one step of disparity is the steeper, the farther the tissue and the closer together the cameras. People fuse gradients
/// up to about 1 (Burt and Julesz, 1980).
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
    /// Baseline where no calibration states it, mm: that of narrow scopes, at which the fewest surfaces are cut.
    pub const USUAL_BASELINE_MM: f32 = 5.0;

    /// Whether two points in the camera's frame (mm, z forward) lie on different surfaces.
    ///
    /// Off the camera's axis points on one line of sight differ in x and y too. That is no distance across: a step in depth near the picture's edge would
    /// pass for a slope.
    pub fn parts(self, a: [f32; 3], b: [f32; 3]) -> bool {
        // Both sides multiplied by the depths: disparity is baseline / z, a place in the picture (x, y) / z.
        let [x, y] = [0, 1].map(|k| b[k] * a[2] - a[k] * b[2]);
        let step = self.baseline_mm * (b[2] - a[2]);
        step * step > self.max_gradient * self.max_gradient * (x * x + y * y).max(1e-9)
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

/// The index `step` from `at`. The picture's own edge is no rim: what lies beyond it is like what lies opposite.
fn mirrored(at: isize, step: isize, end: usize) -> usize {
    let to = at + step;
    let inside = if (0..end as isize).contains(&to) { to } else { at - step };
    inside.clamp(0, end as isize - 1) as usize
}

impl Rims {
    /// Takes corners out of a grid of `width` that do not belong to a surface: those on a ramp between two depths, pieces that are too small, and
    /// teeth of rims. Holes stay holes.
    pub fn clean(&mut self, corners: &mut [Corner], width: usize, limit: GradientLimit) {
        self.cut_edges(corners, width, limit);
        self.cut_ramps(corners, width, limit);
        self.cut_steep_rims(corners, width, limit);
        for _ in 0..ROUNDS {
            self.cut_teeth(corners, width);
        }
        self.cut_islands(corners, width, limit);
    }

    fn take_out(&mut self, corners: &mut [Corner]) {
        corners.iter_mut().zip(&self.is_out).filter(|(_, out)| **out).for_each(|(corner, _)| *corner = NOWHERE);
    }

    /// Takes out narrow strips along the picture's edge: a filter spreads depths there.
    fn cut_edges(&mut self, corners: &mut [Corner], width: usize, limit: GradientLimit) {
        let height = corners.len() / width;
        self.is_out.clear();
        self.is_out.resize(corners.len(), false);
        // From the edge inward: `start`, a step and the number of corners.
        let mut cut = |start: usize, step: isize, count: usize| {
            let at = |k: usize| start.wrapping_add_signed(step * k as isize);
            let is_linked = |k: usize| {
                let (a, b) = (&corners[at(k - 1)], &corners[at(k)]);
                is_known(a) && is_known(b) && !limit.parts(a.world, b.world)
            };
            let run = 1 + (1..count).take_while(|k| is_linked(*k)).count();
            if run < EDGE.min(count) {
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

    fn cut_ramps(&mut self, corners: &mut [Corner], width: usize, limit: GradientLimit) {
        let height = corners.len() / width;
        self.is_out.clear();
        self.is_out.resize(corners.len(), false);
        let limit = limit.scaled(RAMP_SHARE);
        for at in 0..corners.len() {
            let (x, y) = (at % width, at / width);
            let pair = |before: Option<usize>, after: Option<usize>| {
                let (Some(a), Some(b)) = (before, after) else { return false };
                let (a, b) = (&corners[a], &corners[b]);
                is_known(a) && is_known(b) && limit.parts(a.world, b.world)
            };
            let across = pair(x.checked_sub(REACH).map(|_| at - REACH), (x + REACH < width).then_some(at + REACH));
            let down = pair(
                y.checked_sub(REACH).map(|_| at - REACH * width),
                (y + REACH < height).then_some(at + REACH * width),
            );
            self.is_out[at] = across || down;
        }
        self.take_out(corners);
    }

    /// Takes out the corners of a rim where the surface falls away steeply.
    fn cut_steep_rims(&mut self, corners: &mut [Corner], width: usize, limit: GradientLimit) {
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
                            && limit.parts(corners[at].world, corners[known].world)
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

    fn cut_teeth(&mut self, corners: &mut [Corner], width: usize) {
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

    fn cut_islands(&mut self, corners: &mut [Corner], width: usize, limit: GradientLimit) {
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
                is_known(&corners[to]) && !limit.parts(corners[at].world, corners[to].world)
            });
            if self.piece.len() < least {
                self.piece.iter().for_each(|at| self.is_out[*at] = true);
            }
        }
        self.take_out(corners);
    }
}

/// Lights each corner by the normal of what is around it: `shading` darkens what turns away from a viewer along `view` (a unit vector).
pub fn light(corners: &mut [Corner], width: usize, view: [f32; 3], shading: f32) {
    let height = corners.len() / width;
    for at in 0..corners.len() {
        if !is_known(&corners[at]) {
            continue;
        }
        let (x, y) = (at % width, at / width);
        // From the farthest known corner on one side to that on the other.
        let span = |step: usize, before: usize, after: usize| {
            let known = |side: &dyn Fn(usize) -> usize, most: usize| {
                let reach = (1..=most).take_while(|k| is_known(&corners[side(*k)])).last();
                reach.map_or(at, side)
            };
            let a = corners[known(&|k| at - k * step, before.min(REACH))].world;
            let b = corners[known(&|k| at + k * step, after.min(REACH))].world;
            [b[0] - a[0], b[1] - a[1], b[2] - a[2]]
        };
        let (across, down) = (span(1, x, width - 1 - x), span(width, y, height - 1 - y));
        let normal = [
            across[1] * down[2] - across[2] * down[1],
            across[2] * down[0] - across[0] * down[2],
            across[0] * down[1] - across[1] * down[0],
        ];
        let length = normal.iter().map(|v| v * v).sum::<f32>().sqrt();
        let facing = normal.iter().zip(view).map(|(n, v)| n * v).sum::<f32>().abs() / length;
        corners[at].light = if length > 1e-12 { 1.0 - shading + shading * facing } else { 1.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 40;
    /// A slope of 6 at 60 mm.
    const LIMIT: GradientLimit = GradientLimit { max_gradient: 1.5, baseline_mm: 15.0 };

    /// Corners 0.5 mm apart with the given depths, mm; NaN where unknown.
    fn grid(depth: impl Fn(usize, usize) -> f32) -> Vec<Corner> {
        (0..SIDE * SIDE)
            .map(|at| {
                let (x, y) = (at % SIDE, at / SIDE);
                let world = [x as f32 * 0.5, y as f32 * 0.5, depth(x, y)];
                if world[2].is_nan() { NOWHERE } else { Corner { place: world, world, color: [9; 3], light: 1.0 } }
            })
            .collect()
    }

    /// Corners as a camera above the middle sees them, 0.01 of their depth apart.
    fn seen(depth: impl Fn(usize, usize) -> f32) -> Vec<Corner> {
        let mut corners = grid(depth);
        for (at, corner) in corners.iter_mut().enumerate().filter(|(_, corner)| is_known(corner)) {
            let z = corner.world[2];
            let across = |k: usize| (k as f32 - SIDE as f32 / 2.0) * 0.01 * z;
            corner.world = [across(at % SIDE), across(at / SIDE), z];
            corner.place = corner.world;
        }
        corners
    }

    fn known(corners: &[Corner], x: usize, y: usize) -> bool {
        is_known(&corners[y * SIDE + x])
    }

    #[test]
    fn the_ramp_between_two_depths_is_cut_and_both_stay() {
        // 20 mm in 8 corners: each step alone is no steeper than a surface may be.
        let mut corners = seen(|x, _| 50.0 + 2.5 * (x as f32 - 16.0).clamp(0.0, 8.0));
        assert!(!LIMIT.parts(corners[17].world, corners[18].world));
        Rims::default().clean(&mut corners, SIDE, LIMIT);
        assert!((17..24).all(|x| !known(&corners, x, 20)), "the ramp");
        assert!((0..13).all(|x| known(&corners, x, 20)) && (28..SIDE).all(|x| known(&corners, x, 20)));
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

    #[test]
    fn a_strip_along_the_edge_goes_though_it_hangs_on_the_surface() {
        // An instrument leaves the picture; beside it, along the edge, depths fade from the tissue's to its own.
        let is_instrument = |y: usize| (14..26).contains(&y);
        let mut corners = seen(|x, y| match (x, y) {
            (36.., 14..20) => 70.0 - 0.5 * (y - 14) as f32,
            (36.., 20..26) => 70.0 - 0.5 * (26 - y) as f32,
            (20.., y) if is_instrument(y) => 40.0,
            _ => 70.0,
        });
        Rims::default().clean(&mut corners, SIDE, LIMIT);
        assert!((17..23).all(|y| !known(&corners, SIDE - 1, y)), "the strip");
        assert!(known(&corners, 28, 20) && known(&corners, SIDE - 1, 5) && known(&corners, SIDE - 1, 34));
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

    #[test]
    fn what_turns_away_is_darker_and_terraces_are_not_seen() {
        let lit = |slope: f32| {
            // Depths in terraces of two corners.
            let mut corners = grid(|x, _| 50.0 + slope * (x / 2) as f32);
            light(&mut corners, SIDE, [0.0, 0.0, 1.0], 0.6);
            corners.iter().skip(20 * SIDE + 4).take(SIDE - 8).map(|c| c.light).collect::<Vec<f32>>()
        };
        assert!(lit(0.0).iter().all(|l| (l - 1.0).abs() < 1e-3));
        let slanted = lit(1.0);
        assert!(slanted.iter().all(|l| (0.75..0.9).contains(l)), "{slanted:?}");
        assert!(slanted.iter().all(|l| (l - slanted[0]).abs() < 0.01), "{slanted:?}");
    }
}
