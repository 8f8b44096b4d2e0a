//! SURF: detection and description of a gray image or a part of it.
//!
//! H. Bay, A. Ess, T. Tuytelaars, L. Van Gool, "Speeded-Up Robust Features (SURF)", CVIU 110 (2008).

use super::color::{GrayBuffer, shrink_gray_with};
use super::describe::{Descriptor, Tables, describe, describe_extended};
use super::hessian::{Extremum, HessianDetector};
use super::integral::Integral;
use super::isotropic::{Kernels, refine};
use super::orientation::{Scratch, TurnWeights, orientation};
use super::pyramid::Pyramid;
use crate::Rect;
use crate::simd::grow;
use crate::{Parallel, SharedMut, Simd, View};

/// Keypoints per chunk when describing.
const POINTS_PER_CHUNK: usize = 16;
/// SURF scale `s` of a filter of one pixel: sigma 1.2 belongs to the 9 x 9 filter.
const SCALE_PER_SIZE: f32 = 1.2 / 9.0;
/// Lower bound of pixels per maximum.
const PIXELS_PER_MAXIMUM: usize = 32;
/// Rows of a band within which the order of description is free, in pixels.
const ORDER_ROWS: usize = 16;
/// Candidates this near can be doubles of each other, in pixels.
const DOUBLES_CELL_PX: usize = 8;
/// Doubles differ less than this in size.
const DOUBLES_SIZE_RATIO: f32 = 1.3;

/// Parameters of detection and description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfParams {
    /// Minimum determinant of a keypoint, in squared gray levels (the scale of OpenCV's `hessianThreshold`).
    pub hessian_threshold: f32,
    /// Octaves, 1..=4.
    pub octaves: usize,
    /// Filters per octave, at least 3; the usual 4 leave two that may hold maxima.
    pub layers: usize,
    /// Skips the orientation: angle 0, for views that are hardly rotated.
    pub upright: bool,
    /// Refines each candidate with Gaussian derivatives, whose position and rank do not depend on the image's rotation;
    /// about one microsecond per candidate.
    pub second_look: bool,
    /// Keypoints are ranked by response / size^bias: fine detail has a more exact position in pixels.
    pub fine_bias: f32,
    /// Maximum number of keypoints, strongest first; 0 for no limit.
    pub max_points: usize,
    /// Doubles the image in size when nothing is shrunk (as Lowe 2004, section 3.3, does), so that the first octave
    /// holds finer keypoints; costs about four times as much.
    pub upsample: bool,
    /// Size of orientation and descriptor windows over the usual one: larger ones distinguish fine keypoints better.
    pub window: f32,
    /// Descriptors of 128 elements ([`Features::extension`]): more right matches for about twice the time of
    /// description and matching.
    pub extended: bool,
    /// Columns and rows of a grid whose cells share `max_points` evenly before the rest is filled with the strongest; 0
    /// takes the strongest regardless of position.
    pub spread: (usize, usize),
}

impl Default for SurfParams {
    fn default() -> Self {
        Self {
            hessian_threshold: 100.0,
            octaves: 4,
            layers: 4,
            upright: false,
            second_look: true,
            fine_bias: 1.0,
            max_points: 0,
            upsample: false,
            window: 1.0,
            extended: false,
            spread: (0, 0),
        }
    }
}

/// `gray` at twice its size, bilinear: pixel `2i` lies a quarter before the centre of pixel `i`, `2i + 1` a quarter
/// behind it.
fn double(gray: View<'_, u8>, out: &mut Vec<u8>) {
    let (width, height) = (gray.width, gray.height);
    out.clear();
    out.resize(width * height * 4, 0);
    for (y, line) in out.chunks_exact_mut(width * 2).enumerate() {
        let near = gray.row(y / 2);
        let far = gray.row(if y % 2 == 0 { (y / 2).saturating_sub(1) } else { (y / 2 + 1).min(height - 1) });
        let column = |x: usize| 3 * u32::from(near[x]) + u32::from(far[x]);
        for x in 0..width {
            let here = 3 * column(x);
            line[2 * x] = ((here + column(x.saturating_sub(1)) + 8) / 16) as u8;
            line[2 * x + 1] = ((here + column((x + 1).min(width - 1)) + 8) / 16) as u8;
        }
    }
}

