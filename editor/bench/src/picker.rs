//! Picks points and rectangles on an image: a click or drag adds one, a drag moves it, arrow keys move the focused one.

use eframe::egui::{
    Align2, Button, Color32, EventFilter, FontId, Id, Key, Modifiers, Pos2, Rect, RichText, Sense, Stroke, StrokeKind,
    Ui, UiBuilder, Vec2, WidgetInfo, WidgetType, vec2,
};
use panoscope_editor_model::texts::text;
use panoscope_graph::Pick;

use panoscope_editor_model::document::Document;
use panoscope_editor_model::graph_view::GraphView;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::picture::is_pictorial;
use panoscope_editor_widgets::ARROWS;
use panoscope_editor_widgets::theme;

/// Half the size of a handle's clickable area, points.
const REACH: f32 = 14.0;
/// Minimum size of a drawn rectangle, px.
const MIN_DRAG_PX: f64 = 2.0;

/// The state of picking one parameter.
#[derive(Clone, Debug)]
pub struct Picker {
    /// The node.
    pub node: String,
    /// Its parameter.
    pub param: String,
    kind: Pick,
    /// Maximum length of the list of numbers.
    max_len: usize,
    /// Whether the image is the node's own output, cropped to the first rectangle.
    cut: bool,
    /// First corner of a rectangle being drawn, in px.
    begun: Option<[f64; 2]>,
    /// Index of the point or rectangle that was touched last.
    touched: usize,
    /// Index of an added handle that should get the focus.
    focus: Option<usize>,
}

/// A request of the picker.
#[derive(Clone, Debug, PartialEq)]
pub enum PickerRequest {
    /// Set new values.
    Set(Vec<f64>),
    /// End picking.
    Done,
}

/// The image that a node's points refer to: the first image that it reads; for a source, the first image that it makes. Returns the output,
/// its packet type and whether it is the node's own.
pub fn picture_of(view: &GraphView, node: usize) -> Option<(Output, String, bool)> {
    let node_type = view.nodes[node].node_type.as_ref()?;
    let read = node_type.inputs.iter().filter(|p| is_pictorial(&p.packet.name)).find_map(|p| {
        let wire = view.wires_into(node, &p.name).next()?;
        let packet = view.packet(wire.from, &wire.output)?.name.clone();
        Some((view.running_output(view.nodes[wire.from].id(), &wire.output), packet, false))
    });
    let made = || {
        let port = node_type.outputs.iter().find(|p| is_pictorial(&p.packet.name))?;
        Some((Output::new(view.nodes[node].id(), &port.name), port.packet.name.clone(), true))
    };
    read.or_else(|| made().filter(|_| node_type.source))
}

/// A list of numbers as a TOML value; integers have no decimal point.
pub fn to_toml(values: &[f64]) -> toml::Value {
    let number = |v: &f64| match v.fract() == 0.0 && v.abs() < 1e15 {
        true => toml::Value::Integer(*v as i64),
        false => toml::Value::Float(*v),
    };
    values.iter().map(number).collect::<Vec<_>>().into()
}

impl Picker {
    /// Starts picking a parameter; also returns the output of the image. `None` when the parameter has no points or rectangles, or the node has
    /// no image.
    pub fn of(document: &Document, node: &str, param: &str) -> Option<(Self, Output)> {
        let view = document.view();
        let at = view.node(node)?;
        let node_type = view.nodes[at].node_type.as_ref()?;
        let declared = node_type.params.iter().find(|p| p.name == param)?;
        if declared.pick.stride() == 0 {
            return None;
        }
        let max_len = match &declared.kind {
            panoscope_graph::ParamKind::Floats { max_len, .. } => max_len.unwrap_or(usize::MAX),
            _ => return None,
        };
        let (output, _, own) = picture_of(view, at)?;
        let picker = Self {
            node: node.to_owned(),
            param: param.to_owned(),
            kind: declared.pick,
            max_len,
            cut: own && declared.pick == Pick::Rectangles,
            begun: None,
            touched: 0,
            focus: None,
        };
        Some((picker, output))
    }

