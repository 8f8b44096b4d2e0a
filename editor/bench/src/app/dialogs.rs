//! Dialogs over the window: palette, files, plugins, keys; and the notification.

use eframe::egui::{self, Context, Frame, Margin, RichText};

use super::{App, NOTE};
use crate::actions;
use crate::panels::plugins;
use panoscope_editor_model::texts;
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// Height of a window that the list of keys leaves free, points.
const KEYS_MARGIN: f32 = 110.0;
/// Height of a row of the list of keys, points.
const KEYS_ROW: f32 = 21.0;
/// Least width of a column of it, and of its keys.
const KEYS_COLUMN: f32 = 380.0;
const KEYS_NAMES: f32 = 130.0;

impl App {
    /// Shows the dialogs that are open.
    pub(super) fn palettes(&mut self, ctx: &Context) {
        if let Some(palette) = &mut self.palette
            && let Some(picked) = palette.show(ctx, &self.document, &self.types)
        {
            self.palette = None;
            if let Some(picked) = picked {
                self.pick(picked);
            }
        }
        if let Some(files) = &mut self.files
            && let Some(picked) = files.show(ctx)
        {
            self.take_file(picked, ctx);
        }
        if self.plugins {
            match plugins::show(ctx, &self.session.loader(), self.document.catalog()) {
                Some(plugins::PluginsRequest::Reload) => self.session.reload_plugins(),
                Some(plugins::PluginsRequest::Close) => self.plugins = false,
                None => {}
            }
        }
        if self.help {
            let modal = egui::Modal::new("help".into()).backdrop_color(theme::sunk().gamma_multiply(0.5));
            let frame = Frame::popup(&ctx.global_style()).inner_margin(Margin::same(24));
            let shown = modal.frame(frame).show(ctx, |ui| {
                ui.label(RichText::new(text!("keys-heading")).size(16.0));
                ui.add_space(2.0 * theme::STEP);
                let keys =
                    actions::ALL.iter().map(|(action, .., name)| (actions::key_name(*action), texts::plain(name)));
                let clipboard = format!("{}+C, X, V", text!("key-ctrl"));
                let more = [
                    (clipboard.as_str(), text!("keys-clipboard")),
                    (text!("key-digits"), text!("keys-recent")),
                    (text!("key-scale"), text!("keys-scale")),
                    (text!("key-arrows"), text!("keys-move")),
                    (text!("key-shift-arrows"), text!("keys-move-nodes")),
                    (text!("key-shift-drag"), text!("keys-select")),
                    (text!("key-double-click"), text!("keys-add")),
                ];
                let all: Vec<_> = keys.chain(more.map(|(key, description)| (key.to_owned(), description))).collect();
                let room = ctx.content_rect().size() - egui::vec2(KEYS_MARGIN, KEYS_MARGIN);
                let most = room.y.max(200.0);
                // As many columns as the height needs and the width has space for.
                let needed = (all.len() as f32 * KEYS_ROW / most).ceil();
                let columns = needed.min((room.x / KEYS_COLUMN).floor()).max(1.0) as usize;
                egui::ScrollArea::vertical().max_height(most).min_scrolled_height(most).show(ui, |ui| {
                    ui.horizontal_top(|ui| {
                        for (side, part) in all.chunks(all.len().div_ceil(columns)).enumerate() {
                            let words = room.x / columns as f32 - KEYS_NAMES - 4.0 * theme::STEP;
                            let grid = egui::Grid::new(("keys", side)).num_columns(2).spacing([16.0, 3.0]);
                            grid.min_row_height(16.0).show(ui, |ui| {
                                ui.spacing_mut().interact_size.y = 0.0;
                                for (key, description) in part {
                                    ui.label(RichText::new(key).size(12.5).color(theme::accent()));
                                    ui.scope(|ui| {
                                        ui.set_max_width(words);
                                        ui.add(egui::Label::new(RichText::new(*description).size(12.5)).wrap());
                                    });
                                    ui.end_row();
                                }
                            });
                            ui.add_space(3.0 * theme::STEP);
                        }
                    })
                });
            });
            self.help = !shown.should_close();
        }
    }

    /// Draws the last notification at the lower edge.
    pub(super) fn show_notification(&mut self, ctx: &Context) {
        let Some((message, wrong, since)) = &self.notification else { return };
        if since.elapsed() > NOTE {
            self.notification = None;
            return;
        }
        ctx.request_repaint_after(NOTE.saturating_sub(since.elapsed()));
        let color = if *wrong { theme::fault() } else { theme::line() };
        egui::Area::new("note".into())
            .anchor(egui::Align2::LEFT_BOTTOM, egui::vec2(16.0, -16.0))
            .interactable(false)
            .show(ctx, |ui| {
                Frame::new()
                    .fill(theme::panel())
                    .stroke(egui::Stroke::new(1.0, color))
                    .corner_radius(6.0)
                    .inner_margin(Margin::symmetric(12, 8))
                    .show(ui, |ui| {
                        ui.add(egui::Label::new(RichText::new(message)).wrap_mode(egui::TextWrapMode::Extend))
                    });
            });
    }
}
