//! Block matching: sums of absolute differences over a square window, winner takes all, for the
//! left and the right view in one pass.
//!
//! The costs are computed once per (left pixel, disparity); the right view's winners are the minima
//! along the diagonals of the same cost table, so the second map costs a few instructions per vector.
//! Sub-pixel positions come from an equiangular fit (two lines of equal slope), the shape a sum of
//! absolute differences has around its minimum.

use crate::stereo::StereoError;
use crate::stereo::block_matching_finish::Limits;
use crate::stereo::block_matching_kernel::{MAX_LANES, Row, match_row};
use crate::stereo::matching::{Maps, PaddedPair, Span, Target, WinnerRow, left_right_limit, window_above};
use crate::stereo::prefilter::MAX_VALUE;
use crate::stereo::tile::{Tile, TileMap, TileWork, make_room, max_lanes};
use crate::{Parallel, Rect, SharedMut, Simd, View, ViewMut};

/// Columns beyond each side of a tile that are matched with it.
pub const TILE_MARGIN_PX: usize = 8;
/// Smallest number of rows of a band.
const BAND_ROWS: usize = 32;

/// What block matching searches and what it rejects.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockMatchingParams {
    /// Smallest disparity searched, in px; may be negative.
    pub min_disparity_px: i32,
    /// Disparities searched from there on, 1 to 512, rounded up to a multiple of 32.
    pub search_px: usize,
    /// Side of the square window, in px, odd, 3 to 31.
    pub block_px: usize,
    /// Clip of the horizontal Sobel response that is compared, 1 to 31; 0 compares gray values
    /// (sensitive to exposure differences between the views).
    pub prefilter_cap: u8,
    /// Windows whose summed absolute response is smaller are not matched; 0 keeps all.
    pub texture_threshold: u32,
    /// A pixel is rejected when a disparity not next to the best costs at most this much more, in per cent; 0 keeps all.
    pub uniqueness_percent: u32,
    /// Largest difference between the left pixel's disparity and that of the right pixel it points to; `None` keeps all.
    pub left_right_px: Option<u32>,
}

impl Default for BlockMatchingParams {
    fn default() -> Self {
        Self {
            min_disparity_px: 0,
            search_px: 64,
            block_px: 15,
            prefilter_cap: 31,
            texture_threshold: 10,
            uniqueness_percent: 15,
            left_right_px: Some(1),
        }
    }
}

impl BlockMatchingParams {
    /// Names the first parameter that is out of range.
    ///
    /// # Errors
    /// [`StereoError::Parameter`].
    pub fn validate(&self) -> Result<(), StereoError> {
        let refuse = |name, value: String, accepted| Err(StereoError::Parameter { name, value, accepted });
        if self.search_px == 0 || self.search_px > MAX_LANES {
            return refuse("search_px", self.search_px.to_string(), "1 to 512");
        }
        if self.block_px.is_multiple_of(2) || !(3..=31).contains(&self.block_px) {
            return refuse("block_px", self.block_px.to_string(), "an odd number from 3 to 31");
        }
        if self.prefilter_cap > MAX_VALUE / 2 {
            return refuse("prefilter_cap", self.prefilter_cap.to_string(), "0 to 31");
        }
        if self.min_disparity_px.unsigned_abs() > 1 << 20 {
            return refuse("min_disparity_px", self.min_disparity_px.to_string(), "-1048576 to 1048576");
        }
        Ok(())
    }
}

/// Work memory of one band of rows.
#[derive(Debug, Default)]
struct Band {
    columns: Vec<u16>,
    cost: Vec<u16>,
    winners: WinnerRow,
    texture_columns: Vec<u16>,
}

/// Block matcher with its work memory. Allocates only for larger views than before.
#[derive(Debug)]
pub struct BlockMatcher {
    params: BlockMatchingParams,
    pair: PaddedPair,
    bands: Vec<Band>,
    tiles: Vec<TileWork<Band>>,
    avx2: bool,
}

impl BlockMatcher {
    /// A matcher with the given parameters.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range.
    pub fn new(params: BlockMatchingParams) -> Result<Self, StereoError> {
        params.validate()?;
        Ok(Self {
            params,
            pair: PaddedPair::default(),
            bands: Vec::new(),
            tiles: Vec::new(),
            avx2: Simd::detect().avx2(),
        })
    }

    /// Takes the portable path even where AVX2 exists (tests compare the two).
    pub fn force_portable(&mut self) {
        self.avx2 = false;
    }

    /// The parameters in use.
    pub fn params(&self) -> &BlockMatchingParams {
        &self.params
    }

    /// Changes the parameters; memory is kept.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range; the old ones stay.
    pub fn set_params(&mut self, params: BlockMatchingParams) -> Result<(), StereoError> {
        params.validate()?;
        self.params = params;
        Ok(())
    }

