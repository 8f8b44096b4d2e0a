//! The viewer: shows one output large, or compares two by wipe, blink or difference. Number keys show recently viewed outputs.

use eframe::egui::{
    Align, Align2, Button, Color32, ComboBox, Context, FontId, Id, InputState, Key, Layout, Modifiers, Painter, Pos2,
    Rect, RichText, Sense, Stroke, TextureHandle, TextureId, TextureOptions, Ui, UiBuilder, Vec2, WidgetInfo,
    WidgetType, pos2, vec2,
};

use crate::probing::{self, PROFILE_HEIGHT, Probing};
use crate::view3d::View3d;
use panoscope_editor_model::comparing::{Comparison, ComparisonRequest, Measures};
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::pixels::Pixels;
use panoscope_editor_model::probe::{Probe, ProbeRequest};
use panoscope_editor_model::surface::Viewpoint;
use panoscope_editor_model::texts::{decimal, text};
use panoscope_editor_widgets::theme;
use panoscope_editor_widgets::{OutputCache, image_of};

/// Maximum number of recently viewed outputs.
const RECENT: usize = 9;
/// Distance that an arrow key moves the wipe, as a fraction of the image's width.
const WIPE_STEP: f32 = 0.02;
/// Half a period of blinking, s.
const BLINK_S: f64 = 0.6;

/// How two outputs are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compare {
    /// One picture, with a movable line between the two outputs.
    #[default]
    Wipe,
    /// Side by side.
    Beside,
    /// Alternating.
    Blink,
    /// The amplified absolute difference.
    Difference,
}

/// An output with its packet type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// The output.
    pub output: Output,
    /// Type of its packets.
    pub packet: String,
}

/// The state of the viewer; it is closed while it has no source.
#[derive(Default)]
pub struct Viewer {
    a: Option<Source>,
    b: Option<Source>,
    compare: Compare,
    /// Position of the wipe's line, 0..=1.
    wipe: f32,
    recent: Vec<Source>,
    view3d: View3d,
    /// Whether clouds are shown as the camera saw them instead of as surfaces.
    flat: bool,
    /// Whether a value is picked on the image; it is then shown flat and without comparison.
    picking: bool,
    difference: Option<((u64, u64), TextureHandle, f32)>,
    probing: Probing,
}

impl Viewer {
    /// Shows an output.
    pub fn open(&mut self, source: Source) {
        if !self.recent.contains(&source) {
            if self.recent.len() == RECENT {
                self.recent.remove(0);
            }
            self.recent.push(source.clone());
        }
        self.probing = Probing::default();
        self.a = Some(source);
    }

    /// What is asked about the values of the picture, with its output; `None` while none is shown alone.
    pub fn probe_request(&self) -> Option<(&Output, ProbeRequest)> {
        let alone = self.b.is_none() && !self.picking && self.viewpoint().is_none();
        self.a.as_ref().filter(|_| alone).map(|a| (&a.output, self.probing.request()))
    }

    /// Takes the probed line away; returns whether there was one.
    pub fn clear_line(&mut self) -> bool {
        self.a.is_some() && self.probing.clear()
    }

    /// Sets the output to compare with; `None` ends the comparison.
    pub fn compare(&mut self, other: Option<Source>) {
        self.b = other;
        self.wipe = 0.5;
    }

    /// Closes the viewer; returns whether it was open.
    pub fn close(&mut self) -> bool {
        self.b = None;
        self.a.take().is_some()
    }

    /// Shows the recently viewed output number `digit`, from 1.
    pub fn recall(&mut self, digit: usize) {
        if let Some(source) = digit.checked_sub(1).and_then(|i| self.recent.get(i)) {
            self.a = Some(source.clone());
        }
    }

    /// The output that is shown.
    pub fn source(&self) -> Option<&Source> {
        self.a.as_ref()
    }

    /// The outputs that are shown: one, or two during a comparison.
    pub fn sources(&self) -> impl Iterator<Item = &Source> {
        self.a.iter().chain(&self.b)
    }

    /// The viewpoint of the 3D view; `None` while no cloud is shown as a surface.
    pub fn viewpoint(&self) -> Option<Viewpoint> {
        let cloud = self.a.as_ref().is_some_and(|a| a.packet == "cloud");
        (cloud && self.b.is_none() && !self.flat && !self.picking).then(|| self.view3d.viewpoint())
    }

