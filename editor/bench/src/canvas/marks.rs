//! Frames around nodes, and notes: drawn behind the graph, moved and edited by the user, stored in `[editor]`.

use eframe::egui::{
    Align2, CornerRadius, FontId, Id, Key, Pos2, Rect, Sense, Stroke, StrokeKind, TextEdit, Ui, UiBuilder, Vec2,
    WidgetInfo, WidgetType, pos2, vec2,
};

use super::interaction::CanvasRequest;
use super::paint::MIN_TEXT;
use super::{Canvas, Scene};
use panoscope_editor_model::Mark;
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// Height of a frame's title, in points at zoom 1.
const TITLE: f32 = 28.0;
/// Distance between a frame and the nodes inside when it is created.
const ROOM: f32 = 24.0;
/// Size of the corner for resizing a frame.
const CORNER: f32 = 18.0;
/// Width of a note.
const NOTE: f32 = 220.0;

fn rect_of(mark: &Mark) -> Rect {
    let (w, h) = mark.size.unwrap_or((NOTE, 40.0));
    Rect::from_min_size(pos2(mark.at.0, mark.at.1), vec2(w, h))
}

fn name_of(mark: &Mark) -> String {
    match mark.size {
        Some(_) => text!("canvas-frame.name", text = &mark.text),
        None => text!("canvas-note.name", text = &mark.text),
    }
}

/// The user's current manipulation of a mark.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) enum MarkEdit {
    #[default]
    None,
    /// It is moved, with the nodes inside.
    Move { mark: usize, nodes: Vec<String> },
    /// It is resized.
    Size { mark: usize },
    /// Its text is edited.
    Text { mark: usize, begun: bool },
}

fn on_grid(v: f32) -> f32 {
    (v / 8.0).round() * 8.0
}

impl Canvas {
    /// Index of the selected mark.
    pub fn selected_mark(&self) -> Option<usize> {
        self.selected_mark.filter(|m| *m < self.marks.len())
    }

    /// Adds a frame around the selected nodes, or in the middle of the view, and starts editing its title. Returns all marks.
    pub fn frame_selection(&mut self) -> Vec<Mark> {
        let nodes = self.ids.iter().zip(&self.shapes).filter(|(id, _)| self.selected.contains(*id));
        let rects = nodes.filter_map(|(id, shape)| Some(Rect::from_min_size(*self.positions.get(id)?, shape.size)));
        let around =
            rects.reduce(|a, b| a.union(b)).unwrap_or(Rect::from_center_size(self.middle(), vec2(400.0, 240.0)));
        let rect = Rect::from_min_max(around.min - vec2(ROOM, ROOM + TITLE), around.max + vec2(ROOM, ROOM));
        let size = Some((on_grid(rect.width()), on_grid(rect.height())));
        self.add_mark(Mark {
            text: text!("canvas-frame").to_owned(),
            at: (on_grid(rect.left()), on_grid(rect.top())),
            size,
        })
    }

    /// Adds a note in the middle of the view and starts editing it. Returns all marks.
    pub fn add_note(&mut self) -> Vec<Mark> {
        let at = self.middle();
        self.add_mark(Mark { text: text!("canvas-note").to_owned(), at: (at.x, at.y), size: None })
    }

    fn add_mark(&mut self, mark: Mark) -> Vec<Mark> {
        self.marks.push(mark);
        self.mark_edit = MarkEdit::Text { mark: self.marks.len() - 1, begun: false };
        self.marks.clone()
    }

    /// Removes the selected mark and returns the others; `None` when no mark is selected.
    pub fn without_selected_mark(&mut self) -> Option<Vec<Mark>> {
        let mark = self.selected_mark()?;
        self.selected_mark = None;
        self.marks.remove(mark);
        Some(self.marks.clone())
    }

