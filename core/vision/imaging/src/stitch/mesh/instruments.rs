//! Instruments in front of the tissue, found by steps of disparity, and the view that shows each of them.
//!
//! The cells of the reference view whose disparity lies before the mesh make up instruments; metal is often unmatched,
//! so that unmatched cells next to them count as well. An instrument has two positions: its own in the reference view,
//! and one displaced by its parallax in the other view. The panorama shows it completely if one view shows both
//! positions and everything between them. Where neither view does, the reference view shows it up to its border, and the other view is displaced
//! there by the instrument's parallax, so that it goes on without a step.

use super::hints::{Hint, InstrumentHints};
use super::kept::{Keep, Kept, KeptCells};
use super::observe::Observations;
use super::track::{BAND_PX, BORDER_PX, Cut, Track};
use crate::geometry::Point;

/// Maximum number of tracked instruments.
pub const MAX_INSTRUMENTS: usize = 8;
/// Parallax against the mesh of a cell that shows an instrument, px of a view of 640 columns; less is required inside a
/// detector's box.
const SEED_PX: f32 = 12.0;
const HINTED_SEED_PX: f32 = 6.0;
/// Parallax of further cells of it.
const GROW_PX: f32 = 5.0;
/// Minimum number of seeds of an instrument; random matches make smaller pieces.
const MIN_SEEDS: usize = 36;
const MIN_HINTED_SEEDS: usize = 6;
/// Maximum distance between cells of an instrument; their parallax differs by at most [`MAX_STEP_PX`] per cell.
const GAP_CELLS: usize = 2;
const MAX_STEP_PX: f32 = 4.0;
/// Maximum distance of unmatched cells from a matched one of their instrument.
const UNMATCHED_CELLS: u8 = 14;
/// Maximum share of the cells of an instrument; larger objects are the scene.
const MAX_SHARE: f64 = 0.45;
/// Minimum share of a piece's cells of an instrument that takes part in it.
const MIN_VOTES: f64 = 0.15;
/// Frames for which an instrument is kept when it is not found.
const KEPT_FRAMES: u32 = 6;
/// Distance from the border of the reference view within which the views are joined at an instrument, px.
pub const JOINT_PX: f64 = 80.0;

/// Maximum distance of shared unmatched cells from both pieces of one instrument.
const MAX_CONTACT: u8 = 8;

/// Geometry of the views for instruments.
#[derive(Clone, Copy, Debug)]
pub struct Arrangement {
    /// Position of the other camera, in baselines.
    pub along: [f64; 2],
    /// Scale of lengths from a view of 640 columns to px of the map.
    pub scale: f64,
    /// Overlap of the views, in cells: first and last column and row.
    pub shared: [[usize; 2]; 2],
    /// Pixels of the images per pixel of the map.
    pub factor: usize,
    /// Distance around an instrument in which its view is kept, px of the map; half of it with certainty.
    pub margin_px: f64,
}

impl Arrangement {
    /// 0 if the other camera is displaced more horizontally than vertically, else 1.
    pub fn axis(&self) -> usize {
        usize::from(self.along[1].abs() > self.along[0].abs())
    }

    /// Whether the other view reaches beyond the far side of the reference view.
    pub fn is_beyond_end(&self) -> bool {
        self.along[self.axis()] >= 0.0
    }
}

/// Parallax relative to the mesh of a point with displacement `off` in the other view, px. `along`: position of the
/// other camera.
pub fn nearer_px([x, y]: [f64; 2], off: Point) -> f64 {
    -(off[0] * x + off[1] * y) / (x * x + y * y).sqrt().max(1e-9)
}

