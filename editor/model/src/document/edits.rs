//! Edits of the texts, each one undo step; undo and redo.

use std::path::Path;
use std::sync::Arc;

use panoscope_graph::GraphText;
use panoscope_graph::edit::{EditError, FileEdits, GraphEdit, NoHome};

use super::{Document, Texts, UndoStep};
use crate::history::Origin;

/// Number of undo steps that are kept.
const MAX_UNDO_STEPS: usize = 500;

impl Document {
    /// Replaces the text as one undo step. Consecutive steps with the same `merge` are one step.
    pub fn set_text(&mut self, text: &str, label: &str, merge: Option<&str>) {
        self.set_text_by(Origin::Hand, text, label, merge);
    }

    /// As [`Self::set_text`], by somebody.
    pub fn set_text_by(&mut self, by: Origin, text: &str, label: &str, merge: Option<&str>) {
        let others = self.others.clone();
        self.set_texts_by(by, text, others, label, merge);
    }

    /// Replaces the texts of the graph file and of those parts and overlays that `others` has, as one undo step. Returns whether anything differed.
    pub(crate) fn replace_texts(&mut self, text: &str, others: Texts, label: &str) -> bool {
        let mut all = self.others.clone();
        all.extend(others);
        let differs = *text != *self.text || all != self.others;
        self.set_texts_by(Origin::Hand, text, all, label, None);
        differs
    }

    pub(super) fn set_texts_by(&mut self, by: Origin, text: &str, others: Texts, label: &str, merge: Option<&str>) {
        if *text == *self.text && others == self.others {
            return;
        }
        let extends_last = merge.is_some() && merge == self.merge.as_deref() && !self.undo.is_empty();
        if !extends_last {
            let (text, others) = (Arc::clone(&self.text), self.others.clone());
            self.undo.push(UndoStep { text, others, label: label.to_owned() });
            if self.undo.len() > MAX_UNDO_STEPS {
                self.undo.remove(0);
            }
        }
        self.merge = merge.map(str::to_owned);
        self.redo.clear();
        self.text = text.into();
        self.others = others;
        self.derive_by(by, extends_last);
    }

    /// Sets parameters, or with `None` takes them out, as one step. Each change goes into the file that the value came from: the graph, a part, an
    /// overlay, or the default of an argument.
    ///
    /// # Errors
    /// A text cannot be edited like that, or a value comes from the command line; all texts are as before.
    pub fn edit_params(
        &mut self,
        by: Origin,
        label: &str,
        merge: Option<&str>,
        changes: &[(&str, &str, Option<&toml::Value>)],
    ) -> Result<(), EditError> {
        // What is set in the text holds from now on.
        self.played.retain(|(node, param, _)| !changes.iter().any(|(n, p, _)| n == node && p == param));
        self.edit_files(by, label, merge, |files, parsed| {
            for (node, param, value) in changes {
                match parsed.param_home(node, param) {
                    Ok(home) => {
                        let all = parsed.files();
                        let other = all.iter().skip(1).find(|f| Path::new(f.path) == home.file);
                        let edit = match other {
                            Some(other) => files.file(&other.key())?,
                            None => files.root()?,
                        };
                        home.entry.set(edit, *value)?;
                    }
                    // The edit of the text says what is wrong.
                    Err(NoHome::NoNode(_)) => match value {
                        Some(value) => files.root()?.set_param(node, param, value)?,
                        None => files.root()?.unset_param(node, param)?,
                    },
                    Err(error) => return Err(error.into()),
                }
            }
            Ok(())
        })
    }

    /// Edits the graph file with its parts and overlays as one undo step.
    ///
    /// # Errors
    /// The edit does not fit the texts, or it changes a part that is used several times and that [`Self::allow_shared`] does not allow to change;
    /// all texts are as before.
    pub fn edit_files<T>(
        &mut self,
        by: Origin,
        label: &str,
        merge: Option<&str>,
        edit: impl FnOnce(&mut FileEdits<'_>, &GraphText) -> Result<T, EditError>,
    ) -> Result<T, EditError> {
        let parsed = self.parse();
        let mut edits = FileEdits::new(&parsed);
        let result = edit(&mut edits, &parsed)?;
        let root = parsed.files().first().map(|f| f.key()).unwrap_or_default();
        let mut text = Arc::clone(&self.text);
        let mut others = self.others.clone();
        for (path, before, new) in edits.into_texts() {
            if path == root {
                text = new.into();
                continue;
            }
            if before.is_none() && (others.contains_key(&path) || path.exists()) {
                return Err(EditError::FileExists { file: path.display().to_string() });
            }
            let users = parsed.part_users(&path);
            if by == Origin::Hand && users.len() > 1 && !self.shared.contains(&path) {
                return Err(EditError::SharedPart { file: path, users });
            }
            others.insert(path, new.into());
        }
        self.set_texts_by(by, &text, others, label, merge);
        Ok(result)
    }

    /// Ends a merged step, so that the next edit is a step of its own.
    pub fn end_merge(&mut self) {
        self.merge = None;
    }

    /// Edits the text as one undo step.
    ///
    /// # Errors
    /// The edit does not fit the text, which is unchanged.
    pub fn edit(
        &mut self,
        label: &str,
        merge: Option<&str>,
        edit: impl FnOnce(&mut GraphEdit) -> Result<(), EditError>,
    ) -> Result<(), EditError> {
        self.edit_by(Origin::Hand, label, merge, edit)
    }

    /// As [`Self::edit`], with the origin of the change.
    ///
    /// # Errors
    /// The edit does not fit the text, which is unchanged.
    pub fn edit_by(
        &mut self,
        by: Origin,
        label: &str,
        merge: Option<&str>,
        edit: impl FnOnce(&mut GraphEdit) -> Result<(), EditError>,
    ) -> Result<(), EditError> {
        let mut document = GraphEdit::parse(&self.text)?;
        edit(&mut document)?;
        self.set_text_by(by, &document.text(), label, merge);
        Ok(())
    }

    /// Edits the text as part of the previous undo step.
    ///
    /// # Errors
    /// The edit does not fit the text, which is unchanged.
    pub fn amend(&mut self, edit: impl FnOnce(&mut GraphEdit) -> Result<(), EditError>) -> Result<(), EditError> {
        let mut document = GraphEdit::parse(&self.text)?;
        edit(&mut document)?;
        let text = document.text();
        if *text != *self.text {
            self.text = text.into();
            self.derive_by(Origin::Hand, true);
        }
        Ok(())
    }

    /// Undoes the last step and returns its label.
    pub fn undo(&mut self) -> Option<String> {
        let step = self.undo.pop()?;
        let now = self.swap(&step);
        self.redo.push(now);
        self.merge = None;
        self.derive_by(Origin::Undo, false);
        Some(step.label)
    }

    /// Repeats the last undone step and returns its label.
    pub fn redo(&mut self) -> Option<String> {
        let step = self.redo.pop()?;
        let now = self.swap(&step);
        self.undo.push(now);
        self.merge = None;
        self.derive_by(Origin::Redo, false);
        Some(step.label)
    }

    /// Takes the texts of a step; returns those of now under its label.
    fn swap(&mut self, step: &UndoStep) -> UndoStep {
        let text = std::mem::replace(&mut self.text, Arc::clone(&step.text));
        let others = std::mem::replace(&mut self.others, step.others.clone());
        UndoStep { text, others, label: step.label.clone() }
    }
}
