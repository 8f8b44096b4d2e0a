//! `evaluate_disparity`: errors of a disparity map beside the true one.

use panoscope_imaging::stereo::{BAD_PX, MapScorer};
use panoscope_node::abi::Scalar;
use panoscope_node::{
    Context, Disparity, Image, Mask, Node, NodeInfo, Open, Ports, Result, Slot, TableData, Validation,
};

use super::{needs, percent, unknown};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// The map to evaluate. A tick without one counts as unknown everywhere.
    disparity: Option<Image<'f, Disparity>>,
    /// True disparity of the same view; pixels where it is unknown do not count.
    truth: Image<'f, Disparity>,
    /// Pixels that count are not 0; all count without it.
    mask: Option<Image<'f, Mask>>,
}

/// Outputs, of one tick; NaN where no pixel counts.
#[derive(Ports)]
pub struct Out<'f> {
    /// Percent of pixels with an error above 1 px; a pixel without disparity counts as bad.
    bad1_pct: Slot<'f, Scalar>,
    /// The same above 2 px.
    bad2_pct: Slot<'f, Scalar>,
    /// The same above 3 px.
    bad3_pct: Slot<'f, Scalar>,
    /// Mean absolute error of the pixels that have a disparity.
    mean_px: Slot<'f, Scalar>,
    /// Absolute error that 95 % of the pixels with a disparity stay below.
    p95_px: Slot<'f, Scalar>,
    /// Percent of pixels that have a disparity.
    coverage_pct: Slot<'f, Scalar>,
    /// One row: the numbers above, `rms_px`, and the number of pixels that count.
    table: Slot<'f, TableData>,
}

/// Columns of the table.
const COLUMNS: [&str; 8] =
    ["bad1_pct", "bad2_pct", "bad3_pct", "mean_px", "p95_px", "coverage_pct", "rms_px", "pixels"];

// The outputs are named after the thresholds.
const _: () = assert!(BAD_PX[0] == 1.0 && BAD_PX[1] == 2.0 && BAD_PX[2] == 3.0);

/// See the module.
#[derive(Default)]
pub struct EvaluateDisparity {
    scorer: MapScorer,
    unknown: Vec<f32>,
}

impl Node for EvaluateDisparity {
    const INFO: NodeInfo = NodeInfo::compute(
        "evaluate_disparity",
        "stereo",
        "Compares disparities with the truth: bad pixels, mean and 95 % error, coverage.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ();

    fn validate(_: &(), check: &mut Validation<'_>) {
        needs(check, "disparity");
    }

    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, _: &()) -> Result<()> {
        let truth = input.truth.view();
        let found = match &input.disparity {
            Some(disparity) => disparity.view(),
            None => unknown(&mut self.unknown, &truth),
        };
        let score = self.scorer.disparity(found, truth, input.mask.as_ref().map(Image::view))?;
        let [bad1, bad2, bad3, _] = score.bad.map(|share| percent(share, score.pixels));
        let coverage = percent(score.density, score.pixels);
        cx.metric("bad2_pct", bad2);
        out.bad1_pct.set_scalar("bad1", bad1, "%")?;
        out.bad2_pct.set_scalar("bad2", bad2, "%")?;
        out.bad3_pct.set_scalar("bad3", bad3, "%")?;
        out.mean_px.set_scalar("mean error", score.mean_error_px, "px")?;
        out.p95_px.set_scalar("95 % error", score.p95_error_px, "px")?;
        out.coverage_pct.set_scalar("coverage", coverage, "%")?;
        let (mean, p95, rms) = (score.mean_error_px, score.p95_error_px, score.rms_error_px);
        out.table.set_table(&COLUMNS, &[bad1, bad2, bad3, mean, p95, coverage, rms, score.pixels as f64])
    }
}
