//! Block matching on the GPU.
//!
//! One kernel filters both views, one matches the pixels of a view against the other one. It runs for the right view
//! first, whose winners the left-right check of the left view reads. No cost is stored: a workgroup iterates over the
//! disparities and keeps the winners of its pixels.

use panoscope_imaging::rows::each_row;
use panoscope_imaging::stereo::block_matching::TILE_MARGIN_PX;
use panoscope_imaging::stereo::{BlockMatchingParams, Span, Tile};
use panoscope_imaging::{Parallel, Rect, View, ViewMut};
use std::ops::Range;

use panoscope_node::device::{DeviceImage, GROUP, Gpu, Kernel, MARGIN_BYTES, Steps, Store};
use panoscope_node::{Result, error};

/// Columns and rows of a workgroup's block in the shader.
const BLOCK: [usize; 2] = [64, 32];
/// Words in front of the jobs of a call, of a job, and of the sizes of a view.
const CALL_WORDS: usize = 8;
const JOB_WORDS: usize = 13;
const FILTER_WORDS: usize = 8;
/// Additional columns of a row of a filtered view: three before, one after.
const PLANE_MARGIN: usize = 4;
/// Marks a result that is not read.
const NOWHERE: usize = 0xffff_ffff;
/// Workgroups in a row of a dispatch.
const GROUPS_PER_ROW: usize = 32_768;
const MAX_SEARCH_PX: usize = 512;
const MAX_MIN_DISPARITY_PX: u32 = 1 << 20;

/// Pixels of the left view and their search range.
#[derive(Clone, Debug)]
struct Region {
    /// Columns and rows whose disparity is found.
    columns: Range<usize>,
    rows: Range<usize>,
    /// Columns that compete for right pixels.
    competing: Range<usize>,
    /// Smallest disparity, px, and number of disparities.
    min: i64,
    lanes: usize,
}

impl Region {
    /// The columns of `roi` whose search overlaps a right view of `width` columns.
    fn new(roi: Rect, width: usize, min: i32, search_px: usize) -> Option<Self> {
        let Span { x0, count, lanes, .. } = Span::new(roi, width, min, search_px, 0)?;
        let (columns, rows) = (x0..x0 + count, roi.y..roi.y + roi.height);
        Some(Self { competing: columns.clone(), columns, rows, min: min.into(), lanes })
    }

    /// The region of a tile of views of this size, matched like `BlockMatcher::compute_tiles`.
    fn of_tile(tile: &Tile, (width, height): (usize, usize)) -> Option<Self> {
        let area = tile.area.clamped(width, height);
        let roi = tile.widened(TILE_MARGIN_PX, width).clamped(width, height);
        let region = Self::new(roi, width, tile.first_px, tile.search_px)?;
        let columns = region.columns.start.max(area.x)..region.columns.end.min(area.x + area.width);
        (!columns.is_empty()).then_some(Self { columns, ..region })
    }

    /// Columns of a right view of `width` columns that its pixels are compared with.
    fn right_columns(&self, width: usize) -> Range<usize> {
        let first = self.columns.start as i64 - self.min - self.lanes as i64 + 1;
        let end = self.columns.end as i64 - self.min;
        first.max(0) as usize..end.clamp(0, width as i64) as usize
    }
}

/// Location of a part of a result: `columns` of `rows` of a map, row after row from value `start` on.
#[derive(Clone, Debug)]
struct Part {
    columns: Range<usize>,
    rows: Range<usize>,
    start: usize,
}

impl Part {
    /// Copies its row `y`, if it has one, from the result into the map's.
    fn copy_row(&self, result: &[u8], y: usize, row: &mut [f32]) {
        if !self.rows.contains(&y) {
            return;
        }
        let start = 4 * (self.start + (y - self.rows.start) * self.columns.len());
        for (value, bytes) in row[self.columns.clone()].iter_mut().zip(result[start..].as_chunks().0) {
            *value = f32::from_le_bytes(*bytes);
        }
    }
}