/// The instruments of a view, on the grid of observations.
#[derive(Clone, Debug, Default)]
pub struct Instruments {
    pub(super) cell_px: usize,
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Parallax against the mesh, px; NaN where unmatched.
    nearer: Vec<f32>,
    /// Number of the instrument that the reference view shows in a cell, from 1; 0 for none. The number of the previous
    /// frame and the parallax follow.
    pub(super) own: Vec<u8>,
    before: Vec<u8>,
    nearer_before: Vec<f32>,
    /// Number of the instrument that either view draws in a cell.
    drawn: Vec<u8>,
    pub(super) sure: Vec<u8>,
    is_visited: Vec<bool>,
    depth: Vec<u8>,
    queue: Vec<usize>,
    line: Vec<u8>,
    /// Offsets in columns and rows from a cell to those on the way to its position in the other view.
    steps: Vec<[isize; 2]>,
    /// Cut-offs of this frame's instruments.
    pub(super) cuts: [Cut; MAX_INSTRUMENTS],
    pub(super) tracks: [Track; MAX_INSTRUMENTS],
}

impl Instruments {
    /// Forgets all instruments.
    pub fn forget(&mut self) {
        self.own.clear();
        self.drawn.clear();
        self.tracks = Default::default();
    }

    /// Starts a frame: no cell is matched.
    pub fn begin(&mut self, cell_px: usize, columns: usize, rows: usize) {
        let count = columns * rows;
        if (self.cell_px, self.columns, self.rows) != (cell_px, columns, rows) {
            self.forget();
            (self.cell_px, self.columns, self.rows) = (cell_px, columns, rows);
        }
        std::mem::swap(&mut self.nearer, &mut self.nearer_before);
        self.nearer.clear();
        self.nearer.resize(count, f32::NAN);
        self.nearer_before.resize(count, f32::NAN);
        self.own.resize(count, 0);
    }

    /// Sets a matched cell that is `nearer_px` nearer than the mesh. Cells at the rim, which are compared with fewer
    /// neighbours, count as unmatched.
    pub fn set(&mut self, cell: usize, nearer_px: f64) {
        let (x, y) = (cell % self.columns, cell / self.columns);
        if x > 0 && y > 0 && x + 1 < self.columns && y + 1 < self.rows {
            self.nearer[cell] = nearer_px as f32;
        }
    }

    /// Whether a cell showed an instrument, in either view, in the previous frame.
    pub fn was_at(&self, cell: usize) -> bool {
        self.drawn.get(cell).is_some_and(|label| *label != 0)
    }

    /// Whether there are instruments.
    pub fn is_any(&self) -> bool {
        self.tracks.iter().any(|track| track.view != Kept::Free)
    }

    /// Centre of each cell that shows an instrument, px, and its number; in the reference view only, or in either view.
    pub fn cells(&self, in_either: bool) -> impl Iterator<Item = (Point, usize)> {
        let labels = if in_either { &self.drawn } else { &self.own };
        let centre = |index: usize| (index as f64 + 0.5) * self.cell_px as f64;
        let place = move |cell: usize| [centre(cell % self.columns), centre(cell / self.columns)];
        labels.iter().enumerate().filter(|(_, label)| **label != 0).map(move |(i, label)| (place(i), *label as usize))
    }

    /// Columns and rows of the grid, and the side of its cells, px.
    pub fn grid(&self) -> ([usize; 2], usize) {
        ([self.columns, self.rows], self.cell_px)
    }

    /// The instrument of this number, from 1.
    pub fn track(&self, number: usize) -> &Track {
        &self.tracks[number - 1]
    }

    /// The mutable instrument of this number, from 1.
    pub fn track_mut(&mut self, number: usize) -> &mut Track {
        &mut self.tracks[number - 1]
    }

