//! In place of the theatre: why it did not open, and what can be done. Who stands before the screen sees no terminal.

use std::path::Path;

use eframe::egui::{self, Align, Button, Context, Frame, Key, Layout, Margin, RichText, ScrollArea, Ui, vec2};

use super::{EDGE, OpenError};
use panoscope_editor_widgets::Shot;
use panoscope_editor_widgets::theme;

/// Width of the text in points.
const WIDTH: f32 = 860.0;

/// The last remedy where a lock refuses.
const UNVERIFIED: &str = "Or open it unverified, which stays told on the screen:";

/// The window of a theatre that did not open.
pub struct Refused {
    heading: String,
    /// What is wrong, one line or text each.
    causes: Vec<String>,
    /// What can be done, the best first, each with the command that does it.
    remedies: Vec<(&'static str, Option<String>)>,
    left: bool,
    shot: Shot,
}

impl Refused {
    /// Of the graph file at `path`, for this reason.
    pub fn new(ctx: &Context, path: &Path, error: &OpenError, shot: Shot) -> Self {
        theme::apply(ctx);
        theme::apply_theatre(ctx);
        let (name, file) = (path.file_name().unwrap_or(path.as_os_str()).to_string_lossy(), path.display());
        let (lock, unlocked) = (format!("panoscope lock {file}"), format!("panoscope theatre {file} --unlocked"));
        let (heading, causes, remedies) = match error {
            OpenError::Locked(differences) => (
                format!("{name} is not as it was locked"),
                differences.iter().map(ToString::to_string).collect(),
                vec![
                    ("Put back what has changed.", None),
                    ("Or verify the graph as it is now, and lock it anew:", Some(lock)),
                    (UNVERIFIED, Some(unlocked)),
                ],
            ),
            OpenError::Lock(error) => (
                format!("The lock of {name} cannot be read"),
                vec![error.to_string()],
                vec![("Verify the graph, and lock it anew:", Some(lock)), (UNVERIFIED, Some(unlocked))],
            ),
            OpenError::Graph(diagnostics) => (
                format!("{name} has mistakes"),
                vec![diagnostics.render(false).trim_end().to_owned()],
                vec![("Correct them in the editor:", Some(format!("panoscope edit {file}")))],
            ),
            OpenError::NoPicture => (
                format!("{name} makes no picture"),
                vec![error.to_string()],
                vec![("Name outputs with pictures in `views` of `[preset]`.", None)],
            ),
            OpenError::Thread(_) => (
                format!("{name} does not start"),
                vec![error.to_string()],
                vec![("Close other programs, then open it again.", None)],
            ),
        };
        Self { heading, causes, remedies, left: false, shot }
    }

    /// Whether the window was asked to close.
    pub fn has_left(&self) -> bool {
        self.left
    }

    /// Draws a frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        let whole = ui.available_rect_before_wrap();
        let width = WIDTH.min(whole.width() - 2.0 * EDGE);
        let room = egui::Rect::from_center_size(whole.center(), vec2(width, whole.height() - 4.0 * EDGE));
        let mut close = ctx.input_mut(|i| i.consume_key(egui::Modifiers::NONE, Key::Escape));
        ui.scope_builder(egui::UiBuilder::new().max_rect(room).layout(Layout::top_down(Align::Min)), |ui| {
            let text =
                |words: &str, size: f32, color| egui::Label::new(RichText::new(words).size(size).color(color)).wrap();
            ui.spacing_mut().item_spacing.y = 10.0;
            ui.add_space(room.height() * 0.12);
            ui.add(text("The theatre was not opened", 18.0, theme::MUTED));
            ui.add(text(&self.heading, 34.0, theme::FAULT));
            ui.add_space(14.0);
            let most = (ui.available_height() - 340.0).max(120.0);
            let frame = Frame::new().fill(theme::PANEL).corner_radius(8.0).inner_margin(Margin::same(18));
            frame.show(ui, |ui| {
                ui.set_width(ui.available_width());
                ScrollArea::vertical().max_height(most).auto_shrink([false, true]).show(ui, |ui| {
                    for cause in &self.causes {
                        // A listing keeps its columns.
                        let words = RichText::new(cause).size(17.0).color(theme::TEXT);
                        let words = if cause.contains('\n') { words.monospace().size(14.0) } else { words };
                        ui.add(egui::Label::new(words).wrap());
                    }
                });
            });
            ui.add_space(14.0);
            ui.add(text("What to do", 18.0, theme::MUTED));
            for (remedy, command) in &self.remedies {
                ui.add(text(remedy, 17.0, theme::TEXT));
                if let Some(command) = command {
                    let words = RichText::new(command).monospace().size(16.0).color(theme::ACCENT);
                    ui.add(egui::Label::new(words).wrap());
                    ui.add_space(4.0);
                }
            }
            ui.add_space(20.0);
            let button = Button::new(RichText::new("Close (Esc)").size(18.0)).corner_radius(12.0);
            close |= ui.add_sized(vec2(180.0, 52.0), button).clicked();
        });
        if close && !self.left {
            self.left = true;
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        }
        self.shot.take(&ctx);
    }
}

impl eframe::App for Refused {
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