    /// The parameter's values in the text, or its default.
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
        values.len() / self.kind.stride() < self.max_len / self.kind.stride()
    }

    /// Draws the handles on the image of `size_px` in `inner`, and the buttons in `bar`; returns the user's request.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        inner: Rect,
        bar: Rect,
        size_px: Vec2,
        values: &[f64],
    ) -> Option<PickerRequest> {
        let stride = self.kind.stride();
        let whole = values.len() / stride * stride;
        let mut new = values[..whole].to_vec();
        // A cropped image begins at the rectangle's corner.
        let origin = match (self.cut, values) {
            (true, [x, y, ..]) => [*x, *y],
            _ => [0.0; 2],
        };
        let scale = inner.width() / size_px.x.max(1.0);
        let map = PixelMap { inner, scale, origin, size_px };
        let ground = ui.interact(inner, Id::new("pick"), Sense::click_and_drag());
        let label = text!("pick-here", param = format!("{}.{}", self.node, self.param));
        ground.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, label.clone()));
        if self.kind == Pick::Points {
            if ground.clicked()
                && let Some(at) = ground.interact_pointer_pos()
                && self.may_add(&new)
            {
                new.extend(map.px(at));
                self.touched = new.len() / 2 - 1;
            }
        } else {
            self.draw_rectangle(ui, &ground, &map, &mut new);
        }
        for index in 0..new.len() / stride {
            if self.cut && index > 0 {
                break;
            }
            match self.kind {
                Pick::Points => self.point(ui, &map, &mut new, index),
                _ => self.rectangle(ui, &map, &mut new, index),
            }
        }
        let done = self.bar(ui, bar, &map, &mut new);
        if !ui.ctx().text_edit_focused() && ui.input_mut(|i| i.consume_key(Modifiers::NONE, Key::Delete)) {
            self.remove(&mut new);
        }
        if done {
            return Some(PickerRequest::Done);
        }
        (new != values).then_some(PickerRequest::Set(new))
    }

    fn remove(&mut self, values: &mut Vec<f64>) {
        let stride = self.kind.stride();
        let from = self.touched.min((values.len() / stride).saturating_sub(1)) * stride;
        if from + stride <= values.len() {
            values.drain(from..from + stride);
            self.touched = self.touched.saturating_sub(1);
        }
    }

    /// A drag over the image draws a rectangle.
    fn draw_rectangle(&mut self, ui: &Ui, ground: &eframe::egui::Response, map: &PixelMap, values: &mut Vec<f64>) {
        let pointer = ground.interact_pointer_pos();
        if ground.drag_started() {
            self.begun = ui.input(|i| i.pointer.press_origin()).map(|at| map.px(at));
        }
        let Some([x0, y0]) = self.begun else { return };
        let Some([x1, y1]) = pointer.map(|at| map.px(at)) else { return };
        let new = [x0.min(x1), y0.min(y1), (x1 - x0).abs(), (y1 - y0).abs()];
        if ground.dragged() {
            let rect = Rect::from_two_pos(map.at([x0, y0]), map.at([x1, y1]));
            let stroke = Stroke::new(1.5, theme::accent());
            ui.painter().rect(rect, 0.0, theme::accent().gamma_multiply(0.12), stroke, StrokeKind::Inside);
        }
        if ground.drag_stopped() {
            self.begun = None;
            if new[2] < MIN_DRAG_PX || new[3] < MIN_DRAG_PX {
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

    /// One handle at a position in the window; returns by how many px it was moved.
    fn handle(&mut self, ui: &mut Ui, map: &PixelMap, at: Pos2, index: usize, corner: Option<u8>) -> [f64; 2] {
        let id = Id::new(("pick", index, corner));
        let grip = ui.interact(Rect::from_center_size(at, Vec2::splat(2.0 * REACH)), id, Sense::click_and_drag());
        let param = format!("{}.{}", self.node, self.param);
        let label = match (self.kind, corner) {
            (Pick::Points, _) => text!("pick-point", number = index + 1, param = param),
            (_, None) => text!("pick-rectangle", number = index + 1, param = param),
            (_, Some(corner)) => text!("pick-corner", number = index + 1, corner = corner, param = param),
        };
        grip.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, label.clone()));
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
            let ([x0, y0], [x1, y1]) = (map.px(at), map.px(pointer));
            by = [x1 - x0, y1 - y0];
        }
        if grip.has_focus() {
            self.touched = index;
            let arrows = EventFilter { horizontal_arrows: true, vertical_arrows: true, ..EventFilter::default() };
            ui.memory_mut(|m| m.set_focus_lock_filter(id, arrows));
            for (key, direction) in ARROWS {
                let [dx, dy] = direction.map(f64::from);
                for (modifiers, step) in [(Modifiers::SHIFT, 10.0), (Modifiers::NONE, 1.0)] {
                    let count = ui.input_mut(|i| i.count_and_consume_key(modifiers, key)) as f64;
                    by = [by[0] + dx * step * count, by[1] + dy * step * count];
                }
            }
        }
        let color = if grip.has_focus() || grip.hovered() { theme::accent() } else { Color32::WHITE };
        let radius = if self.kind == Pick::Points { 7.0 } else { 5.0 };
        ui.painter().circle_stroke(at, radius, Stroke::new(4.0, Color32::from_black_alpha(170)));
        ui.painter().circle_stroke(at, radius, Stroke::new(2.0, color));
        ui.painter().circle_filled(at, 1.5, color);
        by
    }

    fn point(&mut self, ui: &mut Ui, map: &PixelMap, values: &mut [f64], index: usize) {
        let value = [values[2 * index], values[2 * index + 1]];
        let at = map.at(value);
        let by = self.handle(ui, map, at, index, None);
        let moved = map.inside([value[0] + by[0], value[1] + by[1]]);
        if by != [0.0; 2] {
            values[2 * index..2 * index + 2].copy_from_slice(&moved);
        }
        let font = FontId::proportional(13.0);
        let label = format!("{}", index + 1);
        ui.painter().text(at + vec2(11.0, -9.0), Align2::LEFT_BOTTOM, &label, font.clone(), Color32::BLACK);
        ui.painter().text(at + vec2(10.0, -10.0), Align2::LEFT_BOTTOM, &label, font, Color32::WHITE);
    }

    fn rectangle(&mut self, ui: &mut Ui, map: &PixelMap, values: &mut [f64], index: usize) {
        let [x, y, mut w, mut h] = [0, 1, 2, 3].map(|k| values[4 * index + k]);
        // A width or height of 0 extends to the edge.
        let end = [map.origin[0] + f64::from(map.size_px.x), map.origin[1] + f64::from(map.size_px.y)];
        if w <= 0.0 {
            w = end[0] - x;
        }
        if h <= 0.0 {
            h = end[1] - y;
        }
        let rect = Rect::from_two_pos(map.at([x, y]), map.at([x + w, y + h]));
        ui.painter().rect_stroke(rect, 0.0, Stroke::new(3.5, Color32::from_black_alpha(150)), StrokeKind::Middle);
        ui.painter().rect_stroke(rect, 0.0, Stroke::new(1.5, theme::accent()), StrokeKind::Middle);
        let first = self.handle(ui, map, rect.min, index, Some(1));
        let second = self.handle(ui, map, rect.max, index, Some(2));
        let middle = self.handle(ui, map, rect.center(), index, None);
        if [first, second, middle].iter().all(|by| *by == [0.0; 2]) {
            return;
        }
        let (mut from, mut to) = ([x, y], [x + w, y + h]);
        for axis in 0..2 {
            from[axis] += first[axis] + middle[axis];
            to[axis] += second[axis] + middle[axis];
        }
        let (from, to) = (map.inside(from), map.inside_end(to));
        let new = [from[0].min(to[0]), from[1].min(to[1]), (to[0] - from[0]).abs(), (to[1] - from[1]).abs()];
        if new[2] >= 1.0 && new[3] >= 1.0 {
            values[4 * index..4 * index + 4].copy_from_slice(&new);
        }
    }

    /// The buttons; returns whether picking is done.
    fn bar(&mut self, ui: &mut Ui, bar: Rect, map: &PixelMap, values: &mut Vec<f64>) -> bool {
        let mut done = false;
        ui.scope_builder(UiBuilder::new().max_rect(bar), |ui| {
            ui.horizontal(|ui| {
                let points = self.kind == Pick::Points;
                ui.label(RichText::new(format!("{}.{}", self.node, self.param)).color(theme::accent()));
                let caption = if points { text!("pick-add-point") } else { text!("pick-add-rectangle") };
                let add = ui.add_enabled(self.may_add(values), Button::new(caption));
                if add.on_hover_text(text!("pick-add-hint")).clicked() {
                    let [x, y] = map.px(map.inner.center());
                    let (w, h) = (f64::from(map.size_px.x), f64::from(map.size_px.y));
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
                    .add_enabled(!values.is_empty(), Button::new(text!("pick-remove")))
                    .on_hover_text(text!("pick-remove.hint"))
                    .clicked()
                {
                    self.remove(values);
                }
                if ui.add_enabled(!values.is_empty(), Button::new(text!("pick-clear"))).clicked() {
                    values.clear();
                }
                done = ui.button(text!("pick-done")).on_hover_text(text!("key-escape")).clicked();
                let hint = if points { text!("pick-points-hint") } else { text!("pick-rectangles-hint") };
                ui.label(RichText::new(hint).color(theme::muted()));
            });
        });
        done
    }
}

