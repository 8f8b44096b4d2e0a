//! Draws the background, and the wire or frame that is dragged.

use eframe::egui::epaint::CubicBezierShape;
use eframe::egui::{Color32, FontFamily, FontId, Painter, Pos2, Rect, Stroke, StrokeKind, Ui, pos2, vec2};

use super::curve::bow;
use super::interaction::{Drag, check_wire};
use super::{Canvas, Scene};
use panoscope_editor_widgets::theme;

/// Least size of a text on the canvas, in points of the window.
pub(super) const MIN_TEXT: f32 = 11.0;

impl Canvas {
    /// A font that grows and shrinks with the graph, but stays legible.
    pub(super) fn font(&self, size: f32) -> FontId {
        // Rounded to half points, so that the font texture needs fewer sizes.
        FontId::new(((size * self.scale()) * 2.0).round().max(2.0 * MIN_TEXT) / 2.0, FontFamily::Proportional)
    }

    /// Draws the grid points. The background is the window's clear colour, because filling pixels is slow with software rendering.
    pub(super) fn paint_ground(&self, painter: &Painter) {
        let step = 32.0 * self.scale();
        if step < 14.0 {
            return;
        }
        let origin = self.transform() * Pos2::ZERO;
        let start = |o: f32, low: f32| low + (o - low).rem_euclid(step);
        let color = theme::line().gamma_multiply(0.55);
        let mut y = start(origin.y, self.rect.top());
        while y < self.rect.bottom() {
            let mut x = start(origin.x, self.rect.left());
            while x < self.rect.right() {
                painter.rect_filled(Rect::from_center_size(pos2(x, y), vec2(1.5, 1.5)), 0.0, color);
                x += step;
            }
            y += step;
        }
    }

    /// Draws the wire or selection frame that is being dragged.
    pub(super) fn paint_drag(&self, ui: &Ui, scene: &Scene<'_>) {
        let Some(pointer) = ui.input(|i| i.pointer.latest_pos()) else { return };
        let painter = ui.painter();
        match &self.drag {
            Drag::Frame(from) => {
                let frame = Rect::from_two_pos(self.transform() * *from, pointer);
                let stroke = Stroke::new(1.0, theme::accent());
                painter.rect(frame, 2.0, theme::accent().gamma_multiply(0.1), stroke, StrokeKind::Inside);
            }
            Drag::Wire { from, .. } => {
                let Some(node) = scene.view.node(&from.node) else { return };
                let Some((start, packet)) = self.pin_at(node, &from.port, from.input) else { return };
                let over = self.pin_near(scene.view, from, pointer);
                let verdict = over.as_ref().map(|end| check_wire(scene.view, from, end));
                let end = over
                    .as_ref()
                    .and_then(|end| Some(self.pin_at(scene.view.node(&end.node)?, &end.port, end.input)?.0));
                let color = match verdict {
                    Some(Err(_)) => theme::fault(),
                    Some(Ok(())) => theme::accent(),
                    None => theme::packet(packet),
                };
                let to = end.unwrap_or(pointer);
                let curve = if from.input { bow(to, start, self.scale()) } else { bow(start, to, self.scale()) };
                let stroke = Stroke::new(2.5 * self.scale(), color);
                painter.add(CubicBezierShape::from_points_stroke(curve, false, Color32::TRANSPARENT, stroke));
                if let Some(end) = end {
                    painter.circle_stroke(end, 9.0 * self.scale(), Stroke::new(2.0, color));
                }
                if let Some(Err(why)) = verdict {
                    show_hint(painter, pointer + vec2(16.0, 12.0), &why.to_string());
                }
            }
            Drag::None | Drag::Nodes { .. } => {}
        }
    }
}

/// Draws a short message beside the pointer.
fn show_hint(painter: &Painter, at: Pos2, caption: &str) {
    let font = FontId::new(12.0, FontFamily::Proportional);
    let galley = painter.layout(caption.to_owned(), font, theme::text(), 280.0);
    let rect = Rect::from_min_size(at, galley.size() + vec2(16.0, 12.0));
    painter.rect(rect, 4.0, theme::panel(), Stroke::new(1.0, theme::fault()), StrokeKind::Inside);
    painter.galley(rect.min + vec2(8.0, 6.0), galley, theme::text());
}
