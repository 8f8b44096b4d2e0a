//! Block matching on the processor or on the GPU, which find the same disparities.

use panoscope_imaging::stereo::{
    BlockMatcher, BlockMatchingParams, PairMatcher, PairParams, StereoError, StereoKernel, Tile, project_right,
};
use panoscope_imaging::{Parallel, Rect, Report, View, ViewMut};
use panoscope_node::device::{Device, OnDevice, given_up};
use panoscope_node::{Context, Result};

use crate::gpu::pair::{GpuPairMatcher, ViewsThere};
use crate::matcher::{In, Out};

/// A block matcher that works on the device of its choice.
pub struct DeviceMatcher {
    processor: BlockMatcher,
    gpu: OnDevice<GpuPairMatcher>,
    fault: Option<String>,
}

impl DeviceMatcher {
    /// A matcher on the processor.
    ///
    /// # Errors
    /// A parameter is out of range.
    pub fn new(params: BlockMatchingParams) -> Result<Self, StereoError> {
        Ok(Self { processor: BlockMatcher::new(params)?, gpu: OnDevice::default(), fault: None })
    }

    /// Changes the parameters; memory is kept.
    ///
    /// # Errors
    /// A parameter is out of range.
    pub fn set_params(&mut self, params: BlockMatchingParams) -> Result<(), StereoError> {
        self.processor.set_params(params)
    }

    /// Chooses the device.
    pub fn choose(&mut self, device: Device, report: &dyn Report) {
        self.gpu.choose(device, report, GpuPairMatcher::new);
    }

    /// Matches a pair whose views and maps stay on the GPU. Whether it did: without a GPU, or with one that fails, the
    /// processor is to match it.
    ///
    /// # Errors
    /// There is no frame memory for an output.
    pub fn match_there(
        &mut self,
        pair: &mut PairMatcher,
        cx: &Context<'_>,
        input: &In<'_>,
        out: &mut Out<'_>,
        roi: Rect,
        params: &PairParams,
    ) -> Result<bool> {
        let (width, height) = (input.left.width(), input.left.height());
        self.gpu.attempt(cx, |gpu| {
            let images = [input.left.on_device()?, input.right.on_device()?];
            let left = out.disparity.alloc_on_device(width, height)?;
            let right = out.disparity_right.is_read().then(|| out.disparity_right.alloc_on_device(width, height));
            let views = ViewsThere { images, fetch: &|| [input.left.view(), input.right.view()] };
            let params = (self.processor.params(), params);
            Ok(gpu.compute(pair, cx, views, roi, params, cx.pool(), left, right.transpose()?)?)
        })
    }

    /// Whether the GPU did its work; one that failed is given up.
    fn has_worked(&mut self, worked: Result<()>) -> bool {
        if let Err(error) = &worked {
            self.gpu.give_up();
            self.fault = Some(error.to_string());
        }
        worked.is_ok()
    }

    /// Warns when the GPU has failed since the last call.
    pub fn report_fault(&mut self, report: &dyn Report) {
        if let Some(reason) = self.fault.take() {
            report.warn(&given_up(&reason));
        }
    }
}

impl StereoKernel for DeviceMatcher {
    fn match_roi(
        &mut self,
        range: (i32, usize),
        views: [View<'_, u8>; 2],
        roi: Rect,
        pool: &dyn Parallel,
        mut disparity: ViewMut<'_, f32>,
        mut disparity_right: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError> {
        if let Some(gpu) = self.gpu.get_mut() {
            let (min_disparity_px, search_px) = range;
            let params = BlockMatchingParams { min_disparity_px, search_px, ..self.processor.params().clone() };
            params.validate()?;
            let worked =
                gpu.blocks.compute(&params, views[0], views[1], roi, &mut disparity, disparity_right.as_mut(), pool);
            if self.has_worked(worked) {
                return Ok(());
            }
        }
        self.processor.match_roi(range, views, roi, pool, disparity, disparity_right)
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
        if let Some(gpu) = self.gpu.get_mut() {
            let worked =
                gpu.blocks.compute_tiles(self.processor.params(), views[0], views[1], tiles, &mut disparity, pool);
            if self.has_worked(worked) {
                project_right(&mut disparity, &mut disparity_right, left_right_px, pool);
                return Ok(());
            }
        }
        self.processor.match_tiles(tiles, views, left_right_px, pool, disparity, disparity_right)
    }
}
