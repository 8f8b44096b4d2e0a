//! The window shown instead of the theatre when it cannot open: why, and what to do.

use std::path::Path;

use eframe::egui::{self, Align, Button, Context, Frame, Key, Layout, Margin, RichText, ScrollArea, Ui, vec2};

use super::{EDGE, OpenError, Refusal};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::Shot;
use panoscope_editor_widgets::theme;

/// Width of the text in points.
const WIDTH: f32 = 860.0;

/// The window of a theatre that could not open.
pub struct OpenFailed {
    refusal: Refusal,
    closing: bool,
    shot: Shot,
}

impl OpenFailed {
    /// The window for the graph file at `path` and the error of opening it.
    pub fn new(ctx: &Context, path: &Path, error: &OpenError, shot: Shot) -> Self {
        Self::of(ctx, Refusal::of(path, error), shot)
    }

    /// The window for a refusal.
    pub fn of(ctx: &Context, refusal: Refusal, shot: Shot) -> Self {
        theme::apply(ctx);
        theme::apply_theatre(ctx);
        Self { refusal, closing: false, shot }
    }

    /// Whether the window was asked to close.
    pub fn is_closing(&self) -> bool {
        self.closing
    }

    /// Draws a frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        let whole = ui.available_rect_before_wrap();
        let width = WIDTH.min(whole.width() - 2.0 * EDGE);
        let room = egui::Rect::from_center_size(whole.center(), vec2(width, whole.height() - 4.0 * EDGE));
        let mut close = ctx.input_mut(|i| i.consume_key(egui::Modifiers::NONE, Key::Escape));
        ui.scope_builder(egui::UiBuilder::new().max_rect(room).layout(Layout::top_down(Align::Min)), |ui| {
            let label = |message: &str, size: f32, color| {
                egui::Label::new(RichText::new(message).size(size).color(color)).wrap()
            };
            ui.spacing_mut().item_spacing.y = 10.0;
            ui.add_space(room.height() * 0.12);
            ui.add(label(text!("refused-title"), 18.0, theme::muted()));
            ui.add(label(&self.refusal.heading.to_string(), 34.0, theme::fault()));
            ui.add_space(14.0);
            let most = (ui.available_height() - 340.0).max(120.0);
            let frame = Frame::new().fill(theme::panel()).corner_radius(8.0).inner_margin(Margin::same(18));
            frame.show(ui, |ui| {
                ui.set_width(ui.available_width());
                ScrollArea::vertical().max_height(most).auto_shrink([false, true]).show(ui, |ui| {
                    for cause in &self.refusal.causes {
                        // A listing needs a monospaced font.
                        let message = RichText::new(cause).size(17.0).color(theme::text());
                        let message = if cause.contains('\n') { message.monospace().size(14.0) } else { message };
                        ui.add(egui::Label::new(message).wrap());
                    }
                });
            });
            ui.add_space(14.0);
            ui.add(label(text!("refused-to-do"), 18.0, theme::muted()));
            for (remedy, command) in &self.refusal.remedies {
                ui.add(label(&remedy.to_string(), 17.0, theme::text()));
                if let Some(command) = command {
                    let message = RichText::new(command).monospace().size(16.0).color(theme::accent());
                    ui.add(egui::Label::new(message).wrap());
                    ui.add_space(4.0);
                }
            }
            ui.add_space(20.0);
            let button = Button::new(RichText::new(text!("refused-close")).size(18.0)).corner_radius(12.0);
            close |= ui.add_sized(vec2(180.0, 52.0), button).clicked();
        });
        if close && !self.closing {
            self.closing = true;
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        }
        self.shot.take(&ctx);
    }
}

impl eframe::App for OpenFailed {
    fn ui(&mut self, ui: &mut Ui, _: &mut eframe::Frame) {
        Self::ui(self, ui);
    }

    fn clear_color(&self, _: &egui::Visuals) -> [f32; 4] {
        theme::BLACK.to_normalized_gamma_f32()
    }

    fn persist_egui_memory(&self) -> bool {
        false
    }
}
