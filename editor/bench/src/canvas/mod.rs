//! The canvas: draws the graph and handles input on it. Its state is positions, zoom, selection and the current drag. Changes of the graph
//! are returned as [`CanvasRequest`]s; the canvas does not change the graph itself.

mod arrange;
mod curve;
mod frames;
mod interaction;
mod levels;
mod marks;
mod minimap;
mod node;
mod paint;
mod paths;
mod shape;
mod wires;

use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::Arc;

use eframe::egui::emath::TSTransform;
use eframe::egui::{Mesh, Pos2, Rect, Sense, Ui, Vec2, WidgetInfo, WidgetType, pos2, vec2};

use panoscope_editor_model::graph_view::GraphView;
use panoscope_editor_model::layout;
use panoscope_editor_model::observe::{Counters, Output};
use panoscope_editor_model::texts::text;
use panoscope_editor_model::timeline::Held;
use panoscope_editor_widgets::OutputCache;

pub use interaction::{CanvasRequest, End};
use panoscope_editor_model::Mark;
pub use shape::{Pin, Shape, shown_output};

/// Distance between a new node and the selected one beside it, in points at zoom 1.
const BESIDE: f32 = 64.0;

/// Range of the zoom; each step is a factor of the eighth root of two.
const ZOOM_STEPS: std::ops::RangeInclusive<f32> = -36.0..=8.0;
/// Largest scale at which a whole graph is shown.
const FIT_SCALE: f32 = 1.5;
/// Distance between the whole graph and the edges of the canvas, in points of the window.
const FIT_MARGIN: f32 = 20.0;

/// Greatest width of a thumbnail, and step of widths, px.
const MAX_PICTURE: f32 = 640.0;
const PICTURE_STEP: f32 = 32.0;

/// What the canvas draws.
pub struct Scene<'a> {
    /// The graph.
    pub view: &'a GraphView,
    /// Times and faults of the nodes.
    pub counters: &'a Counters,
    /// Previews of the outputs.
    pub shown: &'a OutputCache,
    /// Whether nodes are coloured by their load.
    pub heat: bool,
    /// Whether the graph runs.
    pub running: bool,
    /// The node at which the last change failed, with the reason.
    pub problem: Option<(&'a str, &'a str)>,
    /// While a recording is shown in place of the running graph: what there is of an output.
    pub recorded: Option<&'a dyn Fn(&Output) -> Held>,
}

/// The state of the canvas.
pub struct Canvas {
    zoom: f32,
    /// Screen distance from the canvas's middle to the graph's origin.
    offset: Vec2,
    positions: HashMap<String, Pos2>,
    /// Frames of opened parts, and the points that positions inside count from.
    frames: HashMap<String, Rect>,
    origins: HashMap<String, Pos2>,
    shapes: Vec<Arc<Shape>>,
    /// Positions of the nodes that the shapes belong to, as they were when the last frame began.
    places: Vec<Pos2>,
    /// Number of layouts so far.
    layouts: u64,
    paths: paths::Paths,
    /// Names of the nodes that the shapes belong to.
    ids: Vec<String>,
    /// Paths of wires that pass other nodes, while both end nodes are where the layout put them.
    lanes: HashMap<(usize, usize), Vec<[Pos2; 2]>>,
    /// Corners of the paths of wires to other rows, likewise.
    routes: HashMap<(usize, usize), Vec<Pos2>>,
    /// For each node, its outputs that are read: their wires run beside each other.
    outputs: Vec<Vec<String>>,
    laid_out: Option<u64>,
    /// Space for the graph, and the window's size, when the layout took its shape.
    shape: Option<(Vec2, Vec2)>,
    /// Whether the whole graph is kept in view; the user's movement ends it.
    fit: bool,
    fitted: Option<(Rect, u64)>,
    drag: interaction::Drag,
    /// Nodes that show all ports.
    unfolded: HashSet<String>,
    /// The output that a node shows, where the user chose it.
    chosen: HashMap<String, String>,
    /// Selected nodes.
    pub selected: BTreeSet<String>,
    /// Selected wire: consumer, input, index in the list.
    pub selected_wire: Option<(String, String, usize)>,
    marks: Vec<Mark>,
    selected_mark: Option<usize>,
    mark_edit: marks::MarkEdit,
    /// Output under the pointer.
    pub under_pointer: Option<Output>,
    /// The part of the window that it was last drawn in.
    pub rect: Rect,
}

