//! The marks of each kind of packet on an image.

use std::fmt::Write;

use panoscope_imaging::draw::{self, Area, Color, Labels};
use panoscope_node::abi::{self, Homography, Roi, Tip};
use panoscope_node::{Choice, Detections, Instances, ViewMut};

use crate::bar::{self, Bar, Key, MAX_DOTS};
use crate::shapes::Shapes;

/// Where text is written.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Words {
    /// On the image: next to the object it belongs to, and in a corner.
    Picture,
    /// On plates in a bar below the image, which keeps its coordinates; dots in the object's colour say which box a plate belongs to. Marks and text
    /// grow with the image's width: sizes are those at 640 px.
    Below,
    /// Nowhere.
    Nowhere,
}

/// Style of the marks.
#[derive(Clone, Copy, Debug)]
pub struct Pen {
    /// Width of lines in px.
    pub line_px: f32,
    /// Scale of text: capital letters are six times as many px high.
    pub text_scale: f32,
    /// Added to every coordinate in px.
    pub offset: (f32, f32),
    /// Opacity of masks, 0 to 1.
    pub alpha: f32,
    /// Minimum score of boxes and masks that are drawn.
    pub min_score: f32,
    /// Where text is written.
    pub words: Words,
}

/// Class name of an instrument whose kind a detector does not know.
const UNKNOWN: &str = "unknown";

/// Colour of a box of a class; gray where the kind is unknown.
fn color_of_class(detections: &Detections<'_>, class_index: u32) -> Color {
    if detections.label(class_index) == UNKNOWN { [190; 3] } else { color_of(u64::from(class_index)) }
}

/// Colour of class or track `index`; consecutive indices differ clearly.
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

impl Pen {
    /// Distance between letters and the edge of their area, px; includes their dark outline.
    pub fn margin_px(&self) -> f32 {
        1.0 + 2.0 * self.text_scale
    }

    /// Distance from a tip to the ends of its cross, px.
    fn reach_px(&self) -> f32 {
        6.0 * self.line_px + 6.0
    }

    /// Width and height of a text, px, outline included.
    fn text_size(&self, words: &str) -> (f32, f32) {
        let (width, height) = draw::text_size(words, self.text_scale);
        (width + 2.0 * self.margin_px(), height + 2.0 * self.margin_px())
    }

    /// Writes a text with its upper left corner at `at`.
    fn write(&self, shapes: &mut Shapes, at: (f32, f32), words: &str, color: Color) {
        shapes.text((at.0 + self.margin_px(), at.1 + self.margin_px()), words, self.text_scale, color);
    }
}

/// Adds the rectangles of detections.
pub fn boxes(shapes: &mut Shapes, detections: &Detections<'_>, pen: &Pen) {
    for item in detections.items().iter().filter(|item| item.score >= pen.min_score) {
        let (x, y) = (item.x_px + pen.offset.0, item.y_px + pen.offset.1);
        let color = color_of_class(detections, item.class_index);
        shapes.rectangle((x, y), (item.width_px, item.height_px), pen.line_px, color);
    }
}

/// Name of a class; empty if it has none, or if the font cannot draw it.
fn drawable_label<'f>(detections: &Detections<'f>, class_index: u32) -> &'f str {
    let label = detections.label(class_index);
    if draw::is_drawable(label) { label } else { "" }
}

/// The first class name among the items that the font cannot draw.
pub fn undrawable_label<'f>(detections: &Detections<'f>) -> Option<&'f str> {
    let mut labels = detections.items().iter().map(|item| detections.label(item.class_index));
    labels.find(|label| !draw::is_drawable(label))
}

/// Writes class, score and track number of each rectangle where `labels` has space; a label without space is skipped.
pub fn box_labels(
    shapes: &mut Shapes,
    detections: &Detections<'_>,
    pen: &Pen,
    words: &mut String,
    labels: &mut Labels,
) {
    for item in detections.items().iter().filter(|item| item.score >= pen.min_score) {
        words.clear();
        let label = drawable_label(detections, item.class_index);
        if label.is_empty() {
            let _ = write!(words, "class {}", item.class_index);
        } else {
            words.push_str(label);
        }
        let _ = write!(words, " {:.0}%", item.score * 100.0);
        if item.track_id >= 0 {
            let _ = write!(words, " #{}", item.track_id);
        }
        let (x, y) = (item.x_px + pen.offset.0, item.y_px + pen.offset.1);
        let anchor = Area { x, y, width: item.width_px, height: item.height_px };
        if let Some(at) = labels.place(anchor, pen.text_size(words)) {
            pen.write(shapes, at, words, color_of_class(detections, item.class_index));
        }
    }
}

