//! Homography from a disparity map (thesis, chapter 4): smooth tissue has no features, but it has depth.
//!
//! A grid covers the overlap of the left rectified view. Each cell gives one point `P` with valid disparity `d`; its
//! partner in the right rectified view is `Q = P - (d, 0)`. Both are mapped back to the cameras' original images, and
//! RANSAC finds the homography between them. Algorithm 2 of that chapter stabilises it.

use super::coarse::{enlarged, map_factor};
use super::disparity_plane::{DisparityPlane, Sample};
use super::grid_cells::{Cells, bounds};
use super::rectified_view::RectifiedView;
use crate::Rect;
use crate::View;
use crate::geometry::ransac::{Ransac, RansacFit, RansacParams};
use crate::geometry::{
    Homography, Plausibility, Point, RegistrationState, Stability, StabilityParams, Stabilized, overlap_roi,
    overlap_rois, rms_of,
};

/// Choice of a grid cell's point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CellPoint {
    /// The valid pixel with the largest disparity: the nearest tissue, the peak of chapter 4.
    Peak,
    /// The middle of the cell, with the median of its disparities: robust to outliers of the matching.
    #[default]
    Median,
}

/// Parameters of [`RegisterGrid`]. Lengths are in pixels of the images, even if the disparity map is smaller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridParams {
    /// Rows of the grid (9 in chapter 4).
    pub rows: usize,
    /// Columns of the grid (24).
    pub columns: usize,
    /// Point of each cell.
    pub point: CellPoint,
    /// Spacing of the pixels of a cell that are used.
    pub step_px: usize,
    /// Share of a cell's used pixels that must have a disparity.
    pub min_valid: f32,
    /// Robust estimation; the threshold is in pixels of the left image.
    pub ransac: RansacParams,
    /// Inliers below which a homography is rejected; at least 4.
    pub min_inliers: usize,
    /// Plausibility limits of a warped frame.
    pub plausibility: Plausibility,
    /// The homography is kept while its median error on the new inliers is below this, in pixels; 0: refit every frame.
    pub stability_px: f64,
    /// It is also kept while its error on the pairs is larger by at most this share.
    pub still_tolerance: f64,
    /// Weight of the previous map relative to all inliers, which fixes what the overlap does not determine; 0 fits the
    /// inliers alone.
    pub anchor_fit: f64,
    /// Rms error of the inliers, px, above which a homography is rejected; 0 accepts all.
    pub max_rms_px: f64,
    /// Failed frames in a row for which the previous homography counts as held.
    pub hold_frames: usize,
}

impl Default for GridParams {
    fn default() -> Self {
        Self {
            rows: 9,
            columns: 24,
            point: CellPoint::default(),
            step_px: 3,
            min_valid: 0.3,
            ransac: RansacParams { threshold_px: 4.0, ..RansacParams::default() },
            min_inliers: 12,
            plausibility: Plausibility::default(),
            stability_px: 0.8,
            still_tolerance: 0.1,
            anchor_fit: 1.0,
            max_rms_px: 0.0,
            hold_frames: 5,
        }
    }
}

/// Result for one disparity map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GridRegistration {
    /// Maps right-image pixels to left-image pixels; the last good one when held or lost, the identity before any.
    pub left_from_right: Homography,
    /// Fresh, held or lost.
    pub state: RegistrationState,
    /// Cells that gave a point.
    pub points: usize,
    /// Points that agree with the homography; 0 unless fresh.
    pub inliers: usize,
    /// Root mean square reprojection error of the inliers in the left image, px; 0 unless fresh.
    pub rms_px: f64,
    /// The error for which this map's homography was rejected, px.
    pub refused_rms_px: Option<f64>,
    /// Overlap in the left image; the whole image unless fresh.
    pub roi_left: Rect,
    /// Overlap in the right image.
    pub roi_right: Rect,
    /// Whether the homography is the previous frame's, kept by the stability test.
    pub kept: bool,
}

