//! `stereo_bm`: block matching, a rectified pair in, disparity maps of both views out (thesis, fig. 3.7).

use panoscope_imaging::stereo::BlockMatchingParams;
use panoscope_node::device::Device;
use panoscope_node::{Context, Node, NodeInfo, Open, Params, Result, Validation};

use crate::matcher::{In, Matcher, Out, SearchWindow, check_kernel, process, rim_px};
use crate::shrinking::factor;
use crate::shrunk::Shrunk;

/// Parameters.
#[derive(Params)]
pub struct StereoBmParams {
    #[param(flatten)]
    search: SearchWindow,
    /// Side of the square window in which views are compared.
    #[param(default = 15, range = 3..=31, step = 2, unit = "px")]
    block_px: usize,
    /// Limit of the horizontal edge response that is compared; 0 compares gray values.
    #[param(default = 31, range = 0..=31)]
    prefilter_cap: u8,
    /// Smallest edge response of a window that is matched; 0 matches all.
    #[param(default = 10, range = 0..=20000)]
    texture: u32,
    /// Drops a pixel when another disparity costs at most this much more than the best one; 0 keeps all.
    #[param(default = 15, range = 0..=100, unit = "%")]
    uniqueness: u32,
    /// Largest difference between the disparities of both views; -1 does not check.
    #[param(default = 1, range = -1..=64, unit = "px")]
    left_right_px: i32,
    /// Factor by which views are shrunk before they are matched: a coarser map, much faster. 0 finds it from the width: 1 below 640 px, 2 from
    /// 640, 3 from 1440, 4 from 2560.
    #[param(default = 1, range = 0..=8)]
    scale: usize,
    /// What matches the views, with the same disparities. A GPU pays for large views. Without one the processor matches, with a warning.
    #[param(default = "cpu")]
    device: Device,
}

/// Smallest window that the kernel compares.
const MIN_BLOCK_PX: usize = 5;

impl StereoBmParams {
    /// In pixels of views shrunk by `factor`; the range is set by each call.
    fn kernel(&self, factor: usize) -> BlockMatchingParams {
        let block = if factor == 1 { self.block_px } else { (self.block_px / factor).max(MIN_BLOCK_PX) | 1 };
        BlockMatchingParams {
            min_disparity_px: self.search.min_disparity_px,
            search_px: self.search.search_px,
            block_px: block,
            prefilter_cap: self.prefilter_cap,
            texture_threshold: self.texture,
            uniqueness_percent: self.uniqueness,
            left_right_px: u32::try_from(self.left_right_px).ok(),
        }
    }
}

/// See the module.
pub struct StereoBm {
    kernel: Shrunk,
    matcher: Matcher,
}

impl Node for StereoBm {
    const INFO: NodeInfo = NodeInfo::compute(
        "stereo_bm",
        "stereo",
        "Block matching: disparity maps of both views of a rectified pair, with the search's offset found by itself.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = StereoBmParams;

    fn validate(params: &StereoBmParams, check: &mut Validation<'_>) {
        check_kernel(check, params.kernel(1).validate());
    }

    fn open(open: &Open<'_>, params: &StereoBmParams) -> Result<Self> {
        let mut kernel = Shrunk::new(params.kernel(1))?;
        kernel.choose(params.device, open);
        Ok(Self { kernel, matcher: Matcher::new()? })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &StereoBmParams,
    ) -> Result<()> {
        let factor = factor(params.scale, input.left.width());
        self.kernel.factor = factor;
        self.kernel.kernel.set_params(params.kernel(factor))?;
        self.kernel.choose(params.device, cx);
        let rim_px = rim_px(params.kernel(factor).block_px) * factor;
        let search = (&params.search, params.left_right_px, rim_px);
        process(&mut self.matcher, &mut self.kernel, cx, &input, &mut out, search)
    }
}
