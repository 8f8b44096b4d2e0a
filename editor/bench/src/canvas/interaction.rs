//! Handles pointer input on the canvas.

use std::sync::Arc;

use eframe::egui::{Id, Mesh, Modifiers, Pos2, Rect, Response, Sense, Ui, Vec2, WidgetInfo, WidgetType, pos2, vec2};

use super::curve::on_curve;
use super::shape::{DETAIL, PORTS};
use super::{Canvas, Mark, Scene};
use panoscope_editor_model::graph_view::{GraphView, WireError};
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::texts::text;

/// Distance within which a dragged wire snaps to a pin, in points of the window.
const SNAP: f32 = 18.0;

/// One end of a wire.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct End {
    /// The node.
    pub node: String,
    /// The port.
    pub port: String,
    /// Whether it is an input.
    pub input: bool,
}

/// A change that the user requests on the canvas.
#[derive(Clone, Debug, PartialEq)]
pub enum CanvasRequest {
    /// Connect an output to an input, replacing its wire; `moved` is removed first.
    Wire {
        /// Producer.
        output: End,
        /// Consumer.
        input: End,
        /// The connection that the wire was dragged from: input and index.
        moved: Option<(End, usize)>,
    },
    /// Remove a wire.
    Unwire {
        /// Consumer.
        input: End,
        /// Index in a list.
        index: usize,
    },
    /// Set new positions of nodes.
    Move(Vec<(String, Pos2)>),
    /// Open a part, or fold it.
    Open {
        /// The part.
        part: String,
        /// Whether its nodes are to be shown.
        open: bool,
    },
    /// Show an output large.
    ViewLarge(Output),
    /// Add a node, connected to the end of a wire if there is one.
    Add {
        /// Position of the node.
        at: Pos2,
        /// The existing end of the wire.
        end: Option<End>,
    },
    /// Insert a node into a wire.
    Insert {
        /// The node.
        node: String,
        /// The wire: consumer, input, index in the list.
        wire: (String, String, usize),
    },
    /// Replace all frames and notes, and move nodes with them.
    Marks {
        /// All frames and notes.
        marks: Vec<Mark>,
        /// New positions of nodes.
        moved: Vec<(String, Pos2)>,
    },
    /// Show why a wire is not possible.
    Report(WireError),
}

#[derive(Clone, Debug, Default)]
pub(super) enum Drag {
    #[default]
    None,
    /// Selected nodes are moved.
    Nodes { moved: bool },
    /// A wire is dragged from a pin; `moved` when it was connected to an input before.
    Wire { from: End, moved: Option<(End, usize)> },
    /// A selection frame, from this point of the graph.
    Frame(Pos2),
}

impl Canvas {
    pub(super) fn touch_ground(
        &mut self,
        ui: &Ui,
        ground: &Response,
        scene: &Scene<'_>,
        requests: &mut Vec<CanvasRequest>,
    ) {
        let modifiers = ui.input(|i| i.modifiers);
        let to_graph = self.transform().inverse();
        if ground.hovered() {
            let scroll = ui.input(|i| i.smooth_scroll_delta().y);
            let pinch = ui.input(|i| i.zoom_delta());
            let steps = (scroll / 24.0 + pinch.log2() * 8.0).round() as i32;
            if let Some(pointer) = ui.input(|i| i.pointer.hover_pos())
                && steps != 0
            {
                self.zoom_around(pointer - self.rect.center(), steps);
            }
        }
        if ground.drag_started()
            && let Some(at) = ground.interact_pointer_pos()
            && modifiers.shift
        {
            self.drag = Drag::Frame(to_graph * at);
        }
        if ground.dragged() && matches!(self.drag, Drag::None) {
            self.pan_by(ground.drag_delta());
        }
        if ground.drag_stopped()
            && let Drag::Frame(from) = self.drag
        {
            if let Some(at) = ui.input(|i| i.pointer.latest_pos()) {
                let frame = Rect::from_two_pos(from, to_graph * at);
                self.selected = self.nodes_in(scene.view, frame).collect();
            }
            self.drag = Drag::None;
        }
        if ground.clicked() {
            let wire = ground.interact_pointer_pos().and_then(|at| self.wire_at(scene.view, at));
            if !modifiers.shift {
                self.selected.clear();
            }
            self.selected_mark = None;
            self.selected_wire = wire;
        }
        if ground.double_clicked()
            && let Some(at) = ground.interact_pointer_pos()
        {
            requests.push(CanvasRequest::Add { at: to_graph * at, end: None });
        }
    }

