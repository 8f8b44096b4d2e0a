//! Points and rectangles of a picture, picked on it: a click adds one, a drag moves it, arrow keys move what has the focus.

use eframe::egui::{
    Align2, Button, Color32, EventFilter, FontId, Id, Key, Modifiers, Pos2, Rect, RichText, Sense, Stroke, StrokeKind,
    Ui, UiBuilder, Vec2, WidgetInfo, WidgetType, vec2,
};
use panoscope_graph::Pick;

use panoscope_editor_model::document::{Document, View};
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::picture::is_pictorial;
use panoscope_editor_widgets::ARROWS;
use panoscope_editor_widgets::theme;

/// How near the pointer must come to a handle, points.
const REACH: f32 = 14.0;
/// A drag shorter than this is no rectangle, px.
const LEAST_PX: f64 = 2.0;

/// A parameter being picked.
#[derive(Clone, Debug)]
pub struct Picker {
    /// The node.
    pub node: String,
    /// Its parameter.
    pub param: String,
    kind: Pick,
    /// Most numbers of the list.
    most: usize,
    /// The picture is what the node itself makes of the first rectangle: it is cut already.
    cut: bool,
    /// Where a new rectangle was begun, in px.
    begun: Option<[f64; 2]>,
    /// Point or rectangle that was touched last.
    touched: usize,
    /// The handle that was added is to have the focus.
    focus: Option<usize>,
}

/// What was asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum Wish {
    /// New values.
    Set(Vec<f64>),
    /// No more picking.
    Done,
}

/// The picture that a node's points lie in: the first one it reads; of a source, the first one it makes. Answers whether it is the node's own.
pub fn picture_of(view: &View, node: usize) -> Option<(Output, String, bool)> {
    let node_type = view.nodes[node].node_type.as_ref()?;
    let read = node_type.inputs.iter().filter(|p| is_pictorial(&p.packet.name)).find_map(|p| {
        let wire = view.wires_into(node, &p.name).next()?;
        let packet = view.packet(wire.from, &wire.output)?.name.clone();
        Some((Output::new(view.nodes[wire.from].id(), &wire.output), packet, false))
    });
    let made = || {
        let port = node_type.outputs.iter().find(|p| is_pictorial(&p.packet.name))?;
        Some((Output::new(view.nodes[node].id(), &port.name), port.packet.name.clone(), true))
    };
    read.or_else(|| made().filter(|_| node_type.source))
}

/// A list of numbers as the file writes it: whole ones without a point.
pub fn to_toml(values: &[f64]) -> toml::Value {
    let number = |v: &f64| match v.fract() == 0.0 && v.abs() < 1e15 {
        true => toml::Value::Integer(*v as i64),
        false => toml::Value::Float(*v),
    };
    values.iter().map(number).collect::<Vec<_>>().into()
}

impl Picker {
    /// Picks a parameter; `None` where it holds neither points nor rectangles, or its node sees no picture. Answers the picture, too.
    pub fn of(document: &Document, node: &str, param: &str) -> Option<(Self, Output)> {
        let view = document.view();
        let at = view.node(node)?;
        let node_type = view.nodes[at].node_type.as_ref()?;
        let declared = node_type.params.iter().find(|p| p.name == param)?;
        if declared.pick.stride() == 0 {
            return None;
        }
        let most = match &declared.kind {
            panoscope_graph::ParamKind::Floats { max_len, .. } => max_len.unwrap_or(usize::MAX),
            _ => return None,
        };
        let (output, _, own) = picture_of(view, at)?;
        let picker = Self {
            node: node.to_owned(),
            param: param.to_owned(),
            kind: declared.pick,
            most,
            cut: own && declared.pick == Pick::Rectangles,
            begun: None,
            touched: 0,
            focus: None,
        };
        Some((picker, output))
    }

    /// The values as the text has them, or the default's.
    pub fn values(&self, document: &Document) -> Option<Vec<f64>> {
        let view = document.view();
        let node = &view.nodes[view.node(&self.node)?];
        let declared = node.node_type.as_ref()?.params.iter().find(|p| p.name == self.param)?;
        let given = node.outline.params.get(&self.param).cloned();
        let given = given.unwrap_or_else(|| panoscope_editor_model::document::default_value(&declared.kind));
        let mut numbers = Vec::new();
        let mut open: Vec<toml::Value> = vec![given];
        while let Some(value) = open.pop() {
            match value {
                toml::Value::Array(list) => open.extend(list.into_iter().rev()),
                other => numbers.extend(other.as_float().or(other.as_integer().map(|i| i as f64))),
            }
        }
        Some(numbers)
    }