impl Default for Canvas {
    fn default() -> Self {
        Self {
            zoom: 0.0,
            offset: Vec2::ZERO,
            positions: HashMap::new(),
            frames: HashMap::new(),
            origins: HashMap::new(),
            shapes: Vec::new(),
            places: Vec::new(),
            layouts: 0,
            paths: paths::Paths::default(),
            ids: Vec::new(),
            lanes: HashMap::new(),
            routes: HashMap::new(),
            outputs: Vec::new(),
            laid_out: None,
            shape: None,
            fit: true,
            fitted: None,
            drag: interaction::Drag::None,
            unfolded: HashSet::new(),
            chosen: HashMap::new(),
            selected: BTreeSet::new(),
            selected_wire: None,
            marks: Vec::new(),
            selected_mark: None,
            mark_edit: marks::MarkEdit::default(),
            under_pointer: None,
            rect: Rect::from_min_size(Pos2::ZERO, vec2(800.0, 600.0)),
        }
    }
}

impl Canvas {
    /// The frame of an opened part.
    pub fn frame(&self, part: &str) -> Option<Rect> {
        self.frames.get(part).copied()
    }

    /// Shows the whole graph, and keeps it in view until the user moves it. Nodes without a position in the file are arranged for the space there is.
    pub fn fit(&mut self) {
        self.fit = true;
        self.fitted = None;
        self.shape = None;
    }

    /// Zooms by eighths of an octave around the middle.
    pub fn zoom_by(&mut self, steps: i32) {
        self.zoom_around(Vec2::ZERO, steps);
    }

    /// Moves the view, in points.
    pub fn pan_by(&mut self, by: Vec2) {
        self.fit = false;
        self.offset += by;
    }

    fn scale(&self) -> f32 {
        2f32.powf(self.zoom / 8.0)
    }

    fn zoom_around(&mut self, middle: Vec2, steps: i32) {
        let before = self.scale();
        self.fit = false;
        self.zoom = (self.zoom + steps as f32).clamp(*ZOOM_STEPS.start(), *ZOOM_STEPS.end());
        self.offset = middle + (self.offset - middle) * (self.scale() / before);
    }

    /// The transform from the graph's points to the window's.
    fn transform(&self) -> TSTransform {
        TSTransform::new(self.rect.center().to_vec2() + self.offset, self.scale())
    }

    /// The graph's point in the middle of the view, on the grid.
    pub fn middle(&self) -> Pos2 {
        let at = self.transform().inverse() * self.rect.center();
        pos2((at.x / 8.0).round() * 8.0, (at.y / 8.0).round() * 8.0)
    }

    /// Preferred position of a new node: right of the selected node if that is visible, else the middle of the view.
    pub fn place_for_new(&self) -> Pos2 {
        let last = self.selected.iter().next_back();
        let shape = last.and_then(|id| self.ids.iter().position(|known| known == id)).and_then(|n| self.shapes.get(n));
        let beside =
            last.and_then(|id| self.position(id)).zip(shape).map(|(at, shape)| at + vec2(shape.size.x + BESIDE, 0.0));
        let seen = |at: &Pos2| self.rect.contains(self.transform() * *at);
        beside.filter(seen).unwrap_or_else(|| self.middle())
    }

    /// The translation that moves a group of added nodes so that they overlap no other node.
    pub fn offset_to_free_space(&mut self, view: &GraphView, revision: u64, added: &[String]) -> Vec2 {
        // The other nodes as they were before, so that nodes without a position in the file do not move.
        let before = self.positions.clone();
        self.lay_out(view, revision);
        let grounds = view.nodes.iter().zip(&self.shapes).filter_map(|(node, shape)| {
            let is_new = added.iter().any(|id| id == node.id());
            let at = before.get(node.id()).filter(|_| !is_new).or_else(|| self.positions.get(node.id())).copied()?;
            Some((added.iter().any(|id| id == node.id()), Rect::from_min_size(at, shape.size)))
        });
        let (new, others): (Vec<_>, Vec<_>) = grounds.partition(|(new, _)| *new);
        let Some(group) = new.into_iter().map(|(_, rect)| rect).reduce(|a, b| a.union(b)) else { return Vec2::ZERO };
        let taken: Vec<layout::Rectangle> = others.iter().map(|(_, r)| (r.min.into(), r.size().into())).collect();
        Pos2::from(layout::free(group.min.into(), group.size().into(), &taken)) - group.min
    }

