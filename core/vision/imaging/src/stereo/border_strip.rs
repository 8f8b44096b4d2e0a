//! Matching of a strip at the border that is narrower than a block.
//!
//! Cameras close to the tissue share a strip along the border of their views. Where it is about as narrow as a block, blocks reach beyond it, and
//! block matching finds nothing or chance. There all columns of the strip are compared at once, over some rows, by normalised correlation. The search
//! goes on row by row from where the blocks matched, so that the strip continues a surface that is known.

use super::StereoError;
use super::pair::{PairMaps, PairViews, RowEdit};
use crate::{Parallel, Rect, View};

/// Columns of a view that lengths refer to; they grow with the view.
const REFERENCE_COLUMNS: usize = 640;
/// Width of a strip, px.
const MIN_PX: usize = 8;
const MAX_PX: usize = 32;
/// Distance of the rows that are matched, and rows above and below each that are compared with it, px.
const ROW_STEP_PX: usize = 4;
const REACH_PX: usize = 8;
/// Columns before the border of which this share must agree, within so many px, for a row to be known.
const KNOWN_PX: usize = 12;
const KNOWN_SHARE: f32 = 0.3;
const AGREE_PX: f32 = 4.0;
/// Rows in a line, in steps, that must be known for the strip to start there: chance does not agree for long.
const MIN_RUN: usize = 6;
/// The disparity changes by at most this much per row, px per px, and by so much more for its noise, px.
const MAX_SLOPE: f32 = 1.2;
const NOISE_PX: f32 = 2.0;
/// Smallest correlation of a match.
const MIN_CORRELATION: f32 = 0.6;
/// Smallest standard deviation of what is matched, levels.
const MIN_TEXTURE: f32 = 1.5;
/// Rows without a match, in steps, after which the search ends.
const MAX_MISSES: usize = 4;

/// Fills in disparities of a strip at the right border of the left view. Reuses its memory.
#[derive(Debug, Default)]
pub struct BorderStrip {
    /// Disparity before the border per step of rows, px; NaN where unknown.
    known: Vec<f32>,
    /// The same, as the strip is matched.
    found: Vec<f32>,
    sorted: Vec<f32>,
    edits: Vec<RowEdit>,
}

/// The strip's rows and lengths in px of the views.
#[derive(Clone, Copy, Debug)]
struct Layout {
    /// Pixels per px of the reference.
    unit: usize,
    /// First row, and number of steps.
    first: usize,
    count: usize,
    width: usize,
    height: usize,
}

impl Layout {
    fn row(&self, step: usize) -> usize {
        self.first + step * ROW_STEP_PX * self.unit
    }

    /// Largest change of the disparity over so many steps, px.
    fn climb(&self, steps: usize) -> f32 {
        let unit = self.unit as f32;
        unit * (MAX_SLOPE * (steps * ROW_STEP_PX) as f32 + NOISE_PX)
    }
}

impl BorderStrip {
    /// Matches the strip of a rectified gray pair where the map knows nothing of it.
    ///
    /// Writes px of the left view, from the column that the right view begins at to the border. Does nothing when the views share more than a strip.
    ///
    /// # Errors
    /// Those of the views and of the maps.
    pub fn fill(
        &mut self,
        views: &mut dyn PairViews,
        maps: &mut dyn PairMaps,
        roi: Rect,
        pool: &dyn Parallel,
    ) -> Result<(), StereoError> {
        let (width, height) = views.size();
        let unit = (width / REFERENCE_COLUMNS).max(1);
        let reaches = roi.x + roi.width >= width;
        let margin = REACH_PX * unit;
        if !reaches || width < 4 * MAX_PX * unit || roi.height <= 2 * margin {
            return Ok(());
        }
        let first = roi.y + margin;
        let count = (roi.height - 2 * margin).div_ceil(ROW_STEP_PX * unit);
        let layout = Layout { unit, first, count, width, height };
        self.read(maps.columns(0, width - KNOWN_PX * unit..width)?, &layout);
        if self.known.iter().all(|d| d.is_nan()) {
            return Ok(());
        }
        let strips = views.border(MAX_PX * unit)?;
        self.found.clear();
        self.found.resize(count, f32::NAN);
        for start in 0..count {
            if self.known[start].is_nan() {
                continue;
            }
            if start > 0 && self.known[start - 1].is_nan() {
                self.walk(strips, &layout, (0..start).rev());
            }
            if start + 1 < count && self.known[start + 1].is_nan() {
                self.walk(strips, &layout, start + 1..count);
            }
        }
        self.take_edits(&layout);
        if self.edits.iter().all(|edit| *edit == RowEdit::NONE) { Ok(()) } else { maps.edit(0, &self.edits, pool) }
    }

