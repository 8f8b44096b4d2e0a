//! The mesh over time: fitted to each disparity map, stable while nothing moves, kept while nothing is observed.

mod gauge;
mod whole;

use std::ops::Range;

use super::super::rectified_view::RectifiedView;
use super::border::{Border, borders};
use super::energy::{Energy, Stiffness};
use super::hints::InstrumentHints;
use super::instruments::{Instruments, nearer_px};
use super::observe::{Observations, Sampling};
use super::relax::{Continuation, Relax};
use super::rigid::Rigid;
use super::scaled::Scaled;
use super::{Lattice, Mesh};
use crate::geometry::{Homography, Point, length, overlap_roi};
use crate::{Parallel, Simd, View};

/// Width of the view to which lengths of [`MeshParams`] refer, columns.
const REFERENCE_COLUMNS: f64 = 640.0;
/// Extent of the mesh beyond the other view's corners, cells.
const MARGIN_CELLS: f64 = 2.5;
/// Additional cells before the mesh is reduced.
const SPARE_CELLS: i32 = 6;
/// Maximum number of vertices; a homography that needs more is implausible.
const MAX_VERTICES: usize = 8192;
/// The other view reaches beyond a side of the reference view when it does so by more than this many cells: on the
/// sides towards which its camera stands, and on the others, where the perspective of far corners does not count as
/// overlap.
const BEYOND_CELLS: [f64; 2] = [1.0, 4.0];
/// Reference number of observations per cell and direction for the stiffness; more observations have less weight each.
const WEIGHED_OBSERVATIONS: f64 = 2.0;
/// Multiples of the stiffness and of the outlier limit in the passes of a first fit; the first pass weighs all
/// observations alike. A stiff mesh follows most of the image and treats an instrument as an outlier; a soft mesh would
/// follow it.
const FIRST_PASSES: [(f64, f64); 9] = [
    (1000.0, f64::INFINITY),
    (1000.0, 2.5),
    (1000.0, 2.5),
    (100.0, 2.0),
    (30.0, 2.0),
    (10.0, 2.0),
    (3.0, 2.0),
    (1.0, 2.0),
    (1.0, 1.0),
];
/// Square of the multiple of the outlier limit above which an observation is ignored: where an instrument hides the
/// tissue, even a weak pull would move the mesh to it.
const MAX_SQUARE: f64 = 4.0;
/// Base of the multiples.
const FIRST_STIFFNESS: Stiffness = Stiffness { bend: 0.05, slope: 0.02, place: 1e-4 };
/// Passes after those, at most, until none moves the mesh by more than [`SETTLED_PX`]: observations at the end of a
/// slope are used only when the mesh is near.
const SETTLE_PASSES: usize = 6;
const SETTLED_PX: f64 = 0.2;
/// Cells beyond a border for whose vertices the mesh is solved. Those further off follow the last ones: [`Relax`]
/// replaces them. With 2 a steep scene at 20 mm lost two thirds of its accuracy; above 4 hardly anything changes.
const SOLVED_BEYOND_CELLS: f64 = 6.0;
/// Movement below which the mesh is kept, px of the images, so that dependent data need not be recomputed.
const DEAD_BAND_PX: f64 = 0.02;
/// Share of the outlier limit above which an observation at a former instrument is ignored.
const FRONT_PX: f64 = 0.35;
/// Decrease of the share of unobserved lines at which the mesh restarts, because its extrapolation may be so wrong that
/// new observations would count as outliers.
const LESS_BLIND: f64 = 0.1;

