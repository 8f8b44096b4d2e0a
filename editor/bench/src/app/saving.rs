//! Saving, and what happens when somebody else changes the file meanwhile: no text is lost, and who is in front of the window chooses.

use std::sync::Arc;

use eframe::egui::{Frame, Margin, Panel, RichText, Ui};

use super::App;
use panoscope_editor_model::disk;
use panoscope_editor_model::history::By;
use panoscope_editor_widgets::theme;

/// Told when a save is refused because it would lose what somebody else wrote.
const NOT_SAVED: &str = "not saved: the file was changed on disk, too; choose in the bar above which text to keep";

/// The file and the graph of the window have both changed since the file was read or saved.
pub(super) struct Conflict {
    /// The file's text now.
    theirs: String,
    /// Saving was tried meanwhile; it would have lost the file's text.
    refused_save: bool,
}

impl App {
    /// Takes a text that somebody else wrote into the file.
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
        self.document.set_text_by(By::File, &text, "change on disk", None);
        self.document.now_saved(&text);
        self.tell("the file changed on disk and was read again; undo brings the old text back", false);
    }

    /// Says that a choice waits, and takes it.
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
                ui.label("The file was changed on disk, and so was the graph here. Choose which text to keep:");
                let theirs = ui.button("Take the file's").on_hover_text("Undo brings the graph of this window back");
                let ours = ui
                    .button("Keep this one")
                    .on_hover_text("The next save replaces the file; its text is kept as a backup");
                if theirs.clicked()
                    && let Some(conflict) = self.conflict.take()
                {
                    self.document.set_text_by(By::File, &conflict.theirs, "take the file's text", None);
                    self.document.now_saved(&conflict.theirs);
                } else if ours.clicked()
                    && let Some(conflict) = self.conflict.take()
                {
                    self.document.now_saved(&conflict.theirs);
                    self.tell("kept; saving replaces the file now, with its text in the backup", false);
                }
            });
        });
    }

    /// Saves the text, unless that would lose what somebody else wrote.
    pub(super) fn save(&mut self) {
        // Someone else's text is not overwritten unseen.
        if let Ok(text) = std::fs::read_to_string(self.document.path())
            && text != **self.document.saved()
            && text != **self.document.text()
        {
            self.conflict = Some(Conflict { theirs: text, refused_save: true });
            self.tell(NOT_SAVED, true);
            return;
        }
        self.conflict = None;
        let text = Arc::clone(self.document.text());
        let result = disk::save(self.document.path(), &text);
        if self.try_edit(result).is_some() {
            self.disk.settle();
            self.document.now_saved(&text);
            self.tell("saved", false);
        }
    }
}