impl GridParams {
    /// The same in pixels of maps that are smaller by a factor.
    fn shrunk(self, factor: usize) -> Self {
        let px = |length: f64| length / factor as f64;
        Self {
            step_px: self.step_px.div_ceil(factor),
            ransac: RansacParams { threshold_px: px(self.ransac.threshold_px), ..self.ransac },
            stability_px: px(self.stability_px),
            max_rms_px: px(self.max_rms_px),
            ..self
        }
    }
}

impl GridRegistration {
    /// The same in pixels of images of these sizes, which are larger by a factor.
    fn enlarged(self, factor: usize, [left, right]: [(usize, usize); 2]) -> Self {
        let whole = |small: &Rect, (width, height): (usize, usize)| {
            Rect::new(small.x * factor, small.y * factor, small.width * factor, small.height * factor)
                .clamped(width, height)
        };
        Self {
            left_from_right: enlarged(&self.left_from_right, factor),
            rms_px: self.rms_px * factor as f64,
            refused_rms_px: self.refused_rms_px.map(|px| px * factor as f64),
            roi_left: whole(&self.roi_left, left),
            roi_right: whole(&self.roi_right, right),
            ..self
        }
    }
}

/// Registers disparity maps one after the other. Allocates only for a larger grid than before.
#[derive(Clone, Debug, Default)]
pub struct RegisterGrid {
    params: GridParams,
    /// By how much the last map was smaller than the images; 0 before the first.
    factor: usize,
    /// The parameters in pixels of that map; so are all later fields.
    scaled: GridParams,
    ransac: Ransac,
    from: Vec<Point>,
    to: Vec<Point>,
    mask: Vec<bool>,
    cell: Vec<f32>,
    samples: Vec<Sample>,
    counts: [Vec<u32>; 2],
    stability: Stability,
    memory: Option<Homography>,
    failures: usize,
    /// Whether the overlap is too narrow for a homography of eight parameters.
    is_narrow: bool,
}

/// Pairs per direction that transfer a plane to images that are not rectified.
const PLANE_PAIRS: usize = 5;
/// Maximum distance of a sample from its plane, independent of the homography's threshold.
const MAX_PLANE_PX: f64 = 4.0;
/// An overlap of less than a side divided by this is narrow.
const NARROW_PART: usize = 3;
/// Approximate maximum number of pixels read per cell.
const MAX_CELL_PIXELS: usize = 300;
/// Smallest number of columns used per cell.
const MIN_CELL_STEPS: usize = 2;

impl RegisterGrid {
    /// A registration without history.
    pub fn new(params: GridParams) -> Self {
        Self { params, scaled: params, ransac: Ransac::new(), ..Self::default() }
    }

    /// The parameters that were last set.
    pub fn params(&self) -> &GridParams {
        &self.params
    }

    /// Changes the parameters; the previous frame's result stays.
    pub fn set_params(&mut self, params: GridParams) {
        self.params = params;
        self.scaled = params.shrunk(self.factor.max(1));
    }

    /// Forgets the previous frame.
    pub fn reset(&mut self) {
        self.memory = None;
        self.failures = 0;
    }

    /// Registers by one disparity map: px of the left rectified view, NaN where unmatched. The map has the size of the
    /// images, or is smaller by a whole factor, see [`map_factor`].
    ///
    /// A failure is a state, not an error: the next frame searches the whole map.
    pub fn register(
        &mut self,
        disparity: View<'_, f32>,
        left: &RectifiedView,
        right: &RectifiedView,
    ) -> GridRegistration {
        let factor = map_factor((disparity.width, disparity.height), left.size).unwrap_or(1);
        if factor != self.factor {
            self.reset();
            self.factor = factor;
            self.scaled = self.params.shrunk(factor);
        }
        if factor == 1 {
            return self.register_map(disparity, left, right);
        }
        let [small_left, small_right] = [left, right].map(|view| view.shrunk(factor));
        let found = self.register_map(disparity, &small_left, &small_right);
        found.enlarged(factor, [left.size, right.size])
    }