/// Parameters of [`MeshFollower`]. Lengths are in pixels of a view with 640 columns and grow with the view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshParams {
    /// Side of a cell.
    pub cell_px: f64,
    /// Observations per cell, each way.
    pub observations: usize,
    /// Spacing of the disparities that are read.
    pub step_px: usize,
    /// Disparities of one observation differ from a plane by at most this.
    pub agree_px: f64,
    /// Observations on one surface below which none of them counts.
    pub min_patch: usize,
    /// Weight of second differences relative to an observation: the smoothness of the mesh.
    pub bend: f64,
    /// Weight of first differences: how fast it fades into the shifted homography without observations.
    pub slope: f64,
    /// Largest relative change of a length where only the other view is visible.
    pub max_stretch: f64,
    /// Width of the zone before the border of the reference view in which the mesh changes to its extrapolation; with 0
    /// it fades beyond the border by its slopes alone.
    pub zone_px: f64,
    /// Distance from the mesh at which an observation has a quarter of its weight; at twice the distance it is ignored.
    pub outlier_px: f64,
    /// Weight of the previous frame while the views move.
    pub hold_moving: f64,
    /// Additional weight while the views are still.
    pub hold_still: f64,
    /// Motion at which the additional weight is halved.
    pub still_px: f64,
    /// Distance of the seam from content that the mesh does not follow.
    pub margin_px: f64,
    /// Motion above which the mesh restarts.
    pub jump_px: f64,
    /// Maximum distance of a valid observation from the homography.
    pub reach_px: f64,
    /// Observations below which the mesh is held.
    pub min_observations: usize,
    /// Whether instruments in front of the tissue are found, shown by one view each, and not bent; for two views.
    pub keeps_instruments: bool,
    /// Whether the reference view is also warped in the zone, by [`MeshFollower::reference_mesh`], so that both views
    /// fit there too.
    pub moves_reference: bool,
    /// Position of the other camera, in units of the disparity's baseline: `[1, 0]` for the right one of a pair, `[0,
    /// 1]` for one equally far below the left one.
    pub along: [f64; 2],
}

impl Default for MeshParams {
    fn default() -> Self {
        Self {
            cell_px: 20.0,
            observations: 3,
            step_px: 3,
            agree_px: 2.0,
            min_patch: 24,
            bend: 0.01,
            slope: 0.005,
            max_stretch: 0.045,
            zone_px: 60.0,
            outlier_px: 12.0,
            hold_moving: 0.005,
            hold_still: 10.0,
            still_px: 0.15,
            margin_px: 24.0,
            jump_px: 12.0,
            reach_px: 96.0,
            min_observations: 24,
            keeps_instruments: true,
            moves_reference: true,
            along: [1.0, 0.0],
        }
    }
}

/// Report of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshReport {
    /// Observations used.
    pub observations: usize,
    /// Share of the lines of cells in what both views see, across the border between them, without observations, where
    /// the mesh extrapolates.
    pub blind: f64,
    /// Median distance of the observations from the mesh, px; NaN while it is held.
    pub residual_px: f64,
    /// Motion of the observations relative to the mesh of the previous frame, px; NaN without one.
    pub motion_px: f64,
    /// Whether the mesh kept its displacement from the homography, because there were too few observations.
    pub is_held: bool,
    /// Whether the mesh restarted.
    pub is_new: bool,
}

/// An observation inside the mesh.
#[derive(Clone, Copy, Debug)]
struct Located {
    /// Index in the grid of observations.
    index: usize,
    cell: (usize, usize),
    t: [f64; 2],
    /// Displacement against the homography, px.
    shift: Point,
    weight: f64,
}

/// Fits a mesh to disparity maps one after the other. Allocates only for a larger mesh than before.
#[derive(Clone, Debug, Default)]
pub struct MeshFollower {
    params: MeshParams,
    /// Without vertices before the first good frame.
    mesh: Mesh,
    lattice: Lattice,
    /// Positions of the vertices by the homography, px of the other view.
    base: Vec<Point>,
    /// Fitted displacement of the vertices from it.
    shift: Vec<Point>,
    /// Columns and rows of the vertices that are solved for, and their displacements.
    solved: [Range<usize>; 2],
    solution: Vec<Point>,
    /// Positions of the vertices in the other view, px, extrapolated where only the other view is visible.
    drawn: Vec<Point>,
    /// Positions in the reference view of the content at the vertices: their own, except where the mesh changes to its
    /// extrapolation.
    shown: Vec<Point>,
    /// The mesh of the reference view.
    reference: Mesh,
    /// Displacements of the previous frame on this frame's lattice.
    shift_before: Vec<Point>,
    before: Vec<Point>,
    observations: Observations,
    located: Vec<Located>,
    /// Observations that the mesh does not follow, far from the homography or few, which may show an instrument.
    loose: Vec<Located>,
    hints: InstrumentHints,
    instruments: Instruments,
    rigid: Rigid,
    blocks: Vec<[f64; 3]>,
    sorted: Vec<f64>,
    is_seen: Vec<bool>,
    /// [`MeshReport::blind`] when the mesh started afresh.
    blind_at_start: f64,
    energy: Energy,
    relax: Relax,
    pub(super) scaled: Scaled,
}