    fn may_add(&self, values: &[f64]) -> bool {
        values.len() / self.kind.stride() < self.most / self.kind.stride()
    }

    /// Draws the handles over the picture, which shows `size_px` in `inner`, and the bar in `bar`; answers what was asked for.
    pub fn show(&mut self, ui: &mut Ui, inner: Rect, bar: Rect, size_px: Vec2, values: &[f64]) -> Option<Wish> {
        let stride = self.kind.stride();
        let whole = values.len() / stride * stride;
        let mut new = values[..whole].to_vec();
        // What a cut picture shows begins where the rectangle does.
        let origin = match (self.cut, values) {
            (true, [x, y, ..]) => [*x, *y],
            _ => [0.0; 2],
        };
        let scale = inner.width() / size_px.x.max(1.0);
        let place = Place { inner, scale, origin, size_px };
        let ground = ui.interact(inner, Id::new("pick"), Sense::click_and_drag());
        let words = format!("Pick {}.{} here", self.node, self.param);
        ground.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, words.clone()));
        if self.kind == Pick::Points {
            if ground.clicked()
                && let Some(at) = ground.interact_pointer_pos()
                && self.may_add(&new)
            {
                new.extend(place.px(at));
                self.touched = new.len() / 2 - 1;
            }
        } else {
            self.draw_rectangle(ui, &ground, &place, &mut new);
        }
        for index in 0..new.len() / stride {
            if self.cut && index > 0 {
                break;
            }
            match self.kind {
                Pick::Points => self.point(ui, &place, &mut new, index),
                _ => self.rectangle(ui, &place, &mut new, index),
            }
        }
        let done = self.bar(ui, bar, &place, &mut new);
        if !ui.ctx().text_edit_focused() && ui.input_mut(|i| i.consume_key(Modifiers::NONE, Key::Delete)) {
            self.remove(&mut new);
        }
        if done {
            return Some(Wish::Done);
        }
        (new != values).then_some(Wish::Set(new))
    }

    fn remove(&mut self, values: &mut Vec<f64>) {
        let stride = self.kind.stride();
        let from = self.touched.min((values.len() / stride).saturating_sub(1)) * stride;
        if from + stride <= values.len() {
            values.drain(from..from + stride);
            self.touched = self.touched.saturating_sub(1);
        }
    }

    /// A drag over free ground makes a rectangle.
    fn draw_rectangle(&mut self, ui: &Ui, ground: &eframe::egui::Response, place: &Place, values: &mut Vec<f64>) {
        let pointer = ground.interact_pointer_pos();
        if ground.drag_started() {
            self.begun = ui.input(|i| i.pointer.press_origin()).map(|at| place.px(at));
        }
        let Some([x0, y0]) = self.begun else { return };
        let Some([x1, y1]) = pointer.map(|at| place.px(at)) else { return };
        let new = [x0.min(x1), y0.min(y1), (x1 - x0).abs(), (y1 - y0).abs()];
        if ground.dragged() {
            let rect = Rect::from_two_pos(place.at([x0, y0]), place.at([x1, y1]));
            let stroke = Stroke::new(1.5, theme::ACCENT);
            ui.painter().rect(rect, 0.0, theme::ACCENT.gamma_multiply(0.12), stroke, StrokeKind::Inside);
        }
        if ground.drag_stopped() {
            self.begun = None;
            if new[2] < LEAST_PX || new[3] < LEAST_PX {
                return;
            }
            if self.cut && values.len() >= 4 {
                values[..4].copy_from_slice(&new);
            } else if self.may_add(values) {
                values.extend(new);
            } else if let Some(last) = values.len().checked_sub(4) {
                values[last..].copy_from_slice(&new);
            }
            self.touched = (values.len() / 4).saturating_sub(1);
        }
    }

    /// One handle at a place; answers by how many px it was moved.
    fn handle(&mut self, ui: &mut Ui, place: &Place, at: Pos2, index: usize, part: &str) -> [f64; 2] {
        let id = Id::new(("pick", index, part.to_owned()));
        let grip = ui.interact(Rect::from_center_size(at, Vec2::splat(2.0 * REACH)), id, Sense::click_and_drag());
        let thing = if self.kind == Pick::Points { "Point" } else { "Rectangle" };
        let words = format!("{thing} {}{part} of {}.{}", index + 1, self.node, self.param);
        grip.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, words.clone()));
        if self.focus == Some(index) {
            self.focus = None;
            grip.request_focus();
        }
        if grip.clicked() || grip.drag_started() {
            grip.request_focus();
        }
        let mut by = [0.0; 2];
        if grip.dragged()
            && let Some(pointer) = grip.interact_pointer_pos()
        {
            let ([x0, y0], [x1, y1]) = (place.px(at), place.px(pointer));
            by = [x1 - x0, y1 - y0];
        }
        if grip.has_focus() {
            self.touched = index;
            let arrows = EventFilter { horizontal_arrows: true, vertical_arrows: true, ..EventFilter::default() };
            ui.memory_mut(|m| m.set_focus_lock_filter(id, arrows));
            for (key, way) in ARROWS {
                let [dx, dy] = way.map(f64::from);
                for (modifiers, step) in [(Modifiers::SHIFT, 10.0), (Modifiers::NONE, 1.0)] {
                    let count = ui.input_mut(|i| i.count_and_consume_key(modifiers, key)) as f64;
                    by = [by[0] + dx * step * count, by[1] + dy * step * count];
                }
            }
        }
        let color = if grip.has_focus() || grip.hovered() { theme::ACCENT } else { Color32::WHITE };
        let radius = if self.kind == Pick::Points { 7.0 } else { 5.0 };
        ui.painter().circle_stroke(at, radius, Stroke::new(4.0, Color32::from_black_alpha(170)));
        ui.painter().circle_stroke(at, radius, Stroke::new(2.0, color));
        ui.painter().circle_filled(at, 1.5, color);
        by
    }

    fn point(&mut self, ui: &mut Ui, place: &Place, values: &mut [f64], index: usize) {
        let value = [values[2 * index], values[2 * index + 1]];
        let at = place.at(value);
        let by = self.handle(ui, place, at, index, "");
        let moved = place.inside([value[0] + by[0], value[1] + by[1]]);
        if by != [0.0; 2] {
            values[2 * index..2 * index + 2].copy_from_slice(&moved);
        }
        let font = FontId::proportional(13.0);
        let words = format!("{}", index + 1);
        ui.painter().text(at + vec2(11.0, -9.0), Align2::LEFT_BOTTOM, &words, font.clone(), Color32::BLACK);
        ui.painter().text(at + vec2(10.0, -10.0), Align2::LEFT_BOTTOM, &words, font, Color32::WHITE);
    }

    fn rectangle(&mut self, ui: &mut Ui, place: &Place, values: &mut [f64], index: usize) {
        let [x, y, mut w, mut h] = [0, 1, 2, 3].map(|k| values[4 * index + k]);
        // 0 reaches to the edge.
        let end = [place.origin[0] + f64::from(place.size_px.x), place.origin[1] + f64::from(place.size_px.y)];
        if w <= 0.0 {
            w = end[0] - x;
        }
        if h <= 0.0 {
            h = end[1] - y;
        }
        let rect = Rect::from_two_pos(place.at([x, y]), place.at([x + w, y + h]));
        ui.painter().rect_stroke(rect, 0.0, Stroke::new(3.5, Color32::from_black_alpha(150)), StrokeKind::Middle);
        ui.painter().rect_stroke(rect, 0.0, Stroke::new(1.5, theme::ACCENT), StrokeKind::Middle);
        let first = self.handle(ui, place, rect.min, index, " corner 1");
        let second = self.handle(ui, place, rect.max, index, " corner 2");
        let middle = self.handle(ui, place, rect.center(), index, "");
        if [first, second, middle].iter().all(|by| *by == [0.0; 2]) {
            return;
        }
        let (mut from, mut to) = ([x, y], [x + w, y + h]);
        for axis in 0..2 {
            from[axis] += first[axis] + middle[axis];
            to[axis] += second[axis] + middle[axis];
        }
        let (from, to) = (place.inside(from), place.inside_end(to));
        let new = [from[0].min(to[0]), from[1].min(to[1]), (to[0] - from[0]).abs(), (to[1] - from[1]).abs()];
        if new[2] >= 1.0 && new[3] >= 1.0 {
            values[4 * index..4 * index + 4].copy_from_slice(&new);
        }
    }

    /// What can be done, in words and by buttons; answers whether it is over.
    fn bar(&mut self, ui: &mut Ui, bar: Rect, place: &Place, values: &mut Vec<f64>) -> bool {
        let mut done = false;
        ui.scope_builder(UiBuilder::new().max_rect(bar), |ui| {
            ui.horizontal(|ui| {
                let points = self.kind == Pick::Points;
                ui.label(RichText::new(format!("{}.{}", self.node, self.param)).color(theme::ACCENT));
                let thing = if points { "point" } else { "rectangle" };
                let add = ui.add_enabled(self.may_add(values), Button::new(format!("Add a {thing}")));
                if add.on_hover_text("In the middle of the picture; arrow keys move it, with Shift by ten").clicked() {
                    let [x, y] = place.px(place.inner.center());
                    let (w, h) = (f64::from(place.size_px.x), f64::from(place.size_px.y));
                    match points {
                        true => values.extend([x, y]),
                        false => values.extend([
                            (x - w / 4.0).round(),
                            (y - h / 4.0).round(),
                            (w / 2.0).round(),
                            (h / 2.0).round(),
                        ]),
                    }
                    self.touched = values.len() / self.kind.stride() - 1;
                    self.focus = Some(self.touched);
                }
                if ui
                    .add_enabled(!values.is_empty(), Button::new("Remove"))
                    .on_hover_text("The one touched last (Delete)")
                    .clicked()
                {
                    self.remove(values);
                }
                if ui.add_enabled(!values.is_empty(), Button::new("Clear")).clicked() {
                    values.clear();
                }
                done = ui.button("Done").on_hover_text("Escape").clicked();
                let hint = if points { "click to add, drag to move" } else { "drag to draw, handles to change" };
                ui.label(RichText::new(hint).color(theme::MUTED));
            });
        });
        done
    }
}

