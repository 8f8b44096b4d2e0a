//! Titled frames around nodes, and notes: drawn behind the graph, moved and named by hand. They stand in `[editor]`.

use eframe::egui::{
    Align2, CornerRadius, FontId, Id, Key, Pos2, Rect, Sense, Stroke, StrokeKind, TextEdit, Ui, UiBuilder, Vec2,
    WidgetInfo, WidgetType, pos2, vec2,
};

use super::touch::Ask;
use super::{Canvas, Scene};
use panoscope_editor_model::Mark;
use panoscope_editor_widgets::theme;

/// Height of a frame's title.
const TITLE: f32 = 28.0;
/// Room between a frame and the nodes that it is made around.
const ROOM: f32 = 24.0;
/// Side of the corner that a frame is resized at.
const CORNER: f32 = 18.0;
/// Width of a note.
const NOTE: f32 = 220.0;

fn rect_of(mark: &Mark) -> Rect {
    let (w, h) = mark.size.unwrap_or((NOTE, 40.0));
    Rect::from_min_size(pos2(mark.at.0, mark.at.1), vec2(w, h))
}

fn kind_of(mark: &Mark) -> &'static str {
    if mark.size.is_some() { "Frame" } else { "Note" }
}

/// What is being done to a mark.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) enum Hand {
    #[default]
    None,
    /// It is moved, with the nodes that lay in it.
    Move { mark: usize, nodes: Vec<String> },
    /// Its corner is pulled.
    Size { mark: usize },
    /// Its text is typed.
    Text { mark: usize, begun: bool },
}

fn on_grid(v: f32) -> f32 {
    (v / 8.0).round() * 8.0
}

impl Canvas {
    /// Selected mark.
    pub fn selected_mark(&self) -> Option<usize> {
        self.selected_mark.filter(|m| *m < self.marks.len())
    }

    /// Makes a frame around the selected nodes, or in the middle of the view, and lets its title be typed.
    pub fn frame_selection(&mut self) -> Vec<Mark> {
        let nodes = self.ids.iter().zip(&self.shapes).filter(|(id, _)| self.selected.contains(*id));
        let rects = nodes.filter_map(|(id, shape)| Some(Rect::from_min_size(*self.places.get(id)?, shape.size)));
        let around =
            rects.reduce(|a, b| a.union(b)).unwrap_or(Rect::from_center_size(self.middle(), vec2(400.0, 240.0)));
        let rect = Rect::from_min_max(around.min - vec2(ROOM, ROOM + TITLE), around.max + vec2(ROOM, ROOM));
        let size = Some((on_grid(rect.width()), on_grid(rect.height())));
        self.add_mark(Mark { text: "Frame".to_owned(), at: (on_grid(rect.left()), on_grid(rect.top())), size })
    }

    /// Adds a note in the middle of the view and lets it be typed.
    pub fn add_note(&mut self) -> Vec<Mark> {
        let at = self.middle();
        self.add_mark(Mark { text: "Note".to_owned(), at: (at.x, at.y), size: None })
    }

    fn add_mark(&mut self, mark: Mark) -> Vec<Mark> {
        self.marks.push(mark);
        self.hand = Hand::Text { mark: self.marks.len() - 1, begun: false };
        self.marks.clone()
    }

    /// The marks without the selected one.
    pub fn without_selected_mark(&mut self) -> Option<Vec<Mark>> {
        let mark = self.selected_mark()?;
        self.selected_mark = None;
        self.marks.remove(mark);
        Some(self.marks.clone())
    }

    /// New places of the selected nodes with their left edges, or with fewer columns than rows their upper edges, in line.
    pub fn aligned(&self) -> Vec<(String, (f32, f32))> {
        let nodes: Vec<(&String, Pos2)> =
            self.selected.iter().filter_map(|id| Some((id, *self.places.get(id)?))).collect();
        let span = |axis: fn(&Pos2) -> f32| {
            let values = nodes.iter().map(|(_, p)| axis(p));
            values.clone().fold(f32::MIN, f32::max) - values.fold(f32::MAX, f32::min)
        };
        let mean = |axis: fn(&Pos2) -> f32| {
            on_grid(nodes.iter().map(|(_, p)| axis(p)).sum::<f32>() / nodes.len().max(1) as f32)
        };
        // What lies rather beside each other is put on one height, what lies rather above each other in one column.
        let (wide, x, y) = (span(|p| p.x) > span(|p| p.y), mean(|p| p.x), mean(|p| p.y));
        nodes.iter().map(|(id, p)| ((*id).clone(), if wide { (p.x, y) } else { (x, p.y) })).collect()
    }

    /// New places of the selected nodes, each moved by this.
    pub fn nudged(&self, by: Vec2) -> Vec<(String, (f32, f32))> {
        let places = self.selected.iter().filter_map(|id| Some((id.clone(), *self.places.get(id)? + by)));
        places.map(|(id, at)| (id, (at.x, at.y))).collect()
    }

    /// Draws the marks and lets them be touched.
    pub(super) fn show_marks(&mut self, ui: &mut Ui, scene: &Scene<'_>, asks: &mut Vec<Ask>) {
        for mark in 0..self.marks.len() {
            self.show_mark(ui, scene, mark, asks);
        }
    }

