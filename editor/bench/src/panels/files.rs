//! A dialog to pick a file by typing, by keys or by clicks. It does not use the system's file dialog.

use std::path::{Path, PathBuf};

use eframe::egui::{
    Align2, Context, Frame, Id, Key, Label, Modal, Modifiers, RichText, ScrollArea, Sense, Ui, WidgetInfo, WidgetType,
    vec2,
};

use crate::search::{self, Candidate};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// Maximum number of entries of a folder.
const MAX_ENTRIES: usize = 5000;

/// What the picked file is for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// A parameter of a node.
    Param {
        /// The node.
        node: String,
        /// Its parameter.
        param: String,
    },
    /// An argument of the graph.
    Argument {
        /// The argument.
        arg: String,
    },
    /// The recording for a sweep.
    Recording,
    /// A recording to show on the nodes.
    Timeline,
    /// A second recording beside it.
    SecondTimeline,
}

struct Entry {
    name: String,
    folder: bool,
}

/// The open dialog.
pub struct Files {
    /// What the picked file is for.
    pub target: Target,
    folder: PathBuf,
    /// The folder that relative paths in the graph start from.
    base: PathBuf,
    entries: Vec<Entry>,
    typed: String,
    chosen: usize,
    fresh: bool,
    wrong: Option<String>,
}

impl Files {
    /// Opens the dialog in the folder of `now`, a path as written in the graph; `base` is the graph's folder.
    pub fn new(target: Target, base: &Path, now: &str) -> Self {
        let base = std::path::absolute(base).unwrap_or_else(|_| base.to_owned());
        let folder = if now.is_empty() { base.clone() } else { base.join(now) };
        let folder = if folder.is_dir() { folder } else { folder.parent().unwrap_or(&base).to_owned() };
        let folder = if folder.is_dir() { folder } else { base.clone() };
        let mut this = Self {
            target,
            folder,
            base,
            entries: Vec::new(),
            typed: String::new(),
            chosen: 0,
            fresh: true,
            wrong: None,
        };
        this.read();
        this
    }

    fn read(&mut self) {
        self.entries.clear();
        (self.chosen, self.wrong) = (0, None);
        self.typed.clear();
        match std::fs::read_dir(&self.folder) {
            Ok(list) => {
                let entry = |e: std::fs::DirEntry| {
                    let name = e.file_name().into_string().ok().filter(|n| !n.starts_with('.'))?;
                    Some(Entry { name, folder: e.path().is_dir() })
                };
                self.entries.extend(list.flatten().filter_map(entry).take(MAX_ENTRIES));
                self.entries.sort_by(|a, b| (!a.folder, &a.name).cmp(&(!b.folder, &b.name)));
            }
            Err(error) => {
                self.wrong = Some(text!(
                    "files-unreadable",
                    folder = self.folder.display().to_string(),
                    reason = error.to_string()
                ))
            }
        }
    }

    fn enter(&mut self, folder: PathBuf) {
        self.folder = folder;
        self.read();
    }

    /// Goes to the parent folder.
    fn up(&mut self) {
        if let Some(parent) = self.folder.parent().map(Path::to_owned) {
            self.enter(parent);
        }
    }

    /// A path as written in the graph: relative if it is inside the graph's folder.
    fn written(&self, path: &Path) -> String {
        // Values of arguments start from the working folder.
        let inside = path.strip_prefix(&self.base).ok().filter(|_| !matches!(self.target, Target::Argument { .. }));
        inside.unwrap_or(path).to_string_lossy().into_owned()
    }

