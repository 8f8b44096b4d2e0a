//! Saves the file, and handles changes of the file by other programs: no text is lost, the user chooses.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui::{Frame, Margin, Panel, RichText, Ui};

use super::App;
use super::conflict::Conflict;
use panoscope_editor_model::copying;
use panoscope_editor_model::disk::{self, DiskWatch};
use panoscope_editor_model::history::Origin;
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

impl App {
    /// Handles a new text of the file that another program wrote.
    pub(super) fn changed_on_disk(&mut self, text: String) {
        let path = self.document.path().to_owned();
        if text == **self.document.saved() {
            self.forget_conflict(&path);
            return;
        }
        if self.document.text() != self.document.saved() && text != **self.document.text() {
            self.add_conflict(path, text, false);
            return;
        }
        self.forget_conflict(&path);
        self.document.set_text_by(Origin::File, &text, "change on disk", None);
        self.document.set_saved(&text);
        if self.is_attached() {
            return self.notify_of_change();
        }
        self.notify(text!("save-reloaded"), false);
    }

    /// Handles new texts of part and overlay files that other programs wrote.
    pub(super) fn poll_other_files(&mut self) {
        let known: Vec<PathBuf> = self.document.saved_files().map(|(path, _)| path.to_owned()).collect();
        self.other_disks.retain(|path, _| known.contains(path));
        for path in known {
            let watch = self.other_disks.entry(path.clone()).or_insert_with(|| DiskWatch::new(&path));
            if let Some(text) = watch.poll() {
                self.other_changed_on_disk(&path, &text);
            }
        }
    }

    fn other_changed_on_disk(&mut self, path: &Path, text: &str) {
        let saved = self.document.saved_files().find(|(known, _)| *known == path).map(|(_, text)| Arc::clone(text));
        let now = self.document.file_text(path).cloned();
        if saved.as_deref() == Some(text) {
            self.forget_conflict(path);
            return;
        }
        if now != saved && now.as_deref() != Some(text) {
            self.add_conflict(path.to_owned(), text.to_owned(), false);
            return;
        }
        self.forget_conflict(path);
        self.document.file_changed_on_disk(path, text, true);
        self.notify(text!("save-reloaded-file", file = path.display().to_string()), false);
    }

    fn add_conflict(&mut self, path: PathBuf, theirs: String, refused: bool) {
        let refused_save = refused || self.conflicts.iter().any(|c| c.path == path && c.refused_save);
        self.forget_conflict(&path);
        self.conflicts.push(Conflict { path, theirs, refused_save, compared: None });
    }

    pub(super) fn forget_conflict(&mut self, path: &Path) {
        self.conflicts.retain(|c| c.path != path);
    }

    /// Shows the bar with the difference and the choice during a conflict, and applies the choice. Several conflicts are shown one after the other.
    pub(super) fn conflict_bar(&mut self, ui: &mut Ui) {
        let Some(conflict) = self.conflicts.first_mut() else { return };
        let is_root = conflict.path == self.document.path();
        let ours = match self.document.file_text(&conflict.path) {
            _ if is_root => Arc::clone(self.document.text()),
            Some(text) => Arc::clone(text),
            None => "".into(),
        };
        let what = match is_root {
            true if self.session.attachment().is_some() => text!("conflict-machine").to_owned(),
            true => text!("conflict-file").to_owned(),
            false => {
                let name = conflict.path.file_name().unwrap_or_default().to_string_lossy();
                text!("conflict-part", file = name)
            }
        };
        let fill = if conflict.refused_save { theme::fault() } else { theme::warn() };
        let frame = Frame::new().fill(fill.gamma_multiply(0.18)).inner_margin(Margin::symmetric(16, 8));
        // Whether the file's text is taken.
        let mut take = None;
        Panel::top("conflict").frame(frame).show(ui, |ui| {
            ui.horizontal(|ui| {
                if conflict.refused_save {
                    ui.label(RichText::new(text!("conflict-unsaved")).color(theme::fault()).strong());
                }
                ui.label(what);
                let theirs = ui.button(text!("conflict-theirs")).on_hover_text(text!("conflict-theirs.hint"));
                let ours = ui.button(text!("conflict-ours")).on_hover_text(text!("conflict-ours.hint"));
                take = if theirs.clicked() { Some(true) } else { ours.clicked().then_some(false) };
            });
            conflict.show_difference(ui, &ours);
        });
        if let Some(take) = take {
            self.resolve_conflict(is_root, take);
        }
    }

