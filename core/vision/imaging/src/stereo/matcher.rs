//! What block matching and semi-global matching do alike: a matcher with its work memory, over a region in bands of rows or over tiles.

use std::fmt::Debug;

use super::StereoError;
use super::matching::{Maps, PaddedPair, Span, Target, again};
use super::stereo_kernel::StereoKernel;
use super::tile::{Tile, TileMap, TileWork, make_room, max_lanes, project_right};
use crate::{Parallel, Rect, SharedMut, Simd, View, ViewMut};

/// What every method searches and compares.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// Smallest disparity searched, px.
    pub min_disparity_px: i32,
    /// Disparities searched from there on.
    pub search_px: usize,
    /// Side of the square window, px.
    pub block_px: usize,
    /// Clip of the prefilter.
    pub prefilter_cap: u8,
}

/// A method of matching, as its parameters. It works row by row: no row needs a row below its own window.
pub trait Method: Clone + Debug + Sync {
    /// Work memory of one band of rows.
    type Band: Default + Debug + Send;

    /// Minimum number of rows of a band.
    const BAND_ROWS: usize;
    /// Rows that a band processes before its output starts.
    const WARM_UP_ROWS: usize;
    /// Columns beyond each side of a tile that are matched with it.
    const TILE_MARGIN_PX: usize;

    /// Names the first parameter that is out of range.
    ///
    /// # Errors
    /// [`StereoError::Parameter`].
    fn check(&self) -> Result<(), StereoError>;

    /// What it searches and compares.
    fn window(&self) -> Window;

    /// The same method over `search_px` disparities from `first_px` on.
    fn over(&self, first_px: i32, search_px: usize) -> Self;

    /// Prepares a band whose first row is `first`.
    fn prepare(job: &Job<'_, Self>, band: &mut Self::Band, first: usize);

    /// Matches row `y`, the one after the row before. Writes into `target` unless the band still warms up.
    fn step(job: &Job<'_, Self>, band: &mut Self::Band, y: usize, target: Option<Target<'_>>);
}

/// What every row of one call shares.
pub struct Job<'a, P> {
    /// The method.
    pub params: &'a P,
    /// The prefiltered views.
    pub pair: &'a PaddedPair,
    /// Whether AVX2 is used.
    pub avx2: bool,
    /// The columns and disparities.
    pub span: Span,
}

/// A matcher with its work memory. Allocates only for larger views than before.
#[derive(Debug)]
pub struct Matcher<P: Method> {
    params: P,
    pair: PaddedPair,
    bands: Vec<P::Band>,
    tiles: Vec<TileWork<P::Band>>,
    avx2: bool,
}

impl<P: Method> Matcher<P> {
    /// A matcher with the given parameters.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range.
    pub fn new(params: P) -> Result<Self, StereoError> {
        params.check()?;
        let (bands, tiles) = (Vec::new(), Vec::new());
        Ok(Self { params, pair: PaddedPair::default(), bands, tiles, avx2: Simd::detect().avx2() })
    }

    /// Takes the portable path even where AVX2 exists (tests compare the two).
    pub fn force_portable(&mut self) {
        self.avx2 = false;
    }

    /// The parameters in use.
    pub fn params(&self) -> &P {
        &self.params
    }

    /// Changes the parameters; memory is kept.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range; the old ones stay.
    pub fn set_params(&mut self, params: P) -> Result<(), StereoError> {
        params.check()?;
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
        let Window { min_disparity_px, search_px, block_px, prefilter_cap } = self.params.window();
        let Some(span) = Span::new(roi, left.width, min_disparity_px, search_px, block_px / 2) else {
            maps.clear_outside(0..0);
            return Ok(());
        };
        // Rows of the region are written whole as they are matched.
        maps.clear_outside(roi.y..roi.y + roi.height);
        let above = span.radius + P::WARM_UP_ROWS;
        let rows = roi.y.saturating_sub(above)..(roi.y + roi.height + span.radius).min(left.height);
        self.pair.fill([left, right], &span, rows, prefilter_cap, self.avx2, pool);
        let job = Job { params: &self.params, pair: &self.pair, avx2: self.avx2, span };
        maps.fill_bands(
            &mut self.bands,
            roi,
            (P::BAND_ROWS, P::WARM_UP_ROWS),
            pool,
            |band, first| P::prepare(&job, band, first),
            |band, y, target| P::step(&job, band, y, target),
        );
        Ok(())
    }

    /// Matches each of `tiles` of a rectified gray pair over its own range, in place of the range of the parameters. Areas of tiles lie inside the
    /// view and do not overlap; pixels outside them are NaN. Left and right are compared inside a tile only: see [`project_right`].
    ///
    /// # Errors
    /// As [`Matcher::compute`].
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
        let Window { block_px, prefilter_cap, .. } = self.params.window();
        let (width, height, radius) = (left.width, left.height, block_px / 2);
        self.pair.fill_all([left, right], max_lanes(tiles), radius, prefilter_cap, self.avx2, pool);
        make_room(&mut self.tiles, tiles.len(), width);
        let (out, work) = (TileMap::new(maps.left, pool), SharedMut::new(&mut self.tiles));
        let (params, pair, avx2) = (&self.params, &self.pair, self.avx2);
        pool.run(tiles.len(), &|index| {
            let tile = &tiles[index];
            let area = tile.area.clamped(width, height);
            // Beyond its sides a tile's pixels compete for the same right ones, and paths converge there.
            let roi = tile.widened(P::TILE_MARGIN_PX, width).clamped(width, height);
            let Some(span) = Span::new(roi, width, tile.first_px, tile.search_px, radius) else { return };
            // SAFETY: `Parallel::run` calls each index once, and the memory of a tile belongs to its index.
            let TileWork { band, line } = unsafe { &mut work.part(index, 1)[0] };
            let job = Job { params, pair, avx2, span };
            let start = area.y.saturating_sub(P::WARM_UP_ROWS);
            P::prepare(&job, band, start);
            for y in start..area.y {
                P::step(&job, band, y, None);
            }
            for y in area.y..area.y + area.height {
                P::step(&job, band, y, Some(Target { left: line, right: None }));
                // SAFETY: areas of tiles do not overlap.
                unsafe { out.put(area, y, line) };
            }
        });
        Ok(())
    }
}

impl<P: Method> StereoKernel for Matcher<P> {
    fn match_roi(
        &mut self,
        (first_px, search_px): (i32, usize),
        views: [View<'_, u8>; 2],
        roi: Rect,
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
        disparity_right: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError> {
        self.set_params(self.params.over(first_px, search_px))?;
        self.compute(views[0], views[1], roi, pool, disparity, disparity_right)
    }

    fn match_tiles(
        &mut self,
        tiles: &[Tile],
        views: [View<'_, u8>; 2],
        left_right_px: Option<f32>,
        pool: &dyn Parallel,
        mut disparity: ViewMut<'_, f32>,
        mut disparity_right: ViewMut<'_, f32>,
    ) -> Result<(), StereoError> {
        self.compute_tiles(views[0], views[1], tiles, pool, again(&mut disparity))?;
        project_right(&mut disparity, &mut disparity_right, left_right_px, pool);
        Ok(())
    }
}
