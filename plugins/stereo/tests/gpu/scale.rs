//! Images shrunk on the device have the bytes of the processor, and maps the same values.

use panoscope_imaging::features::{GrayBuffer, shrink_gray};
use panoscope_imaging::{Serial, View};
use panoscope_stereo::gpu::scale::{Scaler, Scaling};

use super::support::{Held, device, picture};

const SIZE: (usize, usize) = (155, 61);

#[test]
fn shrunk_images_are_those_of_the_processor() {
    let Some(gpu) = device() else { return };
    let mut scaler = Scaler::new(gpu).expect("a scaler");
    let stride = 3 * SIZE.0 + 7;
    let pixels = picture(SIZE.0, SIZE.1, stride, 3);
    for (pixel_bytes, factor) in [1, 3].into_iter().flat_map(|bytes| (2..=8).map(move |factor| (bytes, factor))) {
        let mut expected = GrayBuffer::new();
        shrink_gray(View::with_stride(&pixels, SIZE.0, SIZE.1, pixel_bytes, stride), factor, &mut expected, &Serial);
        let small = (SIZE.0 / factor, SIZE.1 / factor);
        let [from, to] = [Held::of(gpu, &pixels, SIZE.0, SIZE.1, stride), Held::new(gpu, small.0, small.1, 1)];
        scaler.run(factor, &[(Scaling::Shrink { pixel_bytes }, from.image, to.image)]).expect("shrunk");
        assert!(to.rows(gpu, small.0) == expected.view().data, "{pixel_bytes} bytes, by {factor}");
    }
}

/// A map of `size`, without padding, made of one of `from_size` by a factor.
fn made(
    scaling: Scaling,
    values: &[f32],
    from_size: (usize, usize),
    size: (usize, usize),
    factor: usize,
) -> Option<Vec<f32>> {
    let gpu = device()?;
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let (from, to) =
        (Held::of(gpu, &bytes, from_size.0, from_size.1, 4 * from_size.0), Held::new(gpu, size.0, size.1, 4));
    Scaler::new(gpu).expect("a scaler").run(factor, &[(scaling, from.image, to.image)]).expect("made");
    Some(to.rows(gpu, 4 * size.0).as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
}

#[test]
fn blocks_are_sampled_and_repeated() {
    for factor in 2..=8 {
        let small = (SIZE.0 / factor, SIZE.1 / factor);
        let value = |i: usize| if i.is_multiple_of(13) { f32::NAN } else { i as f32 / 7.0 };
        let map: Vec<f32> = (0..SIZE.0 * SIZE.1).map(value).collect();
        let times = 1.0 / factor as f32;
        let Some(found) = made(Scaling::Sample { times }, &map, SIZE, small, factor) else { return };
        for (i, found) in found.iter().enumerate() {
            let (x, y) = (i % small.0 * factor + factor / 2, i / small.0 * factor + factor / 2);
            assert_eq!(found.to_bits(), (map[y * SIZE.0 + x] * times).to_bits(), "{x}, {y} by {factor}");
        }
        let Some(repeated) = made(Scaling::Repeat { times: factor as f32 }, &found, small, SIZE, factor) else {
            return;
        };
        for (i, repeated) in repeated.iter().enumerate() {
            let (x, y) = (i % SIZE.0 / factor, i / SIZE.0 / factor);
            let is_block = x < small.0 && y < small.1;
            let expected = if is_block { found[y * small.0 + x] * factor as f32 } else { f32::NAN };
            assert_eq!(repeated.to_bits(), expected.to_bits(), "block {x}, {y} by {factor}");
        }
    }
}

#[test]
fn slopes_stay_straight_and_steps_stay_steps() {
    // A slope of a quarter px per px, 40 px more from the middle on, and an unknown block.
    let (small, size) = ((32, 6), (97, 19));
    let slope = |x: f32| 10.0 + 0.25 * x + if x < 48.0 { 0.0 } else { 40.0 };
    let value = |i: usize| if i == 2 * 32 + 5 { f32::NAN } else { slope(3.0 * (i % 32) as f32 + 1.0) / 3.0 };
    let given: Vec<f32> = (0..small.0 * small.1).map(value).collect();
    let Some(map) = made(Scaling::Enlarge { times: 3.0, max_step: 1.0 }, &given, small, size, 3) else { return };
    for (x, y) in (0..19).flat_map(|y| (1..95).map(move |x| (x, y))) {
        let found = map[y * 97 + x];
        let is_near_unknown = (14..19).contains(&x) && (5..10).contains(&y);
        // The two pixels next to the step take the value of their block.
        let limit = if (47..=48).contains(&x) || is_near_unknown { 0.26 } else { 1e-3 };
        let is_unknown = (15..18).contains(&x) && (6..9).contains(&y);
        assert!(if is_unknown { found.is_nan() } else { (found - slope(x as f32)).abs() < limit }, "{x}, {y}: {found}");
    }
}
