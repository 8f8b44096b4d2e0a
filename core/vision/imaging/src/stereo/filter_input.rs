//! What a filter of disparities reads.

use crate::stereo::StereoError;
use crate::stereo::confidence::{Confidence, ConfidenceParams};
use crate::stereo::error::{check_channels, check_size};
use crate::{Parallel, Rect, SharedMut, View};

/// Inputs of one call; all views have one size.
#[derive(Clone, Copy, Debug)]
pub struct FilterInput<'a> {
    /// Rectified left view, gray or BGR.
    pub guide: View<'a, u8>,
    /// Left disparity in px, NaN where unmatched.
    pub disparity: View<'a, f32>,
    /// Right disparity in px, for the left-right check.
    pub disparity_right: Option<View<'a, f32>>,
    /// Confidence 0..=1 to use instead of judging it here.
    pub confidence: Option<View<'a, f32>>,
    /// Where to work.
    pub roi: Rect,
}

impl FilterInput<'_> {
    pub(crate) fn check(&self) -> Result<(), StereoError> {
        let size = (self.disparity.width, self.disparity.height);
        check_channels("guide", &[1, 3], "1 (gray) or 3 (BGR)", self.guide.channels)?;
        check_channels("disparity", &[1], "1", self.disparity.channels)?;
        check_size("guide", size, (self.guide.width, self.guide.height))?;
        for (what, map) in [("right disparity", self.disparity_right), ("confidence", self.confidence)] {
            if let Some(map) = map {
                check_channels(what, &[1], "1", map.channels)?;
                check_size(what, size, (map.width, map.height))?;
            }
        }
        Ok(())
    }

    /// Copies the given confidence, or judges it, for the ROI's pixels; 0 wherever the disparity is unknown.
    pub(crate) fn confidence_into(
        &self,
        work: &mut Confidence,
        params: &ConfidenceParams,
        roi: Rect,
        avx2: bool,
        pool: &dyn Parallel,
        out: &mut [f32],
    ) {
        let Some(given) = self.confidence else {
            work.compute(params, self.guide, self.disparity, self.disparity_right, roi, avx2, pool, out);
            return;
        };
        let out = SharedMut::new(out);
        pool.run(roi.height, &|row| {
            // SAFETY: one row, one chunk.
            let out = unsafe { out.part(row * roi.width, roi.width) };
            let confidence = &given.row(roi.y + row)[roi.x..roi.x + roi.width];
            let disparity = &self.disparity.row(roi.y + row)[roi.x..roi.x + roi.width];
            for ((out, confidence), disparity) in out.iter_mut().zip(confidence).zip(disparity) {
                // NaN fails the comparison.
                let value = if *confidence > 0.0 { confidence.min(1.0) } else { 0.0 };
                *out = if disparity.is_finite() { value } else { 0.0 };
            }
        });
    }
}