    /// Columns and rows, ascending, that the next map is read at, if it is of this size; `None` if all of it may be.
    pub fn pixels(&self, size: (usize, usize), left: &RectifiedView, right: &RectifiedView) -> Option<[Vec<u32>; 2]> {
        let factor = map_factor(size, left.size).filter(|factor| *factor == self.factor)?;
        let right_size = if factor == 1 { right.size } else { right.shrunk(factor).size };
        let cells = self.cells(self.known_area(size, right_size)?)?;
        let [x, y] = [cells.columns, cells.rows].map(|count| 0..count);
        let columns = x.flat_map(|at| cells.sampled(cells.column(at))).map(|x| x as u32).collect();
        let rows = y.flat_map(|at| cells.sampled(cells.row(at))).map(|y| y as u32).collect();
        Some([columns, rows])
    }

    /// Registers by a map as large as the images.
    fn register_map(
        &mut self,
        disparity: View<'_, f32>,
        left: &RectifiedView,
        right: &RectifiedView,
    ) -> GridRegistration {
        self.gather(disparity, left, right);
        let whole = |view: &RectifiedView| Rect::new(0, 0, view.size.0, view.size.1);
        let mut result = GridRegistration {
            left_from_right: self.memory.unwrap_or_default(),
            points: self.from.len(),
            roi_left: whole(left),
            roi_right: whole(right),
            ..GridRegistration::default()
        };
        let params = self.scaled;
        let accepted = |fit: &RansacFit| {
            fit.inliers >= params.min_inliers.max(4) && params.plausibility.accepts(&fit.homography, right.size)
        };
        // A homography of a narrow overlap fits there and folds the rest of the view: a plane goes first.
        let plane = if self.is_narrow { self.fit_plane(left, right).filter(accepted) } else { None };
        let fit = plane.or_else(|| {
            self.ransac.estimate(&self.from, &self.to, &params.ransac, &mut self.mask).ok().filter(accepted)
        });
        let fit = if self.is_narrow { fit } else { fit.or_else(|| self.fit_plane(left, right).filter(accepted)) };
        let Some(fit) = fit else { return self.failed(result) };
        let previous = self.memory.filter(|_| self.failures == 0);
        let stable = StabilityParams {
            stability_px: params.stability_px,
            still_tolerance: params.still_tolerance,
            outlier_px: params.ransac.threshold_px,
            anchor_fit: params.anchor_fit,
            max_rms_px: params.max_rms_px,
        };
        let mask = &self.mask;
        let chosen = self.stability.choose(&fit, previous, right.size, (&self.from, &self.to, mask), &stable);
        let Stabilized { homography: map, kept } = chosen;
        let rms_px = rms_of(&map, &self.from, &self.to, mask);
        if params.max_rms_px > 0.0 && rms_px > params.max_rms_px {
            result.refused_rms_px = Some(rms_px);
            return self.failed(result);
        }
        self.failures = 0;
        self.memory = Some(map);
        let (roi_left, roi_right) = overlap_rois(&map, left.size, right.size);
        GridRegistration {
            left_from_right: map,
            state: RegistrationState::Fresh,
            inliers: fit.inliers,
            rms_px,
            roi_left,
            roi_right,
            kept,
            ..result
        }
    }

    /// Handles a map without a homography: the previous one is held for some frames.
    fn failed(&mut self, mut result: GridRegistration) -> GridRegistration {
        self.failures += 1;
        if self.memory.is_some() && self.failures <= self.scaled.hold_frames {
            result.state = RegistrationState::Held;
        }
        result
    }

