//! Small holes of a surface, filled to look at: a match leaves some at highlights and where tissue has no texture.
//!
//! The points are left as they are: what is filled is darker, and has no depth in the image. A hole is filled when what is around it is one surface, close to a plane. Steps of depth stay open.

use super::corner::{Corner, is_located};
use super::rims::{GRAZING_SLOPE, GradientLimit};
use crate::pieces;

/// Largest hole, as a share of all corners.
const MAX_SHARE: f32 = 0.0015;
/// Largest distance of the corners around a hole from their plane, px of disparity in a view of [`USUAL_WIDTH`].
const MAX_DEVIATION_PX: f32 = 1.0;
const USUAL_WIDTH: f32 = 640.0;
/// By how much a hole that was filled in the last image may exceed these limits, so that it does not flicker.
const HELD: f32 = 1.5;
/// Corners around a hole that are needed for a plane.
const MIN_AROUND: usize = 6;

/// Brightness of what is filled, by that of what is around it: so that it differs from what was measured.
const SHADE: f32 = 0.8;

/// Fills holes; keeps its memory.
#[derive(Default)]
pub struct Holes {
    is_visited: Vec<bool>,
    hole: Vec<usize>,
    around: Vec<usize>,
    is_filled: Vec<bool>,
    was_filled: Vec<bool>,
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
    fn fit(samples: impl Iterator<Item = ([f32; 2], f32)> + Clone) -> Option<Self> {
        let count = samples.clone().count() as f32;
        let sums = samples.clone().fold([0.0; 3], |s, ([x, y], v)| [s[0] + x, s[1] + y, s[2] + v]);
        let [mx, my, mean] = sums.map(|sum| sum / count);
        let [mut xx, mut xy, mut yy, mut xv, mut yv] = [0.0; 5];
        for ([x, y], v) in samples {
            let (x, y, v) = (x - mx, y - my, v - mean);
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
            (xv, yv) = (xv + x * v, yv + y * v);
        }
        let determinant = xx * yy - xy * xy;
        let slope = [(xv * yy - yv * xy) / determinant, (yv * xx - xv * xy) / determinant];
        (determinant > 1e-3 * xx * yy).then_some(Self { middle: [mx, my], value: mean, slope })
    }
}

impl Holes {
    /// Whether each corner of the last grid was filled.
    pub fn is_filled(&self) -> &[bool] {
        &self.is_filled
    }

    /// Fills the small holes of a grid of `width`.
    pub fn fill(&mut self, corners: &mut [Corner], width: usize, limit: GradientLimit) {
        let height = corners.len() / width;
        std::mem::swap(&mut self.is_filled, &mut self.was_filled);
        self.is_filled.clear();
        self.is_filled.resize(corners.len(), false);
        self.was_filled.resize(corners.len(), false);
        self.is_visited.clear();
        self.is_visited.extend(corners.iter().map(is_located));
        for start in 0..corners.len() {
            if self.is_visited[start] {
                continue;
            }
            pieces::grow(start, (width, height), &mut self.is_visited, &mut self.hole, |_, to| {
                !is_located(&corners[to])
            });
            let held = self.hole.iter().filter(|at| self.was_filled[**at]).count();
            let factor = if 2 * held > self.hole.len() { HELD } else { 1.0 };
            if self.hole.len() as f32 <= factor * MAX_SHARE * corners.len() as f32 {
                self.fill_hole(corners, (width, height), limit, factor);
            }
        }
    }

