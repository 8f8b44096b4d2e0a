//! Smooth rims of a surface: measures how far inside each corner is, so that the rim can be drawn between corners.
//!
//! Corners are either known or not, so a rim along them shows the steps of their grid. The share of known corners
//! around each, weighted by a binomial window, is 0.5 along a line that cuts these steps off: drawn up to there,
//! straight rims are unchanged and corners of rims become round.

use super::corner::{Corner, NOWHERE, is_known};
use super::rims::GradientLimit;

/// Radius of the window in corners.
const REACH: usize = 2;
const WINDOW: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
/// Minimum value of a drawn corner.
pub const RIM: f32 = 0.5;

/// Finds contours; with reusable buffers.
#[derive(Default)]
pub struct Contour {
    /// For each corner how far it lies inside, 0 to 1.
    inside: Vec<f32>,
    unknown: Vec<bool>,
    near: Vec<bool>,
    added: Vec<(usize, Corner)>,
}

impl Contour {
    /// Depth of each corner inside the surface: 1 inside, [`RIM`] on its rim.
    pub fn inside(&self) -> &[f32] {
        &self.inside
    }

    /// Measures a grid of `width`, and continues each surface by one corner beyond its rim, so that a rim between
    /// corners can be drawn. `place` projects a point in the camera's frame to pixel and depth.
    pub fn find(
        &mut self,
        corners: &mut [Corner],
        width: usize,
        limit: GradientLimit,
        place: impl Fn([f32; 3]) -> [f32; 3],
    ) {
        let height = corners.len() / width;
        self.find_near(corners, width);
        self.inside.clear();
        self.inside.resize(corners.len(), 1.0);
        self.added.clear();
        for at in (0..corners.len()).filter(|at| self.near[*at]) {
            let own = match is_known(&corners[at]) {
                true => Some(corners[at]),
                false => beyond(corners, (width, height), at, limit).map(|world| {
                    let corner = nearest(corners, (width, height), at, limit, world);
                    Corner { place: place(world), world, ..corner }
                }),
            };
            let Some(corner) = own else {
                self.inside[at] = 0.0;
                continue;
            };
            let (x, y) = (at % width, at / width);
            let mut share = 0.0;
            for (dy, weight_y) in WINDOW.iter().enumerate() {
                for (dx, weight_x) in WINDOW.iter().enumerate() {
                    let (u, v) = (mirrored(x, dx, width), mirrored(y, dy, height));
                    let other = &corners[v * width + u];
                    if is_known(other) && !limit.parts_at_rim(corner.world, other.world) {
                        share += weight_x * weight_y;
                    }
                }
            }
            self.inside[at] = share;
            if !is_known(&corners[at]) {
                self.added.push((at, corner));
            }
        }
        for (at, corner) in self.added.drain(..) {
            corners[at] = corner;
        }
    }

    /// Marks the corners that have an unknown one around them.
    fn find_near(&mut self, corners: &[Corner], width: usize) {
        let height = corners.len() / width;
        let Self { unknown, near, .. } = self;
        unknown.clear();
        unknown.extend(corners.iter().map(|corner| !is_known(corner)));
        near.clear();
        near.resize(corners.len(), false);
        for at in (0..corners.len()).filter(|at| unknown[*at]) {
            let (x, y) = (at % width, at / width);
            // Deep in a hole nothing is near that is not marked already.
            let is_deep = x > 0
                && y > 0
                && x + 1 < width
                && y + 1 < height
                && [at - 1, at + 1, at - width, at + width].iter().all(|k| unknown[*k]);
            if is_deep {
                near[at] = true;
                continue;
            }
            for v in y.saturating_sub(REACH)..(y + REACH + 1).min(height) {
                near[v * width + x.saturating_sub(REACH)..v * width + (x + REACH + 1).min(width)].fill(true);
            }
        }
    }
}

/// Position of a corner of the window; the image's border is not a rim, so values beyond it are mirrored.
fn mirrored(at: usize, step: usize, end: usize) -> usize {
    let wanted = at as isize + step as isize - REACH as isize;
    let last = end as isize - 1;
    let inside = if wanted < 0 { -wanted } else { wanted };
    (if inside > last { 2 * last - inside } else { inside }).clamp(0, last) as usize
}

/// Neighbours of a corner and the next ones in the same directions.
fn around(size: (usize, usize), at: usize) -> impl Iterator<Item = (usize, Option<usize>)> {
    const STEPS: [(isize, isize); 8] = [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)];
    let (width, height) = (size.0 as isize, size.1 as isize);
    let (x, y) = (at as isize % width, at as isize / width);
    let index = move |x: isize, y: isize| {
        ((0..width).contains(&x) && (0..height).contains(&y)).then_some((y * width + x) as usize)
    };
    STEPS.into_iter().filter_map(move |(dx, dy)| Some((index(x + dx, y + dy)?, index(x + 2 * dx, y + 2 * dy))))
}

