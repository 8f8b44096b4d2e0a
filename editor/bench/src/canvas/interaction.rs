//! What the pointer does on the canvas.

use eframe::egui::{Id, Modifiers, Pos2, Rect, Response, Sense, Ui, Vec2, WidgetInfo, WidgetType, pos2, vec2};

use super::paint::DETAIL;
use super::{Canvas, Mark, Scene};
use panoscope_editor_model::document::View;
use panoscope_editor_model::observe::Output;

/// Farthest from a pin at which a wire snaps to it, in points of the window.
const SNAP: f32 = 18.0;

/// One end of a wire.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct End {
    /// The node.
    pub node: String,
    /// The port.
    pub port: String,
    /// An input.
    pub input: bool,
}

/// What the user asks for.
#[derive(Clone, Debug, PartialEq)]
pub enum Ask {
    /// Wire an output to an input, in place of the wire that was there; `moved` is taken off first.
    Wire {
        /// Producer.
        output: End,
        /// Consumer.
        input: End,
        /// The connection that the wire was pulled off.
        moved: Option<(End, usize)>,
    },
    /// Take a wire off.
    Unwire {
        /// Consumer.
        input: End,
        /// Place in a list.
        index: usize,
    },
    /// Nodes were moved; new places.
    Move(Vec<(String, Pos2)>),
    /// Show an output large.
    Look(Output),
    /// Add a node at a place, for a wire if there is one.
    Add {
        /// Where.
        at: Pos2,
        /// The end that waits for the other one.
        end: Option<End>,
    },
    /// Put a node into a wire: consumer, input, place in the list.
    Insert {
        /// The node.
        node: String,
        /// The wire.
        wire: (String, String, usize),
    },
    /// Frames and notes are these now, and nodes were moved with them.
    Marks {
        /// All of them.
        marks: Vec<Mark>,
        /// New places.
        moved: Vec<(String, Pos2)>,
    },
    /// A mistake to tell.
    Tell(String),
}

#[derive(Clone, Debug, Default)]
pub(super) enum Drag {
    #[default]
    None,
    /// Selected nodes.
    Nodes { moved: bool },
    /// A wire from a pin; `moved` when it was pulled off an input.
    Wire { from: End, moved: Option<(End, usize)> },
    /// A frame around nodes, from a point of the graph.
    Frame(Pos2),
}

