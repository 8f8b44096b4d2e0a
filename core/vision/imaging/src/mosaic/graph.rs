//! Overlaps between keyframes.

use super::keyframe::{Keyframe, index_of};
use super::outline::distance;
use crate::geometry::Point;

/// Maximum number of point pairs of an edge.
pub(super) const MAX_PAIRS: usize = 24;
/// Edges per keyframe for which memory is reserved.
const EDGES_PER_KEYFRAME: usize = 8;
/// An edge between keyframes that were this many edges apart, or not connected, closes a loop.
const LOOP_HOPS: usize = 4;

/// Corresponding points of two keyframes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    /// Keyframe of the first point of each pair.
    pub from: u64,
    /// Keyframe of the second point.
    pub to: u64,
    /// In pixels of each keyframe.
    pub pairs: [(Point, Point); MAX_PAIRS],
    pub count: usize,
    /// Weight of each pair.
    pub weight: f64,
}

impl Edge {
    /// The pairs in use.
    pub fn pairs(&self) -> &[(Point, Point)] {
        &self.pairs[..self.count]
    }

    /// Root mean square distance in pixels of `to` between the pairs and their positions by the keyframes' poses.
    pub fn error_px(&self, from: &Keyframe, to: &Keyframe) -> Option<f64> {
        let map = to.mosaic_from_frame.inverse()?.compose(&from.mosaic_from_frame);
        let squares: f64 = self.pairs().iter().map(|(p, q)| map.squared_error(*p, *q)).sum();
        let error = (squares / self.count.max(1) as f64).sqrt();
        error.is_finite().then_some(error)
    }
}

/// Connection of two keyframes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Route {
    pub hops: usize,
    /// Length through the centres of the keyframes on the path, in pixels of the mosaic.
    pub length_px: f64,
}

impl Route {
    /// Whether an edge between the two ends would close a loop.
    pub fn is_long(&self) -> bool {
        self.hops >= LOOP_HOPS
    }
}

/// The edges, oldest first.
#[derive(Clone, Debug, Default)]
pub(super) struct Graph {
    edges: Vec<Edge>,
    queue: Vec<usize>,
    reached: Vec<Option<Route>>,
}

impl Graph {
    /// Reserves memory for this many keyframes.
    pub fn reserve(&mut self, keyframes: usize) {
        let edges = keyframes * EDGES_PER_KEYFRAME;
        self.edges.reserve(edges.saturating_sub(self.edges.len()));
        self.queue.reserve(keyframes);
        self.reached.reserve(keyframes);
    }

    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    pub fn add(&mut self, edge: Edge) {
        self.edges.push(edge);
    }

    pub fn is_edge(&self, a: u64, b: u64) -> bool {
        self.edges.iter().any(|e| (e.from, e.to) == (a, b) || (e.from, e.to) == (b, a))
    }

    /// Removes all edges of a keyframe.
    pub fn forget(&mut self, id: u64) {
        self.edges.retain(|e| e.from != id && e.to != id);
    }

    /// The path with the fewest edges between two keyframes; `None` when there is none.
    pub fn route(&mut self, keyframes: &[Keyframe], from: u64, to: u64) -> Option<Route> {
        let (start, goal) = (index_of(keyframes, from)?, index_of(keyframes, to)?);
        self.reached.clear();
        self.reached.resize(keyframes.len(), None);
        self.queue.clear();
        self.queue.push(start);
        self.reached[start] = Some(Route { hops: 0, length_px: 0.0 });
        let mut next = 0;
        while let Some(&at) = self.queue.get(next) {
            next += 1;
            let (id, centre) = (keyframes[at].id, keyframes[at].outline.centre);
            let Some(here) = self.reached[at] else { continue };
            if at == goal {
                return Some(here);
            }
            for edge in self.edges.iter().filter(|e| e.from == id || e.to == id) {
                let other = if edge.from == id { edge.to } else { edge.from };
                let Some(index) = index_of(keyframes, other).filter(|i| self.reached[*i].is_none()) else { continue };
                let length_px = here.length_px + distance(centre, keyframes[index].outline.centre);
                self.reached[index] = Some(Route { hops: here.hops + 1, length_px });
                self.queue.push(index);
            }
        }
        None
    }
}
