//! Weighted-least-squares smoothing of a disparity map, guided by the left view and by confidence.
//!
//! Disparity times confidence and confidence alone are smoothed alike and divided, so that doubtful
//! pixels take their value from trusted ones without an image edge in between. The two-dimensional
//! system is replaced by alternating exact solves along rows and columns, with a strength that falls
//! fourfold from one round to the next (Min et al., "Fast global image smoothing based on weighted
//! least squares", 2014). Objects on which both views agree keep their disparities, however thin they are.

use crate::stereo::confidence::{Confidence, ConfidenceParams};
use crate::stereo::error::{check_channels, check_size};
use crate::stereo::filter_input::FilterInput;
use crate::stereo::guide_weights::weights_row;
use crate::stereo::kept_regions::{EDGE_PX, KeptRegions};
use crate::stereo::scratch::Scratch;
use crate::stereo::shared_field::is_seen_by_both;
use crate::stereo::tridiagonal::{Planes, horizontal, vertical};
use crate::stereo::{StereoError, matching::fill_nan};
use crate::{Parallel, Rect, SharedMut, Simd, ViewMut};

/// Strength and sharpness of the filter.
#[derive(Clone, Debug, PartialEq)]
pub struct WlsParams {
    /// Strength of the smoothing, 0 to 1e7. Strong smoothing flattens slopes and fills far.
    pub lambda: f32,
    /// Colour distance (Euclidean, 0..=441) over which two pixels' coupling falls to 1/e, 0.1 to 1000.
    pub sigma_color: f32,
    /// Rounds of row and column solves, 1 to 8.
    pub iterations: usize,
    /// Smoothed confidence below which a pixel stays unknown: 0 fills everything that is reached at all.
    pub min_support: f32,
    /// How confidence is judged where none is given.
    pub confidence: ConfidenceParams,
}

impl Default for WlsParams {
    fn default() -> Self {
        Self { lambda: 1000.0, sigma_color: 1.5, iterations: 3, min_support: 0.1, confidence: Default::default() }
    }
}