    /// Finds the instruments of a frame whose matched cells are set, and chooses the view of each.
    pub fn find(
        &mut self,
        observations: &Observations,
        how: &Arrangement,
        hints: &InstrumentHints,
        kept: &mut KeptCells,
    ) {
        let least = SEED_PX * how.scale as f32;
        let seeds = self.nearer.iter().filter(|nearer| **nearer >= least).count();
        if seeds < MIN_SEEDS && hints.is_empty() && !self.is_any() {
            self.drawn.clear();
            kept.clear();
            return;
        }
        std::mem::swap(&mut self.own, &mut self.before);
        self.own.clear();
        self.own.resize(self.nearer.len(), 0);
        self.before.resize(self.nearer.len(), 0);
        self.cuts = Default::default();
        self.find_pieces(observations, how, hints);
        self.sure.clone_from(&self.own);
        self.add_unmatched(how, hints);
        self.join_pieces();
        self.keep_missing();
        self.choose(observations, how);
        self.draw(how);
        self.keep_views(how, kept);
    }

    fn hint(&self, cell: usize, how: &Arrangement, hints: &InstrumentHints) -> Hint {
        if hints.is_empty() {
            return Hint::Nothing;
        }
        let centre = |index: usize| (index as f64 + 0.5) * (self.cell_px * how.factor) as f64;
        hints.at([centre(cell % self.columns), centre(cell / self.columns)])
    }

    /// Sets `own` where matched cells make up an instrument.
    fn find_pieces(&mut self, observations: &Observations, how: &Arrangement, hints: &InstrumentHints) {
        let [seed, hinted_seed, grow, step] =
            [SEED_PX, HINTED_SEED_PX, GROW_PX, MAX_STEP_PX].map(|px| px * how.scale as f32);
        let most = (MAX_SHARE * self.own.len() as f64) as usize;
        self.is_visited.clear();
        self.is_visited.resize(self.own.len(), false);
        for start in 0..self.own.len() {
            let is_certain = !hints.is_empty() && self.hint(start, how, hints) == Hint::Certain;
            if self.is_visited[start] || !(self.nearer[start] >= grow || is_certain) {
                continue;
            }
            let (mut seeds, mut hinted) = (0, 0);
            let mut piece = std::mem::take(&mut self.queue);
            piece.clear();
            piece.push(start);
            self.is_visited[start] = true;
            let mut next = 0;
            while let Some(&cell) = piece.get(next) {
                next += 1;
                let nearer = self.nearer[cell];
                let hint = self.hint(cell, how, hints);
                seeds += usize::from(nearer >= seed);
                hinted += usize::from(hint == Hint::Certain || (hint == Hint::Likely && nearer >= hinted_seed));
                let (x, y) = (cell % self.columns, cell / self.columns);
                for row in y.saturating_sub(GAP_CELLS)..(y + GAP_CELLS + 1).min(self.rows) {
                    for column in x.saturating_sub(GAP_CELLS)..(x + GAP_CELLS + 1).min(self.columns) {
                        let to = row * self.columns + column;
                        if self.is_visited[to] {
                            continue;
                        }
                        let other = self.nearer[to];
                        let cells = column.abs_diff(x).max(row.abs_diff(y)) as f32;
                        let is_near = other >= grow && (nearer.is_nan() || (other - nearer).abs() <= step * cells);
                        if is_near || (!hints.is_empty() && self.hint(to, how, hints) == Hint::Certain) {
                            self.is_visited[to] = true;
                            piece.push(to);
                        }
                    }
                }
            }
            if (seeds >= MIN_SEEDS || hinted >= MIN_HINTED_SEEDS) && piece.len() <= most {
                let cut = self.cut_of(&piece, observations, how);
                self.number(&piece, cut);
            }
            self.queue = piece;
        }
    }

    /// Whether a cell is among the first `cells` at the border of the reference view beyond which the other view reaches.
    pub(super) fn is_near_border(&self, place: [usize; 2], cells: usize, how: &Arrangement) -> bool {
        let (place, size) = (place[how.axis()], [self.columns, self.rows][how.axis()]);
        if how.is_beyond_end() { place + cells >= size } else { place < cells }
    }

    /// Whether a cell is so near to that border that its instrument counts as cut off.
    fn is_at_border(&self, place: [usize; 2], how: &Arrangement) -> bool {
        let border = (BORDER_PX * how.scale / self.cell_px as f64).round().max(1.0) as usize;
        self.is_near_border(place, border, how)
    }

