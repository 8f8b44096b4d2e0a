//! Saves the file, and handles changes of the file by other programs: no text is lost, the user chooses.

use std::sync::Arc;

use eframe::egui::{Frame, Margin, Panel, RichText, Ui};

use super::App;
use super::conflict::Conflict;
use panoscope_editor_model::copying;
use panoscope_editor_model::disk::{self, DiskWatch};
use panoscope_editor_model::history::Origin;
use panoscope_editor_widgets::theme;

/// The message when a save is refused because it would lose another program's text.
const NOT_SAVED: &str = "not saved: the file was also changed on disk; choose in the bar above which text to keep";

impl App {
    /// Handles a new text of the file that another program wrote.
    pub(super) fn changed_on_disk(&mut self, text: String) {
        if text == **self.document.saved() {
            self.conflict = None;
            return;
        }
        if self.document.is_changed() && text != **self.document.text() {
            let refused_save = self.conflict.as_ref().is_some_and(|c| c.refused_save);
            self.conflict = Some(Conflict { theirs: text, refused_save });
            return;
        }
        self.conflict = None;
        self.document.set_text_by(Origin::File, &text, "change on disk", None);
        self.document.set_saved(&text);
        self.notify("the file changed on disk and was reloaded; undo restores the old text", false);
    }

    /// Shows the bar with the choice during a conflict, and applies the choice.
    pub(super) fn conflict_bar(&mut self, ui: &mut Ui) {
        let Some(conflict) = &self.conflict else { return };
        let refused = conflict.refused_save;
        let fill = if refused { theme::FAULT } else { theme::WARN };
        let frame = Frame::new().fill(fill.gamma_multiply(0.18)).inner_margin(Margin::symmetric(16, 8));
        Panel::top("conflict").frame(frame).show(ui, |ui| {
            ui.horizontal(|ui| {
                if refused {
                    ui.label(RichText::new("Not saved.").color(theme::FAULT).strong());
                }
                ui.label("The file was changed on disk, and the graph in this window was changed too. Choose which text to keep:");
                let theirs = ui.button("Take the file's").on_hover_text("Undo restores the graph of this window");
                let ours = ui
                    .button("Keep this one")
                    .on_hover_text("The next save replaces the file and keeps its text as a backup");
                if theirs.clicked()
                    && let Some(conflict) = self.conflict.take()
                {
                    self.document.set_text_by(Origin::File, &conflict.theirs, "take the file's text", None);
                    self.document.set_saved(&conflict.theirs);
                } else if ours.clicked()
                    && let Some(conflict) = self.conflict.take()
                {
                    self.document.set_saved(&conflict.theirs);
                    self.notify("kept; the next save replaces the file and keeps its text as a backup", false);
                }
            });
        });
    }

    /// Saves parts and overlays that were changed here; `false` when one of them was not saved.
    fn save_files(&mut self) -> bool {
        let changed = self.document.changed_files().into_iter();
        let changed: Vec<_> =
            changed.map(|(path, text, saved)| (path.to_owned(), Arc::clone(text), Arc::clone(saved))).collect();
        for (path, text, saved) in changed {
            if std::fs::read_to_string(&path).is_ok_and(|disk| disk != *saved && disk != *text) {
                let words = format!(
                    "not saved: {} was changed on disk, too; undo the changes here, or put the file back",
                    path.display()
                );
                self.notify(words, true);
                return false;
            }
            let result = disk::save(&path, &text);
            if self.try_edit(result).is_none() {
                return false;
            }
            self.document.file_now_saved(&path);
        }
        true
    }

    /// Saves a graph of the installation as a copy, which the window edits from then on; `false` if the graph belongs to no installation.
    fn save_copy(&mut self) -> bool {
        let Some(copy) = copying::destination(self.document.path()) else { return false };
        let result = copying::save_as(&mut self.document, &copy);
        if self.try_edit(result).is_some() {
            self.disk = DiskWatch::new(&copy);
            self.notify(
                format!("saved as a copy, because the original belongs to the installation: {}", copy.display()),
                false,
            );
        }
        true
    }

    /// Saves the text, unless that would lose another program's text.
    pub(super) fn save(&mut self) {
        if self.save_copy() {
            return;
        }
        // A text of another program is not overwritten without asking.
        if let Ok(text) = std::fs::read_to_string(self.document.path())
            && text != **self.document.saved()
            && text != **self.document.text()
        {
            self.conflict = Some(Conflict { theirs: text, refused_save: true });
            self.notify(NOT_SAVED, true);
            return;
        }
        self.conflict = None;
        if !self.save_files() {
            return;
        }
        let text = Arc::clone(self.document.text());
        let result = disk::save(self.document.path(), &text);
        if self.try_edit(result).is_some() {
            self.disk.mark_known();
            self.document.set_saved(&text);
            self.notify("saved", false);
        }
    }
}