/// The gray image that is searched: `part` of an image, shrunk with area averages, or twice its size where `doubled` has room for that.
fn searched<'a>(
    simd: Simd,
    part: View<'a, u8>,
    shrink: usize,
    buffer: &'a mut GrayBuffer,
    doubled: Option<&'a mut Vec<u8>>,
    pool: &dyn Parallel,
) -> View<'a, u8> {
    let gray = if shrink == 1 && part.channels == 1 {
        part
    } else {
        shrink_gray_with(simd, part, shrink, buffer, pool);
        buffer.view()
    };
    match doubled {
        None => gray,
        Some(doubled) => {
            double(gray, doubled);
            View::new(doubled, gray.width * 2, gray.height * 2, 1)
        }
    }
}

/// Keypoints, one list per quantity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Keypoints {
    /// Columns, in full-frame pixels; pixel centres are whole numbers.
    pub x_px: Vec<f32>,
    /// Rows, in full-frame pixels.
    pub y_px: Vec<f32>,
    /// Filter sizes (diameters), in full-frame pixels.
    pub size_px: Vec<f32>,
    /// Orientations in radians, x towards y (clockwise as seen); 0 when upright.
    pub angle_rad: Vec<f32>,
    /// Determinants of the Hessian at the keypoints.
    pub response: Vec<f32>,
    /// Signs of the Laplacian: 1 dark on bright ground, -1 bright on dark ground.
    pub laplacian: Vec<i8>,
}

impl Keypoints {
    /// Their number.
    pub fn len(&self) -> usize {
        self.x_px.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.x_px.is_empty()
    }

    /// Position of keypoint `index`.
    pub fn position(&self, index: usize) -> [f64; 2] {
        [f64::from(self.x_px[index]), f64::from(self.y_px[index])]
    }

    fn copy(&mut self, from: usize, to: usize) {
        let lists = [&mut self.x_px, &mut self.y_px, &mut self.size_px, &mut self.angle_rad, &mut self.response];
        lists.into_iter().for_each(|list| list[to] = list[from]);
        self.laplacian[to] = self.laplacian[from];
    }

    fn resize(&mut self, count: usize) {
        self.x_px.resize(count, 0.0);
        self.y_px.resize(count, 0.0);
        self.size_px.resize(count, 0.0);
        self.angle_rad.resize(count, 0.0);
        self.response.resize(count, 0.0);
        self.laplacian.resize(count, 0);
    }
}

/// Keypoints with their descriptors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Positions and sizes.
    pub keypoints: Keypoints,
    /// One descriptor for each keypoint.
    pub descriptors: Vec<Descriptor>,
    /// The other 64 elements of each extended descriptor, both halves together of unit length; empty unless
    /// [`SurfParams::extended`].
    pub extension: Vec<Descriptor>,
}

impl Features {
    /// Number of keypoints.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// Descriptors of 64 elements per keypoint: 2 if extended.
    pub(crate) fn parts(&self) -> usize {
        if self.extension.is_empty() { 1 } else { 2 }
    }

    /// Part `part` of keypoint `index`'s descriptor.
    pub(crate) fn part(&self, index: usize, part: usize) -> Option<&Descriptor> {
        if part == 0 { &self.descriptors } else { &self.extension }.get(index)
    }

    /// Removes the keypoints whose position, px, is not kept.
    pub(crate) fn retain(&mut self, keep: impl Fn([f64; 2]) -> bool) {
        let mut count = 0;
        for index in 0..self.len() {
            if !keep(self.keypoints.position(index)) {
                continue;
            }
            self.keypoints.copy(index, count);
            self.descriptors[count] = self.descriptors[index];
            if !self.extension.is_empty() {
                self.extension[count] = self.extension[index];
            }
            count += 1;
        }
        self.keypoints.resize(count);
        self.descriptors.truncate(count);
        self.extension.truncate(count);
    }

    /// Removes all keypoints and keeps the memory.
    pub fn clear(&mut self) {
        self.keypoints.resize(0);
        self.descriptors.clear();
        self.extension.clear();
    }
}

/// SURF with its work memory. Allocates only for larger images than before.
#[derive(Clone, Debug)]
pub struct Surf {
    params: SurfParams,
    simd: Simd,
    tables: Tables,
    turns: TurnWeights,
    kernels: Kernels,
    gray: GrayBuffer,
    doubled: Vec<u8>,
    integral: Integral,
    pyramid: Pyramid,
    detector: HessianDetector,
    found: Vec<Extremum>,
    counts: Vec<u32>,
    next: Vec<u32>,
    kept: Vec<Extremum>,
    order: Vec<u32>,
}

