//! What each packet looks like on a picture.

use std::fmt::Write;

use panoscope_imaging::draw::{self, Color};
use panoscope_node::abi::{self, Homography, Roi, Tip};
use panoscope_node::{Detections, Instances, ViewMut};

/// How marks are drawn.
#[derive(Clone, Copy, Debug)]
pub struct Pen {
    /// Width of lines in px.
    pub line_px: f32,
    /// Capitals are six times as many px high.
    pub text_scale: f32,
    /// Added to every coordinate in px.
    pub offset: (f32, f32),
    /// How much masks cover, 0 to 1.
    pub alpha: f32,
}

/// A colour for class or track `index`; neighbours differ clearly.
pub fn color_of(index: u64) -> Color {
    const COLORS: [Color; 8] = [
        [80, 200, 60],
        [240, 150, 40],
        [60, 170, 255],
        [220, 80, 220],
        [220, 220, 60],
        [90, 90, 250],
        [160, 230, 160],
        [180, 120, 255],
    ];
    COLORS[(index % COLORS.len() as u64) as usize]
}

/// Rectangles with class, score and track number.
pub fn boxes(out: &mut ViewMut<'_, u8>, detections: &Detections<'_>, pen: &Pen, words: &mut String) {
    for item in detections.items() {
        let color = color_of(u64::from(item.class_index));
        let (x, y) = (item.x_px + pen.offset.0, item.y_px + pen.offset.1);
        draw::rectangle(out, x, y, item.width_px, item.height_px, pen.line_px, color);
        words.clear();
        let label = detections.label(item.class_index);
        if label.is_empty() {
            let _ = write!(words, "class {}", item.class_index);
        } else {
            words.push_str(label);
        }
        let _ = write!(words, " {:.0}%", item.score * 100.0);
        if item.track_id >= 0 {
            let _ = write!(words, " #{}", item.track_id);
        }
        let (_, height) = draw::text_size(words, pen.text_scale);
        // Above the box, or inside where the picture ends.
        let above = y - height - 2.0 * pen.text_scale;
        let text_y = if above >= 0.0 { above } else { y + 2.0 * pen.text_scale };
        draw::text(out, x.max(0.0) + 1.0, text_y, words, pen.text_scale, color);
    }
}

/// Coloured masks. Mask bits outside the picture are left out.
pub fn masks(out: &mut ViewMut<'_, u8>, instances: &Instances<'_>, pen: &Pen) {
    let detections = instances.detections();
    let (width, height) = detections.image_size();
    let stride = width.div_ceil(8);
    if stride == 0 {
        return;
    }
    let (dx, dy) = (pen.offset.0.round() as i64, pen.offset.1.round() as i64);
    let alpha = (pen.alpha.clamp(0.0, 1.0) * 256.0) as u32;
    for (index, item) in detections.items().iter().enumerate() {
        // Each instance has its own colour: touching tools of one class stay apart.
        let color = color_of(if item.track_id >= 0 { item.track_id as u64 } else { index as u64 });
        for (y, row) in instances.mask(index).chunks_exact(stride).take(height).enumerate() {
            let y = y as i64 + dy;
            if y < 0 || y >= out.height as i64 {
                continue;
            }
            let out_width = out.width as i64;
            let line = out.row_mut(y as usize);
            for (byte_index, &byte) in row.iter().enumerate().filter(|(_, byte)| **byte != 0) {
                for bit in (0..8).filter(|bit| byte >> (7 - bit) & 1 == 1) {
                    let x = (byte_index * 8 + bit) as i64;
                    if x >= width as i64 || x + dx < 0 || x + dx >= out_width {
                        continue;
                    }
                    let at = (x + dx) as usize * 3;
                    for (p, c) in line[at..at + 3].iter_mut().zip(color) {
                        *p = ((u32::from(*p) * (256 - alpha) + u32::from(c) * alpha + 128) >> 8) as u8;
                    }
                }
            }
        }
    }
}

/// A cross and its place in mm.
pub fn tip(out: &mut ViewMut<'_, u8>, tip: &Tip, pen: &Pen, words: &mut String) {
    let (x, y) = (tip.u_px as f32 + pen.offset.0, tip.v_px as f32 + pen.offset.1);
    if !x.is_finite() || !y.is_finite() {
        return;
    }
    let color = [60, 220, 255];
    let radius = 4.0 * pen.line_px + 4.0;
    draw::circle(out, x, y, radius, pen.line_px, color);
    draw::cross(out, x, y, radius * 1.5, pen.line_px, color);
    if tip.xyz_valid == 1 {
        words.clear();
        let [x_mm, y_mm, z_mm] = tip.xyz_mm;
        let _ = write!(words, "{x_mm:.1} {y_mm:.1} {z_mm:.1} mm");
        draw::text(out, x + radius * 1.5 + 3.0, y + 3.0, words, pen.text_scale, color);
    }
}

/// A rectangle.
pub fn roi(out: &mut ViewMut<'_, u8>, roi: &Roi, pen: &Pen) {
    let (x, y) = (roi.x as f32 + pen.offset.0, roi.y as f32 + pen.offset.1);
    draw::rectangle(out, x, y, roi.width as f32, roi.height as f32, pen.line_px, [255, 200, 0]);
}

/// The outline of the right view of `size` (width, height in px): green when fresh, yellow when held; nothing when lost.
pub fn registration(out: &mut ViewMut<'_, u8>, value: &Homography, size: (f32, f32), pen: &Pen) {
    let color = match value.state {
        abi::STATE_FRESH => [80, 220, 80],
        abi::STATE_HELD => [0, 210, 255],
        _ => return,
    };
    let h = &value.left_from_right;
    let mut corners = [(0.0, 0.0), (size.0, 0.0), size, (0.0, size.1)];
    for corner in &mut corners {
        let (x, y) = (f64::from(corner.0), f64::from(corner.1));
        let w = h[6] * x + h[7] * y + h[8];
        if w <= 1e-9 {
            // The corner lies behind the view: there is no outline to show.
            return;
        }
        let (u, v) = ((h[0] * x + h[1] * y + h[2]) / w, (h[3] * x + h[4] * y + h[5]) / w);
        *corner = (u as f32 + pen.offset.0, v as f32 + pen.offset.1);
    }
    draw::polygon(out, &corners, pen.line_px, color);
}

/// The registration in words.
pub fn registration_words(value: &Homography, words: &mut String) {
    let state = match value.state {
        abi::STATE_FRESH => "registered",
        abi::STATE_HELD => "registration held",
        _ => "registration lost",
    };
    let _ = writeln!(words, "{state}: {} points, {:.2} px", value.inliers, value.rms_px);
}
