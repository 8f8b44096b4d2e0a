//! The fast bilateral solver (Barron and Poole, "The fast bilateral solver", 2016): the disparity map
//! that is close to the given one where that is trusted and smooth wherever the picture is.
//!
//! The problem is solved on the vertices of a bilateral grid: splat, make the blur bistochastic, run
//! preconditioned conjugate gradients, read back. The grid is over column, row and luminance. From one
//! frame to the next the solution moves little, so the last frame's is where the solver starts.

use crate::stereo::bilateral_grid::BilateralGrid;
use crate::stereo::block_matching::fill_nan;
use crate::stereo::confidence::{Confidence, ConfidenceParams};
use crate::stereo::error::{check_channels, check_size};
use crate::stereo::grid_solver::GridSolver;
use crate::stereo::shared_field::is_seen_by_both;
use crate::stereo::wls::FilterInput;
use crate::stereo::{Roi, StereoError, simd};
use crate::{Parallel, Serial, SharedMut, ViewMut};

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
    /// Most steps of conjugate gradients, 1 to 200.
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
            min_support: 0.05,
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
        if !(2..=128).contains(&self.sigma_xy_px) {
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

/// Grids with fewer vertices are solved on one thread: waking others would cost more.
const SMALL: usize = 1 << 15;

/// The solver with its work memory; nothing is allocated once a size and its vertices have been seen.
#[derive(Debug)]
pub struct BilateralSolver {
    params: BilateralSolverParams,
    judge: Confidence,
    grid: BilateralGrid,
    value: Vec<f32>,
    confidence: Vec<f32>,
    work: GridSolver,
    /// Solution of the last call, by dense cell; NaN where there was no vertex.
    last: Vec<f32>,
    /// Value, and 1 or 0 where it is known or not, of each dense cell.
    reach: Vec<[f32; 2]>,
    last_shape: (Roi, [usize; 3]),
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
            value: Vec::new(),
            confidence: Vec::new(),
            work: GridSolver::default(),
            last: Vec::new(),
            reach: Vec::new(),
            last_shape: Default::default(),
            steps: 0,
            avx2: simd::has_avx2(),
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
        if roi != Roi::full(width, height) {
            fill_nan(&mut disparity, pool);
            if let Some(map) = &mut confidence {
                (0..height).for_each(|y| map.row_mut(y).fill(0.0));
            }
        }
        self.steps = 0;
        if roi.is_empty() {
            return Ok(());
        }
        self.value.resize(roi.width * roi.height, 0.0);
        self.confidence.resize(roi.width * roi.height, 0.0);
        let judged = &self.params.confidence;
        input.confidence_into(&mut self.judge, judged, roi, self.avx2, pool, &mut self.confidence);
        let value = SharedMut::new(&mut self.value);
        pool.run(roi.height, &|row| {
            // SAFETY: one row, one chunk.
            let out = unsafe { value.part(row * roi.width, roi.width) };
            out.copy_from_slice(&input.disparity.row(roi.y + row)[roi.x..roi.x + roi.width]);
        });
        let sigma = (self.params.sigma_xy_px, self.params.sigma_luma);
        self.grid.splat(input.guide, roi, sigma, &self.value, &self.confidence, pool);
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
        self.read_back(roi, pool, disparity, confidence);
        Ok(())
    }

    /// Gives each pixel its vertex's value and support, and keeps the values for the next frame.
    fn read_back(
        &mut self,
        roi: Roi,
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
        let reach = &self.reach;
        pool.run(roi.height, &|row| {
            let y = roi.y + row;
            // SAFETY: one row, one chunk.
            let out = unsafe { out.part(y * stride + roi.x, roi.width) };
            slice_row(grid, reach, row, out);
            // What no right pixel can have seen is no measurement, however smooth the surface beside it.
            for (x, out) in out.iter_mut().enumerate() {
                *out = if is_seen_by_both(roi.x + x, *out, width) { *out } else { f32::NAN };
            }
            if let Some(map) = &out_confidence {
                // SAFETY: as above.
                let out = unsafe { map.part(y * stride_confidence + roi.x, roi.width) };
                let vertices = grid.grid_row(row / grid.sigma_xy);
                for (out, cell) in out.iter_mut().zip(grid.row_cells(row, roi.width)) {
                    *out = work.support[vertices[*cell as usize] as usize];
                }
            }
        });
    }
}

/// One row of pixels: between the cells' centres, values of the four nearest cells of the pixel's
/// luminance are mixed, those without a value left out; the grid would show otherwise.
fn slice_row(grid: &BilateralGrid, reach: &[[f32; 2]], row: usize, out: &mut [f32]) {
    let [columns, rows, lumas] = grid.cells;
    let side = grid.sigma_xy;
    let row_cells = columns * lumas;
    let grid_row = row / side;
    // How far a pixel is from its cell's centre, in cells: 0 in the middle, 1/2 at the rim.
    let offset = |position: usize| ((position % side) as f32 + 0.5) / side as f32 - 0.5;
    let down = offset(row);
    let other_row = if down < 0.0 { grid_row.saturating_sub(1) } else { (grid_row + 1).min(rows - 1) };
    let down = down.abs();
    let here = &reach[grid_row * row_cells..(grid_row + 1) * row_cells];
    let there = &reach[other_row * row_cells..(other_row + 1) * row_cells];
    let ids = grid.row_cells(row, out.len());
    for (column, (out, ids)) in out.chunks_mut(side).zip(ids.chunks(side)).enumerate() {
        for (step, (out, cell)) in out.iter_mut().zip(ids).enumerate() {
            let cell = *cell as usize;
            let across = offset(step);
            // The same luminance in the column on the nearer side; at the border the cell itself.
            let other = if across < 0.0 {
                cell - if column > 0 { lumas } else { 0 }
            } else {
                cell + if column + 1 < columns { lumas } else { 0 }
            };
            let across = across.abs();
            let (a, b, c, d) = (here[cell], here[other], there[cell], there[other]);
            let mix = |i: usize| {
                (a[i] * (1.0 - across) + b[i] * across) * (1.0 - down) + (c[i] * (1.0 - across) + d[i] * across) * down
            };
            // A cell without a value counts with weight 0; a pixel whose own cell has none stays unknown.
            *out = if a[1] > 0.0 { mix(0) / mix(1) } else { f32::NAN };
        }
    }
}