    /// Shows the dialog; returns the picked path, or `Some(None)` when it was closed without picking.
    pub fn show(&mut self, ctx: &Context) -> Option<Option<String>> {
        let order = match self.typed.is_empty() {
            true => (0..self.entries.len()).collect(),
            false => search::rank(
                &self.typed,
                "",
                self.entries.iter().map(|e| Candidate { name: &e.name, ..Candidate::default() }),
            ),
        };
        self.chosen = self.chosen.min(order.len().saturating_sub(1));
        let take = |key| ctx.input_mut(|i| i.consume_key(Modifiers::NONE, key));
        if take(Key::ArrowDown) {
            self.chosen = (self.chosen + 1).min(order.len().saturating_sub(1));
        }
        if take(Key::ArrowUp) {
            self.chosen = self.chosen.saturating_sub(1);
        }
        let above = self.typed.is_empty() && take(Key::Backspace);
        let enter = take(Key::Enter);
        let mut picked = order.get(self.chosen).copied().filter(|_| enter);
        // A name that no entry has is the name of a new file.
        let new = enter && picked.is_none() && !self.typed.trim().is_empty();
        let mut result = new.then(|| Some(self.written(&self.folder.join(self.typed.trim()))));
        let mut go_up = above;
        let frame = Frame::popup(&ctx.global_style()).inner_margin(12.0);
        let area = Modal::default_area(Id::new("files")).anchor(Align2::CENTER_TOP, vec2(0.0, 96.0));
        let shown = Modal::new(Id::new("files"))
            .area(area)
            .frame(frame)
            .backdrop_color(theme::sunk().gamma_multiply(0.5))
            .show(ctx, |ui| {
                ui.set_width(560.0);
                ui.horizontal(|ui| {
                    go_up |= ui.button(text!("files-up")).on_hover_text(text!("files-up.hint")).clicked();
                    let caption = RichText::new(self.folder.display().to_string()).size(12.0).color(theme::muted());
                    ui.add(Label::new(caption).truncate());
                });
                let hint = text!("files-name.hint");
                if search::field(ui, &mut self.typed, &mut self.fresh, hint, text!("files-name")) {
                    self.chosen = 0;
                }
                ui.add_space(theme::STEP);
                ScrollArea::vertical().max_height(380.0).auto_shrink([false, true]).show(ui, |ui| {
                    ui.spacing_mut().item_spacing.y = 0.0;
                    for (row, &index) in order.iter().enumerate() {
                        if row_of(ui, &self.entries[index], row == self.chosen) {
                            picked = Some(index);
                        }
                    }
                    let caption = match (&self.wrong, order.is_empty(), self.typed.is_empty()) {
                        (Some(why), ..) => why.clone(),
                        (_, true, true) => text!("files-empty").to_owned(),
                        (_, true, false) => text!("files-new").to_owned(),
                        _ => String::new(),
                    };
                    if !caption.is_empty() {
                        ui.label(RichText::new(caption).color(theme::muted()));
                    }
                });
            });
        if let Some(entry) = picked.and_then(|index| self.entries.get(index)) {
            let path = self.folder.join(&entry.name);
            if entry.folder {
                self.enter(path);
                self.fresh = true;
            } else {
                result = Some(Some(self.written(&path)));
            }
        } else if go_up {
            self.up();
            self.fresh = true;
        }
        if result.is_none() && shown.should_close() { Some(None) } else { result }
    }
}

/// Draws one row; returns whether it was clicked.
fn row_of(ui: &mut Ui, entry: &Entry, chosen: bool) -> bool {
    let (rect, row) = ui.allocate_exact_size(vec2(ui.available_width(), 26.0), Sense::click());
    let caption = match entry.folder {
        true => text!("files-folder", name = &entry.name),
        false => text!("files-file", name = &entry.name),
    };
    row.widget_info(|| WidgetInfo::selected(WidgetType::SelectableLabel, true, chosen, caption.clone()));
    search::mark_row(ui, rect, &row, chosen);
    let name = if entry.folder { format!("{}/", entry.name) } else { entry.name.clone() };
    let color = if entry.folder { theme::accent() } else { theme::text() };
    let font = eframe::egui::FontId::proportional(13.0);
    ui.painter().text(rect.left_center() + vec2(8.0, 0.0), Align2::LEFT_CENTER, name, font, color);
    row.clicked()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_come_first_and_paths_start_from_the_graph() {
        let base = std::env::temp_dir().join(format!("panoscope_files_{}", std::process::id()));
        std::fs::create_dir_all(base.join("videos")).unwrap();
        for name in ["b.png", "a.png", ".hidden", "videos/left.mkv"] {
            std::fs::write(base.join(name), "").unwrap();
        }
        let mut files = Files::new(Target::Recording, &base, "videos/left.mkv");
        assert_eq!(files.folder, base.join("videos"));
        assert_eq!(files.written(&files.folder.join("left.mkv")), "videos/left.mkv");
        files.up();
        let names: Vec<&str> = files.entries.iter().map(|e| e.name.as_str()).collect();
        assert_eq!(names, ["videos", "a.png", "b.png"]);
        assert_eq!(files.written(Path::new("/else/where.png")), "/else/where.png");
        assert_eq!(Files::new(Target::Recording, &base, "not/there.mkv").folder, base);
        std::fs::remove_dir_all(&base).unwrap();
    }
}
