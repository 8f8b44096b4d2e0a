//! Positions of nodes, level by level: an opened part is laid out by itself and takes its place in the level around it as one box.

use std::collections::HashMap;
use std::sync::Arc;

use eframe::egui::{Pos2, Rect, Vec2, pos2, vec2};

use super::Shape;
use super::frames::{ROOM, TITLE};
use panoscope_editor_model::folding::parent;
use panoscope_editor_model::graph_view::{GraphView, Wire};
use panoscope_editor_model::layout;

/// Distance between the corner of a part's frame and the origin of the positions inside.
const INSET: Vec2 = vec2(ROOM, ROOM + TITLE);
/// Least size of a frame.
const MIN_VALUE: Vec2 = vec2(240.0, 120.0);

/// Where the nodes of a level and of the parts inside it are, in points of the graph.
#[derive(Default)]
pub(super) struct Level {
    /// Nodes, by name.
    pub nodes: HashMap<String, Pos2>,
    /// Frames of opened parts, by name.
    pub frames: HashMap<String, Rect>,
    /// Origins of the positions inside opened parts, by name.
    pub origins: HashMap<String, Pos2>,
    /// Paths of wires that pass other nodes, by the nodes at their ends.
    pub lanes: HashMap<(usize, usize), Vec<[Pos2; 2]>>,
    /// Corners of the paths of wires to other rows, by the nodes at their ends.
    pub routes: HashMap<(usize, usize), Vec<Pos2>>,
}

impl Level {
    fn shift(&mut self, by: Vec2) {
        self.nodes.values_mut().chain(self.origins.values_mut()).for_each(|at| *at += by);
        self.frames.values_mut().for_each(|rect| *rect = rect.translate(by));
        self.lanes.values_mut().flatten().flatten().for_each(|at| *at += by);
        self.routes.values_mut().flatten().for_each(|at| *at += by);
    }

    /// Adds an opened part with its frame.
    fn insert(&mut self, id: &str, mut part: Self, frame: Rect) {
        part.shift(frame.min.to_vec2());
        self.nodes.extend(part.nodes);
        self.origins.extend(part.origins);
        self.lanes.extend(part.lanes);
        self.routes.extend(part.routes);
        self.frames.extend(part.frames);
        self.frames.insert(id.to_owned(), frame);
    }

    /// The rectangle of everything in it.
    fn extent(&self, view: &GraphView, shapes: &[Arc<Shape>]) -> Option<Rect> {
        let nodes =
            self.nodes.iter().filter_map(|(id, at)| Some(Rect::from_min_size(*at, shapes[view.node(id)?].size)));
        nodes.chain(self.frames.values().copied()).reduce(|a, b| a.union(b))
    }
}

/// One thing of a level: a node or an opened part.
struct Item {
    id: String,
    /// Index of the node; `None` for a part.
    node: Option<usize>,
    size: Vec2,
    /// Position in the file.
    position: Option<(f32, f32)>,
}

/// Lays out the nodes of a part, or of the graph where `part` is empty, for a window of this size.
pub(super) fn lay_out(view: &GraphView, shapes: &[Arc<Shape>], part: &str, window: Vec2) -> Level {
    let mut inside: HashMap<String, Level> = HashMap::new();
    let mut items: Vec<Item> = (view.nodes.iter().zip(shapes).enumerate())
        .filter(|(_, (node, _))| parent(node.id()) == part)
        .map(|(n, (node, shape))| Item {
            id: node.id().to_owned(),
            node: Some(n),
            size: shape.size,
            position: node.position,
        })
        .collect();
    for opened in view.parts.iter().filter(|p| p.open && parent(&p.id) == part) {
        let mut level = lay_out(view, shapes, &opened.id, window);
        let extent = level.extent(view, shapes).unwrap_or(Rect::from_min_size(Pos2::ZERO, Vec2::ZERO));
        // The frame begins where positions inside do, and grows around nodes that are left of that or above.
        let origin = extent.min.min(Pos2::ZERO);
        level.shift(-origin.to_vec2());
        let size = (extent.max - origin + INSET + Vec2::splat(ROOM)).max(MIN_VALUE);
        level.origins.insert(opened.id.clone(), Pos2::ZERO - origin.to_vec2());
        level.shift(INSET);
        items.push(Item { id: opened.id.clone(), node: None, size, position: opened.position });
        inside.insert(opened.id.clone(), level);
    }
    let at_level = |n: usize| {
        let id = view.nodes[n].id();
        items.iter().position(|item| match item.node {
            Some(node) => node == n,
            None => id.strip_prefix(item.id.as_str()).is_some_and(|rest| rest.starts_with('/')),
        })
    };
    let ends: Vec<((usize, usize), &Wire)> =
        view.wires.iter().filter_map(|w| Some(((at_level(w.from)?, at_level(w.to)?), w))).collect();
    let pairs = |delayed: bool| -> Vec<(usize, usize)> {
        let between = ends.iter().filter(|((from, to), w)| w.delayed == delayed && from != to);
        between.map(|(items, _)| *items).collect()
    };
    let (edges, delayed) = (pairs(false), pairs(true));
    let sizes: Vec<[f32; 2]> = items.iter().map(|i| [i.size.x, i.size.y]).collect();
    // An unconnected node with a position in the file does not affect the layout.
    let laid: Vec<usize> = (0..items.len())
        .filter(|n| items[*n].position.is_none() || edges.iter().any(|(from, to)| from == n || to == n))
        .collect();
    let automatic = layout::fitted_part(&sizes, &edges, &delayed, window.into(), &laid);
    // Nodes without a position in the file are placed around those with one.
    let mut taken: Vec<layout::Rectangle> =
        items.iter().zip(&sizes).filter_map(|(item, size)| item.position.map(|(x, y)| ([x, y], *size))).collect();
    let placed = taken.len();
    let mut level = Level::default();
    for (n, item) in items.iter().enumerate() {
        let at = match item.position {
            Some((x, y)) => [x, y],
            None if placed == 0 => automatic.positions[n],
            None => {
                let at = layout::clear_of(automatic.positions[n], sizes[n], &taken);
                taken.push((at, sizes[n]));
                at
            }
        };
        let at = pos2(at[0], at[1]);
        match inside.remove(&item.id) {
            None => _ = level.nodes.insert(item.id.clone(), at),
            Some(part) => level.insert(&item.id, part, Rect::from_min_size(at, item.size)),
        }
    }
    let untouched = |n: usize| items[n].position.is_none();
    for ((from, to), wire) in ends {
        if !untouched(from) || !untouched(to) {
            continue;
        }
        let nodes = (wire.from, wire.to);
        if let Some(route) = automatic.routes.get(&(from, to)) {
            level.routes.insert(nodes, route.iter().map(|[x, y]| pos2(*x, *y)).collect());
        }
        let lane = automatic.lanes.get(&(from, to)).filter(|_| items[from].node.is_some() && items[to].node.is_some());
        if let Some(lane) = lane {
            level.lanes.insert(nodes, lane.iter().map(|s| s.map(|[x, y]| pos2(x, y))).collect());
        }
    }
    level
}