    /// Position of the line between both outputs, 0..=1, while they are compared by wipe.
    pub fn wipe_line(&self) -> Option<f32> {
        (self.b.is_some() && self.compare == Compare::Wipe).then_some(self.wipe)
    }

    /// The state of the 3D view.
    pub fn view3d_state(&self) -> &View3d {
        &self.view3d
    }

    /// The 3D view.
    pub fn view3d(&mut self) -> &mut View3d {
        &mut self.view3d
    }

    /// The outputs to compare in numbers; `None` while none are compared.
    pub fn comparison_request(&self) -> Option<ComparisonRequest> {
        let (a, b) = self.a.as_ref().zip(self.b.as_ref())?;
        Some(ComparisonRequest { output: a.output.clone(), other: b.output.clone(), packet: a.packet.clone() })
    }

    /// Starts or ends picking a value on the image.
    pub fn set_picking(&mut self, picking: bool) {
        self.picking = picking;
        if picking {
            self.b = None;
        }
    }

    /// Draws the viewer over the canvas. `others` are outputs to compare with, `trajectories` those of tips, poses and arm links. Returns the
    /// rectangle of the image and that of the buttons below it; `None` while no image is shown.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        rect: Rect,
        shown: &OutputCache,
        others: &[Source],
        trajectories: &[Output],
        (probe, comparison): (Option<&Probe>, Option<&Comparison>),
    ) -> Option<(Rect, Rect)> {
        let a = self.a.clone()?;
        if self.viewpoint().is_some() {
            ui.painter_at(rect).rect_filled(rect, 0.0, theme::SURFACE);
            let room = Rect::from_min_max(rect.min + vec2(24.0, 56.0), rect.max - vec2(24.0, 48.0));
            self.view3d.show(ui, room, shown, &a.output, trajectories);
            self.bar(ui, rect, shown, &a, others);
            self.foot(ui, rect);
            return None;
        }
        let ground = ui.interact(rect, Id::new("viewer"), Sense::click_and_drag());
        ground.widget_info(|| {
            WidgetInfo::labeled(WidgetType::Image, true, text!("viewer-name", output = a.output.to_string()))
        });
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 0.0, theme::sunk());
        let mut room = Rect::from_min_max(rect.min + vec2(24.0, 56.0), rect.max - vec2(24.0, 48.0));
        if self.probing.has_line() && self.probe_request().is_some() {
            let top = room.bottom() - PROFILE_HEIGHT;
            if let Some(probe) = probe {
                probing::profile(ui, room.with_min_y(top), probe);
            }
            room.max.y = top - 8.0;
        }
        let b = self.b.clone().filter(|b| shown.texture(&b.output).is_some());
        let image_rect = shown.texture(&a.output).map(|(_, size)| fit(room, size));
        match (shown.texture(&a.output), b) {
            (None, _) => words(&painter, room.center(), shown.text(&a.output)),
            (Some((texture, size)), None) => {
                let inner = fit(room, size);
                picture(&painter, texture, inner, Color32::WHITE);
                if !self.picking {
                    self.probing.follow(ui, &ground, inner);
                    self.probing.paint(ui, &painter, inner, probe);
                }
                // Another output that has sent nothing.
                self.b.iter().for_each(|b| numbers(ui, rect, b, None));
            }
            (Some((texture, size)), Some(b)) => {
                let inner = fit(room, size);
                // While the pointer does not move, the keys move the line.
                let moves = self.compare == Compare::Wipe && ui.input(|i| i.pointer.delta() != Vec2::ZERO);
                if let Some(pointer) = ground.hover_pos().filter(|_| moves) {
                    self.wipe = ((pointer.x - inner.left()) / inner.width()).clamp(0.0, 1.0);
                }
                if self.compare == Compare::Wipe && ui.memory(|m| m.focused().is_none_or(|id| id == ground.id)) {
                    let steps = [(Key::ArrowLeft, -WIPE_STEP), (Key::ArrowRight, WIPE_STEP)];
                    let by = steps
                        .map(|(key, by)| by * ui.input_mut(|i| i.count_and_consume_key(Modifiers::NONE, key)) as f32);
                    self.wipe = (self.wipe + by[0] + by[1]).clamp(0.0, 1.0);
                }
                if self.compare == Compare::Beside {
                    beside(&painter, room, [&a, &b], shown);
                } else {
                    self.both(ui, &painter, inner, (&a, texture), &b, shown);
                }
                numbers(ui, rect, &b, comparison);
            }
        }
        if let Some(age) = shown.stale(&a.output) {
            let at = room.center_top() + vec2(0.0, 16.0);
            let caption = text!("viewer-stale", seconds = age.as_secs());
            painter.text(at, Align2::CENTER_TOP, caption, FontId::proportional(18.0), theme::warn());
        }
        self.bar(ui, rect, shown, &a, others);
        if !self.picking {
            self.foot(ui, rect);
        }
        image_rect.map(|image_rect| (image_rect, foot_of(rect)))
    }

    /// Handles the number keys, which show recently viewed outputs.
    pub fn recall_by_key(&mut self, input: &mut InputState) {
        const KEYS: [Key; RECENT] =
            [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8, Key::Num9];
        for (n, key) in KEYS.into_iter().enumerate() {
            if input.consume_key(Modifiers::NONE, key) {
                self.recall(n + 1);
            }
        }
    }

    fn both(
        &mut self,
        ui: &Ui,
        painter: &Painter,
        inner: Rect,
        a: (&Source, TextureId),
        b: &Source,
        shown: &OutputCache,
    ) {
        let Some((second, _)) = shown.texture(&b.output) else { return };
        match self.compare {
            Compare::Wipe => {
                let x = inner.left() + inner.width() * self.wipe;
                let left = Rect::from_min_max(inner.min, pos2(x, inner.bottom()));
                let right = Rect::from_min_max(pos2(x, inner.top()), inner.max);
                picture(&painter.with_clip_rect(left.intersect(painter.clip_rect())), a.1, inner, Color32::WHITE);
                picture(&painter.with_clip_rect(right.intersect(painter.clip_rect())), second, inner, Color32::WHITE);
                painter.vline(x, inner.y_range(), Stroke::new(1.5, theme::accent()));
                let top = inner.top() + 8.0;
                tag(painter, pos2(x - 8.0, top), Align2::RIGHT_TOP, a.0.output.to_string());
                tag(painter, pos2(x + 8.0, top), Align2::LEFT_TOP, b.output.to_string());
            }
            Compare::Beside => {}
            Compare::Blink => {
                let first = (ui.input(|i| i.time) / BLINK_S) as i64 % 2 == 0;
                picture(painter, if first { a.1 } else { second }, inner, Color32::WHITE);
                let name = if first { &a.0.output } else { &b.output };
                tag(painter, inner.left_top() + vec2(8.0, 8.0), Align2::LEFT_TOP, name.to_string());
                ui.ctx().request_repaint_after(std::time::Duration::from_secs_f64(BLINK_S / 2.0));
            }
            Compare::Difference => {
                if let Some((texture, mean)) = self.difference(ui.ctx(), shown, &a.0.output, &b.output) {
                    picture(painter, texture, inner, Color32::WHITE);
                    let caption = text!("viewer-difference-is", mean = decimal(mean.into(), 1));
                    tag(painter, inner.left_top() + vec2(8.0, 8.0), Align2::LEFT_TOP, caption);
                }
            }
        }
    }

    /// The image of the difference, computed again when one of the two outputs has a new packet.
    fn difference(&mut self, ctx: &Context, shown: &OutputCache, a: &Output, b: &Output) -> Option<(TextureId, f32)> {
        let of = (shown.packet(a)?.seq, shown.packet(b)?.seq);
        if self.difference.as_ref().is_none_or(|(known, ..)| *known != of) {
            let (pixels, mean) = difference_of(shown.pixels(a)?, shown.pixels(b)?);
            let image = image_of(&pixels);
            match &mut self.difference {
                Some((known, texture, old)) if texture.size() == image.size => {
                    texture.set_partial([0, 0], image, TextureOptions::LINEAR);
                    (*known, *old) = (of, mean);
                }
                place => *place = Some((of, ctx.load_texture("difference", image, TextureOptions::LINEAR), mean)),
            }
        }
        self.difference.as_ref().map(|(_, texture, mean)| (texture.id(), *mean))
    }

    fn bar(&mut self, ui: &mut Ui, rect: Rect, shown: &OutputCache, a: &Source, others: &[Source]) {
        let bar = Rect::from_min_size(rect.min, vec2(rect.width(), 48.0)).shrink2(vec2(24.0, 10.0));
        ui.scope_builder(UiBuilder::new().max_rect(bar), |ui| {
            ui.horizontal(|ui| {
                ui.label(RichText::new(a.output.to_string()).size(15.0).strong());
                let mut about = a.packet.clone();
                if let Some(size) = shown.size(&a.output).filter(|s| s.x > 0.0) {
                    about += &format!("   {} x {} px", size.x, size.y);
                }
                if let Some(caption) = shown.text(&a.output).filter(|_| shown.texture(&a.output).is_some()) {
                    about += &format!("   {caption}");
                }
                ui.label(RichText::new(about).color(theme::muted()));
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    if ui.button(text!("viewer-close")).on_hover_text(text!("key-escape")).clicked() {
                        self.close();
                    }
                    if a.packet == "cloud" && self.b.is_none() && !self.picking {
                        let button = Button::new(text!("viewer-surface")).selected(!self.flat);
                        if ui.add(button).on_hover_text(text!("viewer-surface.hint")).clicked() {
                            self.flat ^= true;
                        }
                    }
                    if self.b.is_some() {
                        for (mode, caption) in [
                            (Compare::Difference, text!("viewer-difference")),
                            (Compare::Blink, text!("viewer-blink")),
                            (Compare::Beside, text!("viewer-beside")),
                            (Compare::Wipe, text!("viewer-wipe")),
                        ] {
                            if ui.add(Button::new(caption).selected(self.compare == mode)).clicked() {
                                self.compare = mode;
                            }
                        }
                    }
                    let now = self
                        .b
                        .as_ref()
                        .map_or_else(|| text!("viewer-with-nothing").to_owned(), |b| b.output.to_string());
                    let combo = ComboBox::from_id_salt("compare").selected_text(now).width(180.0).show_ui(ui, |ui| {
                        if ui.selectable_label(self.b.is_none(), text!("viewer-with-nothing")).clicked() {
                            self.compare(None);
                        }
                        for other in others.iter().filter(|o| *o != a) {
                            if ui.selectable_label(self.b.as_ref() == Some(other), other.output.to_string()).clicked() {
                                self.compare(Some(other.clone()));
                            }
                        }
                    });
                    let id = combo.response.id;
                    ui.ctx().accesskit_node_builder(id, |n| n.set_label(text!("viewer-compare.name")));
                    ui.label(RichText::new(text!("viewer-compare")).color(theme::muted()));
                });
            });
        });
    }

    /// The recently viewed outputs with their number keys.
    fn foot(&mut self, ui: &mut Ui, rect: Rect) {
        ui.scope_builder(UiBuilder::new().max_rect(foot_of(rect)), |ui| {
            ui.horizontal(|ui| {
                if self.viewpoint().is_some() {
                    self.view3d.controls(ui);
                    ui.separator();
                }
                for (i, source) in self.recent.clone().into_iter().enumerate() {
                    let caption = RichText::new(format!("{}  {}", i + 1, source.output)).size(12.0);
                    if ui.selectable_label(self.a.as_ref() == Some(&source), caption).clicked() {
                        self.a = Some(source);
                    }
                }
            });
        });
    }
}