impl Surf {
    /// A detector with these parameters.
    pub fn new(params: SurfParams) -> Self {
        Self::with_simd(params, Simd::detect())
    }

    /// A detector that runs on a chosen instruction set.
    pub fn with_simd(params: SurfParams, simd: Simd) -> Self {
        Self {
            params,
            simd,
            tables: Tables::new(),
            turns: TurnWeights::new(),
            kernels: Kernels::new(),
            gray: GrayBuffer::new(),
            doubled: Vec::new(),
            integral: Integral::new(),
            pyramid: Pyramid::default(),
            detector: HessianDetector::default(),
            found: Vec::new(),
            counts: Vec::new(),
            next: Vec::new(),
            kept: Vec::new(),
            order: Vec::new(),
        }
    }

    /// The parameters that were last set.
    pub fn params(&self) -> &SurfParams {
        &self.params
    }

    /// Changes the parameters; memory is kept.
    pub fn set_params(&mut self, params: SurfParams) {
        self.params = params;
    }

    /// Detects and describes keypoints of `image` (gray, or BGR that is converted on the way).
    ///
    /// Searches only `roi` (clipped to the image; `None`: everything), shrunk by `shrink` with area
    /// averages first (0 counts as 1). Keypoints come back in full-frame pixels, strongest first.
    pub fn detect_and_describe(
        &mut self,
        image: View<'_, u8>,
        roi: Option<Rect>,
        shrink: usize,
        pool: &dyn Parallel,
        out: &mut Features,
    ) {
        let whole = Rect::new(0, 0, image.width, image.height);
        let roi = roi.map_or(whole, |roi| roi.intersect(&whole));
        let shrink = shrink.max(1);
        if roi.width / shrink == 0 || roi.height / shrink == 0 || image.channels == 0 {
            out.clear();
            return;
        }
        let is_doubled = shrink == 1 && self.params.upsample;
        // More maxima than any part of a picture of this size has, so that the lists do not grow again.
        let enlarged = if is_doubled { 4 } else { 1 };
        self.clear_lists(enlarged * (image.width / shrink) * (image.height / shrink) / PIXELS_PER_MAXIMUM);
        let part = image.crop(roi.x, roi.y, roi.width, roi.height);
        let doubled = is_doubled.then_some(&mut self.doubled);
        let gray = searched(self.simd, part, shrink, &mut self.gray, doubled, pool);
        self.integral.compute_with(self.simd, gray, pool);
        let SurfParams { hessian_threshold, octaves, layers, max_points, extended, .. } = self.params;
        // A negative threshold would also let saddles through.
        let threshold = hessian_threshold.max(0.0);
        self.detector.detect(self.simd, &self.integral, octaves, layers, threshold, pool, &mut self.found);
        self.pyramid.build(self.simd, gray, pool);
        let (width, height) = (gray.width, gray.height);
        // Ranked by box responses, more than wanted; then by the refined strength.
        self.rank();
        if self.params.second_look {
            self.select(width, height, max_points + max_points / 2);
            self.refine_candidates(pool);
            self.rank();
            self.drop_doubles(width, height);
        }
        self.select(width, height, max_points);
        let count = self.found.len();
        if count == 0 {
            out.clear();
            return;
        }
        // What the frame before left is overwritten element by element.
        if max_points > 0 {
            reserve(out, max_points, extended);
        }
        out.keypoints.resize(count);
        out.descriptors.resize(count, Descriptor::default());
        out.extension.resize(if extended { count } else { 0 }, Descriptor::default());
        let ratio = if is_doubled { 0.5 } else { shrink as f32 };
        let centre = (ratio - 1.0) * 0.5;
        let keypoints = &mut out.keypoints;
        for (index, point) in self.found.iter().enumerate() {
            keypoints.x_px[index] = roi.x as f32 + point.x * ratio + centre;
            keypoints.y_px[index] = roi.y as f32 + point.y * ratio + centre;
            keypoints.size_px[index] = point.size * ratio;
            keypoints.response[index] = point.response;
            keypoints.laplacian[index] = point.laplacian;
        }
        self.sort_by_row(height);
        self.describe_found(pool, out);
    }

    /// Clears the lists of candidates, with room for `count` of them.
    fn clear_lists(&mut self, count: usize) {
        for list in [&mut self.found, &mut self.kept] {
            list.clear();
            list.reserve(count);
        }
        for list in [&mut self.next, &mut self.order] {
            list.clear();
            list.reserve(count);
        }
    }