    fn show_mark(&mut self, ui: &mut Ui, scene: &Scene<'_>, mark: usize, asks: &mut Vec<Ask>) {
        let this = self.marks[mark].clone();
        let (transform, scale) = (self.transform(), self.scale());
        let framed = this.size.is_some();
        let mut rect = transform * rect_of(&this);
        let font = FontId::proportional((if framed { 16.0 } else { 13.0 } * scale).max(5.0));
        let color = theme::TEXT.gamma_multiply(if framed { 0.75 } else { 0.95 });
        let galley = ui.painter().layout(this.text.clone(), font, color, (rect.width() - 16.0 * scale).max(20.0));
        if !framed {
            rect.max.y = rect.min.y + galley.size().y + 16.0 * scale;
        }
        if !rect.expand(8.0).intersects(self.rect) {
            return;
        }
        let handle = if framed { Rect::from_min_size(rect.min, vec2(rect.width(), TITLE * scale)) } else { rect };
        let body = ui.interact(handle, Id::new(("mark", mark)), Sense::click_and_drag());
        let words = format!("{} {}", kind_of(&this), this.text);
        let selected = self.selected_mark == Some(mark);
        body.widget_info(|| WidgetInfo::selected(WidgetType::SelectableLabel, true, selected, words.clone()));
        let edge = if selected { theme::ACCENT } else { theme::LINE };
        let painter = ui.painter();
        let radius = CornerRadius::same((10.0 * scale).clamp(2.0, 12.0) as u8);
        let fill =
            if framed { theme::PANEL.gamma_multiply(0.6) } else { theme::family("overlay").gamma_multiply(0.10) };
        painter.rect(rect, radius, fill, Stroke::new(1.0, edge), StrokeKind::Inside);
        let typing = matches!(self.hand, Hand::Text { mark: m, .. } if m == mark);
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
            self.hand = Hand::Move { mark, nodes };
        }
        if body.double_clicked() {
            self.hand = Hand::Text { mark, begun: false };
        }
        if framed {
            let corner = Rect::from_min_max(rect.max - Vec2::splat(CORNER * scale), rect.max);
            let pull = ui.interact(corner, Id::new(("mark corner", mark)), Sense::drag());
            pull.widget_info(|| WidgetInfo::labeled(WidgetType::Other, true, format!("Size of {words}")));
            if pull.hovered() || pull.dragged() {
                let at = Align2::RIGHT_BOTTOM;
                ui.painter().text(rect.max - vec2(4.0, 2.0), at, "◢", FontId::proportional(12.0), theme::MUTED);
            }
            if pull.drag_started() {
                self.hand = Hand::Size { mark };
            }
            if pull.dragged()
                && let Some((w, h)) = &mut self.marks[mark].size
            {
                let by = pull.drag_delta() / scale;
                (*w, *h) = ((*w + by.x).max(80.0), (*h + by.y).max(60.0));
            }
            if pull.drag_stopped() {
                self.put_down(mark, asks);
            }
        }
        if body.dragged() {
            self.drag_mark(mark, body.drag_delta() / scale);
        }
        if body.drag_stopped() {
            self.put_down(mark, asks);
        }
        if let Hand::Text { mark: m, begun } = self.hand.clone()
            && m == mark
        {
            self.type_mark(ui, mark, handle, begun, asks);
        }
    }

    fn nodes_inside(&self, scene: &Scene<'_>, frame: Rect) -> Vec<String> {
        let inside = |n: &usize| {
            let id = scene.view.nodes[*n].id();
            let place = self.places.get(id).copied().unwrap_or_default();
            frame.contains_rect(Rect::from_min_size(place, self.shapes[*n].size))
        };
        (0..scene.view.nodes.len()).filter(inside).map(|n| scene.view.nodes[n].id().to_owned()).collect()
    }

    fn drag_mark(&mut self, mark: usize, by: Vec2) {
        let Hand::Move { nodes, .. } = &self.hand else { return };
        let (x, y) = self.marks[mark].at;
        self.marks[mark].at = (x + by.x, y + by.y);
        self.fit = false;
        for id in nodes {
            if let Some(place) = self.places.get_mut(id) {
                *place += by;
            }
        }
    }

    /// Onto the grid, and told.
    fn put_down(&mut self, mark: usize, asks: &mut Vec<Ask>) {
        let hand = std::mem::take(&mut self.hand);
        let (x, y) = self.marks[mark].at;
        let shift = vec2(on_grid(x) - x, on_grid(y) - y);
        self.marks[mark].at = (on_grid(x), on_grid(y));
        if let Some((w, h)) = &mut self.marks[mark].size {
            (*w, *h) = (on_grid(*w), on_grid(*h));
        }
        let nodes = if let Hand::Move { nodes, .. } = hand { nodes } else { Vec::new() };
        let moved = nodes.into_iter().filter_map(|id| {
            let at = *self.places.get(&id)? + shift;
            Some((id, at))
        });
        asks.push(Ask::Marks { marks: self.marks.clone(), moved: moved.collect() });
    }

    fn type_mark(&mut self, ui: &mut Ui, mark: usize, rect: Rect, begun: bool, asks: &mut Vec<Ask>) {
        let framed = self.marks[mark].size.is_some();
        let mut text = self.marks[mark].text.clone();
        let scope = ui.scope_builder(UiBuilder::new().max_rect(rect.shrink(2.0)), |ui| {
            let edit = if framed { TextEdit::singleline(&mut text) } else { TextEdit::multiline(&mut text) };
            ui.add(edit.id(Id::new(("mark text", mark))).desired_width(rect.width().max(120.0)))
        });
        let response = scope.inner;
        ui.ctx().accesskit_node_builder(response.id, |n| n.set_label("Text of the mark"));
        if !begun {
            response.request_focus();
            self.hand = Hand::Text { mark, begun: true };
        }
        self.marks[mark].text = text;
        let left = response.lost_focus() || ui.input(|i| i.key_pressed(Key::Escape));
        if begun && left {
            self.hand = Hand::None;
            asks.push(Ask::Marks { marks: self.marks.clone(), moved: Vec::new() });
        }
    }
}