/// Where pixels of the picture stand in the window.
struct Place {
    inner: Rect,
    /// Points per px.
    scale: f32,
    /// Pixel at the upper left, in the parameter's own numbers.
    origin: [f64; 2],
    size_px: Vec2,
}

impl Place {
    fn at(&self, [x, y]: [f64; 2]) -> Pos2 {
        let [ox, oy] = self.origin;
        self.inner.min + vec2((x - ox) as f32, (y - oy) as f32) * self.scale
    }

    /// The whole px under a place, inside the picture.
    fn px(&self, at: Pos2) -> [f64; 2] {
        let by = (at - self.inner.min) / self.scale.max(1e-6);
        self.inside([f64::from(by.x) + self.origin[0], f64::from(by.y) + self.origin[1]])
    }

    fn inside(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let within = |v: f64, from: f64, len: f32| v.round().clamp(from, from + f64::from(len - 1.0).max(0.0));
        [within(x, self.origin[0], self.size_px.x), within(y, self.origin[1], self.size_px.y)]
    }

    /// As [`Self::inside`], for an end that may lie on the far edge.
    fn inside_end(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let within = |v: f64, from: f64, len: f32| v.round().clamp(from, from + f64::from(len));
        [within(x, self.origin[0], self.size_px.x), within(y, self.origin[1], self.size_px.y)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use eframe::egui::pos2;

    #[test]
    fn pixels_and_places_are_the_same_there_and_back() {
        let inner = Rect::from_min_size(pos2(100.0, 50.0), vec2(640.0, 480.0));
        let place = Place { inner, scale: 2.0, origin: [10.0, 20.0], size_px: vec2(320.0, 240.0) };
        for px in [[10.0, 20.0], [15.0, 100.0], [329.0, 259.0]] {
            assert_eq!(place.px(place.at(px)), px);
        }
        assert_eq!(place.px(pos2(0.0, 9999.0)), [10.0, 259.0], "outside it is the edge");
    }

    #[test]
    fn lists_are_written_as_people_write_them() {
        assert_eq!(to_toml(&[1.0, -2.0, 2.5]).to_string(), "[1, -2, 2.5]");
    }
}