    /// Writes the orientations and descriptors of the keypoints, in the order of [`Self::sort_by_row`].
    fn describe_found(&self, pool: &dyn Parallel, out: &mut Features) {
        let SurfParams { upright, window, extended, .. } = self.params;
        let (simd, tables, turns, pyramid) = (self.simd, &self.tables, &self.turns, &self.pyramid);
        let (found, order) = (&self.found, &self.order);
        let count = found.len();
        let angles = SharedMut::new(&mut out.keypoints.angle_rad);
        let descriptors = SharedMut::new(&mut out.descriptors);
        let extension = SharedMut::new(&mut out.extension);
        pool.run(count.div_ceil(POINTS_PER_CHUNK), &|chunk| {
            let mut scratch = Scratch::new();
            let scratch = &mut scratch;
            let first = chunk * POINTS_PER_CHUNK;
            for index in &order[first..(first + POINTS_PER_CHUNK).min(count)] {
                let (index, point) = (*index as usize, &found[*index as usize]);
                let scale = point.size * SCALE_PER_SIZE * window;
                let (x, y) = (point.x, point.y);
                // SAFETY: each keypoint stands in the order once, and chunks own disjoint parts of it.
                let (angle, descriptor) =
                    unsafe { (&mut angles.part(index, 1)[0], &mut descriptors.part(index, 1)[0]) };
                *angle = if upright { 0.0 } else { orientation(simd, turns, pyramid, x, y, scale, scratch) };
                if extended {
                    // SAFETY: `extension` is as long as `descriptors`, and `index` is used by this chunk alone.
                    let wide = unsafe { &mut extension.part(index, 1)[0] };
                    describe_extended(
                        simd,
                        tables,
                        pyramid,
                        x,
                        y,
                        scale,
                        *angle,
                        [descriptor, wide],
                        &mut scratch.patch,
                    );
                } else {
                    describe(simd, tables, pyramid, x, y, scale, *angle, descriptor, &mut scratch.patch);
                }
            }
        });
    }

    /// Orders the keypoints by rows of the image, so that consecutive ones read cached data.
    fn sort_by_row(&mut self, height: usize) {
        let bands = height / ORDER_ROWS + 1;
        let band_of = |point: &Extremum| (point.y.max(0.0) as usize / ORDER_ROWS).min(bands - 1);
        grow(&mut self.counts, bands);
        let starts = &mut self.counts[..bands];
        starts.fill(0);
        self.found.iter().for_each(|point| starts[band_of(point)] += 1);
        let mut total = 0;
        for start in starts.iter_mut() {
            (*start, total) = (total, total + *start);
        }
        self.order.clear();
        self.order.resize(self.found.len(), 0);
        for (index, point) in self.found.iter().enumerate() {
            let place = &mut starts[band_of(point)];
            self.order[*place as usize] = index as u32;
            *place += 1;
        }
    }

    /// Sets the ranks: responses, biased towards fine detail.
    fn rank(&mut self) {
        let bias = self.params.fine_bias;
        for point in &mut self.found {
            let size = point.size / 9.0;
            let penalty = if bias == 1.0 { size } else { size.powf(bias) };
            point.rank = if penalty > 0.0 { point.response / penalty } else { point.response };
        }
    }

    /// Replaces position and strength of every candidate; those without a blob are dropped.
    fn refine_candidates(&mut self, pool: &dyn Parallel) {
        let (simd, kernels, pyramid) = (self.simd, &self.kernels, &self.pyramid);
        let count = self.found.len();
        let found = SharedMut::new(&mut self.found);
        pool.run(count.div_ceil(POINTS_PER_CHUNK), &|chunk| {
            let first = chunk * POINTS_PER_CHUNK;
            // SAFETY: chunks own disjoint candidates.
            let points = unsafe { found.part(first, POINTS_PER_CHUNK.min(count - first)) };
            for point in points {
                let refined = refine(simd, kernels, pyramid, point.x, point.y, point.size * SCALE_PER_SIZE);
                (point.x, point.y, point.response) = (refined.x, refined.y, refined.response);
            }
        });
        self.found.retain(|point| point.response > 0.0);
    }