    /// The borders of views that cut a piece off.
    fn cut_of(&self, piece: &[usize], observations: &Observations, how: &Arrangement) -> Cut {
        let axis = how.axis();
        let size = [self.columns, self.rows][axis];
        let mut cut = Cut::default();
        for cell in piece {
            cut.by_reference += usize::from(self.is_at_border([cell % self.columns, cell / self.columns], how));
            let seen = &observations.cells[*cell];
            if seen.weight != 0.0 {
                let source = seen.source[axis];
                let far = if how.is_beyond_end() { source } else { (size * self.cell_px) as f64 - source };
                let band = (far / (BAND_PX * how.scale)).max(0.0) as usize;
                if let Some(cells) = cut.bands.get_mut(band) {
                    *cells += 1;
                }
            }
        }
        cut
    }

    /// Gives the cells of a piece the number of the instrument that was there, or a new one.
    fn number(&mut self, piece: &[usize], cut: Cut) {
        let mut votes = [0usize; MAX_INSTRUMENTS + 1];
        for cell in piece {
            votes[self.before[*cell] as usize] += 1;
        }
        let least = ((MIN_VOTES * piece.len() as f64) as usize).max(1);
        let takes_part = |label: usize| label > 0 && votes[label] >= least;
        let best = (1..=MAX_INSTRUMENTS).filter(|label| takes_part(*label)).max_by_key(|label| votes[*label]);
        let Some(best) = best else {
            let Some(free) = self.tracks.iter().position(|track| track.view == Kept::Free && track.shift.is_none())
            else {
                return;
            };
            // Marked as used until its view is chosen.
            self.tracks[free].shift = Some([f64::NAN; 2]);
            piece.iter().for_each(|cell| self.own[*cell] = free as u8 + 1);
            self.cuts[free] = cut;
            return;
        };
        self.cuts[best - 1].add(cut);
        // Instruments that touch, and are shown by different views, stay two, unless the reference view shows both as far as it reaches.
        let (view, is_joined) = (self.tracks[best - 1].view, self.cuts[best - 1].is_twice());
        let is_two = |label: usize| !is_joined && takes_part(label) && self.tracks[label - 1].view != view;
        if !(1..=MAX_INSTRUMENTS).any(is_two) {
            piece.iter().for_each(|cell| self.own[*cell] = best as u8);
            return;
        }
        for cell in piece {
            let label = self.before[*cell];
            self.own[*cell] = if label as usize == best || is_two(label as usize) { label } else { 0 };
        }
        let mut is_changed = true;
        while is_changed {
            is_changed = false;
            for cell in piece {
                if self.own[*cell] == 0
                    && let Some(label) = self.neighbour(*cell)
                {
                    (self.own[*cell], is_changed) = (label, true);
                }
            }
        }
        for cell in piece {
            if self.own[*cell] == 0 {
                self.own[*cell] = best as u8;
            }
        }
    }

    /// Number of an instrument in a cell within reach.
    fn neighbour(&self, cell: usize) -> Option<u8> {
        let (x, y) = (cell % self.columns, cell / self.columns);
        let rows = y.saturating_sub(GAP_CELLS)..(y + GAP_CELLS + 1).min(self.rows);
        let columns = x.saturating_sub(GAP_CELLS)..(x + GAP_CELLS + 1).min(self.columns);
        rows.flat_map(|row| columns.clone().map(move |column| row * self.columns + column))
            .map(|near| self.own[near])
            .find(|label| *label != 0)
    }

