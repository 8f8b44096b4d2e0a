//! Areas where a true homography holds: photographs of a flat wall also show things in front of or behind it.
//!
//! For example, the lowest fifth of the Graffiti images is 3 to 8 px off the published homography, so correct matches
//! there count as wrong. These areas are found without keypoints: normalised cross-correlation searches patches of the
//! first image in the second, around the position that the homography gives.

use panoscope_imaging::View;
use panoscope_imaging::geometry::{Homography, Point};

/// Side of a cell that is classified as a whole, in pixels of the first image.
const CELL_PX: usize = 16;
/// Half the side of the patch around a cell's centre.
const HALF_PATCH_PX: usize = 20;
/// Search radius around the position that the homography gives, in pixels of the second image.
const REACH_PX: i32 = 10;
/// A patch found further away than this contradicts the homography, px.
const OFF_PX: i32 = 2;
/// Minimum correlation at which a patch counts as found.
const FOUND: f32 = 0.8;
/// Minimum lead in correlation over the homography's position for a position that contradicts it.
const LEAD: f32 = 0.05;
/// Cells to each side that vote on a cell.
const VOTERS: usize = 2;

/// Cells of the first image that follow the homography.
pub struct Plane {
    columns: usize,
    rows: usize,
    flat: Vec<bool>,
}

impl Plane {
    /// Classifies every cell of `first` (gray) by `second` (gray); cells without texture take the class of their
    /// neighbours.
    pub fn find(first: View<'_, u8>, second: View<'_, u8>, second_from_first: &Homography) -> Self {
        let (columns, rows) = (first.width.div_ceil(CELL_PX), first.height.div_ceil(CELL_PX));
        let votes: Vec<i32> = (0..columns * rows)
            .map(|cell| {
                let centre = |index: usize| index * CELL_PX + CELL_PX / 2;
                vote(first, second, second_from_first, centre(cell % columns), centre(cell / columns))
            })
            .collect();
        let near = |index: usize, count: usize| index.saturating_sub(VOTERS)..(index + VOTERS + 1).min(count);
        let flat = (0..columns * rows).map(|cell| {
            let places = near(cell / columns, rows).flat_map(|y| near(cell % columns, columns).map(move |x| (x, y)));
            places.map(|(x, y)| votes[y * columns + x]).sum::<i32>() >= 0
        });
        Self { columns, rows, flat: flat.collect() }
    }

    /// Whether the homography holds at a point of the first image.
    pub fn holds(&self, point: Point) -> bool {
        let cell = |value: f64, count: usize| ((value.max(0.0) as usize) / CELL_PX).min(count.saturating_sub(1));
        self.flat.get(cell(point[1], self.rows) * self.columns + cell(point[0], self.columns)).copied().unwrap_or(false)
    }

    /// Share of cells on which it holds.
    pub fn share(&self) -> f64 {
        self.flat.iter().filter(|flat| **flat).count() as f64 / self.flat.len().max(1) as f64
    }
}

/// 1 if the patch is at the homography's position, -1 if it is clearly elsewhere, 0 if unknown.
fn vote(first: View<'_, u8>, second: View<'_, u8>, map: &Homography, x: usize, y: usize) -> i32 {
    let half = HALF_PATCH_PX;
    if x < half || y < half || x + half >= first.width || y + half >= first.height {
        return 0;
    }
    let places: Vec<(usize, usize)> =
        (y - half..=y + half).flat_map(|v| (x - half..=x + half).map(move |u| (u, v))).collect();
    let patch: Vec<f32> = places.iter().map(|&(u, v)| f32::from(first.row(v)[u])).collect();
    let targets: Vec<Point> = places.iter().map(|&(u, v)| map.map([u as f64, v as f64])).collect();
    let margin = f64::from(REACH_PX) + 1.0;
    let inside = |p: &Point| {
        let (right, bottom) = (second.width as f64 - 1.0 - margin, second.height as f64 - 1.0 - margin);
        p[0] >= margin && p[1] >= margin && p[0] <= right && p[1] <= bottom
    };
    if !targets.iter().all(inside) {
        return 0;
    }
    let (mut here, mut best) = (-1.0f32, -1.0f32);
    for dy in -REACH_PX..=REACH_PX {
        for dx in -REACH_PX..=REACH_PX {
            let value = correlation(&patch, second, &targets, f64::from(dx), f64::from(dy));
            best = best.max(value);
            if dx.abs().max(dy.abs()) <= OFF_PX {
                here = here.max(value);
            }
        }
    }
    match () {
        () if best < FOUND => 0,
        () if best > here + LEAD => -1,
        () => i32::from(here >= best),
    }
}

/// Normalised cross-correlation of a patch with the second image at shifted positions; 0 without texture.
fn correlation(patch: &[f32], second: View<'_, u8>, targets: &[Point], dx: f64, dy: f64) -> f32 {
    let (mut a, mut b, mut aa, mut bb, mut ab) = (0.0f64, 0.0f64, 0.0f64, 0.0f64, 0.0f64);
    for (&value, target) in patch.iter().zip(targets) {
        let (x, y) = (target[0] + dx, target[1] + dy);
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f64, y - row as f64);
        let pair = |row: usize| {
            let line = second.row(row);
            f64::from(line[column]) * (1.0 - fx) + f64::from(line[column + 1]) * fx
        };
        let (u, v) = (f64::from(value), pair(row) * (1.0 - fy) + pair(row + 1) * fy);
        a += u;
        b += v;
        aa += u * u;
        bb += v * v;
        ab += u * v;
    }
    let count = patch.len().max(1) as f64;
    let (spread_a, spread_b) = (aa - a * a / count, bb - b * b / count);
    // Less than four gray levels of contrast are not used.
    if spread_a.min(spread_b) < 16.0 * count {
        0.0
    } else {
        ((ab - a * b / count) / (spread_a * spread_b).sqrt()) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_off_the_plane_is_found() {
        const W: usize = 320;
        const H: usize = 240;
        let texture = |x: i64, y: i64| {
            let noise = (x.div_euclid(3).wrapping_mul(73_856_093) ^ y.div_euclid(3).wrapping_mul(19_349_663)) as u64;
            (noise.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8
        };
        let first: Vec<u8> = (0..H * W).map(|i| texture((i % W) as i64, (i / W) as i64)).collect();
        // Everything moves by (6, 2); below row 160 by 5 px more.
        let moved = |i: usize| {
            let (x, y) = ((i % W) as i64, (i / W) as i64);
            texture(x - if y < 162 { 6 } else { 11 }, y - 2)
        };
        let second: Vec<u8> = (0..H * W).map(moved).collect();
        let map = Homography([1.0, 0.0, 6.0, 0.0, 1.0, 2.0, 0.0, 0.0, 1.0]);
        let view = |data| View::new(data, W, H, 1);
        let plane = Plane::find(view(&first[..]), view(&second[..]), &map);
        assert!((40..280).step_by(20).all(|x| plane.holds([f64::from(x), 100.0])));
        assert!((40..280).step_by(20).all(|x| !plane.holds([f64::from(x), 205.0])));
        assert!(plane.share() > 0.4 && plane.share() < 0.9);
    }
}