    fn nodes_in<'a>(&'a self, view: &'a GraphView, frame: Rect) -> impl Iterator<Item = String> + 'a {
        let touched = move |&n: &usize| {
            let position = self.positions.get(view.nodes[n].id()).copied().unwrap_or_default();
            frame.intersects(Rect::from_min_size(position, self.shapes[n].size))
        };
        (0..view.nodes.len()).filter(touched).map(|n| view.nodes[n].id().to_owned())
    }

    /// Draws a node and handles input on it.
    pub(super) fn show_node_at(
        &mut self,
        ui: &mut Ui,
        scene: &Scene<'_>,
        node: usize,
        far: &mut Mesh,
        requests: &mut Vec<CanvasRequest>,
    ) {
        let this = &scene.view.nodes[node];
        let id = this.id();
        let position = self.places[node];
        let transform = self.transform();
        let shape = Arc::clone(&self.shapes[node]);
        let rect = transform * Rect::from_min_size(position, shape.size);
        if !rect.expand(20.0).intersects(self.rect) {
            return;
        }
        let body = ui.interact(rect, Id::new(("node", id)), Sense::click_and_drag());
        body.widget_info(|| {
            let label = text!("canvas-node", node = id);
            WidgetInfo::selected(WidgetType::SelectableLabel, true, self.selected.contains(id), label)
        });
        self.paint_node(ui, scene, node, rect, body.hovered(), far);
        let modifiers = ui.input(|i| i.modifiers);
        if body.clicked() || body.drag_started() || body.gained_focus() {
            self.pick(id, modifiers, body.drag_started());
        }
        if body.drag_started() {
            self.drag = Drag::Nodes { moved: false };
        }
        if body.dragged()
            && let Drag::Nodes { moved } = &mut self.drag
        {
            let by = body.drag_delta() / transform.scaling;
            *moved |= by != Vec2::ZERO;
            self.fit = false;
            for selected in self.selected.clone() {
                self.move_part(&selected, by);
            }
        }
        if body.drag_stopped() && matches!(self.drag, Drag::Nodes { moved: true }) {
            self.finish_move(scene.view, id, requests);
        }
        if body.drag_stopped() {
            self.drag = Drag::None;
        }
        if transform.scaling >= DETAIL {
            self.touch_parts(ui, scene, node, rect, &body, requests);
        }
    }

