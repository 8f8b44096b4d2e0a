//! Matches gray pairs for the training of `stereo_net`: `match_pairs WIDTH HEIGHT`, pairs on standard input, maps on standard output.
//!
//! A pair is the bytes of the left view, then of the right one. For each come three maps of the left view as little-endian i16 in 1/64 px, `i16::MIN`
//! where unknown: by block matching, by block matching of views shrunk by two, and by the semi-global matcher, each with the settings of its node.

use std::io::{Read, Write};

use panoscope_imaging::features::{GrayBuffer, shrink_gray};
use panoscope_imaging::stereo::{
    BlockMatcher, BlockMatchingParams, PairMatcher, PairParams, SearchParams, SemiGlobalMatcher, SemiGlobalParams,
    StereoError, StereoKernel,
};
use panoscope_imaging::{Rect, Serial, View, ViewMut};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// Steps of a pixel in the output.
const STEPS: f32 = 64.0;
/// Speckles that `graphs/parts/stereo_depth.toml` removes, px.
const SPECKLE_AREA_PX: usize = 200;

/// The left map of a pair, by a kernel with the search of its node.
fn maps<K: StereoKernel>(
    kernel: &mut K,
    views: [View<'_, u8>; 2],
    (search_px, speckle_area_px): (usize, usize),
) -> std::result::Result<Vec<f32>, StereoError> {
    let (width, height) = (views[0].width, views[0].height);
    let search = SearchParams {
        auto_offset: true,
        auto_range: true,
        min_disparity_px: 0,
        keeps_asked: false,
        search_px,
        drift_px: 0.0,
    };
    let params = PairParams { search, left_right_px: Some(1), speckle_area_px };
    let mut made = vec![f32::NAN; width * height];
    let roi = Rect::whole(width, height);
    // A new matcher for each pair: the next one shows another scene.
    let mut matcher = PairMatcher::new()?;
    matcher.compute(
        &panoscope_imaging::Silent,
        kernel,
        views,
        roi,
        &params,
        &Serial,
        ViewMut::new(&mut made[..], width, height, 1),
        None,
    )?;
    Ok(made)
}

/// The left map of views shrunk by two, in full size.
fn shrunk(views: [View<'_, u8>; 2]) -> std::result::Result<Vec<f32>, StereoError> {
    let mut small = [GrayBuffer::new(), GrayBuffer::new()];
    for (view, small) in views.into_iter().zip(&mut small) {
        shrink_gray(view, 2, small, &Serial);
    }
    let mut kernel = BlockMatcher::new(BlockMatchingParams { block_px: 7, ..Default::default() })?;
    let made = maps(&mut kernel, small.each_ref().map(GrayBuffer::view), (64, 0))?;
    let columns = views[0].width / 2;
    let at = |index: usize| {
        let (x, y) = (index % views[0].width / 2, index / views[0].width / 2);
        if x < columns { made.get(y * columns + x).map_or(f32::NAN, |value| 2.0 * value) } else { f32::NAN }
    };
    Ok((0..views[0].width * views[0].height).map(at).collect())
}

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let mut next = || -> Result<usize> { Ok(arguments.next().ok_or("match_pairs WIDTH HEIGHT")?.parse()?) };
    let (width, height) = (next()?, next()?);
    let (mut input, mut output) = (std::io::stdin().lock(), std::io::stdout().lock());
    let mut bytes = vec![0; 2 * width * height];
    let mut blocks = BlockMatcher::new(BlockMatchingParams::default())?;
    let mut semi_global = SemiGlobalMatcher::new(SemiGlobalParams::default())?;
    while input.read_exact(&mut bytes).is_ok() {
        let (left, right) = bytes.split_at(width * height);
        let views = [left, right].map(|view| View::new(view, width, height, 1));
        let made = [
            maps(&mut blocks, views, (128, 0))?,
            shrunk(views)?,
            maps(&mut semi_global, views, (128, SPECKLE_AREA_PX))?,
        ];
        let steps = |value: &f32| {
            let value = if value.is_finite() { (value * STEPS).round() as i16 } else { i16::MIN };
            value.to_le_bytes()
        };
        let packed: Vec<u8> = made.iter().flatten().flat_map(steps).collect();
        output.write_all(&packed)?;
        output.flush()?;
    }
    Ok(())
}
