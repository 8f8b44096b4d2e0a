//! Lines and areas with smooth edges. Coordinates are pixels; (0, 0) is the centre of the first pixel.

use super::Color;
use crate::ViewMut;

/// Columns per step when an area is filled.
const TILE: usize = 256;
/// Sub-rows per row of a filled area.
const SUB_ROWS: usize = 4;
/// Edges of a polygon that one sub-row may cross; further ones are not drawn.
const MAX_CROSSINGS: usize = 64;

#[inline]
fn mix(pixel: &mut [u8], color: Color, alpha: f32) {
    let a = (alpha.clamp(0.0, 1.0) * 256.0 + 0.5) as i32;
    for (p, c) in pixel.iter_mut().zip(color) {
        *p = ((i32::from(*p) * (256 - a) + i32::from(c) * a + 128) >> 8) as u8;
    }
}

/// The whole pixels from `low` to `high`, clamped to `0..length`.
fn clip(low: f32, high: f32, length: usize) -> std::ops::Range<usize> {
    let start = low.floor().max(0.0) as usize;
    let end = (high.ceil() + 1.0).clamp(0.0, length as f32) as usize;
    start.min(end)..end
}

/// A line of `thickness_px` with round ends. A line without length is a dot.
pub fn line(out: &mut ViewMut<u8>, from: (f32, f32), to: (f32, f32), thickness_px: f32, color: Color) {
    let finite = [from.0, from.1, to.0, to.1, thickness_px].iter().all(|v| v.is_finite());
    if out.channels != 3 || !finite || thickness_px <= 0.0 {
        return;
    }
    // Far-off ends would lose the sub-pixel precision of f32; the part near the picture is the same.
    let Some((from, to)) = shorten(from, to, out.width as f32, out.height as f32, thickness_px) else { return };
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length2 = dx * dx + dy * dy;
    let reach = thickness_px / 2.0 + 0.5;
    for y in clip(from.1.min(to.1) - reach, from.1.max(to.1) + reach, out.height) {
        // Columns of the line's part that lies within reach of this row.
        let (mut a, mut b) = (from.0, to.0);
        if dy.abs() > 1e-6 {
            let at = |row: f32| (from.0 + dx * ((row - from.1) / dy).clamp(0.0, 1.0), ());
            (a, b) = (at(y as f32 - 1.5 * reach).0, at(y as f32 + 1.5 * reach).0);
        }
        let columns = clip(a.min(b) - 1.5 * reach, a.max(b) + 1.5 * reach, out.width);
        let row = out.row_mut(y);
        for x in columns {
            let (px, py) = (x as f32 - from.0, y as f32 - from.1);
            let t = if length2 > 0.0 { ((px * dx + py * dy) / length2).clamp(0.0, 1.0) } else { 0.0 };
            let (ex, ey) = (px - t * dx, py - t * dy);
            let cover = reach - (ex * ex + ey * ey).sqrt();
            if cover > 0.0 {
                mix(&mut row[3 * x..3 * x + 3], color, cover);
            }
        }
    }
}

/// Cuts a segment to the image plus its thickness (Liang and Barsky), or `None` if nothing of it is visible.
fn shorten(
    from: (f32, f32),
    to: (f32, f32),
    width: f32,
    height: f32,
    thickness: f32,
) -> Option<((f32, f32), (f32, f32))> {
    let room = thickness + 2.0;
    let (mut low, mut high) = (0.0f64, 1.0f64);
    let (dx, dy) = (f64::from(to.0) - f64::from(from.0), f64::from(to.1) - f64::from(from.1));
    for (start, step, end) in [(from.0, dx, width), (from.1, dy, height)] {
        let (start, min, max) = (f64::from(start), f64::from(-room), f64::from(end + room));
        if step == 0.0 {
            if start < min || start > max {
                return None;
            }
            continue;
        }
        let (a, b) = ((min - start) / step, (max - start) / step);
        low = low.max(a.min(b));
        high = high.min(a.max(b));
    }
    let at = |t: f64| ((f64::from(from.0) + t * dx) as f32, (f64::from(from.1) + t * dy) as f32);
    (low <= high).then(|| (at(low), at(high)))
}

/// Lines from point to point.
pub fn polyline(out: &mut ViewMut<u8>, points: &[(f32, f32)], thickness_px: f32, color: Color) {
    for pair in points.windows(2) {
        line(out, pair[0], pair[1], thickness_px, color);
    }
}

/// The sides of a closed polyline.
pub fn sides(points: &[(f32, f32)]) -> impl Iterator<Item = [(f32, f32); 2]> {
    let last = match points {
        [first, _, .., last] => Some([*last, *first]),
        _ => None,
    };
    points.windows(2).map(|side| [side[0], side[1]]).chain(last)
}

/// A closed polyline.
pub fn polygon(out: &mut ViewMut<u8>, points: &[(f32, f32)], thickness_px: f32, color: Color) {
    sides(points).for_each(|[from, to]| line(out, from, to, thickness_px, color));
}