impl Canvas {
    pub(super) fn touch_ground(&mut self, ui: &Ui, ground: &Response, scene: &Scene<'_>, asks: &mut Vec<Ask>) {
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
            asks.push(Ask::Add { at: to_graph * at, end: None });
        }
    }

    fn nodes_in<'a>(&'a self, view: &'a View, frame: Rect) -> impl Iterator<Item = String> + 'a {
        let touched = move |&n: &usize| {
            let place = self.places.get(view.nodes[n].id()).copied().unwrap_or_default();
            frame.intersects(Rect::from_min_size(place, self.shapes[n].size))
        };
        (0..view.nodes.len()).filter(touched).map(|n| view.nodes[n].id().to_owned())
    }

    /// Draws a node and lets it be touched.
    pub(super) fn show_node_at(&mut self, ui: &mut Ui, scene: &Scene<'_>, node: usize, asks: &mut Vec<Ask>) {
        let this = &scene.view.nodes[node];
        let id = this.id();
        let place = self.places.get(id).copied().unwrap_or_default();
        let transform = self.transform();
        let shape = self.shapes[node].clone();
        let rect = transform * Rect::from_min_size(place, shape.size);
        if !rect.expand(20.0).intersects(self.rect) {
            return;
        }
        let body = ui.interact(rect, Id::new(("node", id)), Sense::click_and_drag());
        let words = format!("Node {id}");
        body.widget_info(|| {
            WidgetInfo::selected(WidgetType::SelectableLabel, true, self.selected.contains(id), words.clone())
        });
        self.paint_node(ui, scene, node, rect, body.hovered());
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
            for selected in &self.selected {
                if let Some(place) = self.places.get_mut(selected) {
                    *place += by;
                }
            }
        }
        if body.drag_stopped() && matches!(self.drag, Drag::Nodes { moved: true }) {
            self.end_of_move(scene.view, id, asks);
        }
        if body.drag_stopped() {
            self.drag = Drag::None;
        }
        if transform.scaling >= DETAIL {
            if let (Some(picture), Some((output, _))) = (shape.picture, &shape.output) {
                let rect = transform * picture.translate(place.to_vec2());
                if ui.rect_contains_pointer(rect.intersect(self.rect)) {
                    self.under_pointer = Some(output.clone());
                }
                let clicked_picture = body.clicked()
                    && !modifiers.any()
                    && body.interact_pointer_pos().is_some_and(|at| rect.contains(at));
                if clicked_picture || body.double_clicked() {
                    asks.push(Ask::Look(output.clone()));
                }
            }
            if let Some(fold) = shape.fold {
                let rect = transform * fold.translate(place.to_vec2());
                let button = ui.interact(rect, Id::new(("fold", id)), Sense::click());
                button.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, format!("All ports of {id}")));
                if button.clicked() {
                    if !self.unfolded.remove(id) {
                        self.unfolded.insert(id.to_owned());
                    }
                    self.laid_out = None;
                }
            }
            for pin in &shape.pins {
                let at = transform * (place + pin.at.to_vec2());
                self.touch_pin(ui, scene, node, pin, at, asks);
            }
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

    /// A lone node dropped on a wire goes into it; others stay where they were put.
    fn end_of_move(&mut self, view: &View, id: &str, asks: &mut Vec<Ask>) {
        for selected in &self.selected {
            if let Some(place) = self.places.get_mut(selected) {
                *place = pos2((place.x / 8.0).round() * 8.0, (place.y / 8.0).round() * 8.0);
            }
        }
        let places = self.selected.iter().filter_map(|s| Some((s.clone(), *self.places.get(s)?)));
        asks.push(Ask::Move(places.collect()));
        let Some(node) = view.node(id).filter(|_| self.selected.len() == 1) else { return };
        let free = !view.wires.iter().any(|w| w.to == node || w.from == node);
        let middle = self.places.get(id).copied().unwrap_or_default() + self.shapes[node].size / 2.0;
        if free && let Some(wire) = self.wire_at(view, self.transform() * middle) {
            asks.push(Ask::Insert { node: id.to_owned(), wire });
        }
    }

    fn touch_pin(&mut self, ui: &Ui, scene: &Scene<'_>, node: usize, pin: &super::Pin, at: Pos2, asks: &mut Vec<Ask>) {
        let id = scene.view.nodes[node].id();
        let side = if pin.input { "Input" } else { "Output" };
        let reach = vec2(18.0, 16.0) * self.scale().clamp(0.6, 1.2);
        let response =
            ui.interact(Rect::from_center_size(at, reach), Id::new(("pin", id, &pin.name, pin.input)), Sense::drag());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Other, true, format!("{side} {id}.{}", pin.name)));
        let end = End { node: id.to_owned(), port: pin.name.clone(), input: pin.input };
        if !pin.input && response.hovered() {
            self.under_pointer = Some(Output::new(id, &pin.name));
        }
        if response.hovered() && matches!(self.drag, Drag::None) {
            let port = if pin.input {
                scene.view.nodes[node].input(&pin.name)
            } else {
                scene.view.nodes[node].output(&pin.name)
            };
            let words = port.map_or_else(String::new, |p| format!("{} ({})\n{}", p.name, p.packet.name, p.doc));
            response.clone().on_hover_text(words);
        }
        if response.drag_started() {
            // The end of a wire is pulled off the input it goes to.
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
            asks.extend(self.drop_wire(scene.view, from, moved, pointer));
        }
    }

    /// The pin nearest to a point of the window that could be the other end of a wire from `from`.
    pub(super) fn pin_near(&self, view: &View, from: &End, pointer: Pos2) -> Option<End> {
        let transform = self.transform();
        let mut best: Option<(f32, End)> = None;
        for (node, shape) in view.nodes.iter().zip(&self.shapes) {
            let place = self.places.get(node.id()).copied().unwrap_or_default();
            for pin in shape.pins.iter().filter(|p| p.input != from.input) {
                let distance = (transform * (place + pin.at.to_vec2())).distance(pointer);
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

    /// On a node's body, the first pin that fits.
    fn pin_of_body(&self, view: &View, from: &End, pointer: Pos2) -> Option<End> {
        let at = self.transform().inverse() * pointer;
        let over = |&n: &usize| {
            let place = self.places.get(view.nodes[n].id()).copied().unwrap_or_default();
            Rect::from_min_size(place, self.shapes[n].size).contains(at) && view.nodes[n].id() != from.node
        };
        let node = (0..view.nodes.len()).rev().find(over)?;
        let id = view.nodes[node].id();
        let ends = self.shapes[node].pins.iter().filter(|p| p.input != from.input).map(|p| End {
            node: id.to_owned(),
            port: p.name.clone(),
            input: p.input,
        });
        let mut fitting: Vec<End> = ends.filter(|end| may_wire(view, from, end).is_ok()).collect();
        // One that waits for a wire comes first.
        fitting.sort_by_key(|end| end.input && view.wires_into(node, &end.port).next().is_some());
        fitting.into_iter().next()
    }

    fn drop_wire(&self, view: &View, from: End, moved: Option<(End, usize)>, pointer: Pos2) -> Option<Ask> {
        match self.pin_near(view, &from, pointer) {
            Some(end) => {
                if moved.as_ref().is_some_and(|(input, _)| *input == end) {
                    return None;
                }
                if let Err(why) = may_wire(view, &from, &end) {
                    return Some(Ask::Tell(why));
                }
                let (output, input) = if from.input { (end, from) } else { (from, end) };
                Some(Ask::Wire { output, input, moved })
            }
            None => match moved {
                Some((input, index)) => Some(Ask::Unwire { input, index }),
                None if self.rect.contains(pointer) => {
                    Some(Ask::Add { at: self.transform().inverse() * pointer, end: Some(from) })
                }
                None => None,
            },
        }
    }

    /// The wire at a point of the window.
    pub(super) fn wire_at(&self, view: &View, at: Pos2) -> Option<(String, String, usize)> {
        let near = view.wires.iter().filter_map(|wire| {
            let curves = self.curves(view, wire);
            let points = curves.iter().flat_map(|c| (0..=24).map(|i| super::paint::on_curve(c, i as f32 / 24.0)));
            let distance = points.map(|p| p.distance(at)).fold(f32::MAX, f32::min);
            (distance < 10.0).then_some((distance, wire))
        });
        let (_, wire) = near.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((view.nodes[wire.to].id().to_owned(), wire.input.clone(), wire.index))
    }
}

/// Whether two ends may be joined; if not, why.
pub(super) fn may_wire(view: &View, a: &End, b: &End) -> Result<(), String> {
    let (output, input) = if a.input { (b, a) } else { (a, b) };
    let index = |end: &End| view.node(&end.node).ok_or_else(|| format!("there is no node `{}`", end.node));
    view.may_wire(index(output)?, &output.port, index(input)?, &input.port)
}
