//! The fast bilateral solver (Barron and Poole, "The fast bilateral solver", 2016): the disparity map
//! that is close to the given one where that is reliable, and smooth where the picture is.
//!
//! The problem is solved on the vertices of a bilateral grid: splat, make the blur bistochastic, run
//! preconditioned conjugate gradients, read back. The grid is over column, row and luminance. The
//! solution changes little between frames, so the solver starts from the last frame's.

use crate::stereo::StereoError;
use crate::stereo::bilateral_grid::{BilateralGrid, MAX_SIGMA_XY};
use crate::stereo::confidence::{Confidence, ConfidenceParams};
use crate::stereo::error::{check_channels, check_size};
use crate::stereo::filter_input::FilterInput;
use crate::stereo::grid_solver::GridSolver;
use crate::stereo::kept_regions::KeptRegions;
use crate::stereo::matching::{again, fill_nan};
use crate::stereo::scratch::Scratch;
use crate::stereo::shared_field::is_seen_by_both;
use crate::{Parallel, Rect, Serial, SharedMut, Simd, View, ViewMut};

/// Size of the grid's cells and strength of the solver.
#[derive(Clone, Debug, PartialEq)]
pub struct BilateralSolverParams {
    /// Side of a cell in px, 2 to 128.
    pub sigma_xy_px: usize,
    /// Height of a cell in gray levels, 2 to 128.
    pub sigma_luma: usize,
    /// Weight of smoothness against closeness, 0 to 1e6. Values come from about sqrt(lambda) cells away: the
    /// 128 of other implementations flattens slanted surfaces.
    pub lambda: f32,
    /// Maximum number of steps of conjugate gradients, 1 to 200.
    pub iterations: usize,
    /// The residual, relative to the right-hand side, at which the solver stops.
    pub tolerance: f32,
    /// Mean confidence around a vertex below which its pixels stay unknown, 0 to 1.
    pub min_support: f32,
    /// Whether a call starts from the result of the one before.
    pub warm_start: bool,
    /// How confidence is judged where none is given.
    pub confidence: ConfidenceParams,
}

impl Default for BilateralSolverParams {
    fn default() -> Self {
        Self {
            sigma_xy_px: 8,
            sigma_luma: 16,
            lambda: 0.5,
            iterations: 25,
            tolerance: 1e-3,
            min_support: 0.1,
            warm_start: true,
            confidence: ConfidenceParams::default(),
        }
    }
}

impl BilateralSolverParams {
    /// Names the first parameter that is out of range.
    ///
    /// # Errors
    /// [`StereoError::Parameter`].
    pub fn validate(&self) -> Result<(), StereoError> {
        let refuse = |name, value: String, accepted| Err(StereoError::Parameter { name, value, accepted });
        if !(2..=MAX_SIGMA_XY).contains(&self.sigma_xy_px) {
            return refuse("sigma_xy_px", self.sigma_xy_px.to_string(), "2 to 128");
        }
        if !(2..=128).contains(&self.sigma_luma) {
            return refuse("sigma_luma", self.sigma_luma.to_string(), "2 to 128");
        }
        if !(0.0..=1e6).contains(&self.lambda) {
            return refuse("lambda", self.lambda.to_string(), "0 to 1e6");
        }
        if !(1..=200).contains(&self.iterations) {
            return refuse("iterations", self.iterations.to_string(), "1 to 200");
        }
        if !(0.0..=1.0).contains(&self.tolerance) {
            return refuse("tolerance", self.tolerance.to_string(), "0 to 1");
        }
        if !(0.0..=1.0).contains(&self.min_support) {
            return refuse("min_support", self.min_support.to_string(), "0 to 1");
        }
        if self.confidence.scatter_radius_px > 15 {
            return refuse("scatter_radius_px", self.confidence.scatter_radius_px.to_string(), "0 to 15");
        }
        Ok(())
    }
}

/// Grids with fewer vertices are solved on one thread, because waking others costs more.
const SMALL: usize = 1 << 15;

/// The solver with its work memory. Allocates only for a larger size or more vertices than before.
#[derive(Debug)]
pub struct BilateralSolver {
    params: BilateralSolverParams,
    judge: Confidence,
    grid: BilateralGrid,
    confidence: Vec<f32>,
    scratch: Scratch,
    work: GridSolver,
    kept: KeptRegions,
    /// Solution of the last call, by dense cell; NaN where there was no vertex.
    last: Vec<f32>,
    /// Value, and 1 or 0 where it is known or not, of each dense cell.
    reach: Vec<[f32; 2]>,
    last_shape: (Rect, [usize; 3]),
    steps: usize,
    avx2: bool,
}

impl BilateralSolver {
    /// A solver with the given parameters.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range.
    pub fn new(params: BilateralSolverParams) -> Result<Self, StereoError> {
        params.validate()?;
        Ok(Self {
            params,
            judge: Confidence::default(),
            grid: BilateralGrid::default(),
            confidence: Vec::new(),
            scratch: Scratch::default(),
            work: GridSolver::default(),
            kept: KeptRegions::default(),
            last: Vec::new(),
            reach: Vec::new(),
            last_shape: Default::default(),
            steps: 0,
            avx2: Simd::detect().avx2(),
        })
    }