impl WlsParams {
    /// Names the first parameter that is out of range.
    ///
    /// # Errors
    /// [`StereoError::Parameter`].
    pub fn validate(&self) -> Result<(), StereoError> {
        let refuse = |name, value: String, accepted| Err(StereoError::Parameter { name, value, accepted });
        if !(0.0..=1e7).contains(&self.lambda) {
            return refuse("lambda", self.lambda.to_string(), "0 to 1e7");
        }
        if !(0.1..=1000.0).contains(&self.sigma_color) {
            return refuse("sigma_color", self.sigma_color.to_string(), "0.1 to 1000");
        }
        if !(1..=8).contains(&self.iterations) {
            return refuse("iterations", self.iterations.to_string(), "1 to 8");
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

/// The filter with its work memory. Allocates only for a larger size than before.
#[derive(Debug)]
pub struct WlsFilter {
    params: WlsParams,
    confidence: Confidence,
    right: Vec<f32>,
    down: Vec<f32>,
    product: Vec<f32>,
    support: Vec<f32>,
    scratch: Scratch,
    kept: KeptRegions,
    avx2: bool,
}

impl WlsFilter {
    /// A filter with the given parameters.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range.
    pub fn new(params: WlsParams) -> Result<Self, StereoError> {
        params.validate()?;
        Ok(Self {
            params,
            confidence: Confidence::default(),
            right: Vec::new(),
            down: Vec::new(),
            product: Vec::new(),
            support: Vec::new(),
            scratch: Scratch::default(),
            kept: KeptRegions::default(),
            avx2: Simd::detect().avx2(),
        })
    }

    /// Takes the portable path even where AVX2 exists (tests compare the two).
    pub fn force_portable(&mut self) {
        self.avx2 = false;
    }

    /// The parameters in use.
    pub fn params(&self) -> &WlsParams {
        &self.params
    }

    /// Changes the parameters; memory is kept.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range; the old ones stay.
    pub fn set_params(&mut self, params: WlsParams) -> Result<(), StereoError> {
        params.validate()?;
        self.params = params;
        Ok(())
    }

    /// Smooths `input.disparity`.
    ///
    /// `disparity` receives px, NaN where no trusted pixel is near, where the right view ends, and outside the ROI; `confidence`,
    /// when asked for, the smoothed confidence 0..=1, 0 outside, and at least 0.5 on objects that keep their disparities.
    ///
    /// # Errors
    /// When sizes or channel counts do not agree.
    pub fn compute(
        &mut self,
        input: FilterInput<'_>,
        pool: &dyn Parallel,
        mut disparity: ViewMut<'_, f32>,
        confidence: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError> {
        input.check()?;
        let (width, height) = (input.disparity.width, input.disparity.height);
        check_size("filtered disparity", (width, height), (disparity.width, disparity.height))?;
        check_channels("filtered disparity", &[1], "1", disparity.channels)?;
        if let Some(map) = &confidence {
            check_size("filtered confidence", (width, height), (map.width, map.height))?;
            check_channels("filtered confidence", &[1], "1", map.channels)?;
        }
        let roi = input.roi.clamped(width, height);
        if roi != Rect::whole(width, height) {
            fill_nan(&mut disparity, pool);
        }
        let mut confidence = confidence;
        if let Some(map) = &mut confidence
            && roi != Rect::whole(width, height)
        {
            for y in 0..height {
                map.row_mut(y).fill(0.0);
            }
        }
        if roi.is_empty() {
            return Ok(());
        }
        self.prepare(&input, roi, pool);
        self.solve(roi, pool);

        let (stride, out) = (disparity.stride, SharedMut::new(&mut *disparity.data));
        let (stride_confidence, out_confidence) = match &mut confidence {
            Some(map) => (map.stride, Some(SharedMut::new(&mut *map.data))),
            None => (0, None),
        };
        let least = self.params.min_support.max(1e-6);
        pool.run(roi.height, &|row| {
            let y = roi.y + row;
            // SAFETY: one row, one chunk.
            let out = unsafe { out.part(y * stride + roi.x, roi.width) };
            let at = row * roi.width..(row + 1) * roi.width;
            let (product, support) = (&self.product[at.clone()], &self.support[at]);
            for (x, ((out, product), support)) in out.iter_mut().zip(product).zip(support).enumerate() {
                let value = product / support;
                // A pixel outside the right view is not measured, however smooth the surface beside it.
                let known = (*support >= least) & is_seen_by_both(roi.x + x, value, width);
                *out = if known { value } else { f32::NAN };
            }
            if let Some(map) = &out_confidence {
                // SAFETY: `row` belongs to this chunk alone, in the confidence map as in the disparity map.
                unsafe { map.part(y * stride_confidence + roi.x, roi.width) }.copy_from_slice(support);
            }
        });
        let trust = &self.params.confidence;
        let edge_px = trust.scatter_radius_px + EDGE_PX;
        self.kept.restore(&input, trust, edge_px, pool, &mut disparity, confidence.as_mut());
        Ok(())
    }

    /// Smooths both planes on the processor.
    fn solve(&mut self, roi: Rect, pool: &dyn Parallel) {
        let mut planes =
            Planes { width: roi.width, height: roi.height, first: &mut self.product, second: &mut self.support };
        for round in 0..self.params.iterations {
            let strength = self.params.lambda * 0.25f32.powi(round as i32);
            horizontal(&mut planes, &self.right, strength, &mut self.scratch, self.avx2, pool);
            vertical(&mut planes, &self.down, strength, &mut self.scratch, self.avx2, pool);
        }
    }

    /// Guide weights, confidence, and disparity times confidence.
    fn prepare(&mut self, input: &FilterInput<'_>, roi: Rect, pool: &dyn Parallel) {
        let n = roi.width * roi.height;
        for plane in [&mut self.right, &mut self.down, &mut self.product, &mut self.support] {
            plane.resize(n, 0.0);
        }
        input.confidence_into(&mut self.confidence, &self.params.confidence, roi, self.avx2, pool, &mut self.support);
        let (right, down) = (SharedMut::new(&mut self.right), SharedMut::new(&mut self.down));
        let product = SharedMut::new(&mut self.product);
        let (sigma, avx2, support) = (self.params.sigma_color, self.avx2, &self.support);
        const CHUNK_ROWS: usize = 16;
        pool.run(roi.height.div_ceil(CHUNK_ROWS), &|chunk| {
            for row in chunk * CHUNK_ROWS..((chunk + 1) * CHUNK_ROWS).min(roi.height) {
                let from = row * roi.width;
                // SAFETY: one row, one chunk.
                let (right, down, product) =
                    unsafe { (right.part(from, roi.width), down.part(from, roi.width), product.part(from, roi.width)) };
                let at = (roi.x, roi.y + row, roi.width);
                weights_row(input.guide, at, row + 1 == roi.height, sigma, avx2, right, down);
                let disparity = &input.disparity.row(roi.y + row)[roi.x..roi.x + roi.width];
                let support = &support[from..from + roi.width];
                for ((product, disparity), support) in product.iter_mut().zip(disparity).zip(support) {
                    *product = if *support > 0.0 { disparity * support } else { 0.0 };
                }
            }
        });
    }
}
