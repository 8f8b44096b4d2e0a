//! Text in the stroke font, with a dark outline so that it reads on any picture.

use super::font::{self, ADVANCE, HEIGHT};
use super::{Color, shapes};
use crate::ViewMut;

/// Writes `text` with its top left corner at `(x, y)`; a capital is `6 * scale` pixels high. `\n` starts a line.
pub fn text(out: &mut ViewMut<u8>, x: f32, y: f32, text: &str, scale: f32, color: Color) {
    if !scale.is_finite() || scale <= 0.0 {
        return;
    }
    let thickness = (0.75 * scale).max(1.0);
    for (width, color) in [(thickness + (0.9 * scale).clamp(1.6, 4.0), [0, 0, 0]), (thickness, color)] {
        let (mut column, mut row) = (0.0, 0.0);
        for character in text.chars() {
            if character == '\n' {
                (column, row) = (0.0, row + HEIGHT + 2.0);
                continue;
            }
            for stroke in font::strokes(character) {
                let at = |(gx, gy): (f32, f32)| (x + (column + gx) * scale, y + (row + gy) * scale);
                let mut previous = None;
                for point in font::points(stroke).map(at) {
                    if let Some(p) = previous {
                        shapes::line(out, p, point, width, color);
                    }
                    previous = Some(point);
                }
            }
            column += ADVANCE;
        }
    }
}

/// Width and height in pixels that [`text`] takes, outline not counted.
pub fn text_size(text: &str, scale: f32) -> (f32, f32) {
    let columns = text.split('\n').map(|l| l.chars().count()).max().unwrap_or(0) as f32;
    let rows = text.split('\n').count() as f32;
    ((columns * ADVANCE - 2.0).max(0.0) * scale, ((rows - 1.0) * (HEIGHT + 2.0) + HEIGHT) * scale)
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
        assert!(bright > 100 && dark > 100, "{bright} bright, {dark} dark");
    }
}