    /// The homography of a plane in space, for an overlap too narrow to determine more; `mask` becomes its inliers.
    fn fit_plane(&mut self, left: &RectifiedView, right: &RectifiedView) -> Option<RansacFit> {
        let RansacParams { threshold_px, seed, .. } = self.scaled.ransac;
        let threshold_px = threshold_px.min(MAX_PLANE_PX);
        let plane = DisparityPlane::fit(&self.samples, threshold_px, self.scaled.min_inliers, seed)?;
        // Exact for pinhole cameras; lens distortion is averaged over the view.
        let (mut from, mut to) = ([[0.0; 2]; PLANE_PAIRS * PLANE_PAIRS], [[0.0; 2]; PLANE_PAIRS * PLANE_PAIRS]);
        for index in 0..PLANE_PAIRS * PLANE_PAIRS {
            let along = |step: usize, length: usize| step as f64 / (PLANE_PAIRS - 1) as f64 * (length as f64 - 1.0);
            let place = [along(index % PLANE_PAIRS, right.size.0), along(index / PLANE_PAIRS, right.size.1)];
            from[index] = right.unrectify(place);
            to[index] = left.unrectify(plane.left_from_right(place));
        }
        let homography = Homography::fit(&from, &to, |_| true)?;
        let bound = threshold_px * threshold_px;
        self.mask.clear();
        let (mut inliers, mut squares) = (0, 0.0);
        for (from, to) in self.from.iter().zip(&self.to) {
            let error = homography.squared_error(*from, *to);
            self.mask.push(error < bound);
            if error < bound {
                inliers += 1;
                squares += error;
            }
        }
        let rms_px = (squares / f64::max(inliers as f64, 1.0)).sqrt();
        Some(RansacFit { homography, inliers, rms_px, iterations: 0 })
    }

    /// The part of the left rectified view that both views share, by its disparities alone: where `x - d` lies in the
    /// right view.
    fn shared_area(&mut self, disparity: View<'_, f32>, step: usize) -> Rect {
        let (width, height) = (disparity.width, disparity.height);
        for (counts, length) in self.counts.iter_mut().zip([width, height]) {
            counts.clear();
            counts.resize(length, 0);
        }
        let mut total = 0u32;
        for y in (step / 2..height).step_by(step) {
            let line = disparity.row(y);
            for x in (step / 2..width).step_by(step) {
                let d = line[x];
                if d > 0.0 && d <= x as f32 {
                    self.counts[0][x] += 1;
                    self.counts[1][y] += 1;
                    total += 1;
                }
            }
        }
        let [(x, columns), (y, rows)] = [0, 1].map(|axis| bounds(&self.counts[axis], total, step));
        Rect::new(x, y, columns, rows)
    }

    /// The overlap of the last map, in maps of `size`, if that map was registered.
    fn known_area(&self, (width, height): (usize, usize), right: (usize, usize)) -> Option<Rect> {
        // Rectified views differ from the pictures by little, so that the pictures' overlap places the grid.
        let map = self.memory.filter(|_| self.failures == 0)?;
        Some(overlap_roi(&map, right.0, right.1, width, height))
    }

    /// The grid on an area; `None` if it is too small.
    fn cells(&self, area: Rect) -> Option<Cells> {
        let step = self.scaled.step_px.max(1);
        let (rows, columns) = (self.scaled.rows.max(1), self.scaled.columns.max(1));
        // Cells of a narrow overlap still hold some pixels each.
        let columns = columns.min(area.width / (MIN_CELL_STEPS * step));
        if columns == 0 || area.height < rows {
            return None;
        }
        // A median of some hundred pixels is as good as one of thousands.
        let in_cell = area.width / columns * (area.height / rows);
        Some(Cells { area, rows, columns, step: step.max((in_cell / MAX_CELL_PIXELS).isqrt()) })
    }

