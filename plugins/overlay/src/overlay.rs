//! `overlay`: draws the results of other nodes on their image.

use std::fmt::Write;

use panoscope_imaging::draw::{self, Area, Colormap, Labels};
use panoscope_imaging::fit::Fit;
use panoscope_node::abi::{Detection, Homography, Roi, Scalar, Tip};
use panoscope_node::device::{Device, OnDevice};
use panoscope_node::{
    Bgr8, Choice, Context, Depth, Detections, Disparity, Image, Instances, List, Mask, Node, NodeError, NodeInfo, Open,
    Params, Ports, Result, Slot, Table, Text, Validation, Value, View, ViewMut,
};

use crate::bar::{self, Bar};
use crate::colorize::{AutoRange, Colors};
use crate::fit::{enlargement, fitted_size};
use crate::gpu::below::Below;
use crate::marks::{self, Pen, Words};
use crate::nearness;
use crate::quantity::{error_column, write_with_error};
use crate::shapes::Shapes;

/// A corner of the image.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Corner {
    /// Upper left.
    TopLeft,
    /// Upper right.
    TopRight,
    /// Lower left.
    BottomLeft,
    /// Lower right.
    BottomRight,
}

impl Corner {
    /// Upper left point of something of `size` in this corner of an image of `frame`; both are width, height in px.
    fn at(self, frame: (usize, usize), size: (f32, f32), margin: f32) -> (f32, f32) {
        let right = frame.0 as f32 - size.0 - margin;
        let bottom = frame.1 as f32 - size.1 - margin;
        let (x, y) = match self {
            Self::TopLeft => (margin, margin),
            Self::TopRight => (right, margin),
            Self::BottomLeft => (margin, bottom),
            Self::BottomRight => (right, bottom),
        };
        (x.max(0.0), y.max(0.0))
    }
}

/// Input ports of `overlay`.
#[derive(Ports)]
pub struct In<'f> {
    /// The image to draw on.
    pub image: Image<'f, Bgr8>,
    /// Registration: draws the outline of the right view and writes the state.
    pub homography: Option<Value<'f, Homography>>,
    /// A rectangle, px.
    pub roi: Option<Value<'f, Roi>>,
    /// Boxes with labels.
    pub detections: Option<Detections<'f>>,
    /// Boxes with masks.
    pub instances: Option<Instances<'f>>,
    /// Tip of a tool.
    pub tip: Option<Value<'f, Tip>>,
    /// Table of `proximity`: draws a ring around each tip, a line to the nearest tissue, and the distance.
    pub nearness: Option<Table<'f>>,
    /// A table, of which the first row is written.
    pub table: Option<Table<'f>>,
    /// A number.
    pub scalar: Option<Value<'f, Scalar>>,
    /// Texts, each on separate lines.
    pub text: Option<List<'f, Text<'f>>>,
    /// A mask of the image's size.
    pub mask: Option<Image<'f, Mask>>,
    /// Disparity map, px, shown as an inset.
    pub disparity: Option<Image<'f, Disparity>>,
    /// Depth map, mm, shown as an inset.
    pub depth: Option<Image<'f, Depth>>,
}

/// Output ports of `overlay`.
#[derive(Ports)]
pub struct Out<'f> {
    /// The image with everything drawn on it. The input's own buffer when there is nothing to draw.
    pub image: Slot<'f, Bgr8>,
}

