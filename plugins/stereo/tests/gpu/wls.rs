//! Maps smoothed on the device are those of the processor to 0.01 px.

use panoscope_imaging::stereo::{FilterInput, SolveError, WlsFilter, WlsParams, WlsSolver};
use panoscope_imaging::{Rect, Serial, View, ViewMut};
use panoscope_stereo::gpu::wls::GpuWlsSolver;

use super::support::{device, picture};

const SIZE: (usize, usize) = (203, 121);

/// A slope with a step, holes and wrong matches.
fn rough() -> Vec<f32> {
    let value = |x: usize, y: usize| {
        let surface = 20.0 + x as f32 / 40.0 + if (60..140).contains(&x) && (30..90).contains(&y) { 9.0 } else { 0.0 };
        match (x * 7 + y * 13) % 11 {
            0 | 1 => f32::NAN,
            2 => surface + 3.0,
            _ => surface,
        }
    };
    (0..SIZE.0 * SIZE.1).map(|i| value(i % SIZE.0, i / SIZE.0)).collect()
}

/// Map and confidence of a filter.
fn filtered(params: &WlsParams, guide: View<'_, u8>, roi: Rect, solver: Option<Box<dyn WlsSolver>>) -> [Vec<f32>; 2] {
    let rough = rough();
    let mut filter = WlsFilter::new(params.clone()).expect("a filter");
    filter.set_solver(solver);
    let input = FilterInput {
        guide,
        disparity: View::new(&rough[..], SIZE.0, SIZE.1, 1),
        disparity_right: None,
        confidence: None,
        roi,
    };
    let mut out = [(); 2].map(|()| vec![0.0; SIZE.0 * SIZE.1]);
    let [map, confidence] = out.each_mut().map(|out| ViewMut::new(out, SIZE.0, SIZE.1, 1));
    filter.compute(input, &Serial, map, Some(confidence)).expect("filtered");
    assert_eq!(filter.take_solver_fault(), None);
    out
}

#[test]
fn a_map_is_smoothed_as_on_the_processor() {
    let Some(gpu) = device() else { return };
    let whole = Rect::whole(SIZE.0, SIZE.1);
    let mut known = 0;
    for (channels, roi, iterations, lambda) in [
        (3, whole, 3, 1000.0),
        (3, whole, 3, 200.0),
        (1, Rect::new(31, 17, 150, 80), 3, 1000.0),
        (3, Rect::new(5, 3, 64, 100), 8, 5e5),
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
        let expected = filtered(&params, guide, roi, None);
        let solver = GpuWlsSolver::new(gpu).expect("a solver");
        let found = filtered(&params, guide, roi, Some(Box::new(solver)));
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

#[derive(Debug)]
struct Broken;

impl WlsSolver for Broken {
    fn solve(
        &mut self,
        _: View<'_, u8>,
        _: Rect,
        _: &WlsParams,
        [product, support]: [&mut [f32]; 2],
    ) -> Result<(), SolveError> {
        product.fill(1.0);
        support.fill(1.0);
        Err("the device was lost".into())
    }
}

#[test]
fn the_processor_solves_what_a_device_fails_to_solve() {
    let pixels = picture(SIZE.0, SIZE.1, SIZE.0 * 3, 5);
    let guide = View::new(&pixels[..], SIZE.0, SIZE.1, 3);
    let whole = Rect::whole(SIZE.0, SIZE.1);
    let [expected, _] = filtered(&WlsParams::default(), guide, whole, None);
    let rough = rough();
    let mut filter = WlsFilter::new(WlsParams::default()).expect("a filter");
    filter.set_solver(Some(Box::new(Broken)));
    let disparity = View::new(&rough[..], SIZE.0, SIZE.1, 1);
    let input = FilterInput { guide, disparity, disparity_right: None, confidence: None, roi: whole };
    let mut map = vec![0.0; SIZE.0 * SIZE.1];
    filter.compute(input, &Serial, ViewMut::new(&mut map, SIZE.0, SIZE.1, 1), None).expect("filtered");
    assert!(map.iter().zip(&expected).all(|(a, b)| a.to_bits() == b.to_bits()));
    assert_eq!(filter.take_solver_fault().as_deref(), Some("the device was lost"));
    assert!(!filter.has_solver() && filter.take_solver_fault().is_none());
}