    /// Lays the grid and takes a pair from each cell.
    fn gather(&mut self, disparity: View<'_, f32>, left: &RectifiedView, right: &RectifiedView) {
        self.from.clear();
        self.to.clear();
        let (width, height) = (disparity.width, disparity.height);
        let area = match self.known_area((width, height), right.size) {
            Some(area) => area,
            None => self.shared_area(disparity, self.scaled.step_px.max(1)),
        };
        self.is_narrow = area.width * NARROW_PART < width || area.height * NARROW_PART < height;
        let count = self.scaled.rows.max(1) * self.scaled.columns.max(1);
        self.samples.clear();
        self.samples.reserve(count);
        self.from.reserve(count);
        self.to.reserve(count);
        self.mask.reserve(count.saturating_sub(self.mask.len()));
        self.ransac.reserve(count);
        self.stability.reserve(count, self.scaled.anchor_fit);
        let Some(cells) = self.cells(area) else { return };
        for row in 0..cells.rows {
            for column in 0..cells.columns {
                let Some((point, d)) = self.cell(disparity, &cells, (column, row)) else { continue };
                let other = [point[0] - f64::from(d), point[1]];
                if other[0] >= 0.0 {
                    self.samples.push(Sample { at: point, disparity_px: f64::from(d) });
                }
                let (to, from) = (left.unrectify(point), right.unrectify(other));
                let inside = from[0] >= 0.0
                    && from[1] >= 0.0
                    && from[0] <= right.size.0 as f64 - 1.0
                    && from[1] <= right.size.1 as f64 - 1.0;
                // Written so that NaN fails too.
                if inside && to[0].is_finite() && to[1].is_finite() {
                    self.from.push(from);
                    self.to.push(to);
                }
            }
        }
    }

