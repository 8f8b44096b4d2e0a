//! The paths of all wires in points of the graph, kept until a node moves: while the view moves they are only shifted.

use eframe::egui::{Pos2, Rect};

use super::Canvas;
use super::curve::flattened_to;
use super::shape::PICTURES;
use panoscope_editor_model::graph_view::GraphView;

/// The path of a wire.
#[derive(Clone, Debug)]
pub(super) struct Path {
    /// Its curves.
    pub curves: Vec<[Pos2; 4]>,
    /// The rectangle around their control points.
    pub bounds: Rect,
    /// Its curves as lines, for the scale of the last drawing.
    pub lines: Vec<Vec<Pos2>>,
    /// Whether it goes backward on a way of its own.
    pub around: bool,
}

/// The paths, with what they were made of.
#[derive(Clone, Debug, Default)]
pub(super) struct Paths {
    /// One for each wire of the graph, in the same order.
    pub wires: Vec<Path>,
    places: Vec<Pos2>,
    layout: u64,
    scale: f32,
}

impl Canvas {
    /// Makes the paths again if a node moved or the layout changed.
    pub(super) fn follow_places(&mut self, view: &GraphView) {
        let place = |id: &String| self.positions.get(id).copied().unwrap_or_default();
        self.places = self.ids.iter().map(place).collect();
        if self.paths.layout != self.layouts || self.paths.places != self.places {
            let path = |wire| {
                let curves = self.curves(view, wire);
                let bounds = Rect::from_points(curves.as_flattened());
                Path { bounds, lines: Vec::new(), around: self.goes_around(wire), curves }
            };
            let wires = view.wires.iter().map(path).collect();
            self.paths = Paths { wires, places: self.places.clone(), layout: self.layouts, scale: 0.0 };
        }
    }

    /// Makes lines of the paths again if the scale changed.
    pub(super) fn follow_scale(&mut self) {
        let scale = self.scale();
        if self.paths.scale != scale {
            self.paths.scale = scale;
            // Of hundreds of nodes wires are thin and short.
            let tolerance = if scale < PICTURES { 1.0 } else { 0.25 } / scale;
            for path in &mut self.paths.wires {
                path.lines = path.curves.iter().map(|curve| flattened_to(curve, tolerance)).collect();
            }
        }
    }
}
