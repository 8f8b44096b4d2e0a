//! The big picture: one output, or two beside each other by wipe, blink or difference.

use eframe::egui::{Align2, Color32, FontId, Id, Key, Rect, RichText, Sense, Ui, WidgetInfo, WidgetType, pos2, vec2};

use crate::observe::Output;
use crate::panels::Shown;
use crate::theme;

/// What is shown large.
#[derive(Clone, Debug, PartialEq)]
pub struct Viewer {
    /// The output.
    pub output: Output,
    /// Type of its packets.
    pub packet: String,
}

impl Viewer {
    /// Draws over the canvas; answers `false` when it is to be closed.
    pub fn show(&mut self, ui: &mut Ui, rect: Rect, shown: &Shown) -> bool {
        let ground = ui.interact(rect, Id::new("viewer"), Sense::click());
        let words = format!("Viewer of {}", self.output);
        ground.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, words.clone()));
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 0.0, theme::SUNK);
        let room = rect.shrink2(vec2(24.0, 48.0));
        match shown.texture(&self.output) {
            Some((texture, size)) => {
                let fit = (room.width() / size.x).min(room.height() / size.y);
                let inner = Rect::from_center_size(room.center(), size * fit);
                painter.image(texture, inner, Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0)), Color32::WHITE);
            }
            None => {
                let words = shown.words(&self.output).unwrap_or("nothing yet").to_owned();
                painter.text(room.center(), Align2::CENTER_CENTER, words, FontId::monospace(16.0), theme::TEXT);
            }
        }
        let bar = Rect::from_min_size(rect.min, vec2(rect.width(), 40.0)).shrink2(vec2(16.0, 8.0));
        let mut open = true;
        ui.scope_builder(eframe::egui::UiBuilder::new().max_rect(bar), |ui| {
            ui.horizontal(|ui| {
                ui.label(RichText::new(self.output.to_string()).size(15.0).strong());
                ui.label(RichText::new(&self.packet).color(theme::MUTED));
                if let Some(size) = shown.size(&self.output).filter(|s| s.x > 0.0) {
                    ui.label(RichText::new(format!("{} x {} px", size.x, size.y)).color(theme::MUTED));
                }
                if let Some(words) = shown.words(&self.output).filter(|_| shown.texture(&self.output).is_some()) {
                    ui.label(RichText::new(words).color(theme::MUTED));
                }
                ui.with_layout(eframe::egui::Layout::right_to_left(eframe::egui::Align::Center), |ui| {
                    open &= !ui.button("Close").clicked();
                });
            });
        });
        open && !ui.input_mut(|i| i.consume_key(eframe::egui::Modifiers::NONE, Key::Escape))
    }
}