impl MeshFollower {
    /// A follower without a mesh.
    pub fn new(params: MeshParams) -> Self {
        Self { params, ..Self::default() }
    }

    /// The parameters in force.
    pub fn params(&self) -> &MeshParams {
        &self.params
    }

    /// Changes the parameters; the mesh stays.
    pub fn set_params(&mut self, params: MeshParams) {
        self.params = params;
    }

    /// Detections of instruments, which stay valid until they are changed.
    pub fn hints_mut(&mut self) -> &mut InstrumentHints {
        &mut self.hints
    }

    /// Forgets the mesh.
    pub fn reset(&mut self) {
        self.lattice = Lattice::default();
        self.mesh.lattice = self.lattice;
        self.mesh.source.clear();
        self.mesh.kept.clear();
        self.reference.source.clear();
        self.instruments.forget();
        self.rigid.forget();
        self.scaled.clear();
    }

    /// The mesh, and that of the reference view, between images as large as the map.
    pub(super) fn of_map(&self) -> [&Mesh; 2] {
        [&self.mesh, &self.reference]
    }

    /// Updates the mesh with a frame whose map has the size of the images.
    pub(super) fn update_map(
        &mut self,
        disparity: View<'_, f32>,
        left: &RectifiedView,
        right: &RectifiedView,
        left_from_right: &Homography,
        pool: &dyn Parallel,
    ) -> MeshReport {
        let p = self.params;
        let scale = right.size.0 as f64 / REFERENCE_COLUMNS;
        let mut report = MeshReport {
            observations: 0,
            blind: 1.0,
            residual_px: f64::NAN,
            motion_px: f64::NAN,
            is_held: true,
            is_new: true,
        };
        let Some(lattice) = self.cover(left_from_right, right.size, scale) else {
            self.reset();
            return report;
        };
        if !self.carry_over(lattice, left_from_right, right.size) {
            self.reset();
            return report;
        }
        report.is_new = self.mesh.source.is_empty();
        self.observations.gather(disparity, [left, right], &self.sampling(scale), pool);
        self.observations.keep_patches(p.min_patch);
        self.locate(p.reach_px * scale);
        report.observations = self.located.len();
        let overlap = overlap_roi(left_from_right, right.size.0, right.size.1, left.size.0, left.size.1);
        report.blind = self.blind(overlap);
        if self.located.len() < p.min_observations {
            if !report.is_new {
                self.shift.clone_from(&self.shift_before);
                self.go_on(left_from_right, left.size, right.size);
                self.show(left_from_right);
                self.publish(false);
            }
            return report;
        }
        let mut shared = [0.0; 2];
        if !report.is_new {
            (report.motion_px, shared) = self.motion();
            report.is_new = report.motion_px > p.jump_px * scale || report.blind < self.blind_at_start - LESS_BLIND;
        }
        if report.is_new {
            self.blind_at_start = report.blind;
        }
        // A first fit solves for all vertices: how stiff the whole is decides what passes for a mistake.
        self.solved = match report.is_new {
            true => [0..lattice.columns, 0..lattice.rows],
            false => self.needed(&self.borders(left_from_right, left.size, right.size), scale),
        };
        let [columns, rows] = [0, 1].map(|axis| self.solved[axis].len());
        let stiffness = Stiffness { bend: p.bend, slope: p.slope, place: 1e-4 };
        let limit_px = p.outlier_px * scale;
        let solved = if report.is_new {
            self.instruments.forget();
            self.fit_first(stiffness, limit_px)
        } else {
            self.energy.reset(columns, rows, stiffness);
            let still = 1.0 / (1.0 + (report.motion_px / (p.still_px * scale)).powi(4));
            let hold = p.hold_moving + p.hold_still * still;
            // What only the other view sees moves along with the rest.
            for before in &mut self.before {
                *before = [before[0] + (1.0 - still) * shared[0], before[1] + (1.0 - still) * shared[1]];
            }
            for (shift, (before, base)) in self.shift.iter_mut().zip(self.before.iter().zip(&self.base)) {
                *shift = [before[0] - base[0], before[1] - base[1]];
            }
            // The mesh of the frame before tells which observations are mistakes; seen from it, all are off by the motion.
            self.pass(limit_px + report.motion_px, hold)
        };
        if !solved {
            self.reset();
            return report;
        }
        self.go_on(left_from_right, left.size, right.size);
        report.residual_px = self.judge();
        self.keep_instruments(overlap, report.is_new);
        if report.is_new && self.instruments.is_any() && self.fit_first(stiffness, limit_px) {
            // Without them the mesh lies behind them, and more of them is found.
            self.go_on(left_from_right, left.size, right.size);
            report.residual_px = self.judge();
            self.keep_instruments(overlap, true);
        }
        self.show(left_from_right);
        report.is_held = false;
        self.publish(!report.is_new);
        report
    }