    /// Adds the unmatched cells next to instruments, with the parallax of the nearest matched one.
    fn add_unmatched(&mut self, how: &Arrangement, hints: &InstrumentHints) {
        self.queue.clear();
        self.queue.extend((0..self.own.len()).filter(|cell| self.own[*cell] != 0));
        self.depth.clear();
        self.depth.resize(self.own.len(), 0);
        let [[x0, x1], [y0, y1]] = how.shared;
        let mut next = 0;
        while let Some(&cell) = self.queue.get(next) {
            next += 1;
            if self.depth[cell] >= UNMATCHED_CELLS {
                continue;
            }
            let (x, y) = (cell % self.columns, cell / self.columns);
            // Not along the rim, where nothing counts as matched.
            let rows = y.saturating_sub(1).max(y0).max(1)..(y + 2).min(y1 + 1).min(self.rows - 1);
            let columns = x.saturating_sub(1).max(x0).max(1)..(x + 2).min(x1 + 1).min(self.columns - 1);
            let wide = self.columns;
            for to in rows.flat_map(|row| columns.clone().map(move |column| row * wide + column)) {
                if self.own[to] == 0 && self.nearer[to].is_nan() {
                    self.own[to] = self.own[cell];
                    self.nearer[to] = self.nearer[cell];
                    // A detector tells how far it reaches.
                    let step = u8::from(self.hint(to, how, hints) == Hint::Nothing);
                    self.depth[to] = self.depth[cell] + step;
                    self.queue.push(to);
                    let place = [to % self.columns, to / self.columns];
                    self.cuts[self.own[to] as usize - 1].by_reference += usize::from(self.is_at_border(place, how));
                }
            }
        }
    }

    /// Joins instruments that touch, such as jaws, unless different views show them, each as a whole.
    fn join_pieces(&mut self) {
        let mut cuts = self.cuts;
        let mut same: [u8; MAX_INSTRUMENTS + 1] = std::array::from_fn(|label| label as u8);
        for (cell, here) in self.own.iter().enumerate().filter(|(_, label)| **label != 0) {
            let (x, y) = (cell % self.columns, cell / self.columns);
            let rows = y..(y + GAP_CELLS + 1).min(self.rows);
            let columns = x.saturating_sub(GAP_CELLS)..(x + GAP_CELLS + 1).min(self.columns);
            let wide = self.columns;
            for near in rows.flat_map(|row| columns.clone().map(move |column| row * wide + column)) {
                let there = self.own[near];
                if self.depth[cell] + self.depth[near] > MAX_CONTACT {
                    continue;
                }
                let [a, b] = [*here, there].map(|label| same[label as usize]);
                if there == 0 || a == b {
                    continue;
                }
                let views = [a, b].map(|label| self.tracks[label as usize - 1].view);
                let mut both = cuts[a as usize - 1];
                both.add(cuts[b as usize - 1]);
                if both.is_twice() || views[0] == views[1] || views.contains(&Kept::Free) {
                    // The one that has a view stays.
                    let (stays, goes) = if views[0] == Kept::Free { (b, a) } else { (a, b) };
                    same.iter_mut().filter(|label| **label == goes).for_each(|label| *label = stays);
                    let gone = std::mem::take(&mut cuts[goes as usize - 1]);
                    cuts[stays as usize - 1].add(gone);
                }
            }
        }
        self.cuts = cuts;
        if same.iter().enumerate().all(|(label, same)| label == *same as usize) {
            return;
        }
        for label in 1..=MAX_INSTRUMENTS {
            if same[label] != label as u8 {
                self.tracks[label - 1] = Track::default();
            }
        }
        self.own.iter_mut().for_each(|label| *label = same[*label as usize]);
        self.sure.iter_mut().for_each(|label| *label = same[*label as usize]);
        self.before.iter_mut().for_each(|label| *label = same[*label as usize]);
    }