/// Adds dots in the upper left corner of each rectangle, and adds a plate with the same dots, class and score to the bar. The order is that of the
/// track numbers, so that an instrument keeps its dots and plate while others come and go.
pub fn box_keys(
    shapes: &mut Shapes,
    detections: &Detections<'_>,
    pen: &Pen,
    order: &mut Vec<usize>,
    words: &mut String,
    bar: &mut Bar,
) {
    let items = detections.items();
    order.clear();
    order.extend((0..items.len()).filter(|index| items[*index].score >= pen.min_score));
    order.sort_by_key(|index| items[*index].track_id);
    for (number, item) in order.iter().map(|index| &items[*index]).enumerate() {
        let key = Key { color: color_of_class(detections, item.class_index), dots: (number + 1).min(MAX_DOTS) };
        let (x, y) = (item.x_px + pen.offset.0, item.y_px + pen.offset.1);
        // Inside the picture even where the box begins at its edge.
        let inset = 2.0 * pen.text_scale + pen.line_px;
        bar::dots(
            |at, radius, color, alpha| shapes.disc(at, radius, color, alpha),
            (x.max(0.0) + inset, y.max(0.0) + inset),
            key,
            pen.text_scale,
        );
        words.clear();
        let label = drawable_label(detections, item.class_index);
        if label.is_empty() {
            let _ = write!(words, "class {}", item.class_index);
        } else {
            label.split('_').for_each(|part| words.extend([part, " "]));
        }
        let _ = write!(words, "{}{:.0} %", if label.is_empty() { " " } else { "" }, item.score * 100.0);
        bar.add(words, Some(key));
    }
}

/// Draws coloured masks. Mask bits outside the image are ignored.
pub fn masks(out: &mut ViewMut<'_, u8>, instances: &Instances<'_>, pen: &Pen) {
    let detections = instances.detections();
    let (width, height) = detections.image_size();
    let stride = width.div_ceil(8);
    if stride == 0 {
        return;
    }
    let (dx, dy) = (pen.offset.0.round() as i64, pen.offset.1.round() as i64);
    let alpha = (pen.alpha.clamp(0.0, 1.0) * 256.0) as u32;
    let sure = detections.items().iter().enumerate().filter(|(_, item)| item.score >= pen.min_score);
    for (index, item) in sure {
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

/// Position of a tip in the image, px; `None` when it is unknown.
fn tip_px(tip: &Tip, pen: &Pen) -> Option<(f32, f32)> {
    let (x, y) = (tip.u_px as f32 + pen.offset.0, tip.v_px as f32 + pen.offset.1);
    (x.is_finite() && y.is_finite()).then_some((x, y))
}

/// The area of a tip's cross, px; `None` when the tip is unknown.
pub fn tip_area(tip: &Tip, pen: &Pen) -> Option<Area> {
    let (x, y) = tip_px(tip, pen)?;
    let reach = pen.reach_px() + pen.line_px;
    Some(Area { x: x - reach, y: y - reach, width: 2.0 * reach, height: 2.0 * reach })
}

/// Adds a cross, with its position in mm next to it where `labels` has space.
pub fn tip(shapes: &mut Shapes, tip: &Tip, pen: &Pen, words: &mut String, labels: &mut Labels) {
    let Some((x, y)) = tip_px(tip, pen) else { return };
    let color = [60, 220, 255];
    shapes.circle((x, y), pen.reach_px() / 1.5, pen.line_px, color);
    shapes.cross((x, y), pen.reach_px(), pen.line_px, color);
    // A position without its error is nothing for a plate that people rely on.
    if tip.xyz_valid == 1 && pen.words == Words::Picture {
        words.clear();
        let [x_mm, y_mm, z_mm] = tip.xyz_mm;
        let _ = write!(words, "{x_mm:.1} {y_mm:.1} {z_mm:.1} mm");
        // Right below the middle of the cross, else around it.
        let reach = pen.reach_px() + pen.line_px;
        let anchor = Area { x: x + reach, y, width: 0.0, height: 0.0 };
        let around = tip_area(tip, pen).unwrap_or(anchor);
        let place = labels
            .place_at((anchor.x, anchor.y), pen.text_size(words))
            .or_else(|| labels.place(around, pen.text_size(words)));
        if let Some(at) = place {
            pen.write(shapes, at, words, color);
        }
    }
}

/// Adds a rectangle.
pub fn roi(shapes: &mut Shapes, roi: &Roi, pen: &Pen) {
    let (x, y) = (roi.x as f32 + pen.offset.0, roi.y as f32 + pen.offset.1);
    shapes.rectangle((x, y), (roi.width as f32, roi.height as f32), pen.line_px, [255, 200, 0]);
}

/// Adds the outline of the right view of `size` (width, height in px): green when fresh, yellow when held; nothing when lost.
pub fn registration(shapes: &mut Shapes, value: &Homography, size: (f32, f32), pen: &Pen) {
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
    shapes.polygon(&corners, pen.line_px, color);
}

/// State of the registration as text, with its numbers if wanted; empty for a fresh one without numbers.
pub fn registration_words(value: &Homography, with_numbers: bool, words: &mut String) {
    let state = match value.state {
        abi::STATE_FRESH => "registered",
        abi::STATE_HELD => "registration held",
        _ => "registration lost",
    };
    if with_numbers {
        let _ = writeln!(words, "{state}: {} points, {:.2} px", value.inliers, value.rms_px);
    } else if value.state != abi::STATE_FRESH {
        let _ = writeln!(words, "{state}");
    }
}