/// Parameters of `overlay`.
#[derive(Params)]
pub struct Settings {
    /// Draws the state of the registration.
    #[param(default = true)]
    pub show_registration: bool,
    /// Also draws the outline of the right view and the registration's numbers. Without it only a held or lost registration is named.
    #[param(default = true)]
    pub show_outline: bool,
    /// Draws the rectangle of `roi`.
    #[param(default = true)]
    pub show_roi: bool,
    /// Draws boxes with their labels.
    #[param(default = true)]
    pub show_boxes: bool,
    /// Minimum score of boxes and masks that are drawn.
    #[param(default = 0.0, range = 0.0..=1.0, step = 0.01)]
    pub min_score: f32,
    /// Draws masks.
    #[param(default = true)]
    pub show_masks: bool,
    /// Draws the tip, and the distances of `proximity`.
    #[param(default = true)]
    pub show_tip: bool,
    /// Writes table, scalar and text.
    #[param(default = true)]
    pub show_numbers: bool,
    /// Columns of the table that are written, separated by commas; empty writes all. The unit follows the number, and the 95 % error bound if the
    /// next column holds it: `distance_mm` with `error_mm` is written as `distance 12.3 ± 1.2 mm`.
    #[param(default = "")]
    pub columns: String,
    /// Shows the disparity or depth map as an inset.
    #[param(default = true)]
    pub show_inset: bool,
    /// Where text is written: on the image, or below it where it covers nothing.
    #[param(default = "picture")]
    pub words: Words,
    /// Number of lines of the bar below the image.
    #[param(default = 2, range = 1..=8)]
    pub bar_lines: usize,
    /// Maximum width by height of an image with its bar: for a wider image the text grows, up to twice its size, then the number of lines, until the
    /// bar is high enough. It fills what a wide image leaves free on a screen. 0 leaves the bar as it is.
    #[param(default = 0.0, range = 0.0..=4.0, step = 0.05, unit = "ratio")]
    pub max_aspect: f32,
    /// Width to which a small image with a bar is enlarged, by the nearest integer factor, so that the text stays sharp on a large screen. 0 keeps
    /// its size.
    #[param(default = 0, range = 0..=4096, unit = "px")]
    pub wanted_width: usize,
    /// Text that is always written in the corner; the title of a bar below the image.
    #[param(default = "")]
    pub label: String,
    /// Corner of all text.
    #[param(default = "top_left")]
    pub label_corner: Corner,
    /// Corner of the inset.
    #[param(default = "bottom_right")]
    pub inset_corner: Corner,
    /// Width of the inset, as a share of the image's width.
    #[param(default = 0.3, range = 0.05..=1.0, step = 0.05, unit = "ratio")]
    pub inset_share: f32,
    /// Colour map of the inset.
    #[param(default = "rainbow")]
    pub colors: Colors,
    /// Scale of text: capital letters are six times as many px high.
    #[param(default = 2.0, range = 0.5..=20.0, step = 0.5)]
    pub text_scale: f32,
    /// Width of lines.
    #[param(default = 2.0, range = 0.5..=20.0, step = 0.5, unit = "px")]
    pub line_px: f32,
    /// Opacity of masks.
    #[param(default = 0.4, range = 0.0..=1.0, step = 0.05, unit = "ratio")]
    pub mask_alpha: f32,
    /// Offset added to all coordinates, x and y in px: the position of the left view's corner in the image.
    #[param(default = [], range = 0..=2, unit = "px", points)]
    pub offset_px: Vec<f64>,
    /// Where the image and the bar below it are joined. A GPU does it with an image that was made there and is not enlarged: the result stays there, and
    /// only parts with marks come to the processor, which draws them, and go back. An image with masks or an inset comes whole. Without a GPU the
    /// processor does everything, with a warning.
    #[param(default = "cpu")]
    pub device: Device,
}

/// Maximum width of text in a corner, as a share of the image's: longer lines are wrapped so that the middle stays free.
const WORDS_SHARE: f32 = 0.45;

/// Width of an image at which marks and text have the size of the parameters, if text is written below it.
const USUAL_WIDTH: f32 = 640.0;
/// Minimum scale of text below an image, as a share of the parameter's.
const MIN_SCALE: f32 = 0.5;

/// Breaks lines that are wider than `width_px` at spaces.
fn wrap(words: &mut String, width_px: f32, scale: f32) {
    let mut start = 0;
    while start < words.len() {
        let end = words[start..].find('\n').map_or(words.len(), |at| start + at);
        let mut line_end = end;
        while draw::text_size(&words[start..line_end], scale).0 > width_px {
            match words[start..line_end].trim_end().rfind(' ') {
                Some(at) if at > 0 => line_end = start + at,
                _ => break,
            }
        }
        if line_end < end {
            words.replace_range(line_end..=line_end, "\n");
        }
        start = line_end + 1;
    }
}