    /// Moves the view if a node is outside of it.
    pub fn keep_in_view(&mut self, view: &GraphView, revision: u64, id: &str) {
        self.lay_out(view, revision);
        let node = view.node(id).and_then(|n| self.shapes.get(n)).zip(self.position(id));
        let Some((shape, position)) = node.filter(|_| !self.fit) else { return };
        let rect = Rect::from_min_size(self.transform() * position, shape.size * self.scale());
        if !self.rect.contains_rect(rect) {
            self.offset -= rect.center() - self.rect.center();
        }
    }

    /// Position of a node.
    pub fn position(&self, id: &str) -> Option<Pos2> {
        self.positions.get(id).copied()
    }

    /// Centres the view on a node and selects it; on the part that is shown in its place, where it is inside a folded one.
    pub fn show_node(&mut self, view: &GraphView, id: &str) {
        let mut id = id;
        while view.node(id).is_none()
            && let Some((part, _)) = id.rsplit_once('/')
        {
            id = part;
        }
        if let (Some(node), Some(position)) = (view.node(id), self.positions.get(id))
            && let Some(shape) = self.shapes.get(node)
        {
            self.fit = false;
            self.zoom = self.zoom.max(-4.0);
            self.offset = -(position.to_vec2() + shape.size / 2.0) * self.scale();
            self.select_only(id);
        }
    }

    /// Selects one node and nothing else.
    pub fn select_only(&mut self, id: &str) {
        self.selected = BTreeSet::from([id.to_owned()]);
        self.selected_wire = None;
        self.selected_mark = None;
    }

    /// The output that a node shows, with its packet type.
    pub fn shown_output(&self, view: &GraphView, node: usize) -> Option<(Output, String)> {
        shown_output(view, node, self.chosen.get(view.nodes[node].id()).map(String::as_str))
    }

    /// Sets the output that a node shows.
    pub fn choose_output(&mut self, node: &str, port: &str) {
        self.chosen.insert(node.to_owned(), port.to_owned());
        self.laid_out = None;
    }

    /// Width of a thumbnail in px: as it is drawn, in steps, so that a small change of the zoom asks for no other one.
    pub fn thumbnail_width(&self, pixels_per_point: f32) -> usize {
        let width = (shape::WIDTH - 2.0 * shape::PAD) * self.scale() * pixels_per_point;
        (width.clamp(64.0, MAX_PICTURE) / PICTURE_STEP).ceil() as usize * PICTURE_STEP as usize
    }

    /// Outputs whose thumbnails are visible, with their packet types.
    pub fn visible(&self) -> impl Iterator<Item = (&Output, &str)> {
        let small = self.scale() < shape::PICTURES;
        let seen = self.transform().inverse() * self.rect;
        let shapes = self.shapes.iter().zip(&self.ids).filter(move |(shape, id)| {
            let position = self.positions.get(*id).filter(|_| !small);
            position.is_some_and(|position| seen.intersects(Rect::from_min_size(*position, shape.size)))
        });
        let outputs = shapes.flat_map(|(shape, _)| shape.output.iter().chain(&shape.backdrop));
        outputs.map(|(output, packet)| (output, packet.as_str()))
    }

    /// Lays out the nodes again when the text has changed.
    fn lay_out(&mut self, view: &GraphView, revision: u64) {
        if self.laid_out == Some(revision) {
            return;
        }
        self.laid_out = Some(revision);
        self.layouts += 1;
        self.ids = view.nodes.iter().map(|n| n.id().to_owned()).collect();
        self.shapes = (0..view.nodes.len())
            .map(|n| Shape::of(view, n, &self.unfolded, self.chosen.get(view.nodes[n].id()).map(String::as_str)))
            .map(Arc::new)
            .collect();
        let window = self.shape.map_or_else(|| self.room(), |(room, _)| room);
        let level = levels::lay_out(view, &self.shapes, "", window);
        (self.positions, self.frames, self.origins) = (level.nodes, level.frames, level.origins);
        (self.lanes, self.routes) = (level.lanes, level.routes);
        self.outputs = vec![Vec::new(); view.nodes.len()];
        for wire in &view.wires {
            if !self.outputs[wire.from].contains(&wire.output) {
                self.outputs[wire.from].push(wire.output.clone());
            }
        }
        // A frame has a position as a node has.
        self.positions.extend(self.frames.iter().map(|(id, rect)| (id.clone(), rect.min)));
        if !matches!(self.mark_edit, marks::MarkEdit::Text { .. }) {
            self.marks.clone_from(&view.marks);
        }
        let known = |id: &String| view.node(id).is_some() || view.part(id).is_some_and(|p| p.open);
        self.selected.retain(known);
        self.unfolded.retain(known);
        let wire = |w: &(String, String, usize)| {
            view.wires.iter().any(|x| view.nodes[x.to].id() == w.0 && x.input == w.1 && x.index == w.2)
        };
        self.selected_wire = self.selected_wire.take().filter(wire);
    }