    /// Takes the portable path even where AVX2 exists (tests compare the two).
    pub fn force_portable(&mut self) {
        self.avx2 = false;
    }

    /// The parameters in use.
    pub fn params(&self) -> &BilateralSolverParams {
        &self.params
    }

    /// Changes the parameters; memory is kept.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range; the old ones stay.
    pub fn set_params(&mut self, params: BilateralSolverParams) -> Result<(), StereoError> {
        params.validate()?;
        self.params = params;
        Ok(())
    }

    /// Forgets the last frame, so that the next call starts cold.
    pub fn reset(&mut self) {
        self.last.clear();
    }

    /// Steps of conjugate gradients that the last call took.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Vertices of the last call's grid.
    pub fn vertices(&self) -> usize {
        self.grid.len().saturating_sub(1)
    }

    /// Solves for the disparity map of `input`; outputs as in [`crate::stereo::WlsFilter::compute`].
    ///
    /// # Errors
    /// When sizes or channel counts do not agree.
    pub fn compute(
        &mut self,
        input: FilterInput<'_>,
        pool: &dyn Parallel,
        mut disparity: ViewMut<'_, f32>,
        mut confidence: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError> {
        input.check()?;
        let (width, height) = (input.disparity.width, input.disparity.height);
        check_size("solved disparity", (width, height), (disparity.width, disparity.height))?;
        check_channels("solved disparity", &[1], "1", disparity.channels)?;
        if let Some(map) = &confidence {
            check_size("solved confidence", (width, height), (map.width, map.height))?;
            check_channels("solved confidence", &[1], "1", map.channels)?;
        }
        let roi = input.roi.clamped(width, height);
        if roi != Rect::whole(width, height) {
            fill_nan(&mut disparity, pool);
            if let Some(map) = &mut confidence {
                (0..height).for_each(|y| map.row_mut(y).fill(0.0));
            }
        }
        self.steps = 0;
        if roi.is_empty() {
            return Ok(());
        }
        let sigma = (self.params.sigma_xy_px, self.params.sigma_luma);
        if let Some(given) = input.confidence {
            self.grid.splat(input.guide, roi, sigma, input.disparity, (given, (roi.x, roi.y)), self.avx2, pool);
        } else {
            self.confidence.resize(roi.width * roi.height, 0.0);
            let judged = &self.params.confidence;
            input.confidence_into(&mut self.judge, judged, roi, self.avx2, pool, &mut self.confidence);
            let judged = View::new(&self.confidence[..roi.width * roi.height], roi.width, roi.height, 1);
            self.grid.splat(input.guide, roi, sigma, input.disparity, (judged, (0, 0)), self.avx2, pool);
        }
        let small = self.grid.len() < SMALL;
        let solver_pool: &dyn Parallel = if small { &Serial } else { pool };
        self.work.resize(self.grid.len());
        self.work.balance(&self.grid, solver_pool);
        let warm = self.params.warm_start && self.last_shape == (roi, self.grid.cells) && !self.last.is_empty();
        let limits = (self.params.lambda, self.params.iterations, self.params.tolerance);
        let start = if warm { Some(self.last.as_slice()) } else { None };
        self.steps = self.work.solve(&self.grid, limits, start, solver_pool);
        self.work.spread_support(&self.grid, solver_pool);

        self.last_shape = (roi, self.grid.cells);
        self.read_back(roi, pool, again(&mut disparity), confidence.as_mut().map(again));
        let trust = &self.params.confidence;
        let edge_px = trust.scatter_radius_px + self.params.sigma_xy_px;
        self.kept.restore(&input, trust, edge_px, pool, &mut disparity, confidence.as_mut());
        Ok(())
    }

    /// Gives each pixel its vertex's value and support, and keeps the values for the next frame.
    fn read_back(
        &mut self,
        roi: Rect,
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
        confidence: Option<ViewMut<'_, f32>>,
    ) {
        self.last.resize(self.grid.vertex_of_cell.len(), 0.0);
        self.reach.resize(self.grid.vertex_of_cell.len(), [0.0; 2]);
        let width = disparity.width;
        let (stride, out) = (disparity.stride, SharedMut::new(disparity.data));
        let (stride_confidence, out_confidence) = match confidence {
            Some(map) => (map.stride, Some(SharedMut::new(map.data))),
            None => (0, None),
        };
        let (last, reach) = (SharedMut::new(&mut self.last), SharedMut::new(&mut self.reach));
        let (work, grid, least) = (&self.work, &self.grid, self.params.min_support.max(1e-6));
        pool.run(grid.cells[1], &|grid_row| {
            let vertices = grid.grid_row(grid_row);
            let base = grid_row * vertices.len();
            // SAFETY: grid rows belong to one chunk each.
            let (last, reach) = unsafe { (last.part(base, vertices.len()), reach.part(base, vertices.len())) };
            for ((last, reach), vertex) in last.iter_mut().zip(reach.iter_mut()).zip(vertices) {
                let (x, support) = (work.x[*vertex as usize], work.support[*vertex as usize]);
                *last = if support >= least { x } else { f32::NAN };
                *reach = if support >= least { [x, 1.0] } else { [0.0, 0.0] };
            }
        });
        let (reach, avx2) = (&self.reach, self.avx2);
        let buffers = self.scratch.lend(Slice::scratch_len(grid, roi.width), pool);
        pool.run(grid.cells[1], &|grid_row| {
            for row in grid_row * grid.sigma_xy..((grid_row + 1) * grid.sigma_xy).min(roi.height) {
                let y = roi.y + row;
                // SAFETY: each row of pixels is under one row of cells, which belongs to this chunk alone.
                let out = unsafe { out.part(y * stride + roi.x, roi.width) };
                buffers.with(|work| Slice { grid, reach, row, x0: roi.x, width }.write(work, avx2, out));
                if let Some(map) = &out_confidence {
                    // SAFETY: row `y` of the confidence map belongs to this chunk alone, like that of the disparity map.
                    let out = unsafe { map.part(y * stride_confidence + roi.x, roi.width) };
                    let vertices = grid.grid_row(grid_row);
                    for (out, cell) in out.iter_mut().zip(grid.row_cells(row, roi.width)) {
                        *out = work.support[vertices[*cell as usize] as usize];
                    }
                }
            }
        });
    }
}

/// One row of pixels read from the grid: between the cells' centres, values of the four nearest cells of the pixel's luminance are
/// mixed, without those that have no value; the grid would show otherwise.
struct Slice<'a> {
    grid: &'a BilateralGrid,
    reach: &'a [[f32; 2]],
    row: usize,
    /// First column, and columns of the right view: a pixel outside the right view is not measured, however smooth the surface beside it.
    x0: usize,
    width: usize,
}