/// Pixels of one view that are matched over one range, as the shader reads them.
struct Job<'a> {
    columns: &'a Range<usize>,
    rows: &'a Range<usize>,
    /// Column of the other view that lane 0 of column 0 is compared with.
    shift: i64,
    lanes: usize,
    /// Columns of the other view that compete.
    others: &'a Range<usize>,
    /// Winners of the right view's pixels: offset, first column, number of columns.
    winners: [usize; 3],
    /// Start of the result and its words from row to row.
    output: [usize; 2],
}

/// Work of one call on the device.
#[derive(Debug, Default)]
struct Plan {
    /// Columns of the views, first row of the planes, radius of the window.
    width: usize,
    first_row: usize,
    radius: usize,
    /// Jobs as the shader reads them.
    jobs: Vec<i32>,
    /// Blocks of the left and the right view's jobs.
    blocks: [Vec<u32>; 2],
    /// Values from row to row of the left and the right map that the results are written into; `None` where they are
    /// packed, one after the other.
    strides: [Option<usize>; 2],
    /// Parts of the left and the right map.
    parts: [Vec<Part>; 2],
    /// Words of all winners and of the result.
    winners: usize,
    result: usize,
}

impl Plan {
    /// Adds the jobs of a region: the left view's and, for the check or the right map, the right view's.
    fn add(&mut self, region: &Region, is_checked: bool, has_right: bool) {
        let Region { columns, rows, competing, min, lanes } = region;
        let (shift, lanes) = (*min, *lanes);
        let right_columns = region.right_columns(self.width);
        let winners = [self.winners, right_columns.start, right_columns.len()];
        if is_checked || has_right {
            self.winners += right_columns.len() * rows.len();
            let output = if has_right { self.output(1, &right_columns, rows) } else { [NOWHERE, 0] };
            self.push(1, &Job { columns: &right_columns, rows, shift, lanes, others: competing, winners, output });
        }
        let output = self.output(0, columns, rows);
        let shift = 1 - shift - lanes as i64;
        self.push(0, &Job { columns, rows, shift, lanes, others: &(0..self.width), winners, output });
    }

    /// Space for a part of a map: its offset and the values from row to row.
    fn output(&mut self, side: usize, columns: &Range<usize>, rows: &Range<usize>) -> [usize; 2] {
        if let Some(stride) = self.strides[side] {
            return [rows.start * stride + columns.start, stride];
        }
        let start = self.result;
        self.result += columns.len() * rows.len();
        self.parts[side].push(Part { columns: columns.clone(), rows: rows.clone(), start });
        [start, columns.len()]
    }

    /// Adds a job of the left (0) or right (1) view, and its blocks.
    fn push(&mut self, side: usize, job: &Job<'_>) {
        let number = (self.jobs.len() / JOB_WORDS) as u32;
        let words = |words: &[usize]| words.iter().map(|word| *word as u32 as i32).collect::<Vec<i32>>();
        self.jobs.extend(words(&[job.columns.start, job.columns.end, job.rows.start - self.first_row, job.rows.len()]));
        self.jobs.push(job.shift as i32);
        self.jobs.extend(words(&[job.lanes, job.others.start, job.others.end]));
        self.jobs.extend(words(&job.winners));
        self.jobs.extend(words(&job.output));
        let matched = BLOCK[0] - 2 * self.radius;
        for y in 0..job.rows.len().div_ceil(BLOCK[1]) as u32 {
            for x in 0..job.columns.len().div_ceil(matched) as u32 {
                self.blocks[side].extend([number, x | (y << 16)]);
            }
        }
    }
}

/// Device memory of a view.
#[derive(Debug, Default)]
struct Side {
    view: Store,
    sizes: Store,
    plane: Store,
    blocks: Store,
}

/// Block matcher on the GPU, with memory there that only grows.
///
/// Finds the same disparities as [`BlockMatcher`], up to the last bits of their fractions.
///
/// [`BlockMatcher`]: panoscope_imaging::stereo::BlockMatcher
#[derive(Debug)]
pub struct GpuBlockMatcher {
    gpu: Gpu,
    filter: Kernel,
    /// For the pixels of the left and of the right view.
    matching: [Kernel; 2],
    sides: [Side; 2],
    call: Store,
    winners: Store,
    result: Store,
    /// The result in the host's memory.
    found: Vec<u8>,
}