    /// Handles input on the image, the buttons and the pins of a node, which are drawn from the scale [`DETAIL`] on.
    fn touch_parts(
        &mut self,
        ui: &mut Ui,
        scene: &Scene<'_>,
        node: usize,
        rect: Rect,
        body: &Response,
        requests: &mut Vec<CanvasRequest>,
    ) {
        let (this, position, transform) = (&scene.view.nodes[node], self.places[node], self.transform());
        let (id, shape, modifiers) = (this.id(), Arc::clone(&self.shapes[node]), ui.input(|i| i.modifiers));
        if let (Some(rect), Some((output, _))) = (self.picture_rect(node, rect), &shape.output) {
            if ui.rect_contains_pointer(rect.intersect(self.rect)) {
                self.under_pointer = Some(output.clone());
            }
            let clicked_picture =
                body.clicked() && !modifiers.any() && body.interact_pointer_pos().is_some_and(|at| rect.contains(at));
            if clicked_picture || (body.double_clicked() && !this.is_part) {
                requests.push(CanvasRequest::ViewLarge(output.clone()));
            }
        }
        if this.is_part {
            let at = Rect::from_min_size(position, vec2(super::shape::WIDTH, super::shape::HEADER));
            let header = transform * at.with_min_x(at.right() - super::shape::OPEN);
            let open = ui.interact(header, Id::new(("open part", id)), Sense::click());
            open.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, text!("canvas-open.name", node = id)));
            let on_header = body.interact_pointer_pos().is_some_and(|p| (transform * at).contains(p));
            if open.clicked() || (body.double_clicked() && on_header) {
                requests.push(CanvasRequest::Open { part: id.to_owned(), open: true });
            }
        }
        if let Some(fold) = shape.fold.filter(|_| transform.scaling >= PORTS) {
            let rect = transform * fold.translate(position.to_vec2());
            let button = ui.interact(rect, Id::new(("fold", id)), Sense::click());
            button.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, text!("canvas-all-ports", node = id)));
            if button.clicked() {
                if !self.unfolded.remove(id) {
                    self.unfolded.insert(id.to_owned());
                }
                self.laid_out = None;
            }
        }
        for pin in &shape.pins {
            let at = transform * (position + pin.at.to_vec2());
            self.touch_pin(ui, scene, node, pin, at, requests);
        }
    }

    fn pick(&mut self, id: &str, modifiers: Modifiers, dragging: bool) {
        if modifiers.shift || modifiers.command {
            if !self.selected.remove(id) || dragging {
                self.selected.insert(id.to_owned());
            }
        } else if !(dragging && self.selected.contains(id)) {
            self.select_only(id);
        }
        self.selected_wire = None;
    }

    /// Ends a move: requests the new positions. A single unconnected node that is dropped on a wire is inserted into it.
    fn finish_move(&mut self, view: &GraphView, id: &str, requests: &mut Vec<CanvasRequest>) {
        for selected in &self.selected {
            if let Some(position) = self.positions.get_mut(selected) {
                *position = pos2((position.x / 8.0).round() * 8.0, (position.y / 8.0).round() * 8.0);
            }
        }
        let positions = self.selected.iter().filter_map(|s| Some((s.clone(), *self.positions.get(s)?)));
        requests.push(CanvasRequest::Move(positions.collect()));
        let Some(node) = view.node(id).filter(|_| self.selected.len() == 1) else { return };
        let free = !view.wires.iter().any(|w| w.to == node || w.from == node);
        let middle = self.positions.get(id).copied().unwrap_or_default() + self.shapes[node].size / 2.0;
        if free && let Some(wire) = self.wire_at(view, self.transform() * middle) {
            requests.push(CanvasRequest::Insert { node: id.to_owned(), wire });
        }
    }

    fn touch_pin(
        &mut self,
        ui: &Ui,
        scene: &Scene<'_>,
        node: usize,
        pin: &super::Pin,
        at: Pos2,
        requests: &mut Vec<CanvasRequest>,
    ) {
        let id = scene.view.nodes[node].id();
        let reach = vec2(18.0, 16.0) * self.scale().clamp(0.6, 1.2);
        let response =
            ui.interact(Rect::from_center_size(at, reach), Id::new(("pin", id, &pin.name, pin.input)), Sense::drag());
        response.widget_info(|| {
            let port = format!("{id}.{}", pin.name);
            let name = match pin.input {
                true => text!("canvas-input", port = port),
                false => text!("canvas-output", port = port),
            };
            WidgetInfo::labeled(WidgetType::Other, true, name)
        });
        let end = End { node: id.to_owned(), port: pin.name.clone(), input: pin.input };
        if !pin.input && response.hovered() {
            self.under_pointer = Some(scene.view.running_output(id, &pin.name));
        }
        if response.hovered() && matches!(self.drag, Drag::None) {
            let port = if pin.input {
                scene.view.nodes[node].input(&pin.name)
            } else {
                scene.view.nodes[node].output(&pin.name)
            };
            let hint = port.map_or_else(String::new, |p| format!("{} ({})\n{}", p.name, p.packet.name, p.doc));
            response.clone().on_hover_text(hint);
        }
        if response.drag_started() {
            // Dragging from a connected input moves the end of its wire.
            let last = scene.view.wires_into(node, &pin.name).last().filter(|_| pin.input);
            self.drag = match last {
                Some(wire) => {
                    let from = End {
                        node: scene.view.nodes[wire.from].id().to_owned(),
                        port: wire.output.clone(),
                        input: false,
                    };
                    Drag::Wire { from, moved: Some((end, wire.index)) }
                }
                None => Drag::Wire { from: end, moved: None },
            };
        } else if response.drag_stopped()
            && let Drag::Wire { from, moved } = std::mem::take(&mut self.drag)
            && let Some(pointer) = ui.input(|i| i.pointer.latest_pos())
        {
            requests.extend(self.drop_wire(scene.view, from, moved, pointer));
        }
    }

    /// The pin near a point of the window that could be the other end of a wire from `from`.
    pub(super) fn pin_near(&self, view: &GraphView, from: &End, pointer: Pos2) -> Option<End> {
        let transform = self.transform();
        let mut best: Option<(f32, End)> = None;
        for (node, shape) in view.nodes.iter().zip(&self.shapes) {
            let position = self.positions.get(node.id()).copied().unwrap_or_default();
            for pin in shape.pins.iter().filter(|p| p.input != from.input) {
                let distance = (transform * (position + pin.at.to_vec2())).distance(pointer);
                if distance < SNAP && best.as_ref().is_none_or(|(d, _)| distance < *d) {
                    best =
                        Some((distance, End { node: node.id().to_owned(), port: pin.name.clone(), input: pin.input }));
                }
            }
        }
        if best.is_none() {
            return self.pin_of_body(view, from, pointer);
        }
        best.map(|(_, end)| end)
    }

    /// The first fitting pin of the node under a point of the window.
    fn pin_of_body(&self, view: &GraphView, from: &End, pointer: Pos2) -> Option<End> {
        let at = self.transform().inverse() * pointer;
        let over = |&n: &usize| {
            let position = self.positions.get(view.nodes[n].id()).copied().unwrap_or_default();
            Rect::from_min_size(position, self.shapes[n].size).contains(at) && view.nodes[n].id() != from.node
        };
        let node = (0..view.nodes.len()).rev().find(over)?;
        let id = view.nodes[node].id();
        let ends = self.shapes[node].pins.iter().filter(|p| p.input != from.input).map(|p| End {
            node: id.to_owned(),
            port: p.name.clone(),
            input: p.input,
        });
        let mut fitting: Vec<End> = ends.filter(|end| check_wire(view, from, end).is_ok()).collect();
        // Unconnected inputs first.
        fitting.sort_by_key(|end| end.input && view.wires_into(node, &end.port).next().is_some());
        fitting.into_iter().next()
    }

    fn drop_wire(
        &self,
        view: &GraphView,
        from: End,
        moved: Option<(End, usize)>,
        pointer: Pos2,
    ) -> Option<CanvasRequest> {
        match self.pin_near(view, &from, pointer) {
            Some(end) => {
                if moved.as_ref().is_some_and(|(input, _)| *input == end) {
                    return None;
                }
                if let Err(why) = check_wire(view, &from, &end) {
                    return Some(CanvasRequest::Report(why));
                }
                let (output, input) = if from.input { (end, from) } else { (from, end) };
                Some(CanvasRequest::Wire { output, input, moved })
            }
            None => match moved {
                Some((input, index)) => Some(CanvasRequest::Unwire { input, index }),
                None if self.rect.contains(pointer) => {
                    Some(CanvasRequest::Add { at: self.transform().inverse() * pointer, end: Some(from) })
                }
                None => None,
            },
        }
    }

    /// The wire at a point of the window.
    pub(super) fn wire_at(&self, view: &GraphView, at: Pos2) -> Option<(String, String, usize)> {
        let (at, most) = (self.transform().inverse() * at, 10.0 / self.scale());
        let paths = view.wires.iter().zip(&self.paths.wires).filter(|(_, path)| path.bounds.expand(most).contains(at));
        let near = paths.filter_map(|(wire, path)| {
            let points = path.curves.iter().flat_map(|c| (0..=24).map(|i| on_curve(c, i as f32 / 24.0)));
            let distance = points.map(|p| p.distance(at)).fold(f32::MAX, f32::min);
            (distance < most).then_some((distance, wire))
        });
        let (_, wire) = near.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((view.nodes[wire.to].id().to_owned(), wire.input.clone(), wire.index))
    }
}

/// Checks whether two ends may be connected.
///
/// # Errors
/// Why they may not.
pub(super) fn check_wire(view: &GraphView, a: &End, b: &End) -> Result<(), WireError> {
    let (output, input) = if a.input { (b, a) } else { (a, b) };
    let index = |end: &End| view.node(&end.node).ok_or_else(|| WireError::NoNode { node: end.node.clone() });
    view.check_wire(index(output)?, &output.port, index(input)?, &input.port)
}
