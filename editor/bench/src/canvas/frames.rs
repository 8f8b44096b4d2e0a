//! Frames around the nodes of opened parts.

use eframe::egui::{
    Align2, CornerRadius, FontId, Id, Pos2, Rect, Sense, Stroke, StrokeKind, Ui, WidgetInfo, WidgetType, pos2, vec2,
};

use super::interaction::CanvasRequest;
use super::paint::MIN_TEXT;
use super::{Canvas, Scene};
use panoscope_editor_model::folding::parent;
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// Height of a frame's title, in points at zoom 1.
pub(super) const TITLE: f32 = 32.0;
/// Distance between a frame and the nodes inside.
pub(super) const ROOM: f32 = 24.0;
/// Width of the button that folds a part.
const FOLD: f32 = 56.0;

fn snapped(at: Pos2) -> Pos2 {
    pos2((at.x / 8.0).round() * 8.0, (at.y / 8.0).round() * 8.0)
}

impl Canvas {
    /// Where a position inside the level of a node counts from.
    fn origin_of(&self, id: &str) -> Pos2 {
        self.origins.get(parent(id)).copied().unwrap_or(Pos2::ZERO)
    }

    /// A point of the graph as the file stores it for a node: from the corner of the part that the node is in.
    pub fn stored(&self, id: &str, at: Pos2) -> (f32, f32) {
        let at = at - self.origin_of(id);
        (at.x, at.y)
    }

    /// The innermost opened part at a point of the graph; empty where there is none.
    pub fn part_at(&self, at: Pos2) -> String {
        let around = self.frames.iter().filter(|(_, rect)| rect.contains(at));
        around.max_by_key(|(id, _)| id.len()).map(|(id, _)| id.clone()).unwrap_or_default()
    }

    /// Draws the frames and handles input on their titles. Frames of parts inside a part are drawn on top of its frame.
    pub(super) fn show_frames(&mut self, ui: &mut Ui, scene: &Scene<'_>, requests: &mut Vec<CanvasRequest>) {
        let mut opened: Vec<usize> = (0..scene.view.parts.len()).filter(|p| scene.view.parts[*p].open).collect();
        opened.sort_by_key(|p| scene.view.parts[*p].id.len());
        for part in opened {
            self.show_frame(ui, scene, part, requests);
        }
    }

    fn show_frame(&mut self, ui: &mut Ui, scene: &Scene<'_>, part: usize, requests: &mut Vec<CanvasRequest>) {
        let part = &scene.view.parts[part];
        let Some(rect) = self.frames.get(&part.id).copied() else { return };
        let (transform, scale) = (self.transform(), self.scale());
        let rect = transform * rect;
        if !rect.expand(8.0).intersects(self.rect) {
            return;
        }
        let title = Rect::from_min_size(rect.min, vec2(rect.width(), TITLE * scale));
        let body = ui.interact(title, Id::new(("part", &part.id)), Sense::click_and_drag());
        let selected = self.selected.contains(&part.id);
        body.widget_info(|| {
            let label = text!("canvas-part", part = &part.id);
            WidgetInfo::selected(WidgetType::SelectableLabel, true, selected, label)
        });
        let edge = if selected { theme::accent() } else { theme::family("part").gamma_multiply(0.8) };
        let radius = CornerRadius::same((10.0 * scale).clamp(2.0, 12.0) as u8);
        let painter = ui.painter();
        let fill = theme::family("part").gamma_multiply(0.07);
        painter.rect(rect, radius, fill, Stroke::new(1.5, edge), StrokeKind::Inside);
        let font = |size: f32| FontId::proportional((size * scale).max(MIN_TEXT));
        let middle = title.left_center() + vec2(12.0 * scale, 0.0);
        let name = painter.text(middle, Align2::LEFT_CENTER, &part.id, font(15.0), theme::text());
        let users = match part.users.len() {
            0 | 1 => String::new(),
            count => format!("  ·  {}", text!("part-users", count = count)),
        };
        let room = rect.right() - name.right() - (FOLD + 24.0) * scale;
        let caption = painter.layout_no_wrap(format!("{}{users}", part.file), font(11.5), theme::muted());
        if caption.size().x < room {
            let at = pos2(name.right() + 12.0 * scale, title.center().y - caption.size().y / 2.0);
            painter.galley(at, caption, theme::muted());
        }
        let button = Rect::from_min_max(pos2(title.right() - FOLD * scale, title.top()), title.max);
        let fold = ui.interact(button, Id::new(("fold part", &part.id)), Sense::click());
        fold.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, text!("canvas-fold.name", part = &part.id)));
        let color = if fold.hovered() { theme::text() } else { theme::accent() };
        ui.painter().text(button.center(), Align2::CENTER_CENTER, text!("canvas-fold"), font(11.5), color);
        if fold.clicked() || body.double_clicked() {
            requests.push(CanvasRequest::Open { part: part.id.clone(), open: false });
        }
        if body.clicked() || body.drag_started() {
            self.select_only(&part.id);
        }
        if body.dragged() {
            self.fit = false;
            self.move_part(&part.id, body.drag_delta() / scale);
        }
        if body.drag_stopped()
            && let Some(rect) = self.frames.get(&part.id)
        {
            requests.push(CanvasRequest::Move(vec![(part.id.clone(), snapped(rect.min))]));
        }
    }

    /// Moves a frame with everything inside.
    pub(super) fn move_part(&mut self, part: &str, by: eframe::egui::Vec2) {
        let within = |id: &str| id.strip_prefix(part).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'));
        let positions = self.positions.iter_mut().filter(|(id, _)| within(id)).map(|(_, at)| at);
        let origins = self.origins.iter_mut().filter(|(id, _)| within(id)).map(|(_, at)| at);
        positions.chain(origins).for_each(|at| *at += by);
        self.frames.iter_mut().filter(|(id, _)| within(id)).for_each(|(_, rect)| *rect = rect.translate(by));
    }
}
