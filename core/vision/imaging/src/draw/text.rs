//! Text with a dark outline, so that it is legible on any image.

use super::Color;
use super::font::{self, CAPITAL_HEIGHT, HEIGHT, LINE_HEIGHT, Letter};
use crate::ViewMut;

/// Maximum coordinate of text, px; text beyond it is never visible.
const FAR_PX: f32 = 1e6;

/// Writes `text` with its top left corner at `(x, y)`; a capital is `6 * scale` pixels high. `\n` starts a line.
pub fn text(out: &mut ViewMut<u8>, x: f32, y: f32, text: &str, scale: f32, color: Color) {
    let is_sane = scale.is_finite() && scale > 0.0 && x.abs() < FAR_PX && y.abs() < FAR_PX;
    if !is_sane || out.channels != 3 {
        return;
    }
    // All outlines first: none covers the letter before it.
    for is_outline in [true, false] {
        let (mut pen, mut base) = (x, y + CAPITAL_HEIGHT * scale);
        for character in text.chars() {
            if character == '\n' {
                (pen, base) = (x, base + LINE_HEIGHT * scale);
                continue;
            }
            let letter = font::letter(character, scale, pen - pen.floor());
            let at = [pen.floor() as i32, base.round() as i32];
            if is_outline {
                blend(out, &letter, &letter.outline, at, [0; 3]);
            } else {
                blend(out, &letter, &letter.ink, at, color);
            }
            pen += font::advance(character, scale);
        }
    }
}

/// Blends `color` over the pixels that a letter with its pen at `at` covers.
fn blend(out: &mut ViewMut<u8>, letter: &Letter, coverage: &[u8], at: [i32; 2], color: Color) {
    let [width, _] = letter.size;
    if width == 0 {
        return;
    }
    let (left, top) = (at[0].saturating_add(letter.at[0]), at[1].saturating_add(letter.at[1]));
    let first = usize::try_from(-i64::from(left)).unwrap_or(0).min(width);
    let end = usize::try_from(out.width as i64 - i64::from(left)).unwrap_or(0).min(width);
    for (row, shares) in coverage.chunks_exact(width).enumerate() {
        let y = i64::from(top) + row as i64;
        if y < 0 || y >= out.height as i64 || first >= end {
            continue;
        }
        let start = (i64::from(left) + first as i64) as usize * 3;
        let pixels = out.row_mut(y as usize)[start..].as_chunks_mut::<3>().0;
        for (pixel, share) in pixels.iter_mut().zip(&shares[first..end]).filter(|(_, share)| **share > 0) {
            let share = u32::from(*share) + u32::from(*share >> 7);
            for (p, c) in pixel.iter_mut().zip(color) {
                *p = ((u32::from(*p) * (256 - share) + u32::from(c) * share + 128) >> 8) as u8;
            }
        }
    }
}

/// Width and height in pixels that [`text`] takes, outline not counted.
pub fn text_size(text: &str, scale: f32) -> (f32, f32) {
    if !scale.is_finite() || scale <= 0.0 {
        return (0.0, 0.0);
    }
    let width = |line: &str| line.chars().map(|character| font::advance(character, scale)).sum::<f32>();
    let widest = text.split('\n').map(width).fold(0.0, f32::max);
    let rows = text.split('\n').count() as f32;
    (widest, ((rows - 1.0) * LINE_HEIGHT + HEIGHT) * scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_in_its_box_and_is_outlined() {
        let (w, h) = (200, 60);
        let mut data = vec![128u8; w * h * 3];
        text(&mut ViewMut::new(&mut data, w, h, 3), 20.0, 10.0, "Ag|", 3.0, [255, 255, 255]);
        let size = text_size("Ag|", 3.0);
        let (mut bright, mut dark) = (0, 0);
        for (i, p) in data.as_chunks::<3>().0.iter().enumerate() {
            let (x, y) = ((i % w) as f32, (i / w) as f32);
            if p[0] != 128 {
                assert!(x > 15.0 && x < 25.0 + size.0 && y > 5.0 && y < 15.0 + size.1, "ink at {x},{y}");
            }
            bright += usize::from(p[0] > 240);
            dark += usize::from(p[0] < 20);
        }
        assert!(bright > 100 && dark > 60, "{bright} bright, {dark} dark");
    }

    #[test]
    fn text_beyond_the_picture_is_cut() {
        let (w, h) = (40, 20);
        for (x, y) in [(-12.5, 4.0), (30.2, 4.0), (3.0, -9.0), (3.0, 15.0), (1e9, 0.0), (f32::NAN, 0.0), (-900.0, 3.0)]
        {
            let mut data = vec![128u8; w * h * 3];
            text(&mut ViewMut::new(&mut data, w, h, 3), x, y, "Wide 12.5 ±0.3 mm\nand more", 2.0, [255; 3]);
        }
        assert_eq!(text_size("", 2.0), (0.0, 16.0));
        assert_eq!(text_size("a", f32::NAN), (0.0, 0.0));
    }

    #[test]
    fn what_the_font_lacks_is_known() {
        assert!(font::is_drawable("Łódź 12 µm ±0.3") && font::is_drawable(""));
        assert!(!font::is_drawable("手术钳") && !font::is_drawable("hook 钳"));
    }

    #[test]
    fn the_second_time_is_the_same() {
        let (w, h) = (160, 40);
        let written = || {
            let mut data = vec![90u8; w * h * 3];
            text(&mut ViewMut::new(&mut data, w, h, 3), 4.3, 5.8, "distance 12.34 mm", 1.5, [255; 3]);
            data
        };
        assert_eq!(written(), written());
    }
}
