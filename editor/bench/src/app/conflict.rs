//! The state of a conflict between the window's text of a file and the file.

use std::path::PathBuf;
use std::sync::Arc;

use eframe::egui::text::{LayoutJob, TextFormat};
use eframe::egui::{Color32, FontId, Label, RichText, ScrollArea, Ui, WidgetInfo, WidgetType};
use panoscope_editor_model::difference::{self, Line};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// Equal lines shown before and after a change.
const AROUND: usize = 2;
/// Maximum number of lines of a difference that are shown.
const MAX_LINES: usize = 400;

/// Set while a file and the window's text of it have both changed since the file was read or saved.
pub(super) struct Conflict {
    /// The file.
    pub(super) path: PathBuf,
    /// The current text of the file.
    pub(super) theirs: String,
    /// Whether a save was refused because it would have lost the file's text.
    pub(super) refused_save: bool,
    /// The texts that were compared last, and their difference.
    pub(super) compared: Option<(Arc<str>, Vec<Line>)>,
}

impl Conflict {
    /// The difference between the window's text and the file's.
    fn difference(&mut self, ours: &Arc<str>) -> &[Line] {
        if self.compared.as_ref().is_some_and(|(before, _)| !Arc::ptr_eq(before, ours)) {
            self.compared = None;
        }
        let theirs = &self.theirs;
        &self.compared.get_or_insert_with(|| (Arc::clone(ours), difference::lines(ours, theirs, AROUND))).1
    }

    /// Shows the difference: lines of the window in one colour, those of the file in another, each with a sign.
    pub(super) fn show_difference(&mut self, ui: &mut Ui, ours: &Arc<str>) {
        let lines = self.difference(ours);
        let (mut job, mut count) = (LayoutJob::default(), [0, 0]);
        let mut line = |text: &str, color: Color32| {
            let format = TextFormat { font_id: FontId::monospace(12.0), color, ..TextFormat::default() };
            job.append(&format!("{text}\n"), 0.0, format);
        };
        for entry in lines.iter().take(MAX_LINES) {
            match entry {
                Line::Same(text) => line(&format!("  {text}"), theme::muted()),
                Line::Ours(text) => line(&format!("- {text}"), theme::fault()),
                Line::Theirs(text) => line(&format!("+ {text}"), theme::live()),
                Line::Skipped(lines) => {
                    line(&format!("  ... {}", text!("conflict-equal", count = *lines)), theme::muted())
                }
            }
        }
        for entry in lines {
            count[0] += usize::from(matches!(entry, Line::Ours(_)));
            count[1] += usize::from(matches!(entry, Line::Theirs(_)));
        }
        if lines.len() > MAX_LINES {
            line(&format!("  ... {}", text!("conflict-more", count = lines.len() - MAX_LINES)), theme::muted());
        }
        let caption = text!("conflict-difference", ours = count[0], theirs = count[1]);
        ui.label(RichText::new(&caption).size(12.0));
        ScrollArea::both().max_height(180.0).auto_shrink([false, true]).id_salt("difference").show(ui, |ui| {
            let shown = ui.add(Label::new(job).extend());
            shown.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, text!("conflict-difference.name")));
        });
    }
}
