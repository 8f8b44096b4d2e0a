//! The dialog with all plugins that were found: their node types and files.

use eframe::egui::text::{LayoutJob, TextFormat};
use eframe::egui::{CollapsingHeader, Context, FontId, Frame, Margin, Modal, RichText, ScrollArea};
use panoscope_editor_model::texts::text;
use panoscope_graph::Catalog;
use panoscope_host::loader::Loader;

use panoscope_editor_widgets::theme;

/// Maximum number of letters of the list of node types beside a plugin's name.
const MAX_LETTERS: usize = 68;

/// A request of this dialog.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PluginsRequest {
    /// Swap rebuilt plugins in.
    Reload,
    /// Close the dialog.
    Close,
}

/// Shows the dialog; `catalog` has the plugins that the graph uses.
pub fn show(ctx: &Context, loader: &Loader, catalog: &Catalog) -> Option<PluginsRequest> {
    let modal = Modal::new("plugins".into()).backdrop_color(theme::sunk().gamma_multiply(0.5));
    let frame = Frame::popup(&ctx.global_style()).inner_margin(Margin::same(24));
    let mut request = None;
    let shown = modal.frame(frame).show(ctx, |ui| {
        ui.set_width(560.0);
        ui.horizontal(|ui| {
            ui.label(RichText::new(text!("plugins-heading")).size(16.0));
            if ui.button(text!("plugins-heading.reload")).on_hover_text(text!("plugins-heading.hint")).clicked() {
                request = Some(PluginsRequest::Reload);
            }
        });
        let height = ctx.content_rect().height();
        ScrollArea::vertical().max_height(height * 0.7).min_scrolled_height(height * 0.5).show(ui, |ui| {
            for found in loader.found() {
                let (name, version) = (&found.note.name, &found.note.version);
                let used = catalog.has_plugin(name);
                let color = if used { theme::text() } else { theme::muted() };
                let mut title = LayoutJob::default();
                title.append(
                    name,
                    0.0,
                    TextFormat { font_id: FontId::proportional(14.0), color, ..Default::default() },
                );
                let small = FontId::proportional(12.0);
                let rest = TextFormat { font_id: small, color: theme::muted(), ..Default::default() };
                let nodes = found.note.node_types.join(", ");
                let shown: String = nodes.chars().take(MAX_LETTERS).collect();
                let dots = if shown.len() < nodes.len() { "..." } else { "" };
                title.append(&format!("   {shown}{dots}"), 0.0, rest);
                CollapsingHeader::new(title).id_salt(("plugin", name)).show(ui, |ui| {
                    let caption = format!("{version}   {}", found.file.display());
                    ui.label(RichText::new(caption).size(11.0).color(theme::muted()));
                    let types = catalog.node_types.iter().filter(|t| t.plugin == *name);
                    for node_type in types {
                        ui.label(RichText::new(&node_type.name).color(theme::accent()));
                        ui.label(RichText::new(&node_type.doc).size(12.0));
                    }
                    if !used {
                        ui.label(
                            RichText::new(text!("plugins-nodes", nodes = found.note.node_types.join(", "))).size(12.0),
                        );
                    }
                });
            }
            for problem in loader.problems() {
                ui.label(RichText::new(format!("{}: {}", problem.file, problem.message)).color(theme::fault()));
                ui.label(RichText::new(&problem.help).size(12.0).color(theme::muted()));
            }
        });
    });
    request.or(shown.should_close().then_some(PluginsRequest::Close))
}
