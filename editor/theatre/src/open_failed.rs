//! The window shown instead of the theatre when it cannot open: why, and what to do.

use std::path::Path;

use eframe::egui::{self, Align, Button, Context, Frame, Key, Layout, Margin, RichText, ScrollArea, Ui, vec2};

use super::{EDGE, OpenError};
use panoscope_editor_widgets::Shot;
use panoscope_editor_widgets::theme;

/// Width of the text in points.
const WIDTH: f32 = 860.0;

/// The last remedy for a difference from the lock.
const UNVERIFIED: &str = "Or open it unverified; a mark on the screen will show this:";

/// The window of a theatre that could not open.
pub struct OpenFailed {
    heading: String,
    /// The causes, each a line or a listing.
    causes: Vec<String>,
    /// The remedies, the best one first, each with the command for it.
    remedies: Vec<(&'static str, Option<String>)>,
    closing: bool,
    shot: Shot,
}

impl OpenFailed {
    /// The window for the graph file at `path` and the error of opening it.
    pub fn new(ctx: &Context, path: &Path, error: &OpenError, shot: Shot) -> Self {
        theme::apply(ctx);
        theme::apply_theatre(ctx);
        let (name, file) = (path.file_name().unwrap_or(path.as_os_str()).to_string_lossy(), path.display());
        let (lock, unlocked) = (format!("panoscope lock {file}"), format!("panoscope theatre {file} --unlocked"));
        let (heading, causes, remedies) = match error {
            OpenError::Locked(differences) => (
                format!("{name} differs from its lock"),
                differences.iter().map(ToString::to_string).collect(),
                vec![
                    ("Restore the changed files.", None),
                    ("Or verify the graph as it is now, and lock it again:", Some(lock)),
                    (UNVERIFIED, Some(unlocked)),
                ],
            ),
            OpenError::Lock(error) => (
                format!("The lock of {name} is not valid"),
                vec![error.to_string()],
                vec![("Verify the graph, and lock it again:", Some(lock)), (UNVERIFIED, Some(unlocked))],
            ),
            OpenError::Graph(diagnostics) => (
                format!("{name} has mistakes"),
                vec![diagnostics.render(false).trim_end().to_owned()],
                vec![("Correct them in the editor:", Some(format!("panoscope edit {file}")))],
            ),
            OpenError::Runtime(_) => (
                format!("{name} could not be started"),
                vec![error.to_string()],
                vec![("Install Panoscope again, then verify the graph and lock it:", Some(lock))],
            ),
            OpenError::NoPicture => (
                format!("{name} has no image"),
                vec![error.to_string()],
                vec![("Name outputs with images in `views` of `[preset]`.", None)],
            ),
            OpenError::Thread(_) => (
                format!("{name} could not be started"),
                vec![error.to_string()],
                vec![("Close other programs, then open it again.", None)],
            ),
        };
        Self { heading, causes, remedies, closing: false, shot }
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
            let text = |message: &str, size: f32, color| {
                egui::Label::new(RichText::new(message).size(size).color(color)).wrap()
            };
            ui.spacing_mut().item_spacing.y = 10.0;
            ui.add_space(room.height() * 0.12);
            ui.add(text("The theatre could not be opened", 18.0, theme::MUTED));
            ui.add(text(&self.heading, 34.0, theme::FAULT));
            ui.add_space(14.0);
            let most = (ui.available_height() - 340.0).max(120.0);
            let frame = Frame::new().fill(theme::PANEL).corner_radius(8.0).inner_margin(Margin::same(18));
            frame.show(ui, |ui| {
                ui.set_width(ui.available_width());
                ScrollArea::vertical().max_height(most).auto_shrink([false, true]).show(ui, |ui| {
                    for cause in &self.causes {
                        // A listing needs a monospaced font.
                        let message = RichText::new(cause).size(17.0).color(theme::TEXT);
                        let message = if cause.contains('\n') { message.monospace().size(14.0) } else { message };
                        ui.add(egui::Label::new(message).wrap());
                    }
                });
            });
            ui.add_space(14.0);
            ui.add(text("What to do", 18.0, theme::MUTED));
            for (remedy, command) in &self.remedies {
                ui.add(text(remedy, 17.0, theme::TEXT));
                if let Some(command) = command {
                    let message = RichText::new(command).monospace().size(16.0).color(theme::ACCENT);
                    ui.add(egui::Label::new(message).wrap());
                    ui.add_space(4.0);
                }
            }
            ui.add_space(20.0);
            let button = Button::new(RichText::new("Close (Esc)").size(18.0)).corner_radius(12.0);
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
