//! Rows of a blend zone: differences where the views do not overlap, and what the blend adds to the image.

use super::blend::{self, Blender, Ranges};
use super::pyramid::{LANES, ONE};
use super::segments::{BASE_ONLY, BASE_SHOWN, EMPTY, NEW_ONLY, NEW_SHOWN, Segment, Segments};
use crate::{Parallel, Rect, SharedMut};

/// Blends the differences of a step inside the zone `z` and adds them to the image `out`, BGR, whose pixel in a column and
/// row of the canvas is at the byte that `at` gives; pixels of a row follow one another.
pub(super) fn blend_zone(
    blender: &mut Blender,
    segments: &Segments,
    ranges: &Ranges,
    z: Rect,
    bands: bool,
    pool: &dyn Parallel,
    (out, at): (&mut [u8], &(dyn Fn(usize, usize) -> usize + Sync)),
    avx2: bool,
) {
    fill_rows(blender, segments, ranges, z);
    blender.build(bands, ranges, pool, avx2);
    let target = SharedMut::new(out);
    blender.finish(bands, ranges, pool, avx2, &|row, blended, differences| {
        let y = z.y + row;
        let (start, end) = ranges.active(row);
        let (start, end) = (z.x + start, z.x + end);
        for segment in segments.row(y) {
            let Some((a, b)) = segment.clip(start, end) else { continue };
            if segment.kind == EMPTY {
                continue;
            }
            // SAFETY: `finish` hands each row to one chunk.
            let pixels = unsafe { target.part(at(a, y), (b - a) * 3) };
            let part = (a - start) * LANES..(b - start) * LANES;
            let subtract = segment.kind != NEW_ONLY;
            blend::apply(pixels, &blended[part.clone()], &differences[part], subtract, avx2);
        }
    });
}

/// Sets pixels of a zone row outside the overlap to the difference of the nearest pixels inside, with their own weight.
pub(super) fn extend_row(segments: &[Segment], (z0, z1): (usize, usize), out: &mut [i16]) {
    let Some(known) = segments.iter().position(|s| s.both() && s.clip(z0, z1).is_some()) else {
        return;
    };
    let weight_of = |i: usize| {
        let near = |s: &Segment| match s.kind {
            BASE_ONLY | BASE_SHOWN => Some(ONE),
            NEW_ONLY | NEW_SHOWN => Some(0),
            _ => None,
        };
        near(&segments[i])
            .or_else(|| segments[..i].iter().rev().find_map(near))
            .or_else(|| segments[i..].iter().find_map(near))
            .unwrap_or(ONE)
    };
    let fill = |out: &mut [i16], i: usize, value: [i16; 3]| {
        let Some((a, b)) = segments[i].clip(z0, z1) else { return };
        let lanes = [value[0], value[1], value[2], weight_of(i)];
        for p in out[(a - z0) * LANES..(b - z0) * LANES].as_chunks_mut::<LANES>().0 {
            *p = lanes;
        }
    };
    // The mean of a few pixels, so that one noisy pixel does not draw a streak.
    let mean = |out: &[i16], a: usize, b: usize| -> [i16; 3] {
        let n = (b - a) as i32;
        std::array::from_fn(|c| ((a..b).map(|x| i32::from(out[(x - z0) * LANES + c])).sum::<i32>() / n) as i16)
    };
    let mut value = [0; 3];
    for i in known..segments.len() {
        let Some((a, b)) = segments[i].clip(z0, z1) else { continue };
        if segments[i].both() {
            value = mean(out, b.saturating_sub(8).max(a), b);
        } else {
            fill(out, i, value);
        }
    }
    if let Some((a, b)) = segments[known].clip(z0, z1) {
        value = mean(out, a, b.min(a + 8));
    }
    for i in 0..known {
        fill(out, i, value);
    }
}

/// Sets rows without overlap to the differences of the nearest row with one.
fn fill_rows(blender: &mut Blender, segments: &Segments, ranges: &Ranges, z: Rect) {
    let needed = |r: usize| ranges.needed(r);
    let has = |r: usize| {
        let (a, b) = needed(r);
        segments.row(z.y + r).iter().any(|s| s.both() && s.clip(z.x + a, z.x + b).is_some())
    };
    let row_len = z.width * LANES;
    let (out, smooth) = blender.differences_and_row();
    let mut above: Option<usize> = None;
    let mut below: Option<usize> = (0..z.height).find(|r| has(*r));
    // Source and columns of what was smoothed last: the next row mostly wants the same.
    let mut last: Option<(usize, (usize, usize))> = None;
    for r in 0..z.height {
        if has(r) {
            above = Some(r);
            continue;
        }
        if below.is_some_and(|n| n < r) {
            below = (r + 1..z.height).find(|n| has(*n));
        }
        let from = match (above, below) {
            (Some(a), Some(n)) => Some(if r - a <= n - r { a } else { n }),
            (a, n) => a.or(n),
        };
        let (start, end) = needed(r);
        match from {
            Some(f) => {
                if last != Some((f, (start, end))) {
                    smooth_row(&out[f * row_len..(f + 1) * row_len], needed(f), smooth, (start, end));
                    last = Some((f, (start, end)));
                }
                let columns = start * LANES..end * LANES;
                out[r * row_len..(r + 1) * row_len][columns.clone()].copy_from_slice(&smooth[columns]);
            }
            None => out[r * row_len + start * LANES..r * row_len + end * LANES].fill(0),
        }
        let row = &mut out[r * row_len..(r + 1) * row_len];
        for segment in segments.row(z.y + r) {
            let Some((a, b)) = segment.clip(z.x + start, z.x + end) else { continue };
            let weight = match segment.kind {
                BASE_ONLY => ONE,
                NEW_ONLY => 0,
                _ => continue,
            };
            for p in row[(a - z.x) * LANES..(b - z.x) * LANES].as_chunks_mut::<LANES>().0 {
                p[3] = weight;
            }
        }
    }
}

/// Box filter over 33 pixels of a four-lane row whose columns `known` are filled, into the columns `wanted`. Smoothed,
/// because detail repeated from row to row would be drawn as streaks. The weight lane is copied.
fn smooth_row(source: &[i16], known: (usize, usize), out: &mut [i16], wanted: (usize, usize)) {
    const RADIUS: isize = 16;
    let source = &source.as_chunks::<LANES>().0[known.0..known.1];
    let inside = |x: isize| (x - known.0 as isize).clamp(0, source.len() as isize - 1) as usize;
    let at = |x: isize, c: usize| i32::from(source[inside(x)][c]);
    let first = wanted.0 as isize;
    let mut sum: [i32; 3] = std::array::from_fn(|c| (-RADIUS..=RADIUS).map(|d| at(first + d, c)).sum());
    for (x, o) in out.as_chunks_mut::<LANES>().0[wanted.0..wanted.1].iter_mut().enumerate() {
        let x = first + x as isize;
        for c in 0..3 {
            o[c] = (sum[c] / (2 * RADIUS as i32 + 1)) as i16;
            sum[c] += at(x + RADIUS + 1, c) - at(x - RADIUS, c);
        }
        o[3] = source[inside(x)][3];
    }
}
