//! Masks blended over an image, and the legend of a colour scale.

use super::{Color, Colormap, shapes, text};
use crate::{View, ViewMut};
use std::fmt::Write;

/// Blends `color` over the pixels where `mask` (gray) is not zero; a mask value of 255 counts fully, `alpha` 0..=1
/// scales it.
pub fn blend_mask(out: &mut ViewMut<u8>, mask: &View<u8>, color: Color, alpha: f32) {
    if out.channels != 3 || mask.channels != 1 || alpha.is_nan() {
        return;
    }
    let alpha = (alpha.clamp(0.0, 1.0) * 256.0 + 0.5) as i32;
    let width = mask.width.min(out.width);
    for y in 0..mask.height.min(out.height) {
        for (m, o) in mask.row(y)[..width].iter().zip(out.row_mut(y).as_chunks_mut::<3>().0) {
            let a = (i32::from(*m) * alpha + 127) / 255;
            for (p, c) in o.iter_mut().zip(color) {
                *p = ((i32::from(*p) * (256 - a) + i32::from(c) * a + 128) >> 8) as u8;
            }
        }
    }
}

/// Legend of a colour scale: an upright bar, high end on top, with labels on its right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleBar<'a> {
    /// Left edge of the bar, pixels.
    pub x: i32,
    /// Top of the bar, pixels.
    pub y: i32,
    /// Width of the bar, pixels.
    pub width_px: i32,
    /// Height of the bar, pixels.
    pub height_px: i32,
    /// Number at the bottom.
    pub low: f32,
    /// Number at the top.
    pub high: f32,
    /// Unit written after each number.
    pub unit: &'a str,
    /// Colours of the values.
    pub map: Colormap,
    /// Labels with numbers, two or more, evenly spaced. 0 writes near and far at the ends instead.
    pub labels: usize,
    /// Scale of the text, see [`text`](super::text()).
    pub text_scale: f32,
}

/// Draws a [`ScaleBar`].
pub fn scale_bar(out: &mut ViewMut<u8>, bar: &ScaleBar) {
    let (w, h) = (bar.width_px.clamp(1, 1 << 14), bar.height_px.clamp(2, 1 << 14));
    shapes::fill_rectangle(out, bar.x.saturating_sub(1), bar.y.saturating_sub(1), w + 2, h + 2, [0, 0, 0], 1.0);
    for i in 0..h {
        let color = bar.map.at(1.0 - i as f32 / (h - 1) as f32);
        shapes::fill_rectangle(out, bar.x, bar.y.saturating_add(i), w, 1, color, 1.0);
    }
    let labels = bar.labels.clamp(2, 32);
    for i in 0..labels {
        let t = i as f32 / (labels - 1) as f32;
        let value = bar.low + (bar.high - bar.low) * t;
        let mut label = Label::default();
        let digits = if (bar.high - bar.low).abs() < 10.0 { 1 } else { 0 };
        // A label that is too long is cut, which `Label` reports as an error.
        let _ = match (bar.labels, i) {
            (0, 0) => label.write_str("near"),
            (0, _) => label.write_str("far"),
            _ => write!(label, "{value:.digits$} {}", bar.unit),
        };
        let y = bar.y as f32 + (1.0 - t) * (h - 1) as f32;
        let x = bar.x as f32 + w as f32;
        shapes::line(out, (x, y), (x + 2.0 * bar.text_scale, y), 1.0, [255; 3]);
        text(out, x + 4.0 * bar.text_scale, y - 3.0 * bar.text_scale, label.as_str(), bar.text_scale, [255; 3]);
    }
}

/// Text on the stack, so that drawing allocates nothing.
#[derive(Default)]
struct Label {
    bytes: [u8; 32],
    len: usize,
}

impl Label {
    fn as_str(&self) -> &str {
        std::str::from_utf8(&self.bytes[..self.len]).unwrap_or("")
    }
}

impl Write for Label {
    fn write_str(&mut self, s: &str) -> std::fmt::Result {
        for c in s.chars() {
            if self.len + c.len_utf8() > self.bytes.len() {
                return Err(std::fmt::Error);
            }
            self.len += c.encode_utf8(&mut self.bytes[self.len..]).len();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mask_mixes_by_its_value() {
        let mut data = [100u8; 9];
        blend_mask(&mut ViewMut::new(&mut data, 3, 1, 3), &View::new(&[0, 255, 128], 3, 1, 1), [200, 0, 100], 0.5);
        assert_eq!(data, [100, 100, 100, 150, 50, 100, 125, 75, 100]);
    }

    #[test]
    fn scale_bar_shows_both_ends() {
        let (w, h) = (160, 120);
        let mut data = vec![0u8; w * h * 3];
        let bar = ScaleBar {
            x: 10,
            y: 10,
            width_px: 12,
            height_px: 100,
            low: 20.0,
            high: 80.0,
            unit: "mm",
            map: Colormap::Rainbow,
            labels: 4,
            text_scale: 1.5,
        };
        scale_bar(&mut ViewMut::new(&mut data, w, h, 3), &bar);
        let at = |x: usize, y: usize| -> Color { std::array::from_fn(|c| data[(y * w + x) * 3 + c]) };
        assert_eq!(at(15, 10), Colormap::Rainbow.at(1.0));
        assert_eq!(at(15, 109), Colormap::Rainbow.at(0.0));
        assert!((30..100).any(|x| at(x, 14) != [0; 3]), "no label");
        scale_bar(&mut ViewMut::new(&mut [], 0, 0, 3), &ScaleBar { x: i32::MAX, y: i32::MIN, height_px: -4, ..bar });
    }
}