    /// Matches the pixels of `roi` of a rectified gray pair.
    ///
    /// `disparity` receives px of the left view, NaN where unmatched or outside `roi`.
    /// `disparity_right`, when asked for, receives each right pixel's best match among the left pixels
    /// of `roi`, unchecked, as positive px (`x_left = x_right + disparity`), NaN where there was none.
    ///
    /// # Errors
    /// When sizes or channel counts do not agree, or the view is wider than 65,000 px.
    pub fn compute(
        &mut self,
        left: View<'_, u8>,
        right: View<'_, u8>,
        roi: Rect,
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
        disparity_right: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError> {
        let mut maps = Maps { left: disparity, right: disparity_right };
        maps.check(left, right)?;
        let roi = roi.clamped(left.width, left.height);
        let Some(span) =
            Span::new(roi, left.width, self.params.min_disparity_px, self.params.search_px, self.params.block_px / 2)
        else {
            maps.clear_outside(0..0);
            return Ok(());
        };
        // Rows of the region are written whole as they are matched.
        maps.clear_outside(roi.y..roi.y + roi.height);
        let rows = roi.y.saturating_sub(span.radius)..(roi.y + roi.height + span.radius).min(left.height);
        self.pair.fill([left, right], &span, rows, self.params.prefilter_cap, self.avx2, pool);
        let job = Job { params: &self.params, pair: &self.pair, avx2: self.avx2, span };
        maps.fill_bands(
            &mut self.bands,
            roi,
            (BAND_ROWS, 0),
            pool,
            |band, first| job.prepare(band, first),
            |band, y, target| {
                if let Some(target) = target {
                    job.row(band, y, target);
                }
            },
        );
        Ok(())
    }

    /// Matches each of `tiles` of a rectified gray pair over its own range, in place of the range of the parameters. Areas of tiles lie inside the
    /// view and do not overlap; pixels outside them are NaN. Left and right are compared inside a tile only: see [`project_right`].
    ///
    /// # Errors
    /// As [`BlockMatcher::compute`].
    ///
    /// [`project_right`]: crate::stereo::project_right
    pub fn compute_tiles(
        &mut self,
        left: View<'_, u8>,
        right: View<'_, u8>,
        tiles: &[Tile],
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
    ) -> Result<(), StereoError> {
        let maps = Maps { left: disparity, right: None };
        maps.check(left, right)?;
        let (width, height, radius) = (left.width, left.height, self.params.block_px / 2);
        let lanes = max_lanes(tiles);
        self.pair.fill_all([left, right], lanes, radius, self.params.prefilter_cap, self.avx2, pool);
        make_room(&mut self.tiles, tiles.len(), width);
        let (out, work) = (TileMap::new(maps.left, pool), SharedMut::new(&mut self.tiles));
        let (params, pair, avx2) = (&self.params, &self.pair, self.avx2);
        pool.run(tiles.len(), &|index| {
            let tile = &tiles[index];
            let area = tile.area.clamped(width, height);
            // Beyond its sides a tile's pixels compete for the same right ones.
            let roi = tile.widened(TILE_MARGIN_PX, width).clamped(width, height);
            let Some(span) = Span::new(roi, width, tile.first_px, tile.search_px, radius) else { return };
            // SAFETY: `Parallel::run` calls each index once, and the memory of a tile belongs to its index.
            let TileWork { band, line } = unsafe { &mut work.part(index, 1)[0] };
            let job = Job { params, pair, avx2, span };
            job.prepare(band, area.y);
            for y in area.y..area.y + area.height {
                job.row(band, y, Target { left: line, right: None });
                // SAFETY: areas of tiles do not overlap.
                unsafe { out.put(area, y, line) };
            }
        });
        Ok(())
    }
}

/// What every row of one call shares.
struct Job<'a> {
    params: &'a BlockMatchingParams,
    pair: &'a PaddedPair,
    avx2: bool,
    span: Span,
}

impl Job<'_> {
    /// Sums of the window above the first row, so that every row is one step down.
    fn prepare(&self, band: &mut Band, first: usize) {
        let Span { count, lanes, radius, .. } = self.span;
        let steps = count + 2 * radius;
        band.columns.clear();
        band.columns.resize((steps + 1) * lanes, 0);
        band.cost.resize(count * lanes, 0);
        band.winners.resize(&self.span);
        self.pair.add_window_above(&self.span, first, self.avx2, &mut band.columns);
        band.texture_columns.clear();
        band.texture_columns.resize(steps, 0);
        for y in window_above(&self.span, first) {
            for (sum, value) in band.texture_columns.iter_mut().zip(self.pair.rows(&self.span, y).0) {
                *sum += u16::from(value.abs_diff(self.params.prefilter_cap));
            }
        }
    }

    fn row(&self, band: &mut Band, y: usize, target: Target<'_>) {
        let radius = self.span.radius;
        let (new_left, new_right) = self.pair.rows(&self.span, y as isize + radius as isize);
        let (old_left, old_right) = self.pair.rows(&self.span, y as isize - radius as isize - 1);
        let outside = self.pair.outside(&self.span);
        let row = band.winners.row(&self.span, outside, &mut band.cost, self.params.uniqueness_percent);
        let columns = &mut band.columns;
        match_row(Row { radius, new_left, new_right, old_left, old_right, columns, ..row }, self.avx2);
        self.texture(band, new_left, old_left);
        let limits = Limits {
            texture_at_least: self.params.texture_threshold.min(u32::from(u16::MAX)) as u16,
            left_right_at_most: left_right_limit(self.params.left_right_px),
        };
        band.winners.write(&self.span, outside, &band.cost, &limits, self.avx2, target);
    }

    /// Moves the texture sums down one row and along it.
    fn texture(&self, band: &mut Band, new_left: &[u8], old_left: &[u8]) {
        let cap = self.params.prefilter_cap;
        if self.params.texture_threshold == 0 {
            return;
        }
        for ((sum, entering), leaving) in band.texture_columns.iter_mut().zip(new_left).zip(old_left) {
            *sum = *sum + u16::from(entering.abs_diff(cap)) - u16::from(leaving.abs_diff(cap));
        }
        let window = 2 * self.span.radius + 1;
        let mut total: u16 = band.texture_columns[..window - 1].iter().sum();
        for (i, out) in band.winners.texture.iter_mut().enumerate() {
            total += band.texture_columns[i + window - 1];
            *out = total;
            total -= band.texture_columns[i];
        }
    }
}