    /// Finds the steps in which the map knows the disparity before the border, of which it has these columns.
    fn read(&mut self, border: View<'_, f32>, layout: &Layout) {
        let unit = layout.unit;
        self.known.clear();
        for step in 0..layout.count {
            let y = layout.row(step);
            let rows = y.saturating_sub(2 * unit)..(y + 2 * unit + 1).min(layout.height);
            let total = rows.len() * border.width;
            self.sorted.clear();
            for row in rows {
                self.sorted.extend(border.row(row).iter().filter(|d| d.is_finite()));
            }
            self.known.push(agreed(&mut self.sorted, total, AGREE_PX * unit as f32));
        }
        // What lies further in needs no strip; what agrees by chance does not agree for long.
        let narrow = (layout.width - 2 * MAX_PX * unit) as f32;
        let mut start = 0;
        while start < layout.count {
            let mut end = start + 1;
            while end < layout.count && (self.known[end] - self.known[end - 1]).abs() <= layout.climb(1) {
                end += 1;
            }
            let run = &mut self.known[start..end];
            if run.len() < MIN_RUN {
                run.fill(f32::NAN);
            }
            start = end;
        }
        if !self.known.iter().any(|d| *d >= narrow) {
            self.known.fill(f32::NAN);
        }
    }

    /// Goes on from a known step over those that are not. `strips` are the borders of the views.
    fn walk(&mut self, strips: [View<'_, u8>; 2], layout: &Layout, steps: impl Iterator<Item = usize> + Clone) {
        let from = |steps: &mut dyn Iterator<Item = usize>, known: &[f32]| {
            steps.next().map(|step| {
                if step + 1 < known.len() && known[step + 1].is_finite() { known[step + 1] } else { known[step - 1] }
            })
        };
        let Some(mut last) = from(&mut steps.clone(), &self.known) else { return };
        let mut misses = 0;
        for step in steps {
            if self.known[step].is_finite() || misses == MAX_MISSES {
                return;
            }
            match best(strips, layout, layout.row(step), last, layout.climb(misses + 1)) {
                Some(found) => {
                    self.found[step] = found;
                    (last, misses) = (found, 0);
                }
                None => misses += 1,
            }
        }
    }

    /// Finds what becomes of the map's rows: what was found, and what lies between that and what was known.
    fn take_edits(&mut self, layout: &Layout) {
        self.edits.clear();
        self.edits.resize(layout.height, RowEdit::NONE);
        let high = ROW_STEP_PX * layout.unit;
        for step in 0..layout.count {
            let of = |step: usize| {
                let found = self.found.get(step).copied().filter(|d| d.is_finite());
                (found.or(self.known.get(step).copied().filter(|d| d.is_finite())), found.is_some())
            };
            let ((here, is_here), (next, is_next)) = (of(step), of(step + 1));
            let Some(here) = here.or(next).filter(|_| is_here || is_next) else { continue };
            let next = next.unwrap_or(here);
            for down in 0..high {
                let d = here + (next - here) * down as f32 / high as f32;
                let y = layout.row(step) + down;
                let from = d.ceil().max(0.0) as usize;
                if y < layout.height && from < layout.width {
                    self.edits[y] = RowEdit { from: from as u32, value: d, overwrites: is_here, ..RowEdit::NONE };
                }
            }
        }
    }
}

/// The median of values of which enough, of `total`, lie near it; else NaN.
fn agreed(values: &mut [f32], total: usize, within: f32) -> f32 {
    if (values.len() as f32) < KNOWN_SHARE * total as f32 {
        return f32::NAN;
    }
    let middle = values.len() / 2;
    let median = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
    let near = values.iter().filter(|d| (**d - median).abs() <= within).count();
    if near as f32 >= KNOWN_SHARE * total as f32 { median } else { f32::NAN }
}

/// The disparity near `around` at which the strip around a row correlates best; `None` when it correlates too little.
fn best(strips: [View<'_, u8>; 2], layout: &Layout, row: usize, around: f32, climb: f32) -> Option<f32> {
    let (unit, width) = (layout.unit, layout.width);
    let first = ((around - climb).round() as i64).max((width - MAX_PX * unit) as i64);
    let last = ((around + climb).round() as i64).min((width - MIN_PX * unit) as i64);
    let of = |d: i64| correlation(strips, layout, row, d as usize);
    let (mut best_at, mut best_value) = (first, f32::MIN);
    for d in first..=last {
        let value = of(d);
        if value > best_value {
            (best_at, best_value) = (d, value);
        }
    }
    if best_value < MIN_CORRELATION {
        return None;
    }
    // Vertex of the parabola through the neighbours.
    if best_at == first || best_at == last {
        return Some(best_at as f32);
    }
    let (less, more) = (of(best_at - 1), of(best_at + 1));
    let bend = less - 2.0 * best_value + more;
    let offset = if bend < 0.0 { (0.5 * (less - more) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    Some(best_at as f32 + offset)
}

/// Normalised correlation of the strip that both views share at a disparity, over the rows around one; -1 without texture.
fn correlation([left, right]: [View<'_, u8>; 2], layout: &Layout, row: usize, disparity: usize) -> f32 {
    let Layout { unit, width, height, .. } = *layout;
    let rows = row.saturating_sub(REACH_PX * unit)..(row + REACH_PX * unit + 1).min(height);
    let (mut count, mut a, mut b, mut aa, mut bb, mut ab) = (0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32);
    for y in rows.step_by(unit) {
        let (l, r) = (&left.row(y)[left.width + disparity - width..], &right.row(y)[..width - disparity]);
        for (l, r) in l.iter().zip(r).step_by(unit) {
            // Near zero, so that sums of squares keep their digits.
            let (l, r) = (f32::from(*l) - 128.0, f32::from(*r) - 128.0);
            count += 1.0;
            (a, b, aa, bb, ab) = (a + l, b + r, aa + l * l, bb + r * r, ab + l * r);
        }
    }
    let one = 1.0 / count.max(1.0);
    let (a, b) = (a * one, b * one);
    let (va, vb) = (aa * one - a * a, bb * one - b * b);
    if va.min(vb) < MIN_TEXTURE * MIN_TEXTURE {
        return -1.0;
    }
    (ab * one - a * b) / (va * vb).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Serial;
    use crate::stereo::pair::testing::with_maps;
    use panoscope_base::random::lattice as random;

    const W: usize = 640;
    const H: usize = 240;

    fn smooth(x: f64, y: f64) -> f64 {
        let (i, j) = (x.floor(), y.floor());
        let at = |dx: i64, dy: i64| random(i as i64 + dx, j as i64 + dy, 3);
        let (s, t) = (x - i, y - j);
        (at(0, 0) * (1.0 - s) + at(1, 0) * s) * (1.0 - t) + (at(0, 1) * (1.0 - s) + at(1, 1) * s) * t
    }

    /// A strip that narrows downwards, from 60 to 14 px.
    fn truth(y: usize) -> f32 {
        580.0 + 46.0 * (y as f32 / H as f32).min(0.8) / 0.8
    }

    fn views() -> [Vec<u8>; 2] {
        let texture = |x: f64, y: f64| (60.0 + 130.0 * smooth(x / 5.0, y / 5.0)) as u8;
        let left = (0..W * H).map(|i| texture((i % W) as f64, (i / W) as f64)).collect();
        // The right view is brighter by a half.
        let right = (0..W * H).map(|i| {
            let (x, y) = ((i % W) as f64, i / W);
            (f64::from(texture(x + f64::from(truth(y)), y as f64)) * 1.3).min(255.0) as u8
        });
        [left, right.collect()]
    }

    /// What blocks find: the upper part of the strip, and chance below.
    fn blocks() -> Vec<f32> {
        let known = |x: usize, y: usize| y < 130 && x as f32 >= truth(y);
        let chance = |x: usize, y: usize| random((x / 5) as i64, (y / 5) as i64, 8) < 0.2;
        let value = |x: usize, y: usize| match (known(x, y), chance(x, y)) {
            (true, _) => truth(y),
            (_, true) => 540.0 + 90.0 * random((x / 5) as i64, (y / 5) as i64, 9) as f32,
            _ => f32::NAN,
        };
        (0..W * H).map(|i| value(i % W, i / W)).collect()
    }

    fn filled(map: &mut Vec<f32>, views: &[Vec<u8>; 2]) {
        let mut views = views.each_ref().map(|view| View::new(&view[..], W, H, 1));
        with_maps([map, &mut Vec::new()], (W, H), false, |maps| {
            BorderStrip::default().fill(&mut views, maps, Rect::whole(W, H), &Serial)
        });
    }

    #[test]
    fn a_strip_narrower_than_a_block_is_matched() {
        let mut map = blocks();
        filled(&mut map, &views());
        for y in (20..H - 20).step_by(5) {
            let d = map[y * W + W - 3];
            assert!((d - truth(y)).abs() < 2.0, "{d} for {} in row {y}", truth(y));
        }
    }

    #[test]
    fn nothing_is_filled_where_the_views_share_more_or_nothing() {
        let same = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
        // The views share a third.
        let wide = |map: Vec<f32>| -> Vec<f32> { map.into_iter().map(|d| d - 150.0).collect() };
        let mut map = wide(blocks());
        filled(&mut map, &views());
        assert!(same(&map, &wide(blocks())));
        // Nothing is known to go on from.
        let mut map = blocks();
        map[..130 * W].fill(f32::NAN);
        let before = map.clone();
        filled(&mut map, &views());
        assert!(same(&map, &before));
        // The right view shows something else below.
        let [left, mut right] = views();
        for (i, value) in right.iter_mut().enumerate().skip(130 * W) {
            *value = (60.0 + 130.0 * smooth((i % W) as f64 / 5.0 + 900.0, (i / W) as f64 / 5.0 + 90.0)) as u8;
        }
        let mut map = blocks();
        filled(&mut map, &[left, right]);
        let before = blocks();
        let changed = (150 * W..H * W).filter(|i| map[*i].to_bits() != before[*i].to_bits()).count();
        assert!(changed < 8 * 40, "{changed} pixels");
    }
}
