//! Keeps the image of an instrument straight: around it the mesh is the homography displaced by one vector.
//!
//! A homography keeps lines straight. The displacement is the mean of the mesh there, changes slowly, and fades into
//! the mesh next to the instrument. Where the other view continues an instrument of the reference view, the displacement is that of the instrument.

use super::Lattice;
use super::instruments::{Arrangement, Instruments, JOINT_PX, MAX_INSTRUMENTS};
use super::kept::Kept;
use super::track::Sloped;
use crate::geometry::{Point, length};

/// Distance from an instrument within which the mesh is rigid, cells; includes all corners of a cell with an
/// instrument.
const FULL_CELLS: f64 = 1.5;
/// Cells beyond those over which it fades.
const FADE_CELLS: f64 = 5.0;
/// Decay of a weight per frame after the instrument has gone.
const LEFT: f32 = 0.9;
/// Maximum increase of a weight per frame.
const MAX_RISE: f32 = 0.2;
/// Share of a new displacement that enters the running one per frame.
const RATE: f64 = 0.1;
/// Share of a new displacement between the views of an instrument that enters the running one per frame.
const MATCHED_RATE: f64 = 0.5;
/// Weights below this count as 0.
const MIN_WEIGHT: f32 = 0.01;

/// Weights of the vertices of one view.
#[derive(Clone, Debug, Default)]
struct Weights {
    /// Distance to the nearest instrument, px, and its number.
    distance_px: Vec<f32>,
    nearest: Vec<u8>,
    /// Weight; 1 where the mesh is rigid.
    weight: Vec<f32>,
}

/// Weights of the vertices, and their target displacements.
#[derive(Clone, Debug, Default)]
pub struct Rigid {
    lattice: Lattice,
    /// Weights for instruments shown by the reference view, and by the other view.
    weights: [Weights; 2],
    /// Displacement of the other view against the homography, px.
    shift: Vec<Point>,
    /// The positions of the vertices by the homography of the previous frame, and by how much they have moved since, px.
    base: Vec<Point>,
    moved: Vec<Point>,
    is_used: [bool; 2],
}

impl Rigid {
    /// Forgets all weights.
    pub fn forget(&mut self) {
        self.is_used = [false; 2];
    }

    /// Updates the weights with the instruments of a frame. `drawn`: positions of the vertices in the other view by the
    /// mesh, `base`: by the homography. A `new` mesh takes the weights immediately.
    pub fn update(
        &mut self,
        instruments: &mut Instruments,
        how: &Arrangement,
        lattice: &Lattice,
        [drawn, base]: [&[Point]; 2],
        is_new: bool,
    ) {
        let rate = if is_new { 1.0 } else { RATE };
        let is_new = is_new || self.lattice != *lattice;
        self.lattice = *lattice;
        self.follow_base(base, is_new);
        for (which, view) in [Kept::Reference, Kept::Other].into_iter().enumerate() {
            let weights = &mut self.weights[which];
            if is_new || !self.is_used[which] {
                weights.weight.clear();
            }
            weights.weight.resize(lattice.len(), 0.0);
            let is_shown = instruments.is_any() && weights.measure(instruments, how, lattice, view);
            if !is_shown && !self.is_used[which] {
                continue;
            }
            if !is_shown {
                weights.distance_px.clear();
                weights.distance_px.resize(lattice.len(), f32::MAX);
            }
            if view == Kept::Other {
                let full = FULL_CELLS * lattice.cell_px as f64;
                let moved = &self.moved;
                follow_shifts(instruments, weights, (lattice, how.axis()), (full as f32, rate), [drawn, base, moved]);
                self.shift.resize(lattice.len(), [0.0; 2]);
            }
            self.is_used[which] = false;
            for vertex in 0..lattice.len() {
                let glide = weights.nearest.get(vertex).filter(|number| **number > 0);
                let glide = glide.map_or(0.0, |number| instruments.track(*number as usize).glide);
                let target = target(weights.distance_px[vertex], lattice.cell_px as f32, 1.0 + glide as f32);
                // A mesh halfway would bend it.
                let jumps = target > 0.0 && instruments.track(weights.nearest[vertex] as usize).jumps;
                let held = if jumps { 0.0 } else { weights.weight[vertex] };
                let weight = if is_new || jumps { target } else { target.max(LEFT * held).min(held + MAX_RISE) };
                let weight = if weight < MIN_WEIGHT { 0.0 } else { weight };
                weights.weight[vertex] = weight;
                self.is_used[which] |= weight > 0.0;
                if view == Kept::Other && target > 0.0 {
                    let own = lattice.position(vertex % lattice.columns, vertex / lattice.columns);
                    let track = instruments.track(weights.nearest[vertex] as usize);
                    let Some(wanted) = track.displacement(own) else { continue };
                    let share = if held > 0.0 { f64::from((target / weight.max(target)).min(1.0)) } else { 1.0 };
                    let shift = &mut self.shift[vertex];
                    *shift = [0, 1].map(|k| shift[k] + share * (wanted[k] - shift[k]));
                }
            }
        }
    }