/// Views that are matched.
#[derive(Clone, Copy)]
enum Source<'a> {
    Host([View<'a, u8>; 2]),
    Device([DeviceImage; 2]),
}

/// Maps that are made: on the GPU, or packed results for the processor.
#[derive(Clone, Copy)]
enum Target {
    Device([Option<DeviceImage>; 2]),
    Packed { has_right: bool },
}

impl GpuBlockMatcher {
    /// Prepares the GPU.
    ///
    /// # Errors
    /// It rejects a shader.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let filter = gpu.kernel("block matching filter", &[include_str!("block_matching_filter.wgsl")])?;
        let matching = |constant: &str| gpu.kernel("block matching", &[constant, include_str!("block_matching.wgsl")]);
        let matching = [matching("const IS_LEFT = true;\n")?, matching("const IS_LEFT = false;\n")?];
        let (sides, call, winners, result) = Default::default();
        Ok(Self { gpu, filter, matching, sides, call, winners, result, found: Vec::new() })
    }

    /// Matches the pixels of `roi` of a rectified gray pair; see [`BlockMatcher::compute`], whose maps it fills.
    ///
    /// # Errors
    /// A parameter out of range, images and maps of different sizes; errors of the GPU.
    ///
    /// [`BlockMatcher::compute`]: panoscope_imaging::stereo::BlockMatcher::compute
    pub fn compute(
        &mut self,
        params: &BlockMatchingParams,
        left: View<'_, u8>,
        right: View<'_, u8>,
        roi: Rect,
        disparity: &mut ViewMut<'_, f32>,
        disparity_right: Option<&mut ViewMut<'_, f32>>,
        pool: &dyn Parallel,
    ) -> Result<()> {
        check(params, [&left, &right], [Some(&*disparity), disparity_right.as_deref()])?;
        let roi = roi.clamped(left.width, left.height);
        let region = Region::new(roi, left.width, params.min_disparity_px, params.search_px);
        let regions = region.as_slice();
        let has_right = disparity_right.is_some();
        let parts = self.run(params, Source::Host([left, right]), regions, Target::Packed { has_right })?;
        fill(disparity, &parts[0], &self.found, pool);
        if let Some(map) = disparity_right {
            fill(map, &parts[1], &self.found, pool);
        }
        Ok(())
    }

    /// As [`GpuBlockMatcher::compute`], for views and maps on the GPU, left and right, of one size. Does not wait, and writes only the
    /// pixels that are matched.
    ///
    /// # Errors
    /// As [`GpuBlockMatcher::compute`].
    pub fn compute_there(
        &mut self,
        params: &BlockMatchingParams,
        views: [DeviceImage; 2],
        roi: Rect,
        maps: [Option<DeviceImage>; 2],
    ) -> Result<()> {
        params.validate()?;
        let roi = roi.clamped(views[0].width, views[0].height);
        let region = Region::new(roi, views[0].width, params.min_disparity_px, params.search_px);
        self.run(params, Source::Device(views), region.as_slice(), Target::Device(maps)).map(drop)
    }

    /// As [`GpuBlockMatcher::compute_tiles`], for views and a map on the GPU, of one size; see
    /// [`GpuBlockMatcher::compute_there`].
    ///
    /// # Errors
    /// As [`GpuBlockMatcher::compute_tiles`].
    pub fn compute_tiles_there(
        &mut self,
        params: &BlockMatchingParams,
        views: [DeviceImage; 2],
        tiles: &[Tile],
        map: DeviceImage,
    ) -> Result<()> {
        params.validate()?;
        let regions = regions(tiles, (views[0].width, views[0].height))?;
        self.run(params, Source::Device(views), &regions, Target::Device([Some(map), None])).map(drop)
    }

    /// Matches each of `tiles` of a rectified gray pair over its own range, in place of the range of the parameters;
    /// see [`BlockMatcher::compute_tiles`], whose map it fills.
    ///
    /// # Errors
    /// As [`GpuBlockMatcher::compute`]; also a range that is empty or too wide.
    ///
    /// [`BlockMatcher::compute_tiles`]: panoscope_imaging::stereo::BlockMatcher::compute_tiles
    pub fn compute_tiles(
        &mut self,
        params: &BlockMatchingParams,
        left: View<'_, u8>,
        right: View<'_, u8>,
        tiles: &[Tile],
        disparity: &mut ViewMut<'_, f32>,
        pool: &dyn Parallel,
    ) -> Result<()> {
        check(params, [&left, &right], [Some(&*disparity), None])?;
        let regions = regions(tiles, (left.width, left.height))?;
        let parts = self.run(params, Source::Host([left, right]), &regions, Target::Packed { has_right: false })?;
        fill(disparity, &parts[0], &self.found, pool);
        Ok(())
    }

    /// Matches regions of views. Packed results are in `found` then; returns what they are.
    fn run(
        &mut self,
        params: &BlockMatchingParams,
        views: Source<'_>,
        regions: &[Region],
        target: Target,
    ) -> Result<[Vec<Part>; 2]> {
        let (size, strides) = match views {
            Source::Host(views) => ((views[0].width, views[0].height), views.map(|view| view.stride)),
            Source::Device(views) => ((views[0].width, views[0].height), views.map(|view| view.stride_bytes)),
        };
        let ((width, height), radius) = (size, params.block_px / 2);
        let rows = regions.iter().map(|region| &region.rows);
        let Some((first, end)) = rows.map(|r| (r.start, r.end)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))) else {
            return Ok(Default::default());
        };
        // Rows of the planes, and of the views that they are filtered from.
        let plane = first.saturating_sub(radius)..(end + radius).min(height);
        let source = match views {
            Source::Host(_) => plane.start.saturating_sub(1)..(plane.end + 1).min(height),
            Source::Device(_) => 0..height,
        };
        let mut plan = Plan { width, first_row: plane.start, radius, ..Plan::default() };
        let has_right = match target {
            Target::Packed { has_right } => has_right,
            Target::Device(maps) => {
                plan.strides = maps.map(|map| map.map(|map| map.stride_bytes / 4));
                maps[1].is_some()
            }
        };
        for region in regions {
            plan.add(region, params.left_right_px.is_some(), has_right);
        }
        let filter_words = strides.map(|stride| {
            let cap = i32::from(params.prefilter_cap);
            let [width, rows, source_rows, stride] = [width, plane.len(), source.len(), stride].map(|n| n as i32);
            bytes(&[width, rows, (plane.start - source.start) as i32, source_rows, stride, cap, 0, 0])
        });
        let head: [i32; CALL_WORDS] = [
            width as i32,
            plane.len() as i32,
            radius as i32,
            i32::from(params.prefilter_cap) * 0x0101_0101,
            params.texture_threshold.min(u32::from(u16::MAX)) as i32,
            params.uniqueness_percent as i32,
            params.left_right_px.map_or(u32::from(u16::MAX), |px| px.min(u32::from(u16::MAX))) as i32,
            0,
        ];
        let call_words = bytes(&[&head[..], &plan.jobs].concat());
        let block_words = plan.blocks.each_ref().map(|blocks| {
            let head = [blocks.len() as i32 / 2, 0];
            bytes(&head.into_iter().chain(blocks.iter().map(|word| *word as i32)).collect::<Vec<i32>>())
        });

        let gpu = self.gpu;
        let mut steps = Steps::default();
        let call = self.call.reserve(gpu, call_words.len())?;
        steps.write(call, 0, &call_words);
        let mut planes = [0; 2];
        let mut blocks = [0; 2];
        for (k, side) in self.sides.iter_mut().enumerate() {
            let sizes = side.sizes.reserve(gpu, 4 * FILTER_WORDS)?;
            steps.write(sizes, 0, &filter_words[k]);
            blocks[k] = side.blocks.reserve(gpu, block_words[k].len())?;
            steps.write(blocks[k], 0, &block_words[k]);
            let view = match views {
                Source::Host(views) => {
                    let rows = rows_of(&views[k], &source);
                    let view = side.view.reserve(gpu, rows.data.len() + MARGIN_BYTES)?;
                    steps.write(view, 0, rows.data);
                    view
                }
                Source::Device(views) => views[k].buffer,
            };
            planes[k] = side.plane.reserve(gpu, 4 * (width + PLANE_MARGIN) * plane.len())?;
            steps.run(&self.filter, &[sizes, view, planes[k]], [width + PLANE_MARGIN, plane.len()]);
        }
        let winners = self.winners.reserve(gpu, 4 * plan.winners)?;
        let result = self.result.reserve(gpu, 4 * plan.result)?;
        let results = match target {
            Target::Device(maps) => maps.map(|map| map.map_or(result, |map| map.buffer)),
            Target::Packed { .. } => [result; 2],
        };
        // The left view needs the right one's winners.
        for k in [1, 0] {
            let count = plan.blocks[k].len() / 2;
            if count == 0 {
                continue;
            }
            let groups = [count.min(GROUPS_PER_ROW), count.div_ceil(GROUPS_PER_ROW)];
            let threads = [0, 1].map(|axis| groups[axis] * GROUP[axis]);
            steps.run(&self.matching[k], &[call, blocks[k], planes[k], planes[1 - k], winners, results[k]], threads);
        }
        gpu.submit(&steps)?;
        if plan.result > 0 {
            self.found.resize(4 * plan.result, 0);
            gpu.read(result, &mut self.found)?;
        }
        Ok(plan.parts)
    }
}

