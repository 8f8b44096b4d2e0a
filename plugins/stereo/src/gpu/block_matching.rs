//! Block matching on the GPU.
//!
//! One kernel filters both views, one matches the pixels of a view against the other one. It runs for the right view
//! first, whose winners the left-right check of the left view reads. No cost is stored: a workgroup iterates over the
//! disparities and keeps the winners of its pixels.

use panoscope_imaging::Rect;
use panoscope_imaging::stereo::block_matching::TILE_MARGIN_PX;
use panoscope_imaging::stereo::{BlockMatchingParams, Span, Tile};
use std::ops::Range;

use panoscope_node::device::{DeviceImage, GROUP, Gpu, Kernel, Steps, Store};
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
    /// First word of the result in its map, and words from row to row.
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
    /// Words of a row of the left map, and of the right one if that is made.
    strides: [Option<usize>; 2],
    /// Words of all winners.
    winners: usize,
}

impl Plan {
    /// Adds the jobs of a region: the left view's and, for the check or the right map, the right view's.
    fn add(&mut self, region: &Region, is_checked: bool) {
        let Region { columns, rows, competing, min, lanes } = region;
        let (shift, lanes) = (*min, *lanes);
        let right_columns = region.right_columns(self.width);
        let winners = [self.winners, right_columns.start, right_columns.len()];
        if is_checked || self.strides[1].is_some() {
            self.winners += right_columns.len() * rows.len();
            let output = self.output(1, &right_columns, rows);
            self.push(1, &Job { columns: &right_columns, rows, shift, lanes, others: competing, winners, output });
        }
        let output = self.output(0, columns, rows);
        let shift = 1 - shift - lanes as i64;
        self.push(0, &Job { columns, rows, shift, lanes, others: &(0..self.width), winners, output });
    }

    /// First word of a part of a map, and words from row to row.
    fn output(&self, side: usize, columns: &Range<usize>, rows: &Range<usize>) -> [usize; 2] {
        self.strides[side].map_or([NOWHERE, 0], |stride| [rows.start * stride + columns.start, stride])
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
        let (sides, call, winners) = Default::default();
        Ok(Self { gpu, filter, matching, sides, call, winners })
    }

    /// Matches the pixels of `roi` of a rectified gray pair on the GPU into the maps there, left and right, all of one
    /// size; see [`BlockMatcher::compute`]. Does not wait, and writes only the pixels that are matched.
    ///
    /// # Errors
    /// A parameter out of range; errors of the GPU.
    ///
    /// [`BlockMatcher::compute`]: panoscope_imaging::stereo::BlockMatcher::compute
    pub fn compute(
        &mut self,
        params: &BlockMatchingParams,
        views: [DeviceImage; 2],
        roi: Rect,
        maps: (DeviceImage, Option<DeviceImage>),
    ) -> Result<()> {
        params.validate()?;
        let roi = roi.clamped(views[0].width, views[0].height);
        let region = Region::new(roi, views[0].width, params.min_disparity_px, params.search_px);
        self.run(params, views, region.as_slice(), maps)
    }

    /// As [`GpuBlockMatcher::compute`], of each of `tiles` over its own range, in place of the range of the parameters;
    /// see [`BlockMatcher::compute_tiles`].
    ///
    /// # Errors
    /// As [`GpuBlockMatcher::compute`]; also a range that is empty or too wide.
    ///
    /// [`BlockMatcher::compute_tiles`]: panoscope_imaging::stereo::BlockMatcher::compute_tiles
    pub fn compute_tiles(
        &mut self,
        params: &BlockMatchingParams,
        views: [DeviceImage; 2],
        tiles: &[Tile],
        map: DeviceImage,
    ) -> Result<()> {
        params.validate()?;
        let regions = regions(tiles, (views[0].width, views[0].height))?;
        self.run(params, views, &regions, (map, None))
    }

    /// Matches regions of views.
    fn run(
        &mut self,
        params: &BlockMatchingParams,
        views: [DeviceImage; 2],
        regions: &[Region],
        (left, right): (DeviceImage, Option<DeviceImage>),
    ) -> Result<()> {
        let DeviceImage { width, height, .. } = views[0];
        let radius = params.block_px / 2;
        let rows = regions.iter().map(|region| &region.rows);
        let Some((first, end)) = rows.map(|r| (r.start, r.end)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))) else {
            return Ok(());
        };
        // Rows of the planes.
        let plane = first.saturating_sub(radius)..(end + radius).min(height);
        let strides = [Some(left), right].map(|map| map.map(|map| map.stride_bytes / 4));
        let mut plan = Plan { width, first_row: plane.start, radius, strides, ..Plan::default() };
        for region in regions {
            plan.add(region, params.left_right_px.is_some());
        }
        let filter_words = views.map(|view| {
            let cap = i32::from(params.prefilter_cap);
            let sizes = [width, plane.len(), plane.start, height, view.stride_bytes].map(|n| n as i32);
            bytes(&[&sizes[..], &[cap, 0, 0]].concat())
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
            planes[k] = side.plane.reserve(gpu, 4 * (width + PLANE_MARGIN) * plane.len())?;
            steps.run(&self.filter, &[sizes, views[k].buffer, planes[k]], [width + PLANE_MARGIN, plane.len()]);
        }
        let winners = self.winners.reserve(gpu, 4 * plan.winners)?;
        // Nothing is written to a right map that is not made.
        let results = [left.buffer, right.unwrap_or(left).buffer];
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
        gpu.submit(&steps)
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
