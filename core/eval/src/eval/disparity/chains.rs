//! The chains that are judged, on one pair.

use panoscope_base::Silent;
use panoscope_imaging::stereo::length::Noise;
use panoscope_imaging::stereo::{
    BilateralSolver, BilateralSolverParams, BlockMatcher, BlockMatchingParams, ConfidenceParams, FilterInput,
    PairMatcher, PairParams, SearchParams, SemiGlobalMatcher, SemiGlobalParams, WlsFilter, WlsParams,
};
use panoscope_imaging::{Parallel, Rect, Serial, View, ViewMut};

use super::data::Picture;
use crate::error::{Result, ensure};

/// A disparity map and the name of its chain.
pub struct ChainOutput {
    /// Name of the chain.
    pub chain: &'static str,
    /// Px of the left view, NaN where unknown.
    pub disparity: Vec<f32>,
    /// Of the disparities, 0 to 1, where the chain gives it.
    pub confidence: Option<Vec<f32>>,
    /// `disparity_noise_px` of a node `measure` behind the chain.
    pub disparity_noise_px: f64,
}

/// All chains with the nodes' own settings, over disparities `first_px..first_px + search_px`.
pub fn run(left: &Picture, right: &Picture, first_px: i32, search_px: usize) -> Result<Vec<ChainOutput>> {
    let params = SearchParams { auto_offset: false, auto_range: false, min_disparity_px: first_px, search_px, ..NODES };
    chains(left, right, params, &Serial)
}

/// The same with the search that finds its range by itself.
pub fn search(left: &Picture, right: &Picture, pool: &dyn Parallel) -> Result<Vec<ChainOutput>> {
    chains(left, right, NODES, pool)
}

/// The search of the nodes.
const NODES: SearchParams = SearchParams {
    auto_offset: true,
    auto_range: true,
    min_disparity_px: 0,
    keeps_asked: false,
    search_px: 128,
    drift_px: 0.0,
};
/// Strength of the filter, and area of speckles, in `graphs/parts/stereo_depth.toml`.
const DEPTH: (f32, usize) = (200.0, 200);
/// Uniqueness before the filter in `graphs/parts/stereo_wls.toml`.
const WLS_UNIQUENESS_PERCENT: u32 = 5;

fn view(data: &[f32], (width, height): (usize, usize)) -> View<'_, f32> {
    View::new(data, width, height, 1)
}

fn view_mut(data: &mut [f32], (width, height): (usize, usize)) -> ViewMut<'_, f32> {
    ViewMut::new(data, width, height, 1)
}

fn chains(left: &Picture, right: &Picture, search: SearchParams, pool: &dyn Parallel) -> Result<Vec<ChainOutput>> {
    let size = (left.width, left.height);
    let roi = Rect::whole(size.0, size.1);
    let plane = || vec![f32::NAN; size.0 * size.1];
    ensure!(size == (right.width, right.height), "the views differ in size");
    let views = [left, right].map(|picture| View::new(&picture.gray[..], size.0, size.1, 1));
    let guide = View::new(&left.bgr[..], size.0, size.1, 3);

    let matched = |matched: Matched| -> Result<[Vec<f32>; 2]> {
        let (mut map, mut map_right) = (plane(), plane());
        let (to, to_right) = (view_mut(&mut map, size), Some(view_mut(&mut map_right, size)));
        let mut matcher = PairMatcher::new()?;
        match matched {
            Matched::Blocks { uniqueness_percent } => {
                let params = PairParams { search, left_right_px: Some(1), speckle_area_px: 0 };
                let mut kernel = BlockMatcher::new(BlockMatchingParams { uniqueness_percent, ..Default::default() })?;
                matcher.compute(&Silent, &mut kernel, views, roi, &params, pool, to, to_right)?;
            }
            Matched::SemiGlobal { speckle_area_px } => {
                let params = PairParams { search, left_right_px: Some(1), speckle_area_px };
                let mut kernel = SemiGlobalMatcher::new(SemiGlobalParams::default())?;
                matcher.compute(&Silent, &mut kernel, views, roi, &params, pool, to, to_right)?;
            }
        }
        Ok([map, map_right])
    };
    let filtered = |[map, map_right]: &[Vec<f32>; 2], scatter_radius_px: usize, lambda: f32| -> Result<[Vec<f32>; 2]> {
        let (mut smooth, mut trust) = (plane(), plane());
        let confidence = ConfidenceParams { scatter_radius_px, ..Default::default() };
        let mut wls = WlsFilter::new(WlsParams { lambda, confidence, ..Default::default() })?;
        let (disparity, disparity_right) = (view(map, size), Some(view(map_right, size)));
        let input = FilterInput { guide, disparity, disparity_right, confidence: None, roi };
        wls.compute(input, pool, view_mut(&mut smooth, size), Some(view_mut(&mut trust, size)))?;
        Ok([smooth, trust])
    };
    let lambda = WlsParams::default().lambda;

    let [bm, _] = matched(Matched::Blocks { uniqueness_percent: BlockMatchingParams::default().uniqueness_percent })?;
    let [bm_wls, bm_trust] =
        filtered(&matched(Matched::Blocks { uniqueness_percent: WLS_UNIQUENESS_PERCENT })?, 5, lambda)?;
    let mut bm_wls_fbs = plane();
    let (disparity, confidence) = (view(&bm_wls, size), Some(view(&bm_trust, size)));
    let input = FilterInput { guide, disparity, disparity_right: None, confidence, roi };
    let mut solver = BilateralSolver::new(BilateralSolverParams::default())?;
    solver.compute(input, pool, view_mut(&mut bm_wls_fbs, size), None)?;
    let semi_global = matched(Matched::SemiGlobal { speckle_area_px: 0 })?;
    let [sgbm_wls, sgbm_trust] = filtered(&semi_global, 3, lambda)?;
    let [depth, depth_trust] = filtered(&matched(Matched::SemiGlobal { speckle_area_px: DEPTH.1 })?, 3, DEPTH.0)?;
    let [sgbm, _] = semi_global;
    let all = [
        ("bm", bm, None),
        ("bm_wls", bm_wls, Some(bm_trust.clone())),
        // The graphs measure with the confidence of the filter before the solver.
        ("bm_wls_fbs", bm_wls_fbs, Some(bm_trust)),
        ("sgbm", sgbm, None),
        ("sgbm_wls", sgbm_wls, Some(sgbm_trust)),
        ("depth", depth, Some(depth_trust)),
    ];
    let disparity_noise_px = Noise::USUAL.disparity_px;
    let output = |(chain, disparity, confidence)| ChainOutput { chain, disparity, confidence, disparity_noise_px };
    Ok(all.into_iter().map(output).collect())
}

