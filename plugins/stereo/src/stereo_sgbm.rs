//! `stereo_sgbm`: semi-global matching, a rectified pair in, disparity maps of both views out.

use panoscope_imaging::stereo::{SemiGlobalMatcher, SemiGlobalParams};
use panoscope_node::{Context, Node, NodeInfo, Open, Params, Result, Validation};

use crate::matcher::{In, Matcher, Out, SearchWindow, check_kernel, process, rim_px};

/// Parameters.
#[derive(Params)]
pub struct StereoSgbmParams {
    #[param(flatten)]
    search: SearchWindow,
    /// Side of the square window in which views are compared.
    #[param(default = 5, range = 3..=7, step = 2, unit = "px")]
    block_px: usize,
    /// Limit of the horizontal edge response that is compared; 0 compares gray values.
    #[param(default = 31, range = 0..=31)]
    prefilter_cap: u8,
    /// Penalty of a change of disparity by 1 px; must be below `large_penalty`.
    #[param(default = 10, range = 1..=100)]
    small_penalty: u8,
    /// Penalty of a larger change of disparity.
    #[param(default = 100, range = 2..=120)]
    large_penalty: u8,
    /// Aggregates along diagonal paths too: smoother, slower.
    #[param(default = true)]
    diagonals: bool,
    /// Drops a pixel when another disparity costs at most this much more than the best one; 0 keeps all.
    #[param(default = 5, range = 0..=100, unit = "%")]
    uniqueness: u32,
    /// Largest difference between the disparities of both views; -1 does not check.
    #[param(default = 1, range = -1..=64, unit = "px")]
    left_right_px: i32,
}

impl StereoSgbmParams {
    /// The range is set by each call.
    fn kernel(&self) -> SemiGlobalParams {
        SemiGlobalParams {
            min_disparity_px: self.search.min_disparity_px,
            search_px: self.search.search_px,
            block_px: self.block_px,
            prefilter_cap: self.prefilter_cap,
            small_penalty: self.small_penalty,
            large_penalty: self.large_penalty,
            diagonals: self.diagonals,
            uniqueness_percent: self.uniqueness,
            left_right_px: u32::try_from(self.left_right_px).ok(),
        }
    }
}

/// See the module.
pub struct StereoSgbm {
    kernel: SemiGlobalMatcher,
    matcher: Matcher,
}

impl Node for StereoSgbm {
    const INFO: NodeInfo = NodeInfo::compute(
        "stereo_sgbm",
        "stereo",
        "Semi-global matching: disparity maps of both views of a rectified pair, with the search's offset found by itself.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = StereoSgbmParams;

    fn validate(params: &StereoSgbmParams, check: &mut Validation<'_>) {
        if params.small_penalty >= params.large_penalty {
            let message = format!(
                "`small_penalty` is {}, not below `large_penalty`, which is {}: a large change of disparity must cost more than a small one",
                params.small_penalty, params.large_penalty
            );
            return check.error("small_penalty", message, "lower `small_penalty` or raise `large_penalty`");
        }
        check_kernel(check, params.kernel().validate());
    }

    fn open(_: &Open<'_>, params: &StereoSgbmParams) -> Result<Self> {
        let kernel = SemiGlobalMatcher::new(params.kernel())?;
        Ok(Self { kernel, matcher: Matcher::new()? })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &StereoSgbmParams,
    ) -> Result<()> {
        self.kernel.set_params(params.kernel())?;
        let search = (&params.search, params.left_right_px, rim_px(params.block_px));
        process(&mut self.matcher, &mut self.kernel, cx, &input, &mut out, search)
    }
}