    /// New positions of the selected nodes, aligned in a row or, if they are spread more vertically, in a column.
    pub fn aligned(&self) -> Vec<(String, (f32, f32))> {
        let nodes: Vec<(&String, Pos2)> =
            self.selected.iter().filter_map(|id| Some((id, *self.positions.get(id)?))).collect();
        let span = |axis: fn(&Pos2) -> f32| {
            let values = nodes.iter().map(|(_, p)| axis(p));
            values.clone().fold(f32::MIN, f32::max) - values.fold(f32::MAX, f32::min)
        };
        let mean = |axis: fn(&Pos2) -> f32| {
            on_grid(nodes.iter().map(|(_, p)| axis(p)).sum::<f32>() / nodes.len().max(1) as f32)
        };
        // Spread more horizontally: a row, else a column.
        let (wide, x, y) = (span(|p| p.x) > span(|p| p.y), mean(|p| p.x), mean(|p| p.y));
        nodes.iter().map(|(id, p)| ((*id).clone(), if wide { (p.x, y) } else { (x, p.y) })).collect()
    }

    /// New positions of the selected nodes, each moved by `by`.
    pub fn nudged(&self, by: Vec2) -> Vec<(String, (f32, f32))> {
        let positions = self.selected.iter().filter_map(|id| Some((id.clone(), *self.positions.get(id)? + by)));
        positions.map(|(id, at)| (id, (at.x, at.y))).collect()
    }

    /// Draws the marks and handles input on them.
    pub(super) fn show_marks(&mut self, ui: &mut Ui, scene: &Scene<'_>, requests: &mut Vec<CanvasRequest>) {
        for mark in 0..self.marks.len() {
            self.show_mark(ui, scene, mark, requests);
        }
    }

    fn show_mark(&mut self, ui: &mut Ui, scene: &Scene<'_>, mark: usize, requests: &mut Vec<CanvasRequest>) {
        let this = self.marks[mark].clone();
        let (transform, scale) = (self.transform(), self.scale());
        let framed = this.size.is_some();
        let mut rect = transform * rect_of(&this);
        let font = FontId::proportional((if framed { 16.0 } else { 13.0 } * scale).max(MIN_TEXT));
        let color = theme::text().gamma_multiply(if framed { 0.75 } else { 0.95 });
        let galley = ui.painter().layout(this.text.clone(), font, color, (rect.width() - 16.0 * scale).max(20.0));
        if !framed {
            rect.max.y = rect.min.y + galley.size().y + 16.0 * scale;
        }
        if !rect.expand(8.0).intersects(self.rect) {
            return;
        }
        let handle = if framed { Rect::from_min_size(rect.min, vec2(rect.width(), TITLE * scale)) } else { rect };
        let body = ui.interact(handle, Id::new(("mark", mark)), Sense::click_and_drag());
        let selected = self.selected_mark == Some(mark);
        body.widget_info(|| WidgetInfo::selected(WidgetType::SelectableLabel, true, selected, name_of(&this)));
        let edge = if selected { theme::accent() } else { theme::line() };
        let painter = ui.painter();
        let radius = CornerRadius::same((10.0 * scale).clamp(2.0, 12.0) as u8);
        let fill =
            if framed { theme::panel().gamma_multiply(0.6) } else { theme::family("overlay").gamma_multiply(0.10) };
        painter.rect(rect, radius, fill, Stroke::new(1.0, edge), StrokeKind::Inside);
        let typing = matches!(self.mark_edit, MarkEdit::Text { mark: m, .. } if m == mark);
        if !typing {
            painter.galley(rect.min + vec2(8.0, 6.0) * scale, galley, color);
        }
        if body.clicked() || body.drag_started() {
            self.selected_mark = Some(mark);
            self.selected.clear();
            self.selected_wire = None;
        }
        if body.drag_started() {
            let nodes = if framed { self.nodes_inside(scene, rect_of(&this)) } else { Vec::new() };
            self.mark_edit = MarkEdit::Move { mark, nodes };
        }
        if body.double_clicked() {
            self.mark_edit = MarkEdit::Text { mark, begun: false };
        }
        if framed {
            let corner = Rect::from_min_max(rect.max - Vec2::splat(CORNER * scale), rect.max);
            let pull = ui.interact(corner, Id::new(("mark corner", mark)), Sense::drag());
            pull.widget_info(|| {
                WidgetInfo::labeled(WidgetType::Other, true, text!("canvas-frame.size", text = &this.text))
            });
            if pull.hovered() || pull.dragged() {
                let at = Align2::RIGHT_BOTTOM;
                ui.painter().text(rect.max - vec2(4.0, 2.0), at, "◢", FontId::proportional(12.0), theme::muted());
            }
            if pull.drag_started() {
                self.mark_edit = MarkEdit::Size { mark };
            }
            if pull.dragged()
                && let Some((w, h)) = &mut self.marks[mark].size
            {
                let by = pull.drag_delta() / scale;
                (*w, *h) = ((*w + by.x).max(80.0), (*h + by.y).max(60.0));
            }
            if pull.drag_stopped() {
                self.finish_mark_edit(mark, requests);
            }
        }
        if body.dragged() {
            self.drag_mark(mark, body.drag_delta() / scale);
        }
        if body.drag_stopped() {
            self.finish_mark_edit(mark, requests);
        }
        if let MarkEdit::Text { mark: m, begun } = self.mark_edit.clone()
            && m == mark
        {
            self.type_mark(ui, mark, handle, begun, requests);
        }
    }