    /// Ends the first conflict with the file's text, or with the one of this window.
    fn resolve_conflict(&mut self, is_root: bool, take: bool) {
        let conflict = self.conflicts.remove(0);
        if !is_root {
            self.document.file_changed_on_disk(&conflict.path, &conflict.theirs, take);
        } else {
            if take {
                self.document.set_text_by(Origin::File, &conflict.theirs, "take the file's text", None);
            }
            self.document.set_saved(&conflict.theirs);
        }
        if self.is_attached() {
            return self.after_conflict(take);
        }
        if !take {
            self.notify(text!("conflict-kept"), false);
        }
    }

    /// Saves a graph of the installation as a copy, which the window edits from then on; `false` if the graph belongs to no installation.
    fn save_copy(&mut self) -> bool {
        let Some(copy) = copying::destination(self.document.path()) else { return false };
        let result = copying::save_as(&mut self.document, &copy);
        if self.try_edit(result).is_some() {
            self.disk = DiskWatch::new(&copy);
            self.notify(text!("save-copy", file = copy.display().to_string()), false);
        }
        true
    }

    /// Saves all changed files, parts and overlays before the graph, unless that would lose another program's text.
    pub(super) fn save(&mut self) {
        if self.is_attached() {
            return self.save_machine_copy();
        }
        if self.save_copy() {
            return;
        }
        // A text of another program is not overwritten without asking. All files are compared before the first is written.
        let root = (self.document.path(), self.document.text(), Some(self.document.saved()));
        let root_changed = root.1 != self.document.saved() || !root.0.exists();
        let mut files: Vec<(PathBuf, Arc<str>)> = Vec::new();
        let mut theirs: Vec<(PathBuf, String)> = Vec::new();
        for (path, text, saved) in self.document.changed_files().into_iter().chain([root]) {
            let disk = std::fs::read_to_string(path);
            if let Ok(disk) = disk
                && disk != **text
                && saved.is_none_or(|saved| disk != **saved)
            {
                theirs.push((path.to_owned(), disk));
            }
            if path != root.0 || root_changed || files.is_empty() {
                files.push((path.to_owned(), Arc::clone(text)));
            }
        }
        if !theirs.is_empty() {
            theirs.into_iter().for_each(|(path, text)| self.add_conflict(path, text, true));
            self.notify(text!("save-refused"), true);
            return;
        }
        self.conflicts.clear();
        let count = files.len();
        for (path, text) in files {
            let is_root = path == self.document.path();
            // The folder of a new part.
            let folder = path.parent().filter(|folder| !is_root && !folder.as_os_str().is_empty());
            let result = folder.map_or(Ok(()), std::fs::create_dir_all);
            let result = result
                .map_err(|error| text!("save-failed", file = path.display().to_string(), reason = error.to_string()));
            let result = result.and_then(|()| disk::save(&path, &text).map_err(|error| error.to_string()));
            if self.try_edit(result).is_none() {
                return;
            }
            if is_root {
                self.disk.mark_known();
                self.document.set_saved(&text);
            } else {
                if let Some(watch) = self.other_disks.get_mut(&path) {
                    watch.mark_known();
                }
                self.document.file_now_saved(&path);
            }
        }
        self.notify(text!("save-done", count = count), false);
    }
}
