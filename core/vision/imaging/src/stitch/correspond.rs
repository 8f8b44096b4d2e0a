//! Correspondences of two images by correlation alone, without features and without a prior on the geometry: an
//! evaluation of registrations that shares no method with them.
//!
//! Patches of the second image are searched in all of the first one at a coarse scale by normalised cross-correlation,
//! followed down to full size, refined by a parabola, and searched back; patches that do not return to their start are
//! dropped.

use super::evaluate::Gray;
use crate::geometry::Point;
use crate::{Parallel, SharedMut};

/// Maximum number of columns of the coarsest level.
const COARSE_COLUMNS: usize = 96;
/// Half the side of a patch at every level, px of that level.
const HALF: usize = 7;
/// Search radius of each finer level around the coarser position, px.
const REACH: isize = 2;
/// Minimum correlation at the coarsest level, and its minimum lead over all other positions.
const COARSE: (f32, f32) = (0.75, 0.08);
/// Maximum distance of positions of the same peak, px.
const SAME_TOP: usize = 2;
/// Smallest spread of a patch's gray levels for a correlation.
const MIN_DEVIATION: f32 = 2.0;

/// Parameters of the search for correspondences.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrespondParams {
    /// Spacing of the patches.
    pub step_px: usize,
    /// Minimum correlation at full size, 0..=1.
    pub min_correlation: f32,
    /// Maximum distance between a patch and the match of its counterpart, px.
    pub back_px: f64,
}

impl Default for CorrespondParams {
    fn default() -> Self {
        Self { step_px: 24, min_correlation: 0.85, back_px: 1.0 }
    }
}

/// The same point in both images, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correspondence {
    /// Position in the first (left) image.
    pub left: Point,
    /// Position in the second (right) image.
    pub right: Point,
}

fn halved(picture: &Gray) -> Gray {
    let (width, height) = (picture.width / 2, picture.height / 2);
    let mut data = Vec::with_capacity(width * height);
    for y in 0..height {
        let (a, b) = (&picture.data[2 * y * picture.width..], &picture.data[(2 * y + 1) * picture.width..]);
        data.extend((0..width).map(|x| (a[2 * x] + a[2 * x + 1] + b[2 * x] + b[2 * x + 1]) * 0.25));
    }
    Gray { data, width, height }
}

/// Pyramid of an image, full size first.
fn levels(picture: &Gray) -> Vec<Gray> {
    let mut all = vec![picture.clone()];
    while all[all.len() - 1].width > COARSE_COLUMNS && all[all.len() - 1].height > 6 * HALF {
        all.push(halved(&all[all.len() - 1]));
    }
    all
}

const SIDE: usize = 2 * HALF + 1;

/// A patch without its mean, of unit length.
struct Patch([f32; SIDE * SIDE]);

impl Patch {
    fn of(picture: &Gray, x: usize, y: usize) -> Option<Self> {
        if x < HALF || y < HALF || x + HALF >= picture.width || y + HALF >= picture.height {
            return None;
        }
        let mut values = [0.0; SIDE * SIDE];
        for (row, part) in values.as_chunks_mut::<SIDE>().0.iter_mut().enumerate() {
            let at = (y + row - HALF) * picture.width + x - HALF;
            part.copy_from_slice(&picture.data[at..at + SIDE]);
        }
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        values.iter_mut().for_each(|v| *v -= mean);
        let length = values.iter().map(|v| v * v).sum::<f32>().sqrt();
        if length < MIN_DEVIATION * SIDE as f32 {
            return None;
        }
        values.iter_mut().for_each(|v| *v /= length);
        Some(Self(values))
    }

    /// Correlation with the patch around a position in another image, which must be inside; -1 on flat ground.
    fn with(&self, picture: &Gray, x: usize, y: usize) -> f32 {
        let (mut sum, mut square, mut cross) = (0.0f32, 0.0f32, 0.0f32);
        for (row, part) in self.0.as_chunks::<SIDE>().0.iter().enumerate() {
            let at = (y + row - HALF) * picture.width + x - HALF;
            for (p, v) in part.iter().zip(&picture.data[at..at + SIDE]) {
                sum += v;
                square += v * v;
                cross += p * v;
            }
        }
        let spread = square - sum * sum / (SIDE * SIDE) as f32;
        if spread < (MIN_DEVIATION * SIDE as f32).powi(2) { -1.0 } else { cross / spread.sqrt() }
    }

    /// The best position in a part of the image.
    fn best(&self, picture: &Gray, columns: [isize; 2], rows: [isize; 2]) -> Option<(usize, usize, f32)> {
        let inside = |[from, to]: [isize; 2], length: usize| {
            let last = length as isize - HALF as isize - 1;
            from.max(HALF as isize)..=to.min(last)
        };
        let mut best: Option<(usize, usize, f32)> = None;
        for y in inside(rows, picture.height) {
            for x in inside(columns, picture.width) {
                let value = self.with(picture, x as usize, y as usize);
                if best.is_none_or(|(_, _, b)| value > b) {
                    best = Some((x as usize, y as usize, value));
                }
            }
        }
        best
    }

    /// The best position in the whole image if it is unique.
    fn only(&self, picture: &Gray) -> Option<(usize, usize, f32)> {
        let (mut best, mut values) = ((0, 0, -1.0f32), Vec::new());
        for y in HALF..picture.height.saturating_sub(HALF) {
            for x in HALF..picture.width.saturating_sub(HALF) {
                let value = self.with(picture, x, y);
                values.push((x, y, value));
                if value > best.2 {
                    best = (x, y, value);
                }
            }
        }
        let apart = |x: usize, y: usize| x.abs_diff(best.0) > SAME_TOP || y.abs_diff(best.1) > SAME_TOP;
        let rival = values.iter().any(|&(x, y, value)| apart(x, y) && value > best.2 - COARSE.1);
        (best.2 >= COARSE.0 && !rival).then_some(best)
    }
}

