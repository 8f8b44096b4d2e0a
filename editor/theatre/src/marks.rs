//! Marks that several parts of the window draw.

use std::sync::Arc;

use eframe::egui::{Color32, FontId, Galley, Painter, Rect, Stroke, StrokeKind, Ui};
use panoscope_editor_widgets::theme;

/// A text on one line, smaller where it does not fit in `width`.
pub(super) fn fitting(painter: &Painter, words: &str, size: f32, width: f32, color: Color32) -> Arc<Galley> {
    let lay = |size: f32| painter.layout_no_wrap(words.to_owned(), FontId::proportional(size), color);
    let galley = lay(size);
    if galley.size().x <= width {
        galley
    } else {
        lay((size * width / galley.size().x).max(theme::legible(painter.ctx(), 0.0)))
    }
}

/// Draws a frame around the focused image, outside of it.
pub(super) fn focus_frame(ui: &Ui, rect: Rect) {
    ui.painter().rect_stroke(rect.expand(4.0), 6.0, Stroke::new(2.0, theme::accent()), StrokeKind::Inside);
}