    fn cell_px(&self, scale: f64) -> usize {
        ((self.params.cell_px * scale).round() as usize).max(8)
    }

    fn sampling(&self, scale: f64) -> Sampling {
        let p = &self.params;
        let cell_px = (self.cell_px(scale) / p.observations.max(1)).max(4);
        let step_px = ((p.step_px as f64 * scale).round() as usize).max(1);
        Sampling { cell_px, step_px, agree_px: (p.agree_px * scale) as f32, along: p.along }
    }

    /// Columns and rows that are read of a map of `size`, as large as the right image.
    pub(super) fn pixels_of_map(&self, size: (usize, usize), right: (usize, usize)) -> [Vec<u32>; 2] {
        self.sampling(right.0 as f64 / REFERENCE_COLUMNS).pixels(size)
    }

    /// The lattice for this homography: the current one while it fits.
    fn cover(&self, left_from_right: &Homography, size: (usize, usize), scale: f64) -> Option<Lattice> {
        let corners = left_from_right.map_corners(size.0, size.1)?;
        let cell_px = self.cell_px(scale);
        let bounds = [0, 1].map(|k| {
            let along = corners.map(|corner| corner[k] / cell_px as f64);
            (along.iter().copied().fold(f64::MAX, f64::min), along.iter().copied().fold(f64::MIN, f64::max))
        });
        let held = self.lattice;
        let fits = held.cell_px == cell_px
            && !held.is_empty()
            && [held.columns, held.rows].iter().zip(held.first).zip(bounds).all(|((count, first), (low, high))| {
                let (first, last) = (f64::from(first), f64::from(first) + *count as f64 - 1.0);
                let spare = MARGIN_CELLS + f64::from(SPARE_CELLS);
                first <= low - 1.0 && last >= high + 1.0 && low - first <= spare && last - high <= spare
            });
        if fits {
            return Some(held);
        }
        let ends = bounds.map(|(low, high)| ((low - MARGIN_CELLS).floor() as i32, (high + MARGIN_CELLS).ceil() as i32));
        let [columns, rows] = ends.map(|(low, high)| (high - low + 1).max(2) as usize);
        let lattice = Lattice { cell_px, first: ends.map(|(low, _)| low), columns, rows };
        (columns.saturating_mul(rows) <= MAX_VERTICES).then_some(lattice)
    }

    /// Transfers the homography and the state of the previous frame to the lattice of this frame.
    fn carry_over(&mut self, lattice: Lattice, left_from_right: &Homography, size: (usize, usize)) -> bool {
        let Some(back) = left_from_right.inverse_bounded() else { return false };
        let old = self.lattice;
        let known = !old.is_empty() && !self.mesh.source.is_empty() && old.cell_px == lattice.cell_px;
        self.shift_before.clear();
        self.before.clear();
        if known {
            for row in 0..lattice.rows {
                for column in 0..lattice.columns {
                    let along = |first: i32, index: usize, old_first: i32, count: usize| {
                        let wanted = first + index as i32 - old_first;
                        let nearest = wanted.clamp(0, count as i32 - 1);
                        (nearest as usize, nearest == wanted)
                    };
                    let (x, same_x) = along(lattice.first[0], column, old.first[0], old.columns);
                    let (y, same_y) = along(lattice.first[1], row, old.first[1], old.rows);
                    let from = y * old.columns + x;
                    let [dx, dy] = self.shift[from];
                    let [u, v] =
                        if same_x && same_y { self.base[from] } else { back.map(lattice.position(column, row)) };
                    self.shift_before.push([dx, dy]);
                    self.before.push([u + dx, v + dy]);
                }
            }
        }
        self.base.clear();
        for row in 0..lattice.rows {
            for column in 0..lattice.columns {
                self.base.push(back.map(lattice.position(column, row)));
            }
        }
        self.shift.resize(lattice.len(), [0.0; 2]);
        self.lattice = lattice;
        if !known {
            self.mesh.source.clear();
        }
        // Near its horizon a homography brings points anywhere.
        let far = 8.0 * (size.0 + size.1) as f64;
        self.base.iter().flatten().all(|v| v.abs() < far)
    }