/// Draws the results of other nodes on images.
#[derive(Default)]
pub struct Overlay {
    auto: AutoRange,
    words: String,
    item: String,
    inset: Vec<u8>,
    /// The image with its marks, before it is enlarged.
    small: Vec<u8>,
    fit: Fit,
    labels: Labels,
    bar: Bar,
    /// Indices of the boxes that are shown, in the order of their tracks.
    shown: Vec<usize>,
    /// Whether a label that cannot be drawn was reported.
    has_warned: bool,
    on_device: OnDevice<Below>,
    /// Lines, circles and text.
    shapes: Shapes,
}

/// The inputs that the parameters show.
struct Layers<'f> {
    homography: Option<Value<'f, Homography>>,
    roi: Option<Value<'f, Roi>>,
    boxes: Option<Detections<'f>>,
    instances: Option<Instances<'f>>,
    mask: Option<Image<'f, Mask>>,
    tip: Option<Value<'f, Tip>>,
    nearness: Option<Table<'f>>,
    map: Option<View<'f, f32>>,
}

impl<'f> Layers<'f> {
    fn of(input: &In<'f>, params: &Settings) -> Self {
        let map = input.disparity.map(|p| p.view()).or(input.depth.map(|p| p.view()));
        Self {
            homography: input.homography.filter(|_| params.show_registration),
            roi: input.roi.filter(|_| params.show_roi),
            boxes: input.instances.map(|i| i.detections()).or(input.detections).filter(|_| params.show_boxes),
            instances: input.instances.filter(|_| params.show_masks),
            mask: input.mask.filter(|_| params.show_masks),
            tip: input.tip.filter(|_| params.show_tip),
            nearness: input.nearness.filter(|_| params.show_tip),
            map: map.filter(|_| params.show_inset),
        }
    }

    /// Whether nothing but text is drawn.
    fn is_empty(&self, params: &Settings) -> bool {
        let is_sure = |item: &Detection| item.score >= params.min_score;
        !(self.has_areas(params)
            || self.homography.is_some_and(|_| params.show_outline)
            || self.roi.is_some()
            || self.boxes.is_some_and(|b| b.items().iter().any(is_sure))
            || self.tip.is_some()
            || self.nearness.is_some())
    }

    /// Whether masks or an inset are drawn.
    fn has_areas(&self, params: &Settings) -> bool {
        let is_sure = |item: &Detection| item.score >= params.min_score;
        self.mask.is_some()
            || self.map.is_some()
            || self.instances.is_some_and(|i| i.detections().items().iter().any(is_sure))
    }
}