/// How a chain begins.
enum Matched {
    Blocks { uniqueness_percent: u32 },
    SemiGlobal { speckle_area_px: usize },
}

#[cfg(test)]
mod tests {
    use panoscope_base::Threads;

    use super::super::synthetic::{self, SyntheticPair};
    use super::*;

    #[test]
    fn disparities_from_20_to_199_px_are_found_in_one_picture() {
        let pool = Threads::new(2);
        let condition = synthetic::CONDITIONS.iter().find(|condition| condition.name == "range").expect("a condition");
        let SyntheticPair([left, right]) = synthetic::render(condition, synthetic::HELD_OUT_SEEDS[0], &pool);
        let (width, height) = left.size;
        let views = [&left, &right].map(|view| Picture::new(width, height, view.bgr.clone()));
        // The share of what both cameras see nearer than one search of 128 px reaches that is within 5 % of its depth.
        let right = |search: SearchParams| {
            let made = chains(&views[0], &views[1], search, &pool).expect("chains");
            let map = made.iter().find(|made| made.chain == "depth").expect("a chain");
            let all = map.disparity.iter().zip(&left.disparity).zip(&left.visible);
            let (mut near, mut right) = (0usize, 0usize);
            for ((found, truth), _) in all.filter(|((_, truth), visible)| **visible != 0 && **truth > 150.0) {
                near += 1;
                right += usize::from(found.is_finite() && (truth / found.max(1.0) - 1.0).abs() < 0.05);
            }
            assert!(near > 1000, "the scene has near places: {near}");
            100.0 * right as f64 / near as f64
        };
        let (found, in_one) = (right(NODES), right(SearchParams { auto_range: false, ..NODES }));
        assert!(
            found > 80.0 && in_one < 20.0,
            "{found} % of near places with searches side by side, {in_one} % with one"
        );
    }

    #[test]
    fn the_filter_keeps_a_car_of_smooth_paint() {
        let pool = Threads::new(2);
        let condition = synthetic::CONDITIONS.iter().find(|condition| condition.name == "street").expect("a condition");
        let SyntheticPair([left, right]) = synthetic::render(condition, synthetic::HELD_OUT_SEEDS[0], &pool);
        let width = left.size.0;
        let views = [&left, &right].map(|view| Picture::new(width, left.size.1, view.bgr.clone()));
        let made = search(&views[0], &views[1], &pool).expect("chains");
        // The rear of the near car is the only upright surface this near.
        let is_car = |at: &usize| {
            let d = left.disparity[*at];
            d > 60.0 && (left.disparity[at - width] - d).abs() < 0.1 && left.visible[*at] != 0
        };
        let car: Vec<usize> = (width..left.disparity.len()).filter(is_car).collect();
        assert!(car.len() > 20_000, "the car is large: {} px", car.len());
        let bad = |chain: &str| {
            let map = &made.iter().find(|made| made.chain == chain).expect("a chain").disparity;
            let right = car.iter().filter(|at| (map[**at] - left.disparity[**at]).abs() <= 2.0).count();
            100.0 * (1.0 - right as f64 / car.len() as f64)
        };
        // What removes wrong patches removes little of it: 37 % were bad when each piece between holes was a patch.
        let (filtered, kept) = (bad("depth"), bad("sgbm_wls"));
        assert!(filtered < 33.0 && filtered < kept + 10.0, "{filtered} % bad, {kept} % without the removal of patches");
    }
}