    /// Finds the observations that lie inside the mesh and near the homography.
    fn locate(&mut self, reach_px: f64) {
        self.located.clear();
        self.loose.clear();
        let (lattice, base) = (self.lattice, &self.base);
        let share = (WEIGHED_OBSERVATIONS / self.params.observations.max(1) as f64).powi(2);
        for (index, seen) in self.observations.cells.iter().enumerate().filter(|(_, seen)| seen.weight != 0.0) {
            let Some((cell, t)) = lattice.cell_of(seen.at) else { continue };
            let at = lattice.interpolate(|vertex| base[vertex], cell, t);
            let shift = [seen.source[0] - at[0], seen.source[1] - at[1]];
            let located = Located { index, cell, t, shift, weight: share * f64::from(seen.weight.abs()) };
            let counts = seen.weight > 0.0 && length(shift) <= reach_px;
            if counts { &mut self.located } else { &mut self.loose }.push(located);
        }
    }

    /// Solves without a previous frame.
    fn fit_first(&mut self, stiffness: Stiffness, limit_px: f64) -> bool {
        let [columns, rows] = [0, 1].map(|axis| self.solved[axis].len());
        self.shift.clear();
        self.shift.resize(self.lattice.len(), [0.0; 2]);
        FIRST_PASSES.iter().all(|(stiffer, times)| {
            let wanted = if *stiffer > 1.0 { FIRST_STIFFNESS.times(*stiffer) } else { stiffness };
            self.energy.reset(columns, rows, wanted);
            self.pass(times * limit_px, 0.0)
        }) && self.settle(limit_px)
    }

    /// Repeats a pass of a first fit until the mesh converges.
    fn settle(&mut self, limit_px: f64) -> bool {
        for _ in 0..SETTLE_PASSES {
            self.shift_before.clone_from(&self.shift);
            if !self.pass(limit_px, 0.0) {
                return false;
            }
            let moved = |(a, b): (&Point, &Point)| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
            if self.shift.iter().zip(&self.shift_before).map(moved).fold(0.0, f64::max) < SETTLED_PX {
                break;
            }
        }
        true
    }

    /// One solution with weights from the distances to the mesh so far. `hold` is the weight of the previous frame.
    fn pass(&mut self, limit_px: f64, hold: f64) -> bool {
        self.energy.begin();
        let (lattice, shift, [columns, rows]) = (self.lattice, &self.shift, &self.solved);
        let (has_instruments, along) = (self.instruments.is_any(), self.params.along);
        let nearer = |off: Point| nearer_px(along, off);
        for seen in &self.located {
            let at = lattice.interpolate(|vertex| shift[vertex], seen.cell, seen.t);
            let square = ((seen.shift[0] - at[0]).powi(2) + (seen.shift[1] - at[1]).powi(2)) / (limit_px * limit_px);
            let (column, row) = seen.cell;
            let is_solved = columns.contains(&column)
                && columns.contains(&(column + 1))
                && rows.contains(&row)
                && rows.contains(&(row + 1));
            let is_instrument = || {
                self.instruments.was_at(seen.index)
                    && nearer([seen.shift[0] - at[0], seen.shift[1] - at[1]]) > FRONT_PX * limit_px
            };
            if square > MAX_SQUARE || !is_solved || (has_instruments && is_instrument()) {
                continue;
            }
            let cell = (column - columns.start, row - rows.start);
            // Geman and McClure: what is far off hardly pulls.
            self.energy.observe(cell, seen.t, seen.shift, seen.weight / (1.0 + square).powi(2));
        }
        if hold > 0.0 {
            for (y, row) in rows.clone().enumerate() {
                for (x, column) in columns.clone().enumerate() {
                    let vertex = row * lattice.columns + column;
                    let (before, base) = (self.before[vertex], self.base[vertex]);
                    self.energy.pull(x, y, [before[0] - base[0], before[1] - base[1]], hold);
                }
            }
        }
        self.solution.resize(columns.len() * rows.len(), [0.0; 2]);
        if !self.energy.solve(&mut self.solution, Simd::detect()) {
            return false;
        }
        for row in 0..lattice.rows {
            let y = row.clamp(rows.start, rows.end - 1) - rows.start;
            let solution = &self.solution[y * columns.len()..(y + 1) * columns.len()];
            for column in 0..lattice.columns {
                let x = column.clamp(columns.start, columns.end - 1) - columns.start;
                self.shift[row * lattice.columns + column] = solution[x];
            }
        }
        true
    }