/// Extrapolated position of an unknown corner: the mean of the lines through two known corners in a row; `None` without
/// a neighbour.
fn beyond(corners: &[Corner], size: (usize, usize), at: usize, limit: GradientLimit) -> Option<[f32; 3]> {
    let known = |index: &usize| is_known(&corners[*index]);
    let (first, _) = around(size, at).find(|(near, _)| known(near))?;
    let reference = corners[first].world;
    let (mut sum, mut count) = ([0.0f32; 3], 0.0);
    for (near, behind) in around(size, at).filter(|(near, _)| known(near)) {
        let (a, b) = (corners[near].world, behind.filter(|index| known(index)).map(|index| corners[index].world));
        let Some(b) = b.filter(|b| !limit.parts_at_rim(a, *b) && !limit.parts_at_rim(a, reference)) else {
            continue;
        };
        (sum, count) = ([0, 1, 2].map(|k| sum[k] + 2.0 * a[k] - b[k]), count + 1.0);
    }
    let world = sum.map(|v| v / count);
    (count > 0.0 && world[2] > 0.0).then_some(world)
}

/// The neighbour whose colour a continued corner takes.
fn nearest(corners: &[Corner], size: (usize, usize), at: usize, limit: GradientLimit, world: [f32; 3]) -> Corner {
    let fits = |index: &usize| is_known(&corners[*index]) && !limit.parts_at_rim(corners[*index].world, world);
    around(size, at).map(|(near, _)| near).find(fits).map_or(NOWHERE, |index| corners[index])
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 24;

    fn grid(depth: impl Fn(usize, usize) -> f32) -> Vec<Corner> {
        let corner = |at: usize| {
            let (x, y) = ((at % SIDE) as f32, (at / SIDE) as f32);
            let z = depth(at % SIDE, at / SIDE);
            let world = [(x - 12.0) * 0.01 * z, (y - 12.0) * 0.01 * z, z];
            if z.is_nan() { NOWHERE } else { Corner { place: [x, y, z], world, color: [z as u8; 3], ..NOWHERE } }
        };
        (0..SIDE * SIDE).map(corner).collect()
    }

    fn found(depth: impl Fn(usize, usize) -> f32) -> (Vec<Corner>, Contour) {
        let (mut corners, mut contour) = (grid(depth), Contour::default());
        contour.find(&mut corners, SIDE, GradientLimit { max_gradient: 1.5, baseline_mm: 15.0 }, |world| world);
        (corners, contour)
    }

    #[test]
    fn a_straight_rim_stays_where_it_is() {
        let (corners, contour) = found(|x, _| if x < 10 { 50.0 } else { f32::NAN });
        let row = &contour.inside()[8 * SIDE..9 * SIDE];
        assert!(row[..8].iter().all(|v| *v == 1.0), "{row:?}");
        // Half way between the last known corner and the first unknown one.
        let crossing = 9.0 + (row[9] - RIM) / (row[9] - row[10]);
        assert!((crossing - 9.5).abs() < 1e-3, "{crossing}");
        assert!((corners[8 * SIDE + 10].world[2] - 50.0).abs() < 1e-3, "the plane goes on");
        assert!(corners[8 * SIDE + 12].place[0].is_nan() && row[12] < RIM);
        // The picture's edge is no rim.
        assert!(contour.inside()[..8].iter().all(|v| *v == 1.0));
    }

    #[test]
    fn a_rim_in_steps_becomes_a_slope_and_a_hole_stays_one() {
        // Steps of three corners: the rim's distance from the line through them, by its crossings of the rows.
        let (_, contour) = found(|x, y| if x < 6 + 3 * (y / 3) / 2 { 50.0 } else { f32::NAN });
        let crossing = |y: usize| {
            let row = &contour.inside()[y * SIDE..(y + 1) * SIDE];
            let at = (0..SIDE - 1).find(|x| row[*x] >= RIM && row[x + 1] < RIM).expect("a rim");
            at as f32 + (row[at] - RIM) / (row[at] - row[at + 1])
        };
        let jumps: Vec<f32> = (6..17).map(|y| crossing(y + 1) - crossing(y)).collect();
        assert!(jumps.iter().all(|jump| (-0.2..1.4).contains(jump)), "{jumps:?}");
        let (corners, contour) =
            found(|x, y| if (8..14).contains(&x) && (8..14).contains(&y) { f32::NAN } else { 50.0 });
        assert!(contour.inside()[11 * SIDE + 11] < RIM && corners[11 * SIDE + 11].place[0].is_nan());
    }

    #[test]
    fn two_surfaces_have_two_rims() {
        let (corners, contour) = found(|x, _| match x {
            ..10 => 40.0,
            13.. => 70.0,
            _ => f32::NAN,
        });
        let z = |x: usize| corners[8 * SIDE + x].world[2];
        assert!((z(10) - 40.0).abs() < 1e-3 && (z(12) - 70.0).abs() < 1e-3 && z(11).is_nan());
        let row = &contour.inside()[8 * SIDE..9 * SIDE];
        assert!(row[9] > RIM && row[10] < RIM && row[12] < RIM && row[13] > RIM, "{row:?}");
    }
}