    fn cell(&mut self, disparity: View<'_, f32>, cells: &Cells, (column, row): (usize, usize)) -> Option<(Point, f32)> {
        let (columns, rows) = (cells.column(column), cells.row(row));
        self.cell.clear();
        let (mut looked, mut peak) = (0usize, (0.0f32, [0.0; 2]));
        for y in cells.sampled(rows.clone()) {
            let line = disparity.row(y);
            for x in cells.sampled(columns.clone()) {
                looked += 1;
                let d = line[x];
                if d > 0.0 && d.is_finite() {
                    self.cell.push(d);
                    if d > peak.0 {
                        peak = (d, [x as f64, y as f64]);
                    }
                }
            }
        }
        let valid = self.cell.len();
        if valid == 0 || (valid as f32) < self.scaled.min_valid * looked as f32 {
            return None;
        }
        match self.scaled.point {
            CellPoint::Peak => Some((peak.1, peak.0)),
            CellPoint::Median => {
                let (_, &mut median, _) = self.cell.select_nth_unstable_by(valid / 2, f32::total_cmp);
                let middle = |range: std::ops::Range<usize>| (range.start + range.end - 1) as f64 / 2.0;
                Some(([middle(columns), middle(rows)], median))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stereo::Lens;

    fn camera() -> RectifiedView {
        RectifiedView {
            size: (640, 480),
            focal_px: [750.0; 2],
            centre_px: [319.5, 239.5],
            lens: Lens::NONE,
            rectified_from_camera: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            rectified_focal_px: [750.0; 2],
            rectified_centre_px: [319.5, 239.5],
        }
    }

    /// Disparity of a plane that leans back: `d = 200 + x / 40 - y / 30`.
    fn plane() -> Vec<f32> {
        (0..640 * 480).map(|i| 200.0 + (i % 640) as f32 / 40.0 - (i / 640) as f32 / 30.0).collect()
    }

    #[test]
    fn pixels_that_are_not_announced_are_not_read() {
        let map = plane();
        let size = (640, 480);
        let [mut whole, mut part] = [0, 1].map(|_| RegisterGrid::new(GridParams::default()));
        assert_eq!(part.pixels(size, &camera(), &camera()), None, "the first map");
        for tick in 0..3 {
            let known = part.pixels(size, &camera(), &camera());
            assert_eq!(known.is_some(), tick > 0);
            let is_known = |at: usize| {
                known.as_ref().is_none_or(|[columns, rows]| {
                    columns.contains(&(at as u32 % 640)) && rows.contains(&(at as u32 / 640))
                })
            };
            let seen: Vec<f32> = (0..map.len()).map(|at| if is_known(at) { map[at] } else { 1e9 }).collect();
            let [expected, found] = [(&mut whole, &map), (&mut part, &seen)]
                .map(|(grid, map)| grid.register(View::new(map, 640, 480, 1), &camera(), &camera()));
            assert_eq!(found, expected, "tick {tick}");
            assert_eq!(found.state, RegistrationState::Fresh);
            let count = known.map_or(0, |[columns, rows]| columns.len() * rows.len());
            assert!(count < 640 * 480 / 8, "{count}");
        }
    }

    #[test]
    fn a_plane_is_registered_exactly_despite_holes_and_outliers() {
        let mut map = plane();
        for (i, d) in map.iter_mut().enumerate() {
            match i % 17 {
                0..=6 => *d = f32::NAN,
                7 => *d = 30.0,
                _ => {}
            }
        }
        let camera = camera();
        let mut register =
            RegisterGrid::new(GridParams { stability_px: 0.0, anchor_fit: 0.0, ..GridParams::default() });
        let found = register.register(View::new(&map, 640, 480, 1), &camera, &camera);
        assert_eq!(found.state, RegistrationState::Fresh);
        for [x, y] in [[300.0, 50.0], [600.0, 400.0], [450.0, 240.0]] {
            let d = 200.0 + x / 40.0 - y / 30.0;
            let error = found.left_from_right.squared_error([x - d, y], [x, y]).sqrt();
            assert!(error < 0.2, "{error} px at {x}, {y}");
        }
        assert!(found.roi_left.x > 180 && found.roi_left.width > 400, "{:?}", found.roi_left);
    }

    #[test]
    fn a_small_map_registers_large_pictures() {
        let (small, camera) = (plane(), camera());
        let large = RectifiedView {
            size: (1920, 1440),
            focal_px: [2250.0; 2],
            centre_px: [958.5 + 1.0, 718.5 + 1.0],
            rectified_focal_px: [2250.0; 2],
            rectified_centre_px: [958.5 + 1.0, 718.5 + 1.0],
            ..camera
        };
        assert_eq!(large.shrunk(3), camera);
        let mut register =
            RegisterGrid::new(GridParams { stability_px: 0.0, anchor_fit: 0.0, ..GridParams::default() });
        let found = register.register(View::new(&small, 640, 480, 1), &large, &large);
        assert_eq!(found.state, RegistrationState::Fresh);
        for [x, y] in [[300.0, 50.0], [600.0, 400.0], [450.0, 240.0]] {
            let [d, at] = [200.0 + x / 40.0 - y / 30.0, 0.0].map(|d| [3.0 * (x - d) + 1.0, 3.0 * y + 1.0]);
            let error = found.left_from_right.squared_error(d, at).sqrt();
            assert!(error < 0.6, "{error} px at {x}, {y}");
        }
        assert!(found.roi_left.x > 540 && found.roi_left.width > 1200, "{:?}", found.roi_left);
        // The same map of pictures of its own size starts anew.
        let found = register.register(View::new(&small, 640, 480, 1), &camera, &camera);
        let error = found.left_from_right.squared_error([300.0 - 205.8333, 50.0], [300.0, 50.0]).sqrt();
        assert!(found.state == RegistrationState::Fresh && error < 0.2, "{error} px");
    }

    #[test]
    fn an_overlap_of_a_few_columns_is_registered_by_a_plane() {
        // Views 20 mm from the tissue share a strip of 40 to 60 px of 640; half of it is unmatched, and wrong matches lie around it.
        let mut map = vec![f32::NAN; 640 * 480];
        let truth = |x: usize, y: usize| 590.0 - y as f32 / 24.0 + (x % 3) as f32 * 0.3;
        for y in 0..480 {
            for x in 0..640 {
                let d = truth(x, y);
                match (x * 31 + y * 17) % 40 {
                    0 if x > 450 => map[y * 640 + x] = 490.0 + (x % 90) as f32,
                    1..=20 if x as f32 >= d => map[y * 640 + x] = d,
                    _ => {}
                }
            }
        }
        let camera = camera();
        let mut register = RegisterGrid::new(GridParams::default());
        for frame in 0..3 {
            let found = register.register(View::new(&map, 640, 480, 1), &camera, &camera);
            assert_eq!(found.state, RegistrationState::Fresh, "frame {frame}: {found:?}");
            for y in [0.0, 240.0, 479.0] {
                let [u, v] = found.left_from_right.map([639.0, y]);
                let expected = 639.0 + 590.0 - y / 24.0;
                assert!((u - expected).abs() < 30.0 && (v - y).abs() < 10.0, "frame {frame}: {u}, {v} at row {y}");
            }
        }
    }

    #[test]
    fn rectification_is_undone() {
        let (sin, cos) = 0.05f64.sin_cos();
        let turned = RectifiedView {
            rectified_from_camera: [cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos],
            lens: Lens::of_coefficients(&[-0.1, 0.02, 0.001, -0.001]).unwrap(),
            ..camera()
        };
        let [u, v] = turned.unrectify([400.0, 100.0]);
        // Forward: undistort by iteration, rotate, project.
        let (mut x, mut y) = ((u - 319.5) / 750.0, (v - 239.5) / 750.0);
        let (x0, y0) = (x, y);
        for _ in 0..50 {
            let r2 = x * x + y * y;
            let radial = 1.0 + r2 * (-0.1 + r2 * 0.02);
            let (dx, dy) =
                (2.0 * 0.001 * x * y - 0.001 * (r2 + 2.0 * x * x), 0.001 * (r2 + 2.0 * y * y) - 2.0 * 0.001 * x * y);
            (x, y) = ((x0 - dx) / radial, (y0 - dy) / radial);
        }
        let w = -sin * x + cos;
        let back = [750.0 * (cos * x + sin) / w + 319.5, 750.0 * y / w + 239.5];
        assert!((back[0] - 400.0).abs() < 1e-6 && (back[1] - 100.0).abs() < 1e-6, "{back:?}");
    }

    #[test]
    fn empty_maps_hold_then_lose_then_resume() {
        let (map, camera) = (plane(), camera());
        let empty = vec![f32::NAN; map.len()];
        let mut register = RegisterGrid::new(GridParams { hold_frames: 2, ..GridParams::default() });
        let mut state = |map: &[f32]| register.register(View::new(map, 640, 480, 1), &camera, &camera).state;
        assert_eq!(state(&empty), RegistrationState::Lost);
        assert_eq!(state(&map), RegistrationState::Fresh);
        assert_eq!(
            [state(&empty), state(&empty), state(&empty)],
            [RegistrationState::Held, RegistrationState::Held, RegistrationState::Lost]
        );
        assert_eq!(state(&map), RegistrationState::Fresh);
    }

    #[test]
    fn small_changes_leave_the_homography_as_it_is() {
        let (map, camera) = (plane(), camera());
        let mut register = RegisterGrid::new(GridParams { anchor_fit: 0.0, ..GridParams::default() });
        let first = register.register(View::new(&map, 640, 480, 1), &camera, &camera);
        let noisy: Vec<f32> = map.iter().enumerate().map(|(i, d)| d + ((i * 7919) % 13) as f32 * 0.05 - 0.3).collect();
        let second = register.register(View::new(&noisy, 640, 480, 1), &camera, &camera);
        assert!(second.kept);
        assert_eq!(first.left_from_right, second.left_from_right);
        let moved: Vec<f32> = map.iter().map(|d| d + 5.0).collect();
        let third = register.register(View::new(&moved, 640, 480, 1), &camera, &camera);
        assert!(!third.kept);
        let error = third.left_from_right.squared_error([395.0 - 206.875, 240.0], [395.0, 240.0]).sqrt();
        assert!(error < 0.5, "{error} px");
    }
}
