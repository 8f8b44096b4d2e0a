//! Starts a graph: templates for a new file, and files dropped on the window.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use eframe::egui::{self, Context, Frame, Margin, RichText, WidgetInfo, WidgetType, vec2};
use panoscope_editor_model::texts::text;
use panoscope_graph::edit::{EditError, GraphEdit};

use super::App;
use panoscope_editor_widgets::theme;

/// Name and description of a template in the language of the window.
type Described = fn() -> [&'static str; 2];

/// Name in English, name and description as shown, and text of each template.
const TEMPLATES: [(&str, Described, &str); 4] = [
    (
        "Two cameras",
        || [text!("template-cameras"), text!("template-cameras.about")],
        include_str!("../../templates/two_cameras.toml"),
    ),
    (
        "Panorama",
        || [text!("template-panorama"), text!("template-panorama.about")],
        include_str!("../../templates/panorama.toml"),
    ),
    ("Depth", || [text!("template-depth"), text!("template-depth.about")], include_str!("../../templates/depth.toml")),
    ("Empty", || [text!("template-empty"), text!("template-empty.about")], include_str!("../../templates/empty.toml")),
];

/// Names and texts of the templates.
pub fn templates() -> impl Iterator<Item = (&'static str, &'static str)> {
    TEMPLATES.iter().map(|(name, _, text)| (*name, *text))
}

/// Whether a file is an image or a video, by its extension.
fn is_picture(file: &Path) -> bool {
    let ending = file.extension().and_then(OsStr::to_str).unwrap_or_default().to_ascii_lowercase();
    matches!(
        ending.as_str(),
        "png" | "jpg" | "jpeg" | "bmp" | "tif" | "tiff" | "mp4" | "mkv" | "avi" | "mov" | "webm" | "mpg" | "m4v"
    )
}

/// Adds a source of one or two files to a graph's text; returns the text and the node's name.
///
/// # Errors
/// The edit does not fit the text.
pub fn with_source(text: &str, files: &[PathBuf]) -> Result<(String, String), EditError> {
    let mut edit = GraphEdit::parse(text)?;
    let taken = edit.node_names();
    let mut names = std::iter::once("scope".to_owned()).chain((2..).map(|k| format!("scope_{k}")));
    let id = names.find(|n| !taken.contains(n)).unwrap_or_default();
    edit.add_plugin("capture")?;
    edit.add_node(&id, "capture")?;
    let sides = ["left", "right"];
    for (side, file) in sides.iter().zip(files) {
        edit.set_param(&id, side, &file.to_string_lossy().into_owned().into())?;
    }
    Ok((edit.text(), id))
}

impl App {
    /// Offers templates while the file does not exist and the text is empty.
    pub(super) fn offer_templates(&mut self, ctx: &Context) {
        if !self.document.text().trim().is_empty() || self.document.path().is_file() {
            return;
        }
        let frame = Frame::popup(&ctx.global_style()).inner_margin(Margin::same(24));
        let modal = egui::Modal::new("templates".into()).backdrop_color(theme::sunk().gamma_multiply(0.5));
        let mut chosen = None;
        modal.frame(frame).show(ctx, |ui| {
            ui.set_width(420.0);
            ui.label(RichText::new(text!("new-heading")).size(18.0));
            let name = self.document.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
            ui.label(RichText::new(text!("new-written", file = name)).color(theme::muted()));
            ui.add_space(2.0 * theme::STEP);
            for (english, words, text) in TEMPLATES {
                let [name, description] = words();
                let button = egui::Button::new(RichText::new(name).size(14.0)).min_size(vec2(420.0, 34.0));
                let response = ui.add(button).on_hover_text(description);
                response
                    .widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, text!("new-template", name = name)));
                if response.clicked() {
                    chosen = Some((english, text));
                }
                ui.label(RichText::new(description).size(12.0).color(theme::muted()));
                ui.add_space(theme::STEP);
            }
        });
        if let Some((name, text)) = chosen {
            self.document.set_text(text, &format!("template {name}"), None);
        }
    }

    /// Handles dropped files: images and videos become a source, a graph opens in a new window.
    pub(super) fn take_dropped(&mut self, ctx: &Context) {
        let dropped: Vec<PathBuf> = ctx.input(|i| i.raw.dropped_files.iter().map(|f| f.path().to_owned()).collect());
        self.dropped(dropped);
    }

    /// Handles files as if they were dropped on the window.
    pub fn dropped(&mut self, files: Vec<PathBuf>) {
        let files = self.drop_on_form(files);
        if files.is_empty() {
            return;
        }
        let (graphs, others): (Vec<_>, Vec<_>) =
            files.into_iter().partition(|f| f.extension() == Some(OsStr::new("toml")));
        let (mut pictures, unknown): (Vec<_>, Vec<_>) = others.into_iter().partition(|f| is_picture(f));
        for graph in graphs {
            self.open_graph(&graph);
        }
        pictures.sort();
        if !pictures.is_empty() && pictures.len() <= 2 {
            let text = self.document.text().clone();
            let result = with_source(&text, &pictures);
            if let Some((text, id)) = self.try_edit(result) {
                self.document.set_text(&text, "add dropped files", None);
                self.canvas.select_only(&id);
            }
        } else if pictures.len() > 2 {
            self.notify(text!("new-drop"), true);
        }
        if let Some(file) = unknown.first() {
            self.notify(text!("new-unknown", file = file.display().to_string()), true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_graph::GraphText;

    #[test]
    fn dropped_files_become_a_source_of_two_sides() {
        let files = ["/a/l.png", "/a/r.png"].map(PathBuf::from);
        let (text, id) = with_source("plugins = [\"flow\"]\n[nodes.scope]\ntype = \"frames\"\n", &files).unwrap();
        assert_eq!(id, "scope_2");
        let parsed = GraphText::parse("g.toml".as_ref(), &text);
        assert_eq!(parsed.plugins(), ["flow", "capture"]);
        let params = &parsed.outline()[1].params;
        assert_eq!((params["left"].as_str(), params["right"].as_str()), (Some("/a/l.png"), Some("/a/r.png")));
        assert!(is_picture(Path::new("x.MKV")) && !is_picture(Path::new("x.toml")));
    }
}