    /// Drops candidates whose refined position and size are those of a stronger one.
    ///
    /// Neighbouring octaves find the same blob; two equal descriptors would fail every ratio test.
    fn drop_doubles(&mut self, width: usize, height: usize) {
        self.found.sort_unstable_by(by_rank);
        let (columns, rows) = (width / DOUBLES_CELL_PX + 1, height / DOUBLES_CELL_PX + 1);
        // Lists of kept candidates by cell: first of each cell, next of each candidate (both one too high; 0 ends).
        grow(&mut self.counts, columns * rows);
        self.counts[..columns * rows].fill(0);
        self.next.clear();
        self.kept.clear();
        for point in &self.found {
            let cell = |value: f32, limit: usize| ((value.max(0.0) as usize) / DOUBLES_CELL_PX).min(limit - 1);
            let (column, row) = (cell(point.x, columns), cell(point.y, rows));
            let reach = (0.5 * SCALE_PER_SIZE * point.size).min(DOUBLES_CELL_PX as f32);
            let mut double = false;
            for y in row.saturating_sub(1)..(row + 2).min(rows) {
                for x in column.saturating_sub(1)..(column + 2).min(columns) {
                    let mut entry = self.counts[y * columns + x] as usize;
                    while entry > 0 {
                        let other = &self.kept[entry - 1];
                        let (dx, dy) = (other.x - point.x, other.y - point.y);
                        double |= dx * dx + dy * dy < reach * reach
                            && other.laplacian == point.laplacian
                            && other.size < point.size * DOUBLES_SIZE_RATIO
                            && point.size < other.size * DOUBLES_SIZE_RATIO;
                        entry = self.next[entry - 1] as usize;
                    }
                }
            }
            if !double {
                self.kept.push(*point);
                let head = &mut self.counts[row * columns + column];
                self.next.push(*head);
                *head = self.kept.len() as u32;
            }
        }
        std::mem::swap(&mut self.kept, &mut self.found);
    }

    /// Sorts the maxima by rank and keeps `limit` of them (0: all).
    fn select(&mut self, width: usize, height: usize, limit: usize) {
        let (columns, rows) = self.params.spread;
        if limit == 0 || self.found.len() <= limit {
            self.found.sort_unstable_by(by_rank);
            return;
        }
        if columns * rows == 0 {
            self.found.select_nth_unstable_by(limit - 1, by_rank);
            self.found.truncate(limit);
            self.found.sort_unstable_by(by_rank);
            return;
        }
        self.found.sort_unstable_by(by_rank);
        let cells = columns * rows;
        grow(&mut self.counts, cells);
        self.counts[..cells].fill(0);
        let quota = (limit / cells) as u32;
        self.kept.clear();
        let (step_x, step_y) = (columns as f32 / width.max(1) as f32, rows as f32 / height.max(1) as f32);
        // First each cell's share; what is left over goes to the strongest of the others.
        let counts = &mut self.counts;
        let mut share = 0usize;
        for point in &mut self.found {
            let column = ((point.x.max(0.0) * step_x) as usize).min(columns - 1);
            let row = ((point.y.max(0.0) * step_y) as usize).min(rows - 1);
            let count = &mut counts[row * columns + column];
            if *count < quota {
                *count += 1;
                share += 1;
                self.kept.push(*point);
                point.size = -point.size;
            }
        }
        let rest = limit.saturating_sub(share);
        self.kept.extend(self.found.iter().filter(|point| point.size > 0.0).take(rest));
        self.kept.sort_unstable_by(by_rank);
        std::mem::swap(&mut self.kept, &mut self.found);
    }
}

/// Best first; ties are broken by position, so the order never depends on the order of the candidates.
fn by_rank(a: &Extremum, b: &Extremum) -> std::cmp::Ordering {
    b.rank.total_cmp(&a.rank).then(a.y.total_cmp(&b.y)).then(a.x.total_cmp(&b.x)).then(a.size.total_cmp(&b.size))
}

fn reserve(out: &mut Features, count: usize, extended: bool) {
    let more = |len: usize| count.saturating_sub(len);
    let keypoints = &mut out.keypoints;
    keypoints.x_px.reserve(more(keypoints.x_px.len()));
    keypoints.y_px.reserve(more(keypoints.y_px.len()));
    keypoints.size_px.reserve(more(keypoints.size_px.len()));
    keypoints.angle_rad.reserve(more(keypoints.angle_rad.len()));
    keypoints.response.reserve(more(keypoints.response.len()));
    keypoints.laplacian.reserve(more(keypoints.laplacian.len()));
    out.descriptors.reserve(more(out.descriptors.len()));
    if extended {
        out.extension.reserve(more(out.extension.len()));
    }
}