/// The rectangle of the buttons below the image.
fn foot_of(rect: Rect) -> Rect {
    Rect::from_min_max(pos2(rect.left(), rect.bottom() - 40.0), rect.max).shrink2(vec2(24.0, 6.0))
}

fn fit(room: Rect, size: Vec2) -> Rect {
    let scale = (room.width() / size.x).min(room.height() / size.y);
    Rect::from_center_size(room.center(), size * scale)
}

/// Draws two outputs side by side at one scale, each with its name.
fn beside(painter: &Painter, room: Rect, sources: [&Source; 2], shown: &OutputCache) {
    let half = vec2((room.width() - 8.0) / 2.0, room.height());
    let places = [Rect::from_min_size(room.min, half), Rect::from_min_size(room.right_top() - vec2(half.x, 0.0), half)];
    for (source, place) in sources.into_iter().zip(places) {
        let Some((texture, size)) = shown.texture(&source.output) else { continue };
        let inner = fit(place, size);
        picture(painter, texture, inner, Color32::WHITE);
        tag(painter, inner.left_top() + vec2(8.0, 8.0), Align2::LEFT_TOP, source.output.to_string());
    }
}

/// How two outputs differ, as text.
fn in_numbers(comparison: Option<&Comparison>) -> String {
    let Some(Comparison { seq, measures }) = comparison else { return text!("viewer-numbers-none").to_owned() };
    let tick = usize::try_from(*seq).unwrap_or(usize::MAX);
    match *measures {
        None => text!("viewer-numbers-unlike").to_owned(),
        Some(Measures::Images { psnr_db, ssim }) => {
            text!("viewer-numbers-images", psnr = decimal(psnr_db, 1), ssim = decimal(ssim, 4), tick = tick)
        }
        Some(Measures::Maps { mean_error, p95_error, density, unit }) => text!(
            "viewer-numbers-maps",
            mean = decimal(mean_error, 3),
            p95 = decimal(p95_error, 2),
            density = decimal(100.0 * density, 1),
            unit = unit,
            tick = tick
        ),
    }
}