impl Overlay {
    fn write_words(&mut self, input: &In<'_>, params: &Settings) {
        let words = &mut self.words;
        words.clear();
        if !params.label.is_empty() && params.words == Words::Picture {
            let _ = writeln!(words, "{}", params.label);
        }
        if let Some(value) = input.homography.as_ref().filter(|_| params.show_registration) {
            marks::registration_words(value, params.show_outline, words);
        }
        if !params.show_numbers {
            return;
        }
        for text in input.text.iter().flat_map(|texts| texts.iter()).flatten() {
            let _ = writeln!(words, "{}", text.trim_end());
        }
        if let Some(scalar) = &input.scalar {
            let name = |bytes: &[u8]| -> usize { bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len()) };
            let (label, unit) = (&scalar.name[..name(&scalar.name)], &scalar.unit[..name(&scalar.unit)]);
            let text = |bytes| std::str::from_utf8(bytes).unwrap_or("");
            let _ = writeln!(words, "{} {:.2} {}", text(label), scalar.value, text(unit));
        }
        if let Some(table) = &input.table
            && let Some(row) = table.rows().next()
        {
            for (index, (name, value)) in table.names().zip(row).enumerate() {
                if params.columns.is_empty() {
                    let _ = writeln!(words, "{name} {value:.2}");
                } else if params.columns.split(',').any(|wanted| wanted.trim() == name) {
                    let (what, unit) = name.rsplit_once('_').unwrap_or((name, ""));
                    what.split('_').for_each(|word| words.extend([word, " "]));
                    let bound = error_column(table.names(), index).and_then(|at| row.get(at));
                    match bound {
                        Some(bound) => write_with_error(words, *value, *bound, unit),
                        None if value.is_finite() => {
                            let _ = write!(words, "{value:.2} {unit}");
                        }
                        None => words.push('-'),
                    }
                    words.push('\n');
                }
            }
        }
    }

    fn draw_inset(&mut self, picture: &mut ViewMut<'_, u8>, map: &View<'_, f32>, params: &Settings) {
        let (low, high) = self.auto.follow(map);
        self.inset.resize(map.width * map.height * 3, 0);
        let mut colored = ViewMut::new(&mut self.inset, map.width, map.height, 3);
        draw::colorize(map, low, high, Colormap::from(params.colors), &mut colored);
        let frame = (picture.width, picture.height);
        let limit = ((frame.0 as f32 * params.inset_share) as usize, frame.1);
        let size = fitted_size((map.width, map.height), limit);
        let (x, y) = params.inset_corner.at(frame, (size.0 as f32, size.1 as f32), 6.0);
        draw::fill_rectangle(picture, x as i32 - 1, y as i32 - 1, size.0 as i32 + 2, size.1 as i32 + 2, [0; 3], 1.0);
        self.fit.place(picture, &colored.as_view(), (x as usize, y as usize), size);
        if params.words != Words::Picture {
            return;
        }
        self.item.clear();
        let _ = write!(self.item, "{low:.0}..{high:.0}");
        let scale = (params.text_scale * 0.75).max(1.0);
        draw::text(picture, x + 3.0, y + 3.0, &self.item, scale, [255, 255, 255]);
        let (width, height) = draw::text_size(&self.item, scale);
        self.labels.take(Area { x, y, width: width + 6.0, height: height + 6.0 });
    }

    /// Draws on a copy of the image, with text in a corner of it.
    fn draw_in_place(
        &mut self,
        image: &Image<'_, Bgr8>,
        layers: &Layers<'_>,
        slot: &mut Slot<'_, Bgr8>,
        pen: &Pen,
        params: &Settings,
    ) -> Result<()> {
        let frame = (image.width(), image.height());
        let mut picture = slot.alloc_copy(image)?;
        let size = draw::text_size(self.words.trim_end(), params.text_scale);
        let corner = params.label_corner.at(frame, size, 4.0 * params.text_scale);
        // Lines and bright tissue stay away from the letters.
        let room = (2.0 * params.text_scale).ceil();
        let plate =
            Area { x: corner.0 - room, y: corner.1 - room, width: size.0 + 2.0 * room, height: size.1 + 2.0 * room };
        // What keeps its place is taken before labels look for theirs.
        self.labels.begin(frame.0, frame.1);
        if !self.words.trim_end().is_empty() {
            self.labels.take(plate);
        }
        self.draw_layers(&mut picture, layers, pen, params);
        let words = self.words.trim_end();
        if !words.is_empty() {
            let plate = [plate.x, plate.y, plate.width, plate.height].map(|v| v as i32);
            draw::fill_rectangle(&mut picture, plate[0], plate[1], plate[2], plate[3], [0; 3], 0.55);
            draw::text(&mut picture, corner.0, corner.1, words, params.text_scale, [255, 255, 255]);
        }
        Ok(())
    }

    /// Joins an image that was made on the GPU, with its marks, and the bar below it there. `false` where the processor has to do it.
    fn join_on_device(
        &mut self,
        cx: &Context<'_>,
        image: &Image<'_, Bgr8>,
        slot: &mut Slot<'_, Bgr8>,
        layers: &Layers<'_>,
        (lines, scale): (usize, f32),
        (pen, params): (&Pen, &Settings),
    ) -> Result<bool> {
        if self.on_device.get().is_none() {
            return Ok(false);
        }
        let frame = (image.width(), image.height());
        self.labels.begin(frame.0, frame.1);
        self.take_tip(layers, pen);
        self.shapes.clear();
        self.add_outlines(frame, layers, pen, params);
        self.add_objects(layers, pen, params);
        self.bar.add(&self.words, None);
        let Self { bar, shapes, on_device, .. } = self;
        on_device.attempt(cx, |below| {
            let out = slot.alloc_on_device(frame.0, frame.1 + bar::height_px(lines, scale))?;
            below.join(image, shapes, (bar, lines, scale), out)
        })
    }

    /// Draws on a copy of the image, enlarged towards `wanted_width`, with a bar of text below it.
    fn draw_with_bar(
        &mut self,
        cx: &Context<'_>,
        image: &Image<'_, Bgr8>,
        layers: &Layers<'_>,
        slot: &mut Slot<'_, Bgr8>,
        mut pen: Pen,
        params: &Settings,
    ) -> Result<()> {
        let frame = (image.width(), image.height());
        let scale = (frame.0 as f32 / USUAL_WIDTH).max(MIN_SCALE);
        (pen.line_px, pen.text_scale) = (pen.line_px * scale.max(1.0), pen.text_scale * scale);
        let factor = enlargement(frame.0, params.wanted_width);
        let (width, height) = (factor * frame.0, factor * frame.1);
        let wanted_px = if params.max_aspect > 0.0 { width as f32 / params.max_aspect - height as f32 } else { 0.0 };
        let (lines, bar_scale) = bar::filling(params.bar_lines, factor as f32 * pen.text_scale, wanted_px);
        let is_there = factor == 1 && image.is_from_device() && !layers.has_areas(params);
        if is_there && self.join_on_device(cx, image, slot, layers, (lines, bar_scale), (&pen, params))? {
            return Ok(());
        }
        let bar_px = bar::height_px(lines, bar_scale);
        let whole = slot.alloc(width, height + bar_px)?;
        let stride = whole.stride;
        let (upper, lower) = whole.data.split_at_mut(height * stride);
        let mut upper = ViewMut::with_stride(upper, width, height, 3, stride);
        let mut below = ViewMut::with_stride(lower, width, bar_px, 3, stride);
        self.labels.begin(frame.0, frame.1);
        let from = image.view();
        let copy = |picture: &mut ViewMut<'_, u8>| {
            (0..frame.1).for_each(|y| picture.row_mut(y).copy_from_slice(from.row(y)));
        };
        if factor == 1 {
            copy(&mut upper);
            self.draw_layers(&mut upper, layers, &pen, params);
        } else {
            let mut small = std::mem::take(&mut self.small);
            small.resize(3 * frame.0 * frame.1, 0);
            let mut picture = ViewMut::new(&mut small, frame.0, frame.1, 3);
            copy(&mut picture);
            self.draw_layers(&mut picture, layers, &pen, params);
            self.fit.place(&mut upper, &picture.as_view(), (0, 0), (width, height));
            self.small = small;
        }
        self.bar.add(&self.words, None);
        self.bar.draw(&mut below, lines, bar_scale);
        Ok(())
    }

    /// Draws the layers: areas first, then lines, text last. Starts the bar; `labels` must have been started.
    fn draw_layers(&mut self, picture: &mut ViewMut<'_, u8>, layers: &Layers<'_>, pen: &Pen, params: &Settings) {
        self.take_tip(layers, pen);
        if let Some(mask) = layers.mask {
            draw::blend_mask(picture, &mask.view(), [200, 160, 40], params.mask_alpha);
        }
        if let Some(instances) = &layers.instances {
            marks::masks(picture, instances, pen);
        }
        self.shapes.clear();
        self.add_outlines((picture.width, picture.height), layers, pen, params);
        if let Some(map) = &layers.map {
            self.shapes.draw(picture);
            self.shapes.clear();
            self.draw_inset(picture, map, params);
        }
        self.add_objects(layers, pen, params);
        self.shapes.draw(picture);
    }

    /// Keeps the place of the tip free of text.
    fn take_tip(&mut self, layers: &Layers<'_>, pen: &Pen) {
        if let Some(area) = layers.tip.as_ref().and_then(|tip| marks::tip_area(tip, pen)) {
            self.labels.take(area);
        }
    }

    /// Adds the outline of the right view and the rectangle.
    fn add_outlines(&mut self, frame: (usize, usize), layers: &Layers<'_>, pen: &Pen, params: &Settings) {
        if let Some(value) = layers.homography.as_ref().filter(|_| params.show_outline) {
            marks::registration(&mut self.shapes, value, (frame.0 as f32, frame.1 as f32), pen);
        }
        if let Some(roi) = &layers.roi {
            marks::roi(&mut self.shapes, roi, pen);
        }
    }

    /// Adds boxes, tips and distances with their text. Starts the bar.
    fn add_objects(&mut self, layers: &Layers<'_>, pen: &Pen, params: &Settings) {
        let shapes = &mut self.shapes;
        if let Some(boxes) = &layers.boxes {
            marks::boxes(shapes, boxes, pen);
        }
        self.bar.begin(&params.label);
        // The tip's text belongs to a point, so it takes its room before that of the boxes.
        if let Some(tip) = &layers.tip {
            marks::tip(shapes, tip, pen, &mut self.item, &mut self.labels);
        }
        if let Some(boxes) = &layers.boxes {
            match params.words {
                Words::Picture => marks::box_labels(shapes, boxes, pen, &mut self.item, &mut self.labels),
                Words::Below => marks::box_keys(shapes, boxes, pen, &mut self.shown, &mut self.item, &mut self.bar),
                Words::Nowhere => {}
            }
        }
        if let Some(table) = &layers.nearness {
            nearness::draw(shapes, table, pen, &mut self.item, &mut self.bar);
        }
    }
}