    /// Keeps the cells of an instrument that is not found for a few frames, then frees its slot.
    fn keep_missing(&mut self) {
        let mut is_seen = [false; MAX_INSTRUMENTS + 1];
        self.own.iter().for_each(|label| is_seen[*label as usize] = true);
        for (index, track) in self.tracks.iter_mut().enumerate() {
            track.missing_frames = if is_seen[index + 1] { 0 } else { track.missing_frames + 1 };
            if track.missing_frames > KEPT_FRAMES {
                *track = Track::default();
            }
        }
        for cell in 0..self.own.len() {
            let label = self.before[cell];
            if label == 0 || self.own[cell] != 0 || is_seen[label as usize] {
                continue;
            }
            if self.tracks[label as usize - 1].view != Kept::Free {
                self.own[cell] = label;
                self.nearer[cell] = self.nearer_before[cell];
            }
        }
    }

    /// Sets `drawn`: the instruments' positions in the reference view, in the other view, and all cells in between; and
    /// `sure`, the same for matched cells.
    fn draw(&mut self, how: &Arrangement) {
        self.drawn.clone_from(&self.own);
        let [x, y] = how.along;
        let long = (x * x + y * y).sqrt().max(1e-9);
        self.steps.clear();
        let limit = self.columns + self.rows;
        self.steps.extend((1..=limit).map(|step| [x, y].map(|along| (-along / long * step as f64).round() as isize)));
        for (cell, label) in self.own.iter().enumerate().filter(|(_, label)| **label != 0) {
            if self.tracks[*label as usize - 1].joint.is_some() {
                continue;
            }
            let is_sure = self.sure[cell] != 0;
            let cells = f64::from(self.nearer[cell]) / self.cell_px as f64;
            let start = [cell % self.columns, cell / self.columns];
            // NaN draws nothing.
            for step in self.steps.iter().take(cells.max(0.0).ceil() as usize) {
                let [Some(u), Some(v)] = [0, 1].map(|k| start[k].checked_add_signed(step[k])) else { break };
                if u >= self.columns || v >= self.rows {
                    break;
                }
                let passed = v * self.columns + u;
                for (labels, counts) in [(&mut self.drawn, true), (&mut self.sure, is_sure)] {
                    if counts && labels[passed] == 0 {
                        labels[passed] = *label;
                    }
                }
            }
        }
    }

    /// Keeps the view of each instrument in all cells around its drawn cells.
    fn keep_views(&mut self, how: &Arrangement, kept: &mut KeptCells) {
        if !self.is_any() {
            self.drawn.clear();
            kept.clear();
            return;
        }
        let cells = kept.reset(self.cell_px, self.columns, self.rows);
        for (labels, margin_px, is_sure) in
            [(&self.drawn, how.margin_px, false), (&self.sure, 0.5 * how.margin_px, true)]
        {
            let reach = (margin_px / self.cell_px as f64).round() as usize;
            // Row by row into `depth`, then column by column into the cells.
            self.depth.clear();
            self.depth.resize(labels.len(), 0);
            for (from, to) in labels.chunks_exact(self.columns).zip(self.depth.chunks_exact_mut(self.columns)) {
                spread(from, to, reach);
            }
            for column in 0..self.columns {
                self.line.clear();
                self.line.extend(self.depth.iter().skip(column).step_by(self.columns));
                self.line.resize(2 * self.rows, 0);
                let (from, to) = self.line.split_at_mut(self.rows);
                spread(from, to, reach);
                for (row, label) in to.iter().enumerate().filter(|(_, label)| **label != 0) {
                    let view = self.tracks[*label as usize - 1].view;
                    cells[row * self.columns + column] = Keep { view, is_sure };
                }
            }
        }
    }
}

/// Copies a line of numbers, and extends each by up to `reach` empty cells.
fn spread(from: &[u8], to: &mut [u8], reach: usize) {
    to.copy_from_slice(from);
    // Where the numbers before have reached.
    let mut reached = 0;
    for (i, label) in from.iter().enumerate().filter(|(_, label)| **label != 0) {
        let end = (i + reach + 1).min(from.len());
        for near in &mut to[i.saturating_sub(reach).max(reached)..end] {
            *near = if *near == 0 { *label } else { *near };
        }
        reached = end;
    }
}
