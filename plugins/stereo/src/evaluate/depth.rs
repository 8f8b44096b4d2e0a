//! `evaluate_depth`: errors of a depth map beside the true one.

use panoscope_imaging::stereo::MapScorer;
use panoscope_node::abi::Scalar;
use panoscope_node::{Context, Depth, Image, Mask, Node, NodeInfo, Open, Ports, Result, Slot, TableData, Validation};

use super::{needs, percent, unknown};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// The map to evaluate. A tick without one counts as unknown everywhere.
    depth: Option<Image<'f, Depth>>,
    /// True depth of the same view; pixels where it is unknown do not count.
    truth: Image<'f, Depth>,
    /// Pixels that count are not 0; all count without it.
    mask: Option<Image<'f, Mask>>,
}

/// Outputs, of one tick; NaN where no pixel counts.
#[derive(Ports)]
pub struct Out<'f> {
    /// Median absolute error of the pixels that have a depth.
    median_mm: Slot<'f, Scalar>,
    /// Mean absolute error of the pixels that have a depth.
    mean_mm: Slot<'f, Scalar>,
    /// Absolute error that 95 % of the pixels with a depth stay below.
    p95_mm: Slot<'f, Scalar>,
    /// Percent of pixels that have a depth.
    coverage_pct: Slot<'f, Scalar>,
    /// One row: the numbers above, and the number of pixels that count.
    table: Slot<'f, TableData>,
}

/// Columns of the table.
const COLUMNS: [&str; 5] = ["median_mm", "mean_mm", "p95_mm", "coverage_pct", "pixels"];

/// See the module.
#[derive(Default)]
pub struct EvaluateDepth {
    scorer: MapScorer,
    unknown: Vec<f32>,
}

impl Node for EvaluateDepth {
    const INFO: NodeInfo = NodeInfo::compute(
        "evaluate_depth",
        "stereo",
        "Compares depth with the truth, pixel by pixel: median, mean and 95 % error in mm, coverage.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ();

    fn validate(_: &(), check: &mut Validation<'_>) {
        needs(check, "depth");
    }

    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, _: &()) -> Result<()> {
        let truth = input.truth.view();
        let found = match &input.depth {
            Some(depth) => depth.view(),
            None => unknown(&mut self.unknown, &truth),
        };
        let score = self.scorer.depth(found, truth, input.mask.as_ref().map(Image::view))?;
        let coverage = percent(score.density, score.pixels);
        let (median, mean, p95) = (score.median_error_mm, score.mean_error_mm, score.p95_error_mm);
        cx.metric("median_mm", median);
        out.median_mm.set_scalar("median error", median, "mm")?;
        out.mean_mm.set_scalar("mean error", mean, "mm")?;
        out.p95_mm.set_scalar("95 % error", p95, "mm")?;
        out.coverage_pct.set_scalar("coverage", coverage, "%")?;
        out.table.set_table(&COLUMNS, &[median, mean, p95, coverage, score.pixels as f64])
    }
}
