//! Restricts the canvas area of a view to its lit part, so that rims are neither shown nor blended, and no seam runs
//! along them.

use super::mesh::Mapping;
use super::warp::{BLOCK, Block, Span};
use crate::lit::LitPart;

/// Columns on each side of an end of the row before in which the end of a row is searched first.
const NEAR: u32 = 16;

/// Finds the lit columns of canvas rows.
struct Rows<'a> {
    mapping: Mapping<'a>,
    lit: &'a LitPart,
    block: Block,
    avx2: bool,
}

impl Rows<'_> {
    /// Whether columns `from .. to` of a row are lit: the first, the last, and the first and the last column that is.
    fn look(&mut self, y: usize, from: u32, to: u32) -> Option<Look> {
        let (width, height) = self.lit.size();
        let (mut first, mut last, mut lit) = (None, None, [false; 2]);
        let mut x = from;
        while x < to {
            let count = ((to - x) as usize).min(BLOCK);
            let stride = width * 3;
            self.mapping.locate((x as usize, y), (width, height, stride), count, &mut self.block, self.avx2);
            for i in 0..count {
                let offset = self.block.offset[i] as usize;
                if self.lit.contains(offset % stride / 3, offset / stride) {
                    let at = x + i as u32;
                    lit = [lit[0] || at == from, at + 1 == to];
                    (first, last) = (first.or(Some(at)), Some(at));
                }
            }
            x += count as u32;
        }
        Some(Look { first: first?, last: last?, lit })
    }

    /// The lit columns of a row, near those of the row before.
    fn cut(&mut self, y: usize, span: Span, before: Span) -> Span {
        if !before.is_empty() {
            let near = |at: u32| (at.saturating_sub(NEAR).max(span.start), (at + NEAR).min(span.end));
            let (low, high) = (near(before.start), near(before.end));
            // The end lies within when the window begins in the dark, or where the view does.
            let start = self.look(y, low.0, low.1).filter(|look| low.0 == span.start || !look.lit[0]);
            let end = self.look(y, high.0, high.1).filter(|look| high.1 == span.end || !look.lit[1]);
            if let (Some(start), Some(end)) = (start, end)
                && start.first <= end.last
            {
                return Span { start: start.first, end: end.last + 1 };
            }
        }
        self.look(y, span.start, span.end)
            .map_or(Span::default(), |look| Span { start: look.first, end: look.last + 1 })
    }
}

#[derive(Clone, Copy)]
struct Look {
    first: u32,
    last: u32,
    lit: [bool; 2],
}

/// Cuts `spans`, one for each row from `rows.start` on to `rows.end`, which `mapping` maps to a view of which `lit` is
/// lit.
pub fn cut(mapping: Mapping, lit: &LitPart, rows: std::ops::Range<usize>, spans: &mut [Span], avx2: bool) {
    let mut finder = Rows { mapping, lit, block: Block::default(), avx2 };
    let mut before = Span::default();
    for y in rows.start..rows.end.min(spans.len()) {
        if !spans[y].is_empty() {
            spans[y] = finder.cut(y, spans[y], before);
        }
        before = spans[y];
    }
}

/// Minimum lead of one side over the other, in percent, before the new view changes sides; prevents flickering.
const CLEARLY_MORE: i64 = 125;

/// Whether the new view is shown to the left of the images so far, or to the right. The previous frame's side is kept
/// unless the other one shows clearly more.
pub fn reaches_left(base: &[Span], new: &[Span], was_left: bool) -> bool {
    let (mut left, mut right) = (0, 0);
    for (base, new) in base.iter().zip(new).filter(|(base, new)| !base.is_empty() && !new.is_empty()) {
        right += (i64::from(new.end) - i64::from(base.end)).max(0);
        left += (i64::from(base.start) - i64::from(new.start)).max(0);
    }
    if was_left { 100 * right <= CLEARLY_MORE * left } else { 100 * left > CLEARLY_MORE * right }
}