/// Peak of the parabola through three values one apart, relative to the middle one.
fn top(before: f32, here: f32, after: f32) -> f64 {
    let curve = before - 2.0 * here + after;
    if curve < -1e-6 { f64::from(((before - after) / (2.0 * curve)).clamp(-0.5, 0.5)) } else { 0.0 }
}

/// Searches the surroundings of pixel `(x, y)` of `from` in `to`; both full size first.
fn seek(from: &[Gray], to: &[Gray], (x, y): (usize, usize)) -> Option<(Point, f32)> {
    let mut place: Option<(usize, usize)> = None;
    for level in (0..from.len().min(to.len())).rev() {
        // A patch that is flat, or over the edge, at one scale is followed at the next.
        let Some(patch) = Patch::of(&from[level], x >> level, y >> level) else {
            place = place.map(|(x, y)| (2 * x, 2 * y));
            continue;
        };
        let found = match place {
            None => patch.only(&to[level]),
            Some((cx, cy)) => {
                let around = |c: usize| [2 * c as isize - REACH, 2 * c as isize + 1 + REACH];
                patch.best(&to[level], around(cx), around(cy))
            }
        };
        let (cx, cy, value) = found?;
        if level == 0 {
            let inside = cx > HALF && cy > HALF && cx + HALF + 1 < to[0].width && cy + HALF + 1 < to[0].height;
            if !inside {
                return None;
            }
            let at = |dx: isize, dy: isize| patch.with(&to[0], cx.wrapping_add_signed(dx), cy.wrapping_add_signed(dy));
            let (dx, dy) = (top(at(-1, 0), value, at(1, 0)), top(at(0, -1), value, at(0, 1)));
            return Some(([cx as f64 + dx, cy as f64 + dy], value));
        }
        place = Some((cx, cy));
    }
    None
}

/// Finds correspondences of two gray images; allocates, because it is meant for evaluation.
pub fn correspondences(
    left: &Gray,
    right: &Gray,
    params: &CorrespondParams,
    pool: &dyn Parallel,
) -> Vec<Correspondence> {
    let step = params.step_px.max(1);
    let places: Vec<(usize, usize)> = (step / 2..right.height)
        .step_by(step)
        .flat_map(|y| (step / 2..right.width).step_by(step).map(move |x| (x, y)))
        .collect();
    let (left, right) = (levels(left), levels(right));
    let mut found: Vec<Option<Correspondence>> = vec![None; places.len()];
    let shared = SharedMut::new(&mut found);
    pool.run(places.len(), &|index| {
        let place = places[index];
        let pair = || {
            let (there, value) = seek(&right, &left, place)?;
            if value < params.min_correlation {
                return None;
            }
            let (back, _) = seek(&left, &right, (there[0].round() as usize, there[1].round() as usize))?;
            // The way back starts at a whole pixel.
            let (dx, dy) = (there[0] - there[0].round(), there[1] - there[1].round());
            let off = (back[0] + dx - place.0 as f64).hypot(back[1] + dy - place.1 as f64);
            let pair = Correspondence { left: there, right: [place.0 as f64, place.1 as f64] };
            (off <= params.back_px).then_some(pair)
        };
        // SAFETY: every chunk has its own place.
        unsafe { shared.part(index, 1)[0] = pair() };
    });
    found.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Serial;
    use panoscope_base::random::lattice;

    /// Blobs of several sizes: which tissue has and a repeated pattern lacks.
    fn scene(width: usize, height: usize, shift: [f64; 2], seed: u64) -> Gray {
        let value = |x: f64, y: f64| {
            let mut sum = 128.0;
            for (index, cell) in [48.0, 20.0, 9.0].into_iter().enumerate() {
                let corner = |i: i64, j: i64| {
                    let seed = seed << 8 ^ index as u64;
                    lattice(i, j, seed) - 0.5
                };
                let (u, v) = (x / cell, y / cell);
                let (i, j) = (u.floor(), v.floor());
                let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
                let (s, t) = (smooth(u - i), smooth(v - j));
                let (i, j) = (i as i64, j as i64);
                let mix = |a: f64, b: f64, s: f64| a + (b - a) * s;
                sum += 60.0
                    * mix(mix(corner(i, j), corner(i + 1, j), s), mix(corner(i, j + 1), corner(i + 1, j + 1), s), t);
            }
            sum as f32
        };
        let data =
            (0..width * height).map(|k| value((k % width) as f64 + shift[0], (k / width) as f64 + shift[1])).collect();
        Gray { data, width, height }
    }

    #[test]
    fn shifted_pictures_correspond() {
        let (left, right) = (scene(320, 240, [0.0, 0.0], 3), scene(320, 240, [83.5, -6.25], 3));
        let found = correspondences(&left, &right, &CorrespondParams::default(), &Serial);
        assert!(found.len() > 30, "{}", found.len());
        let off = |p: &Correspondence| (p.left[0] - p.right[0] - 83.5).hypot(p.left[1] - p.right[1] + 6.25);
        for pair in &found {
            assert!(off(pair) < 0.9, "{pair:?} is {} px off", off(pair));
        }
        let mean = found.iter().map(off).sum::<f64>() / found.len() as f64;
        assert!(mean < 0.35, "{mean} px off in the mean");
    }

    #[test]
    fn strangers_hardly_correspond() {
        let (left, right) = (scene(320, 240, [0.0, 0.0], 3), scene(320, 240, [0.0, 0.0], 4));
        let found = correspondences(&left, &right, &CorrespondParams::default(), &Serial);
        assert!(found.len() <= 1, "{found:?}");
    }
}