/// Shows how two outputs differ at the right of the buttons below them. `b` is the one that is compared with.
fn numbers(ui: &Ui, rect: Rect, b: &Source, comparison: Option<&Comparison>) {
    let caption = in_numbers(comparison);
    let (at, font) = (foot_of(rect).right_center(), FontId::proportional(13.0));
    let label = ui.painter().text(at, Align2::RIGHT_CENTER, &caption, font, theme::text());
    let response = ui.interact(label, Id::new("viewer-numbers"), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, &caption));
    response.on_hover_text(text!("viewer-numbers-about", output = b.output.to_string()));
}

/// Shows an output without a picture: what its packet says, or that there is none.
fn words(painter: &Painter, at: Pos2, text: Option<&str>) {
    let (caption, font, color) = match text {
        Some(text) => (text, FontId::monospace(16.0), theme::text()),
        None => (text!("viewer-nothing"), FontId::proportional(16.0), theme::muted()),
    };
    painter.text(at, Align2::CENTER_CENTER, caption, font, color);
}

fn picture(painter: &Painter, texture: TextureId, rect: Rect, tint: Color32) {
    painter.image(texture, rect, Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0)), tint);
}

/// A label on an image, readable on any background.
fn tag(painter: &Painter, at: Pos2, align: Align2, caption: String) {
    let galley = painter.layout_no_wrap(caption, FontId::proportional(12.0), theme::text());
    let margin = vec2(6.0, 3.0);
    let rect = align.anchor_size(at, galley.size() + 2.0 * margin);
    painter.rect_filled(rect, 4.0, Color32::from_black_alpha(170));
    painter.galley(rect.min + margin, galley, theme::text());
}