    /// The space for a graph that is shown whole.
    fn room(&self) -> Vec2 {
        self.rect.shrink(FIT_MARGIN).size()
    }

    /// The scale of the graph.
    pub fn zoom_factor(&self) -> f32 {
        self.scale()
    }

    /// The rectangles of all nodes in the window, by name.
    pub fn node_rects(&self) -> Vec<(String, Rect)> {
        let nodes = self.ids.iter().zip(&self.shapes);
        let rect = |at: &Pos2, shape: &Arc<Shape>| self.transform() * Rect::from_min_size(*at, shape.size);
        nodes.filter_map(|(id, shape)| Some((id.clone(), rect(self.positions.get(id)?, shape)))).collect()
    }

    /// The bounding rectangle of nodes, marks and paths of wires, in points of the graph.
    fn extent(&self, view: &GraphView) -> Option<Rect> {
        let rects = self.places.iter().zip(&self.shapes).map(|(at, shape)| Rect::from_min_size(*at, shape.size));
        let marks = view.marks.iter().map(|m| {
            let (w, h) = m.size.unwrap_or((220.0, 40.0));
            Rect::from_min_size(pos2(m.at.0, m.at.1), vec2(w, h))
        });
        let corners = self.routes.values().flatten().map(|at| Rect::from_min_max(*at, *at));
        let nodes = rects.chain(marks).chain(self.frames.values().copied());
        let around = self.paths.wires.iter().filter(|path| !path.corners.is_empty()).map(|path| path.bounds);
        nodes.chain(corners).chain(around).reduce(|a, b| a.union(b))
    }

    fn fit_now(&mut self, view: &GraphView) {
        if let Some(extent) = self.extent(view) {
            let room = self.room();
            let scale = (room.x / extent.width()).min(room.y / extent.height()).clamp(1e-3, FIT_SCALE);
            self.zoom = (scale.log2() * 8.0).max(*ZOOM_STEPS.start());
            self.offset = -extent.center().to_vec2() * self.scale();
        }
    }

    /// Draws the graph into the remaining space of `ui`; returns the user's requests.
    pub fn show(&mut self, ui: &mut Ui, scene: &Scene<'_>, revision: u64) -> Vec<CanvasRequest> {
        let rect = ui.available_rect_before_wrap();
        self.rect = rect;
        // The layout keeps its shape while panels open and close; another size of the window gives it another one.
        let window = ui.ctx().content_rect().size();
        if self.shape.is_none_or(|(_, before)| self.fit && before != window) {
            self.shape = Some((self.room(), window));
            self.laid_out = None;
            self.fitted = None;
        }
        self.lay_out(scene.view, revision);
        self.follow_places(scene.view);
        if self.fit && self.fitted != Some((rect, revision)) && matches!(self.drag, interaction::Drag::None) {
            self.fitted = Some((rect, revision));
            self.fit_now(scene.view);
        }
        let mut requests = Vec::new();
        ui.set_clip_rect(rect.intersect(ui.clip_rect()));
        let ground = ui.allocate_rect(rect, Sense::click_and_drag());
        ground.widget_info(|| WidgetInfo::labeled(WidgetType::Panel, true, text!("canvas-name")));
        self.touch_ground(ui, &ground, scene, &mut requests);
        let painter = ui.painter().clone();
        self.paint_ground(&painter);
        self.show_marks(ui, scene, &mut requests);
        self.show_frames(ui, scene, &mut requests);
        self.paint_wires(&painter, scene);
        self.under_pointer = None;
        // From afar the boxes of all nodes are one mesh, below their names.
        let (slot, mut far) = (painter.add(eframe::egui::Shape::Noop), Mesh::default());
        let order = self.order(scene.view);
        for node in order {
            self.show_node_at(ui, scene, node, &mut far, &mut requests);
        }
        painter.set(slot, far);
        self.paint_drag(ui, scene);
        self.name_wires(ui, &ground, scene);
        self.show_minimap(ui, scene);
        requests
    }

    /// The drawing order: selected nodes last, so that they are on top.
    fn order(&self, view: &GraphView) -> Vec<usize> {
        let mut order: Vec<usize> = (0..view.nodes.len()).collect();
        if !self.selected.is_empty() {
            order.sort_by_key(|&n| self.selected.contains(view.nodes[n].id()));
        }
        order
    }
}