impl Node for Overlay {
    const INFO: NodeInfo = NodeInfo::compute(
        "overlay",
        "overlay",
        "Draws registrations, boxes, masks, tips, numbers and maps on an image.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        if params.offset_px.len() == 1 {
            check.error(
                "offset_px",
                "`offset_px` needs two numbers, x and y, but has one",
                "give two numbers, or none",
            );
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let mut overlay = Self::default();
        overlay.on_device.choose(params.device, open, Below::new);
        Ok(overlay)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Settings) -> Result<()> {
        let offset = match params.offset_px.as_slice() {
            [] => (0.0, 0.0),
            [x, y] => (*x as f32, *y as f32),
            other => {
                return Err(NodeError::new(format!("`offset_px` needs two numbers, x and y, but has {}", other.len())));
            }
        };
        self.on_device.choose(params.device, cx, Below::new);
        let layers = Layers::of(&input, params);
        if let Some(label) = layers.boxes.as_ref().and_then(marks::undrawable_label)
            && !std::mem::replace(&mut self.has_warned, true)
        {
            cx.warn(&format!("the font cannot draw the class name `{label}`: its number is drawn instead"));
        }
        self.words.clear();
        if params.words != Words::Nowhere {
            self.write_words(&input, params);
        }
        let pen = Pen {
            line_px: params.line_px,
            text_scale: params.text_scale,
            offset,
            alpha: params.mask_alpha,
            min_score: params.min_score,
            words: params.words,
        };
        // A bar comes and goes with the parameter only: the image keeps its size.
        if params.words == Words::Below {
            return self.draw_with_bar(cx, &input.image, &layers, &mut out.image, pen, params);
        }
        wrap(&mut self.words, input.image.width() as f32 * WORDS_SHARE, params.text_scale);
        if layers.is_empty(params) && self.words.is_empty() {
            return out.image.forward(input.image.frame());
        }
        self.draw_in_place(&input.image, &layers, &mut out.image, &pen, params)
    }
}