/// Four times the absolute difference, at the first image's size, and the mean difference over all channels.
fn difference_of(a: &Pixels, b: &Pixels) -> (Pixels, f32) {
    let mut rgba = Vec::with_capacity(a.rgba.len());
    let mut sum = 0u64;
    for y in 0..a.height {
        let row = y * b.height / a.height.max(1) * b.width;
        for x in 0..a.width {
            let p = &a.rgba[(y * a.width + x) * 4..][..3];
            let q = &b.rgba[(row + x * b.width / a.width.max(1)) * 4..][..3];
            for k in 0..3 {
                let d = p[k].abs_diff(q[k]);
                sum += u64::from(d);
                rgba.push(d.saturating_mul(4));
            }
            rgba.push(255);
        }
    }
    let mean = sum as f32 / (a.width * a.height * 3).max(1) as f32;
    (Pixels { width: a.width, height: a.height, rgba }, mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_found_at_other_sizes_too() {
        let a = Pixels { width: 2, height: 2, rgba: [10, 10, 10, 255].repeat(4) };
        let b = Pixels { width: 4, height: 4, rgba: [13, 10, 10, 255].repeat(16) };
        let (pixels, mean) = difference_of(&a, &b);
        assert_eq!(&pixels.rgba[..4], [12, 0, 0, 255]);
        assert!((mean - 1.0).abs() < 1e-6);
        assert_eq!(difference_of(&a, &a).1, 0.0);
    }

    #[test]
    fn numbers_show_recently_viewed_outputs() {
        let source = |port: &str| Source { output: Output::new("n", port), packet: String::new() };
        let mut viewer = Viewer::default();
        viewer.open(source("a"));
        viewer.open(source("b"));
        viewer.recall(1);
        assert_eq!(viewer.source(), Some(&source("a")));
        viewer.recall(9);
        assert_eq!(viewer.source(), Some(&source("a")));
        assert!(viewer.close() && !viewer.close());
    }
}