    fn nodes_inside(&self, scene: &Scene<'_>, frame: Rect) -> Vec<String> {
        let inside = |n: &usize| {
            let id = scene.view.nodes[*n].id();
            let position = self.positions.get(id).copied().unwrap_or_default();
            frame.contains_rect(Rect::from_min_size(position, self.shapes[*n].size))
        };
        (0..scene.view.nodes.len()).filter(inside).map(|n| scene.view.nodes[n].id().to_owned()).collect()
    }

    fn drag_mark(&mut self, mark: usize, by: Vec2) {
        let MarkEdit::Move { nodes, .. } = &self.mark_edit else { return };
        let (x, y) = self.marks[mark].at;
        self.marks[mark].at = (x + by.x, y + by.y);
        self.fit = false;
        for id in nodes {
            if let Some(position) = self.positions.get_mut(id) {
                *position += by;
            }
        }
    }

    /// Ends a move or resize: snaps the mark to the grid and requests the change.
    fn finish_mark_edit(&mut self, mark: usize, requests: &mut Vec<CanvasRequest>) {
        let mark_edit = std::mem::take(&mut self.mark_edit);
        let (x, y) = self.marks[mark].at;
        let shift = vec2(on_grid(x) - x, on_grid(y) - y);
        self.marks[mark].at = (on_grid(x), on_grid(y));
        if let Some((w, h)) = &mut self.marks[mark].size {
            (*w, *h) = (on_grid(*w), on_grid(*h));
        }
        let nodes = if let MarkEdit::Move { nodes, .. } = mark_edit { nodes } else { Vec::new() };
        let moved = nodes.into_iter().filter_map(|id| {
            let at = *self.positions.get(&id)? + shift;
            Some((id, at))
        });
        requests.push(CanvasRequest::Marks { marks: self.marks.clone(), moved: moved.collect() });
    }

    fn type_mark(&mut self, ui: &mut Ui, mark: usize, rect: Rect, begun: bool, requests: &mut Vec<CanvasRequest>) {
        let framed = self.marks[mark].size.is_some();
        let mut text = self.marks[mark].text.clone();
        let scope = ui.scope_builder(UiBuilder::new().max_rect(rect.shrink(2.0)), |ui| {
            let edit = if framed { TextEdit::singleline(&mut text) } else { TextEdit::multiline(&mut text) };
            ui.add(edit.id(Id::new(("mark text", mark))).desired_width(rect.width().max(120.0)))
        });
        let response = scope.inner;
        ui.ctx().accesskit_node_builder(response.id, |n| n.set_label(text!("canvas-mark-text")));
        if !begun {
            response.request_focus();
            self.mark_edit = MarkEdit::Text { mark, begun: true };
        }
        self.marks[mark].text = text;
        let left = response.lost_focus() || ui.input(|i| i.key_pressed(Key::Escape));
        if begun && left {
            self.mark_edit = MarkEdit::None;
            requests.push(CanvasRequest::Marks { marks: self.marks.clone(), moved: Vec::new() });
        }
    }
}