    /// Fills one hole if one surface is around it. What reaches the edge of the grid is no hole.
    fn fill_hole(
        &mut self,
        corners: &mut [Corner],
        (width, height): (usize, usize),
        limit: GradientLimit,
        factor: f32,
    ) {
        self.around.clear();
        for &at in &self.hole {
            let (x, y) = (at % width, at / width);
            if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
                return;
            }
            self.around
                .extend([at - 1, at + 1, at - width, at + width].into_iter().filter(|k| is_located(&corners[*k])));
        }
        self.around.sort_unstable();
        self.around.dedup();
        if self.around.len() < MIN_AROUND {
            return;
        }
        let position = |at: usize| [(at % width) as f32, (at / width) as f32];
        let plane =
            |of: fn([f32; 3]) -> f32| Plane::fit(self.around.iter().map(|at| (position(*at), of(corners[*at].world))));
        let planes = (plane(|p| p[0] / p[2]), plane(|p| p[1] / p[2]), plane(|p| 1.0 / p[2]));
        let (Some(right), Some(down), Some(inverse)) = planes else { return };
        let spacing = right.slope[0].hypot(right.slope[1]);
        let is_grazing = inverse.slope[0].hypot(inverse.slope[1]) > GRAZING_SLOPE * inverse.value * spacing;
        let deviation = |at: &usize| (1.0 / corners[*at].world[2] - inverse.at(position(*at))).abs();
        let largest = self.around.iter().map(deviation).fold(0.0, f32::max);
        let px = spacing * width as f32 / USUAL_WIDTH;
        if is_grazing || limit.baseline_mm * largest > factor * MAX_DEVIATION_PX * px {
            return;
        }
        for &at in &self.hole {
            let here = position(at);
            // The plane, and what the corners around deviate from it, the nearer the more.
            let (mut total, mut off, mut color) = (0.0, 0.0, [0.0; 3]);
            for other in &self.around {
                let there = position(*other);
                let weight = 1.0 / ((here[0] - there[0]).powi(2) + (here[1] - there[1]).powi(2));
                total += weight;
                off += weight * (1.0 / corners[*other].world[2] - inverse.at(there));
                (0..3).for_each(|k| color[k] += weight * f32::from(corners[*other].color[k]));
            }
            let z = 1.0 / (inverse.at(here) + off / total);
            corners[at].world = [right.at(here) * z, down.at(here) * z, z];
            corners[at].color = color.map(|value| (SHADE * value / total).round() as u8);
            self.is_filled[at] = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::corner::NOWHERE;
    use super::*;

    const SIDE: usize = 80;
    const LIMIT: GradientLimit = GradientLimit { max_gradient: 1.5, baseline_mm: 5.0 };

    /// Corners as a camera of 80 columns of 8 px sees them, 750 px away from its sensor; NaN where unknown.
    fn seen(depth: impl Fn(usize, usize) -> f32) -> Vec<Corner> {
        let corner = |at: usize| {
            let (x, y) = (at % SIDE, at / SIDE);
            let z = depth(x, y);
            let across = |k: usize| (8.0 * k as f32 - 320.0) / 750.0 * z;
            if z.is_nan() { NOWHERE } else { Corner { world: [across(x), across(y), z], color: [90; 3], ..NOWHERE } }
        };
        (0..SIDE * SIDE).map(corner).collect()
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
        let (mut corners, mut holes) = (seen(holed(3, 0.0)), Holes::default());
        holes.fill(&mut corners, SIDE, LIMIT);
        assert!(corners.iter().all(is_located));
        assert_eq!(holes.is_filled().iter().filter(|filled| **filled).count(), 9);
        let middle = corners[21 * SIDE + 21];
        assert!((middle.world[2] - 62.1).abs() < 0.05 && middle.color == [72; 3], "{:?}", middle.world);
        assert!((middle.world[0] - (8.0 * 21.0 - 320.0) / 750.0 * 62.1).abs() < 0.05, "{:?}", middle.world);
    }

    #[test]
    fn steps_large_holes_and_what_lies_at_the_edge_stay_open() {
        let open = |depth: &dyn Fn(usize, usize) -> f32| {
            let (mut corners, mut holes) = (seen(depth), Holes::default());
            let before = corners.iter().filter(|corner| is_located(corner)).count();
            holes.fill(&mut corners, SIDE, LIMIT);
            assert!(!holes.is_filled().contains(&true));
            corners.iter().filter(|corner| is_located(corner)).count() == before
        };
        assert!(open(&holed(3, 30.0)), "a step");
        assert!(open(&holed(12, 0.0)), "a large hole");
        assert!(open(&|x, y| if x < 2 && y == 20 { f32::NAN } else { 60.0 }), "at the edge");
    }

    #[test]
    fn a_hole_that_was_filled_stays_filled_while_it_is_a_little_larger() {
        let mut holes = Holes::default();
        // 9 corners are within the limit, 12 are not.
        let mut filled = |width: usize| {
            holes.fill(&mut seen(holed(width, 0.0)), SIDE, LIMIT);
            holes.is_filled().contains(&true)
        };
        assert!(!filled(4));
        assert!(filled(3) && filled(4));
        assert!(!filled(12) && !filled(4));
    }
}
