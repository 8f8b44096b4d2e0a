//! The panel of presets and snapshots: values to apply and to morph between, states of the graph to go back to.

use std::collections::HashMap;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use eframe::egui::{
    Button, ComboBox, Context, Image, RichText, ScrollArea, Slider, TextEdit, TextureHandle, TextureOptions, Ui,
    WidgetInfo, WidgetType, vec2,
};

use super::inspector::section;
use panoscope_editor_model::pixels::Pixels;
use panoscope_editor_model::presets::Presets;
use panoscope_editor_model::snapshots::{Snapshot, Snapshots};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::numbers;
use panoscope_editor_widgets::{image_of, theme};

/// Size of a thumbnail, points.
const THUMBNAIL: [f32; 2] = [176.0, 99.0];
/// Maximum width of a stored picture, px.
const STORED_WIDTH: usize = 352;

/// A request of this panel.
#[derive(Clone, Debug, PartialEq)]
pub enum StateRequest {
    /// Store the values of now under a name.
    Store(String),
    /// Apply a preset.
    Apply(String),
    /// Remove a preset.
    Remove(String),
    /// Apply the values between two presets: names, share of the second one.
    Morph(String, String, f64),
    /// Take a snapshot.
    Take,
    /// Go back to a snapshot.
    Restore(u32),
    /// Remove a snapshot.
    Drop(u32),
}

/// The presets and snapshots of the graph, and what is chosen in the panel.
#[derive(Default)]
pub struct States {
    /// The presets.
    pub presets: Presets,
    /// Why the file of presets cannot be used.
    pub problem: Option<String>,
    /// The snapshots.
    pub snapshots: Snapshots,
    name: String,
    morph: [String; 2],
    share: f64,
    pictures: HashMap<u32, Option<TextureHandle>>,
}

impl States {
    /// Reads presets and snapshots of a graph.
    pub fn load(&mut self, graph: &Path) {
        let (presets, problem) = match Presets::load(graph) {
            Ok(presets) => (presets, None),
            Err(error) => (Presets::default(), Some(error.to_string())),
        };
        (self.presets, self.problem) = (presets, problem);
        self.snapshots = Snapshots::load(graph);
        self.pictures.clear();
    }

    /// Shows the panel; returns the user's requests.
    pub fn show(&mut self, ui: &mut Ui) -> Vec<StateRequest> {
        let mut requests = Vec::new();
        ui.columns(2, |columns| {
            if let [left, right] = columns {
                left.push_id("presets", |ui| self.presets(ui, &mut requests));
                right.push_id("snapshots", |ui| self.snapshots(ui, &mut requests));
            }
        });
        requests
    }

    fn presets(&mut self, ui: &mut Ui, requests: &mut Vec<StateRequest>) {
        section(ui, text!("presets-heading"));
        if let Some(problem) = &self.problem {
            ui.label(RichText::new(problem).color(theme::fault()));
            return;
        }
        ui.horizontal(|ui| {
            let field =
                TextEdit::singleline(&mut self.name).hint_text(text!("presets-heading.hint")).desired_width(200.0);
            let field = ui.add(field);
            ui.ctx().accesskit_node_builder(field.id, |node| node.set_label(text!("presets-heading.name")));
            let entered = field.lost_focus() && ui.input(|i| i.key_pressed(eframe::egui::Key::Enter));
            let store = ui.add_enabled(!self.name.trim().is_empty(), Button::new(text!("presets-heading.store")));
            if store.clicked() || (entered && !self.name.trim().is_empty()) {
                requests.push(StateRequest::Store(std::mem::take(&mut self.name)));
            }
        });
        let names: Vec<String> = self.presets.list().iter().map(|preset| preset.name.clone()).collect();
        self.morph(ui, &names, requests);
        ScrollArea::vertical().id_salt("list").auto_shrink([false, false]).show(ui, |ui| {
            if names.is_empty() {
                ui.label(RichText::new(text!("presets-heading.none")).color(theme::muted()));
            }
            for name in &names {
                ui.horizontal(|ui| {
                    if named(ui, name, &text!("preset-apply", name = name)) {
                        requests.push(StateRequest::Apply(name.clone()));
                    }
                    if small(ui, text!("state-remove"), &text!("preset-remove", name = name)) {
                        requests.push(StateRequest::Remove(name.clone()));
                    }
                });
            }
        });
    }

    /// Shows two presets and the slider between them.
    fn morph(&mut self, ui: &mut Ui, names: &[String], requests: &mut Vec<StateRequest>) {
        if names.len() < 2 {
            return;
        }
        for (end, fallback) in self.morph.iter_mut().zip([0, 1]) {
            if !names.contains(end) {
                end.clone_from(&names[fallback]);
            }
        }
        ui.horizontal(|ui| {
            for (end, label) in self.morph.iter_mut().zip([text!("morph-name.from"), text!("morph-name.to")]) {
                let combo = ComboBox::from_id_salt(label).selected_text(end.as_str()).width(110.0).show_ui(ui, |ui| {
                    for name in names {
                        ui.selectable_value(end, name.clone(), name);
                    }
                });
                ui.ctx().accesskit_node_builder(combo.response.id, |node| node.set_label(label));
            }
            ui.spacing_mut().slider_width = (ui.available_width() - 64.0).max(80.0);
            let mut percent = self.share * 100.0;
            let slider =
                ui.add(Slider::new(&mut percent, 0.0..=100.0).custom_parser(numbers::parse).step_by(1.0).suffix(" %"));
            ui.ctx().accesskit_node_builder(slider.id, |node| node.set_label(text!("morph-name")));
            if slider.changed() {
                self.share = percent / 100.0;
                let [from, to] = self.morph.clone();
                requests.push(StateRequest::Morph(from, to, self.share));
            }
        });
    }