    /// Keeps displaced positions where they are when the homography changes: it is measured anew at intervals, and a step of it
    /// would move the instruments against the tissue.
    fn follow_base(&mut self, base: &[Point], is_new: bool) {
        self.moved.clear();
        if is_new || self.base.len() != base.len() {
            self.moved.resize(base.len(), [0.0; 2]);
        } else {
            self.moved.extend(base.iter().zip(&self.base).map(|(now, then)| [now[0] - then[0], now[1] - then[1]]));
        }
        for (shift, moved) in self.shift.iter_mut().zip(&self.moved) {
            *shift = [shift[0] - moved[0], shift[1] - moved[1]];
        }
        self.base.clear();
        self.base.extend_from_slice(base);
    }

    /// Makes the mesh of the other view rigid around the instruments that it shows.
    pub fn straighten(&self, drawn: &mut [Point], base: &[Point]) {
        if !self.is_used[1] || self.weights[1].weight.len() != drawn.len() {
            return;
        }
        for (vertex, weight) in self.weights[1].weight.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            let (at, base, shift) = (&mut drawn[vertex], base[vertex], self.shift[vertex]);
            *at = [0, 1].map(|k| at[k] + f64::from(*weight) * (base[k] + shift[k] - at[k]));
        }
    }

    /// Keeps the reference view unchanged around the instruments that it shows.
    pub fn keep_reference(&self, shown: &mut [Point], lattice: &Lattice) {
        if !self.is_used[0] || self.weights[0].weight.len() != shown.len() {
            return;
        }
        for (vertex, weight) in self.weights[0].weight.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            let own = lattice.position(vertex % lattice.columns, vertex / lattice.columns);
            shown[vertex] = [0, 1].map(|k| shown[vertex][k] + f64::from(*weight) * (own[k] - shown[vertex][k]));
        }
    }
}