/// Maps the image's pixels to the window.
struct PixelMap {
    inner: Rect,
    /// Points of the window per px.
    scale: f32,
    /// Coordinates of the image's upper left pixel.
    origin: [f64; 2],
    size_px: Vec2,
}

impl PixelMap {
    fn at(&self, [x, y]: [f64; 2]) -> Pos2 {
        let [ox, oy] = self.origin;
        self.inner.min + vec2((x - ox) as f32, (y - oy) as f32) * self.scale
    }

    /// The pixel at a position in the window, inside the image.
    fn px(&self, at: Pos2) -> [f64; 2] {
        let by = (at - self.inner.min) / self.scale.max(1e-6);
        self.inside([f64::from(by.x) + self.origin[0], f64::from(by.y) + self.origin[1]])
    }

    fn inside(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let within = |v: f64, from: f64, len: f32| v.round().clamp(from, from + f64::from(len - 1.0).max(0.0));
        [within(x, self.origin[0], self.size_px.x), within(y, self.origin[1], self.size_px.y)]
    }

    /// As [`Self::inside`], for a corner that may lie on the right or lower edge.
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
        let map = PixelMap { inner, scale: 2.0, origin: [10.0, 20.0], size_px: vec2(320.0, 240.0) };
        for px in [[10.0, 20.0], [15.0, 100.0], [329.0, 259.0]] {
            assert_eq!(map.px(map.at(px)), px);
        }
        assert_eq!(map.px(pos2(0.0, 9999.0)), [10.0, 259.0], "outside it is the edge");
    }

    #[test]
    fn lists_are_written_as_people_write_them() {
        assert_eq!(to_toml(&[1.0, -2.0, 2.5]).to_string(), "[1, -2, 2.5]");
    }
}