/// The corners of the rectangle from `(x, y)`, `width` x `height` pixels.
pub fn corners(x: f32, y: f32, width: f32, height: f32) -> [(f32, f32); 4] {
    [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
}

/// The outline of the rectangle from `(x, y)`, `width` x `height` pixels.
pub fn rectangle(out: &mut ViewMut<u8>, x: f32, y: f32, width: f32, height: f32, thickness_px: f32, color: Color) {
    polygon(out, &corners(x, y, width, height), thickness_px, color);
}

/// A filled rectangle of whole pixels; `alpha` 0 leaves the image unchanged, 1 covers it.
pub fn fill_rectangle(out: &mut ViewMut<u8>, x: i32, y: i32, width: i32, height: i32, color: Color, alpha: f32) {
    if out.channels != 3 || !alpha.is_finite() {
        return;
    }
    let cut = |start: i32, length: i32, limit: usize| {
        let end = (i64::from(start) + i64::from(length.max(0))).clamp(0, limit as i64) as usize;
        (start.max(0) as usize).min(end)..end
    };
    let columns = cut(x, width, out.width);
    for y in cut(y, height, out.height) {
        for pixel in out.row_mut(y)[3 * columns.start..3 * columns.end].as_chunks_mut::<3>().0 {
            mix(pixel, color, alpha);
        }
    }
}

/// A circle's outline.
pub fn circle(out: &mut ViewMut<u8>, x: f32, y: f32, radius_px: f32, thickness_px: f32, color: Color) {
    ring(out, x, y, radius_px, |d| thickness_px / 2.0 + 0.5 - (d - radius_px).abs(), thickness_px, color);
}

/// A filled circle.
pub fn fill_circle(out: &mut ViewMut<u8>, x: f32, y: f32, radius_px: f32, color: Color, alpha: f32) {
    ring(out, x, y, radius_px, |d| (radius_px + 0.5 - d).clamp(0.0, 1.0) * alpha, 0.0, color);
}

fn ring(out: &mut ViewMut<u8>, x: f32, y: f32, radius: f32, cover: impl Fn(f32) -> f32, thickness: f32, color: Color) {
    if out.channels != 3 || ![x, y, radius, thickness].iter().all(|v| v.is_finite()) || radius < 0.0 {
        return;
    }
    let reach = radius + thickness / 2.0 + 1.0;
    let columns = clip(x - reach, x + reach, out.width);
    for row in clip(y - reach, y + reach, out.height) {
        let pixels = out.row_mut(row);
        for column in columns.clone() {
            let d = ((column as f32 - x).powi(2) + (row as f32 - y).powi(2)).sqrt();
            let c = cover(d);
            if c > 0.0 {
                mix(&mut pixels[3 * column..3 * column + 3], color, c);
            }
        }
    }
}

/// Two crossing strokes of `size_px` each way.
pub fn cross(out: &mut ViewMut<u8>, x: f32, y: f32, size_px: f32, thickness_px: f32, color: Color) {
    line(out, (x - size_px, y), (x + size_px, y), thickness_px, color);
    line(out, (x, y - size_px), (x, y + size_px), thickness_px, color);
}

/// An arrow; the head is `head_px` long.
pub fn arrow(out: &mut ViewMut<u8>, from: (f32, f32), to: (f32, f32), head_px: f32, thickness_px: f32, color: Color) {
    line(out, from, to, thickness_px, color);
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = dx.hypot(dy);
    if length.is_nan() || length <= 0.0 {
        return;
    }
    let (ux, uy) = (dx / length * head_px, dy / length * head_px);
    line(out, to, (to.0 - ux - 0.5 * uy, to.1 - uy + 0.5 * ux), thickness_px, color);
    line(out, to, (to.0 - ux + 0.5 * uy, to.1 - uy - 0.5 * ux), thickness_px, color);
}

/// A filled polygon (even-odd rule), edges smooth; `alpha` 0 leaves the image unchanged, 1 covers it.
pub fn fill_polygon(out: &mut ViewMut<u8>, points: &[(f32, f32)], color: Color, alpha: f32) {
    let finite = points.iter().all(|p| p.0.is_finite() && p.1.is_finite());
    if out.channels != 3 || points.len() < 3 || !finite || !alpha.is_finite() {
        return;
    }
    let bounds = points.iter().fold((f32::MAX, f32::MIN, f32::MAX, f32::MIN), |b, p| {
        (b.0.min(p.0), b.1.max(p.0), b.2.min(p.1), b.3.max(p.1))
    });
    let columns = clip(bounds.0 - 1.0, bounds.1 + 1.0, out.width);
    for y in clip(bounds.2 - 1.0, bounds.3 + 1.0, out.height) {
        let mut tile = columns.start;
        while tile < columns.end {
            let count = (columns.end - tile).min(TILE);
            let mut cover = [0.0f32; TILE];
            for sub in 0..SUB_ROWS {
                let at = y as f32 - 0.5 + (sub as f32 + 0.5) / SUB_ROWS as f32;
                let mut crossings = [0.0f32; MAX_CROSSINGS];
                let mut found = 0;
                for i in 0..points.len() {
                    let (a, b) = (points[i], points[(i + 1) % points.len()]);
                    if (a.1 <= at) != (b.1 <= at) && found < MAX_CROSSINGS {
                        crossings[found] = a.0 + (at - a.1) / (b.1 - a.1) * (b.0 - a.0);
                        found += 1;
                    }
                }
                crossings[..found].sort_unstable_by(f32::total_cmp);
                for pair in crossings[..found].as_chunks::<2>().0 {
                    let (left, right) = (pair[0] + 0.5 - tile as f32, pair[1] + 0.5 - tile as f32);
                    for x in clip(left - 1.0, right, count) {
                        cover[x] += (right.min(x as f32 + 1.0) - left.max(x as f32)).max(0.0);
                    }
                }
            }
            let row = &mut out.row_mut(y)[3 * tile..3 * (tile + count)];
            for (pixel, c) in row.as_chunks_mut::<3>().0.iter_mut().zip(cover) {
                if c > 0.0 {
                    mix(pixel, color, alpha * c / SUB_ROWS as f32);
                }
            }
            tile += count;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_horizontal_line_covers_its_thickness_and_nothing_else() {
        let mut data = vec![0u8; 40 * 20 * 3];
        let mut out = ViewMut::new(&mut data, 40, 20, 3);
        line(&mut out, (5.0, 10.0), (30.0, 10.0), 3.0, [255; 3]);
        let at = |x: usize, y: usize| data[(y * 40 + x) * 3];
        for x in 5..=30 {
            assert_eq!((at(x, 8), at(x, 9), at(x, 10), at(x, 11), at(x, 12)), (0, 255, 255, 255, 0));
        }
        assert_eq!(at(33, 10), 0);
        assert_eq!(at(2, 10), 0);
    }

    #[test]
    fn area_of_shapes_is_right() {
        let mut data = vec![0u8; 100 * 100 * 3];
        let mut area = |draw: &dyn Fn(&mut ViewMut<u8>)| {
            data.fill(0);
            draw(&mut ViewMut::new(&mut data, 100, 100, 3));
            data.iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0 / 255.0
        };
        let close = |a: f64, b: f64| assert!((a - b).abs() < 0.01 * b, "{a} is not {b}");
        close(area(&|o| fill_circle(o, 50.0, 50.0, 30.0, [255; 3], 1.0)), std::f64::consts::PI * 900.0);
        close(area(&|o| circle(o, 50.0, 50.0, 30.0, 4.0, [255; 3])), std::f64::consts::PI * 240.0);
        close(area(&|o| fill_polygon(o, &[(10.2, 10.0), (90.2, 10.0), (50.0, 80.0)], [255; 3], 1.0)), 2800.0);
        close(area(&|o| fill_rectangle(o, 10, 20, 30, 40, [255; 3], 1.0)), 1200.0);
        close(area(&|o| fill_rectangle(o, -10, 90, 30, 40, [255; 3], 1.0)), 200.0);
        close(area(&|o| line(o, (10.0, 20.0), (80.0, 75.0), 5.0, [255; 3])), 89.02 * 5.0 + 19.6);
    }

    #[test]
    fn hostile_coordinates_are_survived() {
        let mut data = vec![7u8; 31 * 17 * 3];
        let mut out = ViewMut::new(&mut data, 31, 17, 3);
        let bad = [f32::NAN, f32::INFINITY, -f32::INFINITY, 1e30, -1e30, 0.0, 5.5];
        for a in bad {
            for b in bad {
                line(&mut out, (a, b), (b, a), 2.0, [1; 3]);
                line(&mut out, (a, 3.0), (4.0, b), a, [1; 3]);
                circle(&mut out, a, b, 3.0, 1.0, [1; 3]);
                circle(&mut out, 3.0, b, a, 1.0, [1; 3]);
                fill_circle(&mut out, a, 2.0, b, [1; 3], 0.5);
                fill_polygon(&mut out, &[(a, b), (3.0, 4.0), (b, a)], [1; 3], 1.0);
                rectangle(&mut out, a, b, b, a, 1.0, [1; 3]);
                arrow(&mut out, (a, 1.0), (1.0, b), 5.0, 1.0, [1; 3]);
                cross(&mut out, a, b, a, 1.0, [1; 3]);
            }
        }
        fill_rectangle(&mut out, i32::MIN, i32::MIN, i32::MAX, i32::MAX, [1; 3], f32::NAN);
        fill_rectangle(&mut out, i32::MAX, 0, i32::MAX, 5, [1; 3], 1.0);
        for (w, h) in [(0, 0), (1, 1), (3, 5)] {
            let mut data = vec![7u8; w * h * 3];
            let mut out = ViewMut::new(&mut data, w, h, 3);
            line(&mut out, (-9.0, -9.0), (9.0, 9.0), 3.0, [0; 3]);
            fill_polygon(&mut out, &[(-9.0, -9.0), (9.0, -9.0), (0.0, 9.0)], [0; 3], 1.0);
        }
    }
}