/// Weight at a distance from an instrument. It fades over `widths` times the usual distance, so that a large displacement
/// bends the tissue less.
fn target(distance_px: f32, cell_px: f32, widths: f32) -> f32 {
    let t = 1.0 - (distance_px / cell_px - FULL_CELLS as f32) / (widths * FADE_CELLS as f32);
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Moves the displacement of each instrument towards the mean of the mesh within `full_px` of it by the share `rate`. What a joined one needs to go on
/// across the border is added, which is its own displacement without the part along itself.
fn follow_shifts(
    instruments: &mut Instruments,
    weights: &Weights,
    (lattice, axis): (&Lattice, usize),
    (full_px, rate): (f32, f64),
    [drawn, base, moved]: [&[Point]; 3],
) {
    let mut sums = [[0.0f64; 5]; MAX_INSTRUMENTS];
    for (vertex, _) in weights.distance_px.iter().enumerate().filter(|(_, distance)| **distance <= full_px) {
        let sum = &mut sums[weights.nearest[vertex] as usize - 1];
        let (at, base, moved) = (drawn[vertex], base[vertex], moved[vertex]);
        let terms = [at[0] - base[0], at[1] - base[1], 1.0, moved[0], moved[1]];
        sum.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    }
    for (index, [x, y, count, moved_x, moved_y]) in sums.into_iter().enumerate().filter(|(_, sum)| sum[2] > 0.0) {
        let track = instruments.track_mut(index + 1);
        let moved = [moved_x / count, moved_y / count];
        track.shift = track.shift.map(|held| [held[0] - moved[0], held[1] - moved[1]]);
        track.matched.iter_mut().for_each(|held| held.move_by([-moved[0], -moved[1]]));
        let mean = [x / count, y / count];
        if let Some(ends) = track.ends
            && let Some(new) = matched(lattice, base, ends)
        {
            track.matched.get_or_insert(new).approach(&new, MATCHED_RATE);
        }
        let joint = track.joint.and_then(|[here, there]| {
            let (cell, t) = lattice.cell_of(here)?;
            let base = lattice.interpolate(|vertex| base[vertex], cell, t);
            let off = [0, 1].map(|k| there[k] - base[k] - mean[k]);
            // A shaft looks the same everywhere along itself: only what moves it across itself is needed, and tissue is bent less.
            let slope = track.slope?;
            let across = (off[1 - axis] - slope * off[axis]) / (1.0 + slope * slope);
            let mut moved = mean;
            moved[axis] -= slope * across;
            moved[1 - axis] += across;
            Some(moved)
        });
        let mean = joint.unwrap_or(mean);
        track.shift = Some(match track.shift {
            Some(held) => [0, 1].map(|k| held[k] + rate * (mean[k] - held[k])),
            None => mean,
        });
    }
}

/// The displacement from the homography that shows two places of the other view at those of the reference view; `None` outside the mesh.
fn matched(lattice: &Lattice, base: &[Point], ends: [[Point; 2]; 2]) -> Option<Sloped> {
    let off = |[here, there]: [Point; 2]| {
        let (cell, t) = lattice.cell_of(here)?;
        let base = lattice.interpolate(|vertex| base[vertex], cell, t);
        Some([0, 1].map(|k| there[k] - base[k]))
    };
    Some(Sloped::through([ends[0][0], ends[1][0]], [off(ends[0])?, off(ends[1])?]))
}

impl Weights {
    /// Sets the distance of each vertex to the nearest instrument of a view. Returns whether there is one.
    fn measure(&mut self, instruments: &Instruments, how: &Arrangement, lattice: &Lattice, view: Kept) -> bool {
        self.distance_px.clear();
        self.distance_px.resize(lattice.len(), f32::MAX);
        self.nearest.clear();
        self.nearest.resize(lattice.len(), 0);
        let in_either = view == Kept::Other;
        let axis = how.axis();
        let (size, cell_px) = instruments.grid();
        let end = size[axis] as f64 * cell_px as f64;
        let is_near_end = |at: Point, px: f64| if how.is_beyond_end() { at[axis] + px > end } else { at[axis] < px };
        // The cells at the rim itself are never matched.
        let last_px = 2.0 * cell_px as f64;
        let outwards = if how.is_beyond_end() { 1.0 } else { -1.0 };
        let mut is_any = false;
        for (at, number) in instruments.cells(in_either) {
            let track = instruments.track(number);
            let is_joint = in_either && track.joint.is_some() && is_near_end(at, JOINT_PX * how.scale);
            let is_shown = if in_either { track.view == view } else { instruments.is_for_reference(number) };
            if !is_shown && !is_joint {
                continue;
            }
            is_any = true;
            self.mark(lattice, at, number);
            // Only the other view sees how an instrument goes on beyond the border: straight.
            let Some(slope) = track.slope.filter(|_| in_either && is_near_end(at, last_px)) else { continue };
            let step = 0.5 * lattice.cell_px as f64;
            for n in 1..=4 * lattice.columns.max(lattice.rows) {
                let mut next = at;
                next[axis] += outwards * step * n as f64;
                next[1 - axis] += outwards * slope * step * n as f64;
                if !self.mark(lattice, next, number) {
                    break;
                }
            }
        }
        if is_any {
            self.spread(lattice);
        }
        is_any
    }

    /// Marks an instrument at a position. Returns whether it is inside the mesh.
    fn mark(&mut self, lattice: &Lattice, at: Point, number: usize) -> bool {
        let Some(((column, row), _)) = lattice.cell_of(at) else { return false };
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let own = lattice.position(column + dx, row + dy);
            let distance = length([own[0] - at[0], own[1] - at[1]]) as f32;
            let vertex = (row + dy) * lattice.columns + column + dx;
            if distance < self.distance_px[vertex] {
                (self.distance_px[vertex], self.nearest[vertex]) = (distance, number as u8);
            }
        }
        true
    }

    /// Propagates distances between vertices, forwards and backwards.
    fn spread(&mut self, lattice: &Lattice) {
        let (columns, rows) = (lattice.columns as isize, lattice.rows as isize);
        let side = lattice.cell_px as f32;
        for forth in [1isize, -1] {
            for n in 0..lattice.len() as isize {
                let vertex = if forth > 0 { n } else { columns * rows - 1 - n };
                let (x, y) = (vertex % columns, vertex / columns);
                for (dx, dy) in [(-1, 0), (-1, -1), (0, -1), (1, -1)] {
                    let (u, v) = (x + forth * dx, y + forth * dy);
                    if u < 0 || v < 0 || u >= columns || v >= rows {
                        continue;
                    }
                    let (from, to) = ((v * columns + u) as usize, vertex as usize);
                    let way = if dx != 0 && dy != 0 { side * std::f32::consts::SQRT_2 } else { side };
                    let distance = self.distance_px[from] + way;
                    if distance < self.distance_px[to] {
                        (self.distance_px[to], self.nearest[to]) = (distance, self.nearest[from]);
                    }
                }
            }
        }
    }
}
