//! The source of a node type written in Python: edited beside the graph, and swapped into the running graph when it is saved.

use std::path::{Path, PathBuf};

use eframe::egui::{Button, FontId, RichText, ScrollArea, TextEdit, TextStyle, Ui};

use panoscope_editor_model::disk::{self, SaveError};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// Maximum size of a source file, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// A request of this panel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceRequest {
    /// Save the file and swap the plugin.
    Save,
    /// Close the panel.
    Close,
}

/// An opened source file.
#[derive(Clone, Debug)]
pub struct SourceFile {
    /// The file.
    pub path: PathBuf,
    /// The text as it is edited.
    pub text: String,
    /// The text on disk when it was last read or saved.
    saved: String,
}

/// Why a source was not read or saved.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// It cannot be read.
    #[error("{}", text!("source-unreadable", file = file.clone(), reason = reason.to_string()))]
    Unreadable {
        /// The file.
        file: String,
        /// The operating system's error.
        reason: std::io::Error,
    },
    /// It is longer than the panel takes.
    #[error("{}", text!("source-too-long", file = file.clone()))]
    TooLong {
        /// The file.
        file: String,
    },
    /// Another program changed it since it was read.
    #[error("{}", text!("source-replaced", file = file.clone()))]
    Replaced {
        /// The file.
        file: String,
    },
    /// It cannot be written.
    #[error(transparent)]
    Save(#[from] SaveError),
}

impl SourceFile {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or is too long.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let file = || path.display().to_string();
        let fail = |reason: std::io::Error| SourceError::Unreadable { file: file(), reason };
        let text = disk::read_text(path, MAX_BYTES).map_err(fail)?;
        let text = text.ok_or_else(|| SourceError::TooLong { file: file() })?;
        Ok(Self { path: path.to_owned(), saved: text.clone(), text })
    }

    /// Whether the text is not on disk.
    pub fn is_changed(&self) -> bool {
        self.text != self.saved
    }

    /// Writes the file; the old text is kept in `FILE.bak`.
    ///
    /// # Errors
    /// It was changed by another program meanwhile, or cannot be written; the file is unchanged.
    pub fn save(&mut self) -> Result<(), SourceError> {
        if std::fs::read_to_string(&self.path).is_ok_and(|now| now != self.saved) {
            return Err(SourceError::Replaced { file: self.path.display().to_string() });
        }
        disk::save(&self.path, &self.text)?;
        self.saved.clone_from(&self.text);
        Ok(())
    }
}

/// Shows the panel; `problem` is why the last version does not run.
pub fn show(ui: &mut Ui, source: &mut SourceFile, problem: Option<&str>) -> Option<SourceRequest> {
    let mut request = None;
    ui.horizontal(|ui| {
        let name = source.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        ui.label(RichText::new(name).size(15.0)).on_hover_text(source.path.display().to_string());
        if ui
            .add_enabled(source.is_changed(), Button::new(text!("source-save")))
            .on_hover_text(text!("source-save.hint"))
            .clicked()
        {
            request = Some(SourceRequest::Save);
        }
        if ui.button(text!("source-close")).clicked() {
            request = Some(SourceRequest::Close);
        }
        if source.is_changed() {
            ui.label(RichText::new(text!("source-changed")).size(11.5).color(theme::accent()));
        }
    });
    if let Some(problem) = problem {
        ui.label(RichText::new(problem).size(12.0).color(theme::fault()));
    }
    let by_key = ui.input_mut(|i| i.consume_key(eframe::egui::Modifiers::COMMAND, eframe::egui::Key::Enter));
    if by_key && source.is_changed() {
        request = Some(SourceRequest::Save);
    }
    ScrollArea::both().auto_shrink([false, false]).show(ui, |ui| {
        ui.style_mut().text_styles.insert(TextStyle::Monospace, FontId::monospace(12.5));
        let rows = (ui.available_height() / 16.0) as usize;
        let field = TextEdit::multiline(&mut source.text).code_editor().desired_rows(rows.max(8));
        let field = ui.add(field.desired_width(f32::INFINITY));
        ui.ctx().accesskit_node_builder(field.id, |node| node.set_label(text!("source-name")));
    });
    request
}
