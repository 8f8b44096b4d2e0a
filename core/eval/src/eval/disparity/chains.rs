//! The chains that are judged, on one pair.

use panoscope_imaging::stereo::{
    BilateralSolver, BilateralSolverParams, BlockMatcher, BlockMatchingParams, ConfidenceParams, FilterInput,
    SemiGlobalMatcher, SemiGlobalParams, SharedField, WlsFilter, WlsParams,
};
use panoscope_imaging::{Rect, Serial, View, ViewMut};

use super::data::Picture;
use crate::error::{Result, ensure};

/// A disparity map and the name of its chain.
pub struct ChainOutput {
    /// Name of the chain.
    pub chain: &'static str,
    /// Px of the left view, NaN where unknown.
    pub disparity: Vec<f32>,
}

/// All chains with the nodes' own settings, over disparities `first_px..first_px + search_px`.
pub fn run(left: &Picture, right: &Picture, first_px: i32, search_px: usize) -> Result<Vec<ChainOutput>> {
    let (width, height) = (left.width, left.height);
    let roi = Rect::whole(width, height);
    let plane = || vec![f32::NAN; width * height];
    fn view(data: &[f32], width: usize, height: usize) -> View<'_, f32> {
        View::new(data, width, height, 1)
    }
    ensure!((width, height) == (right.width, right.height), "the views differ in size");
    let (a, b) = (View::new(&left.gray[..], width, height, 1), View::new(&right.gray[..], width, height, 1));
    let guide = View::new(&left.bgr[..], width, height, 3);

    let mut outputs = Vec::new();
    for semi_global in [false, true] {
        let (mut raw, mut raw_right) = (plane(), plane());
        let (to, to_right) = (ViewMut::new(&mut raw, width, height, 1), ViewMut::new(&mut raw_right, width, height, 1));
        let scatter_radius_px = if semi_global {
            let params = SemiGlobalParams { min_disparity_px: first_px, search_px, ..Default::default() };
            SemiGlobalMatcher::new(params)?.compute(a, b, roi, &Serial, to, Some(to_right))?;
            3
        } else {
            let params = BlockMatchingParams { min_disparity_px: first_px, search_px, ..Default::default() };
            BlockMatcher::new(params)?.compute(a, b, roi, &Serial, to, Some(to_right))?;
            5
        };
        // As the nodes do.
        let (both, both_right) =
            (&mut ViewMut::new(&mut raw, width, height, 1), &mut ViewMut::new(&mut raw_right, width, height, 1));
        SharedField::default().clear_outside(both, both_right, roi);
        let (mut smooth, mut trust, mut solved) = (plane(), plane(), plane());
        let confidence = ConfidenceParams { scatter_radius_px, ..Default::default() };
        let mut wls = WlsFilter::new(WlsParams { confidence, ..Default::default() })?;
        let input = FilterInput {
            guide,
            disparity: view(&raw, width, height),
            disparity_right: Some(view(&raw_right, width, height)),
            confidence: None,
            roi,
        };
        let support = ViewMut::new(&mut trust, width, height, 1);
        wls.compute(input, &Serial, ViewMut::new(&mut smooth, width, height, 1), Some(support))?;
        if !semi_global {
            let mut solver = BilateralSolver::new(BilateralSolverParams::default())?;
            let input = FilterInput {
                guide,
                disparity: view(&smooth, width, height),
                disparity_right: None,
                confidence: Some(view(&trust, width, height)),
                roi,
            };
            solver.compute(input, &Serial, ViewMut::new(&mut solved, width, height, 1), None)?;
        }
        let names: [&'static str; 2] = if semi_global { ["sgbm", "sgbm_wls"] } else { ["bm", "bm_wls"] };
        outputs.push(ChainOutput { chain: names[0], disparity: raw });
        outputs.push(ChainOutput { chain: names[1], disparity: smooth });
        if !semi_global {
            outputs.push(ChainOutput { chain: "bm_wls_fbs", disparity: solved });
        }
    }
    Ok(outputs)
}