/// The regions of tiles of views of this size.
fn regions(tiles: &[Tile], size: (usize, usize)) -> Result<Vec<Region>> {
    for tile in tiles {
        let is_far = tile.first_px.unsigned_abs() > MAX_MIN_DISPARITY_PX;
        if is_far || !(1..=MAX_SEARCH_PX).contains(&tile.search_px) {
            return Err(error!(
                "a tile searches {} disparities from {} px on; accepted are 1 to {MAX_SEARCH_PX}, at most {MAX_MIN_DISPARITY_PX} px from 0",
                tile.search_px, tile.first_px
            ));
        }
    }
    Ok(tiles.iter().filter_map(|tile| Region::of_tile(tile, size)).collect())
}

fn bytes(words: &[i32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// These rows of a view, with their padding.
fn rows_of<'a>(view: &View<'a, u8>, rows: &Range<usize>) -> View<'a, u8> {
    let end = (rows.end * view.stride).min(view.data.len());
    View { data: &view.data[rows.start * view.stride..end], height: rows.len(), ..*view }
}

/// Writes the parts of a map, and NaN elsewhere.
fn fill(map: &mut ViewMut<'_, f32>, parts: &[Part], result: &[u8], pool: &dyn Parallel) {
    each_row(map, pool, |y, row| {
        match parts {
            [part] if part.rows.contains(&y) => {
                row[..part.columns.start].fill(f32::NAN);
                row[part.columns.end..].fill(f32::NAN);
            }
            _ => row.fill(f32::NAN),
        }
        parts.iter().for_each(|part| part.copy_row(result, y, row));
    });
}

/// Checks parameters, and that views and maps have one size and one channel.
fn check(
    params: &BlockMatchingParams,
    [left, right]: [&View<'_, u8>; 2],
    maps: [Option<&ViewMut<'_, f32>>; 2],
) -> Result<()> {
    params.validate()?;
    let size = [left.width, left.height, 1];
    let maps = maps.map(|map| map.map_or(size, |map| [map.width, map.height, map.channels]));
    let found = [
        ("left view", [left.width, left.height, left.channels]),
        ("right view", [right.width, right.height, right.channels]),
        ("disparity", maps[0]),
        ("right disparity", maps[1]),
    ];
    if let Some((name, [width, height, channels])) = found.iter().find(|(_, found)| *found != size) {
        return Err(error!(
            "{name} is {width}x{height} in {channels} channels; {}x{} in 1 is needed, as of the left view",
            left.width, left.height
        ));
    }
    // As on the processor.
    if left.width > 65_000 {
        return Err(error!("a view of {} columns; at most 65000 are matched", left.width));
    }
    Ok(())
}