    /// The sides of the reference view beyond which the other view reaches, by the homography.
    fn borders(
        &self,
        left_from_right: &Homography,
        left: (usize, usize),
        right: (usize, usize),
    ) -> [Option<Border>; 4] {
        let cells = self.params.along.map(|steps| if steps == 0.0 { BEYOND_CELLS[1] } else { BEYOND_CELLS[0] });
        borders(cells.map(|cells| cells * self.lattice.cell_px as f64), left_from_right, left, right)
    }

    /// Columns and rows of the vertices that the image depends on: without those beyond a border where the mesh is
    /// extrapolated.
    fn needed(&self, borders: &[Option<Border>; 4], scale: f64) -> [Range<usize>; 2] {
        let lattice = self.lattice;
        let mut needed = [0..lattice.columns, 0..lattice.rows];
        for border in borders.iter().flatten().filter(|border| border.zone_px(self.params.zone_px * scale) > 0.0) {
            let at = border.at_px / lattice.cell_px as f64 - f64::from(lattice.first[border.axis]);
            let range = &mut needed[border.axis];
            // At least two lines stay.
            if border.outwards > 0.0 {
                range.end = range.end.min((at + SOLVED_BEYOND_CELLS).max(1.0) as usize + 1).max(range.start + 2);
            } else {
                range.start = range.start.max((at - SOLVED_BEYOND_CELLS).max(0.0) as usize).min(range.end - 2);
            }
        }
        needed
    }

    /// Sets the drawn positions: the fitted mesh, extrapolated where only the other view is visible.
    fn go_on(&mut self, left_from_right: &Homography, left: (usize, usize), right: (usize, usize)) {
        self.drawn.clear();
        self.drawn
            .extend(self.base.iter().zip(&self.shift).map(|(base, shift)| [base[0] + shift[0], base[1] + shift[1]]));
        self.shown.clear();
        let Some(back) = left_from_right.inverse_bounded() else { return };
        let scale = right.0 as f64 / REFERENCE_COLUMNS;
        let how = Continuation { zone_px: self.params.zone_px * scale, max_stretch: self.params.max_stretch };
        for border in self.borders(left_from_right, left, right).iter().flatten() {
            self.relax.apply(&mut self.drawn, &self.lattice, border, &how, [left_from_right, &back]);
        }
    }

    /// Makes the solution the mesh of this frame. With `steady`, a solution that hardly differs keeps the current mesh.
    fn publish(&mut self, steady: bool) {
        let mesh = &mut self.mesh;
        let positions = self.drawn.iter().copied();
        let dead_band_px = DEAD_BAND_PX / self.scaled.factor() as f64;
        if steady && mesh.lattice == self.lattice && mesh.source.len() == self.lattice.len() {
            let near =
                |(new, old): (Point, &[f32; 2])| (0..2).all(|k| (new[k] - f64::from(old[k])).abs() < dead_band_px);
            if positions.clone().zip(&mesh.source).all(near) {
                return;
            }
        }
        mesh.lattice = self.lattice;
        mesh.source.clear();
        mesh.source.extend(positions.map(|at| at.map(|v| v as f32)));
        self.reference.lattice = self.lattice;
        self.reference.source.clear();
        self.reference.source.extend(self.shown.iter().map(|at| at.map(|v| v as f32)));
    }
}
