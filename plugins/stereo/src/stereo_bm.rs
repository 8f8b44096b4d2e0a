//! `stereo_bm`: block matching, a rectified pair in, disparity maps of both views out (thesis, fig. 3.7).

use panoscope_imaging::stereo::{BlockMatcher, BlockMatchingParams};
use panoscope_node::{Context, Node, NodeInfo, Open, Params, Result, Validation};

use crate::matcher::{In, Matcher, Out, SearchWindow, check_kernel};
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
    /// Factor by which views are shrunk before they are matched: a coarser map, much faster.
    #[param(default = 1, range = 1..=8)]
    scale: usize,
}

/// Disparities that the kernel searches at once.
const SEARCH_STEP_PX: usize = 32;
/// Smallest window that the kernel compares.
const LEAST_BLOCK_PX: usize = 5;

impl StereoBmParams {
    /// In pixels of the shrunk views.
    fn kernel(&self, min_disparity_px: i32) -> BlockMatchingParams {
        let scale = self.scale.max(1);
        // Rounded down: what lies beyond the end by less than a shrunk pixel costs a whole block of disparities.
        let first = min_disparity_px.div_euclid(scale as i32);
        let end = (min_disparity_px + self.search.search_px as i32).div_euclid(scale as i32) + 1;
        let search = if scale == 1 { self.search.search_px } else { (end - first).max(1) as usize - 1 };
        let block = if scale == 1 { self.block_px } else { (self.block_px / scale).max(LEAST_BLOCK_PX) | 1 };
        BlockMatchingParams {
            min_disparity_px: first,
            search_px: search.next_multiple_of(SEARCH_STEP_PX),
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
        check_kernel(check, params.kernel(params.search.min_disparity_px).validate());
    }

    fn open(_: &Open<'_>, params: &StereoBmParams) -> Result<Self> {
        let kernel = BlockMatcher::new(params.kernel(params.search.min_disparity_px))?;
        Ok(Self { kernel: Shrunk::new(kernel), matcher: Matcher::new()? })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &StereoBmParams,
    ) -> Result<()> {
        self.kernel.factor = params.scale;
        self.matcher.process(cx, &input, &mut out, params.search, &mut self.kernel, |shrunk, offset_px| {
            let wanted = params.kernel(offset_px);
            if *shrunk.kernel.params() == wanted { Ok(()) } else { shrunk.kernel.set_params(wanted) }
        })
    }
}
