//! The paths of all wires in points of the graph, kept until a node moves: while the view moves they are only shifted. No path passes under a node.

use eframe::egui::{Pos2, Rect};

use super::Canvas;
use super::curve::{bow, flattened_to, rounded, simplified};
use super::interaction::Drag;
use super::shape::PICTURES;
use panoscope_editor_model::graph_view::{GraphView, Wire};
use panoscope_editor_model::layout::{Ends, Obstacles};

/// Greatest distance between a curve and the lines that are tested for nodes, in points at zoom 1.
const TESTED: f32 = 1.0;

/// Greatest distance between a curve and its lines, in points of the window: near, and from afar, where the wires of hundreds of nodes are thin.
const PRECISE: f32 = 0.25;
const FAR: f32 = 1.5;

/// The path of a wire.
#[derive(Clone, Debug)]
pub(super) struct Path {
    /// Its curves.
    pub curves: Vec<[Pos2; 4]>,
    /// The rectangle around their control points.
    pub bounds: Rect,
    /// Its curves as lines, for the scale of the last drawing: one for each, from afar one for all.
    pub lines: Vec<Vec<Pos2>>,
    /// The corners of a path around nodes that are in the way; empty for other paths.
    pub corners: Vec<[f32; 2]>,
}

/// The paths, with what they were made of.
#[derive(Clone, Debug, Default)]
pub(super) struct Paths {
    /// One for each wire of the graph, in the same order.
    pub wires: Vec<Path>,
    places: Vec<Pos2>,
    layout: u64,
    /// Whether nodes were dragged meanwhile.
    dragged: bool,
    scale: f32,
}

/// Nodes, and behind them the frames of opened parts with their names.
struct Ground<'a> {
    obstacles: Obstacles,
    nodes: usize,
    frames: Vec<&'a str>,
}

impl Ground<'_> {
    /// The frames around the ends of a wire: it goes through their edges.
    fn around_ends(&self, view: &GraphView, wire: &Wire) -> Vec<usize> {
        let is_in = |node: usize, frame: &str| {
            view.nodes[node].id().strip_prefix(frame).is_some_and(|rest| rest.starts_with('/'))
        };
        let frames = self.frames.iter().enumerate();
        let around = frames.filter(|(_, frame)| is_in(wire.from, frame) || is_in(wire.to, frame));
        around.map(|(k, _)| self.nodes + k).collect()
    }

    /// What curves pass under.
    fn under(&self, curves: &[[Pos2; 4]], within: &[usize]) -> Vec<usize> {
        let points = |curve| flattened_to(curve, TESTED).into_iter().map(|at: Pos2| [at.x, at.y]);
        let line: Vec<[f32; 2]> = curves.iter().flat_map(points).collect();
        self.obstacles.under(&line, within)
    }
}

impl Canvas {
    /// What wires must not pass under. Nodes that are being dragged are not among it, so that one can be dropped on a wire.
    fn ground(&self) -> Ground<'_> {
        let frames: Vec<(&str, Rect)> = self.frames.iter().map(|(id, rect)| (id.as_str(), *rect)).collect();
        let dragged = matches!(self.drag, Drag::Nodes { .. });
        let nodes = self.ids.iter().zip(self.places.iter().zip(&self.shapes)).map(|(id, (at, shape))| {
            if dragged && self.selected.contains(id) { Rect::NAN } else { Rect::from_min_size(*at, shape.size) }
        });
        let all = nodes.chain(frames.iter().map(|(_, rect)| *rect));
        let obstacles = Obstacles::new(all.map(|rect| (rect.min.into(), rect.size().into())));
        Ground { obstacles, nodes: self.places.len(), frames: frames.into_iter().map(|(id, _)| id).collect() }
    }

    /// Makes the paths again if a node moved or the layout changed.
    pub(super) fn follow_places(&mut self, view: &GraphView) {
        let place = |id: &String| self.positions.get(id).copied().unwrap_or_default();
        self.places = self.ids.iter().map(place).collect();
        let dragged = matches!(self.drag, Drag::Nodes { .. });
        let is_same = self.paths.layout == self.layouts && self.paths.dragged == dragged;
        if is_same && self.paths.places == self.places {
            return;
        }
        let ground = self.ground();
        let before = if is_same { &self.paths.wires[..] } else { &[] };
        let wires = view.wires.iter().enumerate();
        let wires = wires.map(|(n, wire)| self.path(view, wire, &ground, before.get(n))).collect();
        self.paths = Paths { wires, places: self.places.clone(), layout: self.layouts, dragged, scale: 0.0 };
    }

    /// The path of a wire: as the layout has it where that passes under nothing, else around what is in the way. A path around nodes is kept from
    /// `before` while its ends stay and nothing comes in its way.
    fn path(&self, view: &GraphView, wire: &Wire, ground: &Ground<'_>, before: Option<&Path>) -> Path {
        let within = ground.around_ends(view, wire);
        let direct = self.curves(wire);
        let Some((from, to)) = self.ends(wire) else {
            return Path { curves: Vec::new(), bounds: Rect::NOTHING, lines: Vec::new(), corners: Vec::new() };
        };
        let is_free = !direct.is_empty() && ground.under(&direct, &within).is_empty();
        let mut corners = Vec::new();
        if !is_free {
            let (from, to) = ([from.x, from.y], [to.x, to.y]);
            let known = before.map(|path| &path.corners);
            let known = known.filter(|corners| corners.first() == Some(&from) && corners.last() == Some(&to));
            let known = known.filter(|corners| ground.obstacles.under(corners, &within).is_empty());
            let around = |net: usize| ground.obstacles.around(&Ends { from, to, within: &within, net });
            let found = known.cloned().or_else(|| around(self.net(wire))).or_else(|| around(0));
            corners = found.unwrap_or_default();
        }
        let curves = match (&corners[..], direct.is_empty()) {
            ([], true) => vec![bow(from, to, 1.0)],
            ([], false) => direct,
            (corners, _) => rounded(&corners.iter().map(|[x, y]| Pos2::new(*x, *y)).collect::<Vec<_>>()),
        };
        let bounds = Rect::from_points(curves.as_flattened());
        Path { curves, bounds, lines: Vec::new(), corners }
    }

    /// Which wires pass under which nodes, as `producer.output to consumer.input under node`.
    pub fn wires_under_nodes(&self, view: &GraphView) -> Vec<String> {
        let ground = self.ground();
        let wires = view.wires.iter().zip(&self.paths.wires);
        let under = wires.flat_map(|(wire, path)| {
            let found = ground.under(&path.curves, &ground.around_ends(view, wire));
            let nodes = found.into_iter().filter(|n| *n < ground.nodes);
            nodes.map(move |n| {
                let (from, to) = (view.nodes[wire.from].id(), view.nodes[wire.to].id());
                format!("{from}.{} to {to}.{} under {}", wire.output, wire.input, view.nodes[n].id())
            })
        });
        under.collect()
    }

    /// Makes lines of the paths again if the scale changed.
    pub(super) fn follow_scale(&mut self) {
        let scale = self.scale();
        if self.paths.scale != scale {
            self.paths.scale = scale;
            for path in &mut self.paths.wires {
                let lines = path.curves.iter().map(|curve| flattened_to(curve, PRECISE / scale));
                path.lines = match scale < PICTURES {
                    true => vec![simplified(&lines.flatten().collect::<Vec<_>>(), FAR / scale)],
                    false => lines.collect(),
                };
            }
        }
    }
}