/// Removes the part of the new view outside the previous images on the side where it shows less, because the seam would
/// end at a rim there.
pub fn cut_beyond(base: &[Span], new: &mut [Span], is_left: bool) {
    for (base, new) in base.iter().zip(new).filter(|(base, _)| !base.is_empty()) {
        if is_left {
            new.end = new.end.min(base.end).max(new.start);
        } else {
            new.start = new.start.max(base.start).min(new.end);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::projective::IDENTITY;
    use super::super::tests::{SIZE, compose, shoot, tilted};
    use super::super::{CompositeParams, Compositor, ExposureMethod, GeometryState};
    use super::*;
    use crate::Serial;

    fn disc(centre: [f64; 2], radius: f64) -> LitPart {
        let mut part = LitPart::whole(SIZE.0, SIZE.1);
        for y in 0..SIZE.1 {
            let half = (radius * radius - (y as f64 - centre[1]).powi(2)).max(0.0).sqrt();
            let (start, end) = ((centre[0] - half).max(0.0), centre[0] + half);
            part.set_row(y, start.ceil() as usize..if half > 0.0 { end as usize } else { 0 });
        }
        part
    }

    #[test]
    fn rows_are_cut_where_the_view_is_dark() {
        let part = disc([150.0, 118.0], 97.0);
        let turned = [0.9, 0.2, 20.0, -0.2, 0.95, 40.0, 1e-4, 0.0, 1.0];
        for (matrix, avx2) in [(IDENTITY, false), (turned, false), (turned, crate::Simd::detect().avx2())] {
            let mapping = Mapping::Plane(&matrix);
            let (mut spans, mut block) = (Vec::new(), Block::default());
            mapping.coverage(SIZE, 400, 300, &mut spans);
            let whole = spans.clone();
            cut(mapping, &part, 0..300, &mut spans, avx2);
            for (y, (span, whole)) in spans.iter().zip(&whole).enumerate() {
                for x in whole.start..whole.end {
                    mapping.locate((x as usize, y), (SIZE.0, SIZE.1, SIZE.0 * 3), 1, &mut block, false);
                    let (u, v) = (block.offset[0] as usize / 3 % SIZE.0, block.offset[0] as usize / 3 / SIZE.0);
                    // A turned row crosses the steps of the part's edge; it may meet one twice.
                    let is_lit = part.contains(u, v);
                    let near = [(1, 0), (0, 1), (1, 2), (2, 1)]
                        .map(|(a, b)| part.contains((u + a).wrapping_sub(1), (v + b).wrapping_sub(1)));
                    assert!(span.contains(x) == is_lit || near.contains(&!is_lit), "{x}, {y}");
                }
            }
            assert!(spans.iter().any(|span| !span.is_empty()));
        }
    }

    #[test]
    fn a_view_shows_beyond_the_other_on_one_side_only() {
        let span = |start, end| Span { start, end };
        let (base, mut new) = ([span(20, 80), span(30, 80), span(0, 0)], [span(10, 120), span(35, 110), span(5, 90)]);
        assert!([true, false].iter().all(|was| !reaches_left(&base, &new, *was) && reaches_left(&new, &base, *was)));
        // Nearly equal sides: where it was.
        let even = [span(10, 92), span(20, 90), span(5, 90)];
        assert!(reaches_left(&base, &even, true) && !reaches_left(&base, &even, false));
        cut_beyond(&base, &mut new, false);
        assert_eq!(new.map(|s| (s.start, s.end)), [(20, 120), (35, 110), (5, 90)]);
        cut_beyond(&base, &mut new, true);
        assert_eq!(new.map(|s| (s.start, s.end)), [(20, 80), (35, 80), (5, 90)]);
    }

    #[test]
    fn a_panorama_of_round_views_shows_no_rim() {
        let (mut left, mut right) = (shoot(&IDENTITY, SIZE.0, SIZE.1, 1.0), shoot(&tilted(), SIZE.0, SIZE.1, 1.0));
        let parts = [disc([155.0, 120.0], 125.0), disc([165.0, 118.0], 125.0)];
        // The rims begin 2 px farther out, as those of masks do.
        let outer = [disc([155.0, 120.0], 127.0), disc([165.0, 118.0], 127.0)];
        for (view, part) in [&mut left, &mut right].into_iter().zip(&outer) {
            for (i, pixel) in view.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                if !part.contains(i % SIZE.0, i / SIZE.0) {
                    *pixel = [0, 0, 0];
                }
            }
        }
        let params = CompositeParams { exposure: ExposureMethod::None, ..CompositeParams::default() };
        let mut compositor = Compositor::new(params);
        (0..2).for_each(|view| compositor.set_lit(view, Some(&parts[view])));
        let h = [IDENTITY, tilted()];
        let panorama = compose(&mut compositor, &[&left, &right], &h, GeometryState::Fresh, &Serial);
        assert!(panorama.psnr(|_, _| true) > 38.0, "{:.1} dB", panorama.psnr(|_, _| true));
        // Both discs, less what they share, and nothing of the corners.
        let lit = panorama.mask.iter().filter(|mask| **mask == 255).count() as f64;
        assert!((70_000.0..98_000.0).contains(&lit), "{lit} px");
        // Without lit parts all is shown again.
        (0..2).for_each(|view| compositor.set_lit(view, None));
        let panorama = compose(&mut compositor, &[&left, &right], &h, GeometryState::Fresh, &Serial);
        assert!(panorama.psnr(|_, _| true) < 20.0);
    }
}