    fn snapshots(&mut self, ui: &mut Ui, requests: &mut Vec<StateRequest>) {
        section(ui, text!("snapshots-heading"));
        if ui.horizontal(|ui| ui.button(text!("snapshots-heading.take")).clicked()).inner {
            requests.push(StateRequest::Take);
        }
        for refused in self.snapshots.refused() {
            ui.label(RichText::new(refused).size(11.5).color(theme::warn()));
        }
        ui.add_space(theme::STEP);
        let now_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
        ScrollArea::horizontal().id_salt("pictures").auto_shrink([false, false]).show(ui, |ui| {
            ui.horizontal_top(|ui| {
                for snapshot in self.snapshots.list().iter().rev() {
                    let number = snapshot.number;
                    let picture = self
                        .pictures
                        .entry(number)
                        .or_insert_with(|| stored_picture(ui.ctx(), &self.snapshots.picture_file(number)));
                    ui.vertical(|ui| snapshot_of(ui, snapshot, picture.as_ref(), now_s, requests));
                }
                if self.snapshots.list().is_empty() {
                    let caption = text!("snapshots-heading.none");
                    ui.label(RichText::new(caption).color(theme::muted()));
                }
            });
        });
    }

    /// Stores the picture of a snapshot; without one it has none.
    pub fn store_picture(&mut self, number: u32, pixels: Option<&Pixels>) {
        self.pictures.remove(&number);
        if let Some(small) = pixels.and_then(thumbnail) {
            // A snapshot without a picture is of use too.
            let _ = small.save(self.snapshots.picture_file(number));
        }
    }
}

/// A smaller copy of a picture.
fn thumbnail(pixels: &Pixels) -> Option<image::RgbImage> {
    let step = pixels.width.div_ceil(STORED_WIDTH).max(1);
    let (width, height) = (pixels.width / step, pixels.height / step);
    let mut small = image::RgbImage::new(width as u32, height as u32);
    for (x, y, to) in small.enumerate_pixels_mut() {
        let at = (y as usize * step * pixels.width + x as usize * step) * 4;
        to.0.copy_from_slice(pixels.rgba.get(at..at + 3)?);
    }
    (width > 0 && height > 0).then_some(small)
}

/// The texture of a stored picture; `None` where there is none that can be read.
fn stored_picture(ctx: &Context, file: &Path) -> Option<TextureHandle> {
    let mut reader = image::ImageReader::open(file).ok()?;
    let mut limits = image::Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(4096), Some(4096));
    reader.limits(limits);
    let rgba = reader.decode().ok()?.into_rgba8();
    let pixels = Pixels { width: rgba.width() as usize, height: rgba.height() as usize, rgba: rgba.into_raw() };
    Some(ctx.load_texture("snapshot", image_of(&pixels), TextureOptions::LINEAR))
}

fn snapshot_of(
    ui: &mut Ui,
    snapshot: &Snapshot,
    picture: Option<&TextureHandle>,
    now_s: u64,
    requests: &mut Vec<StateRequest>,
) {
    let number = snapshot.number;
    let caption = text!("snapshot-restore", number = number);
    let room = vec2(THUMBNAIL[0], THUMBNAIL[1]);
    let clicked = match picture {
        Some(texture) => {
            let size = texture.size_vec2();
            let fit = (room.x / size.x).min(room.y / size.y);
            let button = ui.add(Button::image(Image::new((texture.id(), size * fit))));
            button.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, caption.clone()));
            button.clicked()
        }
        None => {
            let button = ui.add_sized(room, Button::new(text!("snapshot-blank", number = number)));
            button.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, caption.clone()));
            button.clicked()
        }
    };
    if clicked {
        requests.push(StateRequest::Restore(number));
    }
    ui.horizontal(|ui| {
        let age = now_s.saturating_sub(snapshot.taken_s);
        ui.label(RichText::new(format!("{number}  ·  {}", age_words(age))).size(11.5).color(theme::muted()));
        if small(ui, text!("state-remove"), &text!("snapshot-remove", number = number)) {
            requests.push(StateRequest::Drop(number));
        }
    });
}

fn age_words(seconds: u64) -> String {
    match seconds {
        0..60 => text!("age-now").to_owned(),
        60..3600 => text!("age-minutes", count = seconds / 60),
        3600..86_400 => text!("age-hours", count = seconds / 3600),
        _ => text!("age-days", count = seconds / 86_400),
    }
}

/// A button with a name for screen readers; returns whether it was clicked.
fn named(ui: &mut Ui, caption: &str, name: &str) -> bool {
    let button = ui.button(caption);
    button.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, name.to_owned()));
    button.clicked()
}

/// As [`named`], small and without a frame.
fn small(ui: &mut Ui, caption: &str, name: &str) -> bool {
    let button = ui.add(Button::new(RichText::new(caption).size(11.0).color(theme::muted())).frame(false));
    button.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, name.to_owned()));
    button.clicked()
}
