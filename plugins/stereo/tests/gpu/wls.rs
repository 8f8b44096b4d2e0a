//! Maps smoothed on the device are those of the processor to 0.01 px.

use panoscope_imaging::stereo::{FilterInput, WlsFilter, WlsParams};
use panoscope_imaging::{Rect, Serial, View, ViewMut};
use panoscope_node::device::Gpu;
use panoscope_stereo::gpu::wls_filter::{GpuWlsFilter, WlsImages};

use super::support::{Held, device, picture};

const SIZE: (usize, usize) = (203, 121);
/// Sides of the filtered rectangle are multiples of this.
const GRAIN_PX: usize = 32;

/// A slope with a step, holes and wrong matches; unknown outside `known`.
fn rough(known: Rect) -> Vec<f32> {
    let value = |x: usize, y: usize| {
        let surface = 20.0 + x as f32 / 40.0 + if (60..140).contains(&x) && (30..90).contains(&y) { 9.0 } else { 0.0 };
        let is_known = (known.x..known.x + known.width).contains(&x) && (known.y..known.y + known.height).contains(&y);
        match (x * 7 + y * 13) % 11 {
            0 | 1 if known.area() > 1 => f32::NAN,
            _ if !is_known => f32::NAN,
            2 => surface + 3.0,
            _ => surface,
        }
    };
    (0..SIZE.0 * SIZE.1).map(|i| value(i % SIZE.0, i / SIZE.0)).collect()
}

/// Map and confidence of the processor's filter in `roi`.
fn filtered(params: &WlsParams, guide: View<'_, u8>, rough: &[f32], roi: Rect) -> [Vec<f32>; 2] {
    let mut filter = WlsFilter::new(params.clone()).expect("a filter");
    let disparity = View::new(rough, SIZE.0, SIZE.1, 1);
    let input = FilterInput { guide, disparity, disparity_right: None, confidence: None, roi };
    let mut out = [(); 2].map(|()| vec![0.0; SIZE.0 * SIZE.1]);
    let [map, confidence] = out.each_mut().map(|out| ViewMut::new(out, SIZE.0, SIZE.1, 1));
    filter.compute(input, &Serial, map, Some(confidence)).expect("filtered");
    out
}

/// The same on the device, which finds the rectangle by itself.
fn filtered_there(gpu: Gpu, params: &WlsParams, guide: View<'_, u8>, rough: &[f32]) -> [Vec<f32>; 2] {
    let bytes: Vec<u8> = rough.iter().flat_map(|value| value.to_le_bytes()).collect();
    let disparity = Held::of(gpu, &bytes, SIZE.0, SIZE.1, 4 * SIZE.0);
    let held_guide = Held::of(gpu, guide.data, SIZE.0, SIZE.1, guide.stride);
    let [smooth, confidence] = [(); 2].map(|()| Held::new(gpu, SIZE.0, SIZE.1, 4));
    let images = WlsImages {
        guide: (held_guide.image, guide.channels),
        disparity: disparity.image,
        right: None,
        given: None,
        mask: None,
        beyond_px: 0,
        smooth: smooth.image,
        confidence: confidence.image,
    };
    GpuWlsFilter::new(gpu).expect("a filter").compute(&images, params, 1).expect("filtered");
    [smooth, confidence].map(|held| {
        let rows = held.rows(gpu, 4 * SIZE.0);
        rows.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
    })
}

#[test]
fn a_map_is_smoothed_as_on_the_processor() {
    let Some(gpu) = device() else { return };
    let whole = Rect::whole(SIZE.0, SIZE.1);
    let mut known = 0;
    for (channels, part, iterations, lambda) in [
        (3, whole, 3, 1000.0),
        (3, whole, 3, 200.0),
        (1, Rect::new(31, 37, 150, 50), 3, 1000.0),
        (3, Rect::new(35, 3, 64, 100), 8, 5e5),
        (1, Rect::new(100, 60, 1, 1), 1, 10.0),
    ] {
        let stride = SIZE.0 * channels + 5;
        let pixels: Vec<u8> = match channels {
            3 => picture(SIZE.0, SIZE.1, stride, 5),
            _ => picture(SIZE.0, SIZE.1, SIZE.0 * 3, 5)
                .chunks_exact(SIZE.0 * 3)
                .flat_map(|row| &row[..stride])
                .copied()
                .collect(),
        };
        let guide = View::with_stride(&pixels[..], SIZE.0, SIZE.1, channels, stride);
        let params = WlsParams { iterations, lambda, sigma_color: 12.0, ..WlsParams::default() };
        let rough = rough(part);
        let [x, y] = [part.x, part.y].map(|at| at / GRAIN_PX * GRAIN_PX);
        let [end_x, end_y] = [part.x + part.width, part.y + part.height].map(|at| at.next_multiple_of(GRAIN_PX));
        let roi = Rect::new(x, y, end_x - x, end_y - y).clamped(SIZE.0, SIZE.1);
        let expected = filtered(&params, guide, &rough, roi);
        let found = filtered_there(gpu, &params, guide, &rough);
        let mut unequal = 0;
        for (at, (found, expected)) in found[0].iter().zip(&expected[0]).enumerate() {
            let (x, y) = (at % SIZE.0, at / SIZE.0);
            // Support right at its limit may fall on either side.
            unequal += usize::from(found.is_nan() != expected.is_nan());
            let is_close = found.is_nan() || expected.is_nan() || (found - expected).abs() <= 0.01;
            assert!(is_close, "{found} and not {expected} at column {x}, row {y}");
            known += usize::from(expected.is_finite());
        }
        assert!(unequal <= 3, "{unequal} pixels are known on one side alone");
        let most = found[1].iter().zip(&expected[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(most < 1e-3, "confidence differs by {most}");
    }
    assert!(known > 30_000, "{known}");
}
