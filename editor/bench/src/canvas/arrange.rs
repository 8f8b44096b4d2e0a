//! Selected nodes arranged anew along the flow.

use eframe::egui::{Pos2, Rect};

use super::Canvas;
use panoscope_editor_model::folding::parent;
use panoscope_editor_model::graph_view::GraphView;
use panoscope_editor_model::layout::{self, Rectangle};

impl Canvas {
    /// New positions of the selected nodes and opened parts, in layers along the flow from where their upper left corner is, clear of all others.
    /// Of selected nodes of several levels only those of the outermost one move.
    pub fn arranged(&self, view: &GraphView) -> Vec<(String, (f32, f32))> {
        let nodes = self
            .ids
            .iter()
            .zip(&self.shapes)
            .filter_map(|(id, shape)| Some((id.as_str(), Rect::from_min_size(self.position(id)?, shape.size))));
        let all = nodes.chain(self.frames.iter().map(|(id, rect)| (id.as_str(), *rect)));
        let outer = self.selected.iter().map(|id| parent(id)).min_by_key(|part| part.len()).unwrap_or_default();
        let level = all.filter(|(id, _)| parent(id) == outer);
        let (items, others): (Vec<_>, Vec<_>) = level.partition(|(id, _)| self.selected.contains(*id));
        let Some(around) = items.iter().map(|(_, rect)| *rect).reduce(|a, b| a.union(b)) else { return Vec::new() };
        let item = |node: usize| {
            let id = view.nodes[node].id();
            items
                .iter()
                .position(|(item, _)| id.strip_prefix(*item).is_some_and(|r| r.is_empty() || r.starts_with('/')))
        };
        let pairs = |delayed: bool| -> Vec<(usize, usize)> {
            let wires = view.wires.iter().filter(|wire| wire.delayed == delayed);
            wires.filter_map(|wire| item(wire.from).zip(item(wire.to))).filter(|(from, to)| from != to).collect()
        };
        let sizes: Vec<[f32; 2]> = items.iter().map(|(_, rect)| rect.size().into()).collect();
        let laid = layout::fitted(&sizes, &pairs(false), &pairs(true), self.room().into()).positions;
        let rects = laid.iter().zip(&sizes).map(|(at, size)| Rect::from_min_size(Pos2::from(*at), (*size).into()));
        let Some(group) = rects.reduce(|a, b| a.union(b)) else { return Vec::new() };
        let taken: Vec<Rectangle> = others.iter().map(|(_, rect)| (rect.min.into(), rect.size().into())).collect();
        let corner = Pos2::from(layout::clear_of(around.min.into(), group.size().into(), &taken));
        let place = |at: &[f32; 2]| (Pos2::from(*at) + (corner - group.min)).round();
        items.iter().zip(&laid).map(|((id, _), at)| ((*id).to_owned(), place(at).into())).collect()
    }
}