impl Slice<'_> {
    /// Numbers of scratch memory that [`Self::write`] needs for `width` pixels of a row.
    fn scratch_len(grid: &BilateralGrid, width: usize) -> usize {
        4 * grid.cells[0] * grid.cells[2] + 2 * width
    }

    fn write(self, work: &mut [f32], avx2: bool, out: &mut [f32]) {
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            // SAFETY: the caller found AVX2.
            unsafe { self.write_avx2(work, out) };
            return;
        }
        let _ = avx2;
        self.write_body(work, out);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn write_avx2(self, work: &mut [f32], out: &mut [f32]) {
        self.write_body(work, out);
    }

    #[inline(always)]
    fn write_body(self, work: &mut [f32], out: &mut [f32]) {
        let Self { grid, reach, row, x0, width } = self;
        let [columns, rows, lumas] = grid.cells;
        let (side, n) = (grid.sigma_xy, out.len());
        let row_cells = columns * lumas;
        let grid_row = row / side;
        // How far the pixels of a cell are from its centre, in cells: 0 in the middle, 1/2 at the rim.
        let mut offsets = [0.0; MAX_SIGMA_XY];
        for (step, offset) in offsets[..side].iter_mut().enumerate() {
            *offset = (step as f32 + 0.5) / side as f32 - 0.5;
        }
        let offsets = &offsets[..side];
        let down = offsets[row % side];
        let other_row = if down < 0.0 { grid_row.saturating_sub(1) } else { (grid_row + 1).min(rows - 1) };
        let down = down.abs();
        let here = &reach[grid_row * row_cells..(grid_row + 1) * row_cells];
        let there = &reach[other_row * row_cells..(other_row + 1) * row_cells];
        let (work, value) = work.split_at_mut(4 * row_cells);
        let (value, _) = value.split_at_mut(2 * n);
        let (own, mixed) = work.as_chunks_mut::<2>().0.split_at_mut(row_cells);
        // Both rows of cells are mixed once, for all pixels; a pixel whose own cell has no value stays unknown.
        for (((own, mixed), here), there) in own.iter_mut().zip(mixed.iter_mut()).zip(here).zip(there) {
            for i in 0..2 {
                mixed[i] = here[i] * (1.0 - down) + there[i] * down;
                own[i] = if here[1] > 0.0 { mixed[i] } else { f32::NAN };
            }
        }
        let ids = grid.row_cells(row, n);
        let value = value.as_chunks_mut::<2>().0;
        for (column, (value, ids)) in value.chunks_mut(side).zip(ids.chunks(side)).enumerate() {
            // The same luminance in the column on the nearer side; at the border the cell itself.
            let (before, after) = (if column > 0 { lumas } else { 0 }, if column + 1 < columns { lumas } else { 0 });
            for ((value, cell), across) in value.iter_mut().zip(ids).zip(offsets) {
                let cell = *cell as usize;
                let other = if *across < 0.0 { cell - before } else { cell + after };
                let across = across.abs();
                let (a, b) = (own[cell], mixed[other]);
                for i in 0..2 {
                    value[i] = a[i] * (1.0 - across) + b[i] * across;
                }
            }
        }
        for (x, (out, value)) in out.iter_mut().zip(value.iter()).enumerate() {
            // A cell without a value counts with weight 0.
            let value = value[0] / value[1];
            *out = if is_seen_by_both(x0 + x, value, width) { value } else { f32::NAN };
        }
    }
}
