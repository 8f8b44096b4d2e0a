//! Tests of the whole compositor on synthetic images whose true panorama is known.

use super::*;
use crate::geometry::Homography;
use crate::{Parallel, Serial, Simd, View, ViewMut};
use panoscope_base::Threads;

/// Smooth tissue-like texture: value noise of four octaves, at world position (x, y).
fn world(x: f64, y: f64) -> [f64; 3] {
    let hash = |ix: i64, iy: i64, o: u64| {
        let mut h =
            (ix as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (iy as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F) ^ o;
        h = (h ^ h >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        h = (h ^ h >> 32).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((h ^ h >> 31) >> 40) as f64 / (1u64 << 24) as f64
    };
    let mut v = [110.0, 100.0, 150.0];
    for (octave, (size, strength)) in [(90.0, 60.0), (40.0, 40.0), (17.0, 26.0), (8.0, 16.0)].iter().enumerate() {
        let (u, w) = (x / size, y / size);
        let (iu, iw) = (u.floor() as i64, w.floor() as i64);
        let fade = |t: f64| t * t * (3.0 - 2.0 * t);
        let (fu, fw) = (fade(u - u.floor()), fade(w - w.floor()));
        for (c, value) in v.iter_mut().enumerate() {
            let at = |dx, dy| hash(iu + dx, iw + dy, (octave * 3 + c) as u64);
            let top = at(0, 0) * (1.0 - fu) + at(1, 0) * fu;
            let bottom = at(0, 1) * (1.0 - fu) + at(1, 1) * fu;
            *value += strength * (top * (1.0 - fw) + bottom * fw - 0.5);
        }
    }
    v
}

/// The image of a camera whose pixels `world_from_view` maps to world positions.
pub(super) fn shoot(world_from_view: &[f64; 9], width: usize, height: usize, gain: f64) -> Vec<u8> {
    let mut data = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let [wx, wy] = Homography(*world_from_view).map([x as f64, y as f64]);
            data.extend(world(wx, wy).map(|v| (v * gain + 0.5).clamp(0.0, 255.0) as u8));
        }
    }
    data
}

pub(super) const SIZE: (usize, usize) = (320, 240);

/// The second view lies 150 px to the right, turned and tilted a little.
pub(super) fn tilted() -> [f64; 9] {
    [1.02, 0.03, 150.0, -0.02, 0.99, 6.0, 4e-5, -3e-5, 1.0]
}

fn shifted(h: &[f64; 9], dx: f64, dy: f64) -> [f64; 9] {
    Homography::translation(dx, dy).product(&Homography(*h)).0
}

pub(super) struct Panorama {
    data: Vec<u8>,
    pub(super) mask: Vec<u8>,
    pub(super) report: CompositeReport,
}

impl Panorama {
    fn at(&self, x: usize, y: usize) -> [f64; 3] {
        let i = (y * self.report.canvas.width + x) * 3;
        std::array::from_fn(|c| f64::from(self.data[i + c]))
    }

    /// PSNR against the world where the mask is set and `inside` holds.
    pub(super) fn psnr(&self, inside: impl Fn(usize, usize) -> bool) -> f64 {
        let canvas = self.report.canvas;
        let (mut sum, mut count) = (0.0, 0);
        for y in 0..canvas.height {
            for x in 0..canvas.width {
                if self.mask[y * canvas.width + x] == 255 && inside(x, y) {
                    let truth = world(x as f64 - f64::from(canvas.left), y as f64 - f64::from(canvas.top));
                    for (a, b) in self.at(x, y).iter().zip(truth) {
                        sum += (a - b.round()).powi(2);
                        count += 1;
                    }
                }
            }
        }
        assert!(count > 0, "nothing to compare");
        10.0 * (255.0f64.powi(2) / (sum / f64::from(count)).max(1e-9)).log10()
    }
}

/// Mean structural similarity (Wang et al. 2004) of 8x8 blocks of the green channel, where `inside` holds.
fn ssim(p: &Panorama, inside: impl Fn(usize, usize) -> bool) -> f64 {
    let canvas = p.report.canvas;
    let (mut sum, mut blocks) = (0.0, 0.0);
    for y0 in (0..canvas.height - 8).step_by(4) {
        for x0 in (0..canvas.width - 8).step_by(4) {
            let mut pixels = (0..64).map(|i| (x0 + i % 8, y0 + i / 8));
            if !pixels.all(|(x, y)| inside(x, y) && p.mask[y * canvas.width + x] == 255) {
                continue;
            }
            let mut m = [0.0; 5];
            for (x, y) in (0..64).map(|i| (x0 + i % 8, y0 + i / 8)) {
                let a = p.at(x, y)[1];
                let b = world(x as f64 - f64::from(canvas.left), y as f64 - f64::from(canvas.top))[1];
                for (m, v) in m.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                    *m += v / 64.0;
                }
            }
            let (va, vb, cov) = (m[2] - m[0] * m[0], m[3] - m[1] * m[1], m[4] - m[0] * m[1]);
            let (c1, c2) = (6.5025, 58.5225);
            sum += (2.0 * m[0] * m[1] + c1) * (2.0 * cov + c2) / ((m[0] * m[0] + m[1] * m[1] + c1) * (va + vb + c2));
            blocks += 1.0;
        }
    }
    assert!(blocks > 50.0, "too few blocks");
    sum / blocks
}

pub(super) fn compose(
    c: &mut Compositor,
    views: &[&[u8]],
    h: &[[f64; 9]],
    state: GeometryState,
    pool: &dyn Parallel,
) -> Panorama {
    let views: Vec<View<u8>> = views.iter().map(|v| View::new(v, SIZE.0, SIZE.1, 3)).collect();
    let canvas = c.canvas(&views, h, state).unwrap();
    let mut data = vec![93u8; canvas.width * canvas.height * 3];
    let mut mask = vec![93u8; canvas.width * canvas.height];
    let report = c
        .compose(
            &views,
            h,
            state,
            pool,
            &mut ViewMut::new(&mut data, canvas.width, canvas.height, 3),
            Some(&mut ViewMut::new(&mut mask, canvas.width, canvas.height, 1)),
        )
        .unwrap();
    assert_eq!(report.canvas, canvas);
    Panorama { data, mask, report }
}

fn pair(gain: f64) -> (Vec<u8>, Vec<u8>, [[f64; 9]; 2]) {
    (shoot(&IDENTITY, SIZE.0, SIZE.1, 1.0), shoot(&tilted(), SIZE.0, SIZE.1, gain), [IDENTITY, tilted()])
}

fn all_methods() -> impl Iterator<Item = CompositeParams> {
    let seams = [SeamMethod::None, SeamMethod::DynamicProgramming, SeamMethod::GraphCut];
    let blends = [BlendMethod::None, BlendMethod::Feather, BlendMethod::MultiBand];
    seams.into_iter().flat_map(move |seam| {
        blends.into_iter().map(move |blend| CompositeParams { seam, blend, ..CompositeParams::default() })
    })
}

#[test]
fn two_views_of_one_world_give_back_the_world() {
    let (left, right, h) = pair(1.0);
    for params in all_methods().chain([CompositeParams { seam_scale: 1, ..CompositeParams::default() }]) {
        let name = format!("{:?} {:?} {}", params.seam, params.blend, params.seam_scale);
        let mut c = Compositor::new(params);
        let p = compose(&mut c, &[&left, &right], &h, GeometryState::Fresh, &Serial);
        let psnr = p.psnr(|_, _| true);
        assert!(psnr > 42.0, "{name}: {psnr:.1} dB");
        if let Some(z) = c.layers.steps[1].zone {
            let s = ssim(&p, |x, y| x >= z.x && x < z.x + z.width && y >= z.y && y < z.y + z.height);
            assert!(s > 0.99, "{name}: SSIM at the seam {s:.4}");
        }
        assert_eq!(p.report.state, GeometryState::Fresh);
    }
}

#[test]
fn the_reference_is_copied_and_outside_the_blend_zone_one_view_is_shown() {
    let (left, right, h) = pair(1.0);
    // Disturbing the right view must not reach the left part, nor the other way round.
    let ghost: Vec<u8> = right.iter().map(|v| v / 2).collect();
    let params = CompositeParams { exposure: ExposureMethod::None, seam_interval_frames: 1000, ..Default::default() };
    let mut c = Compositor::new(params);
    let a = compose(&mut c, &[&left, &right], &h, GeometryState::Fresh, &Serial);
    c.params.seam_cost_growth = 1e9;
    let b = compose(&mut c, &[&left, &ghost], &h, GeometryState::Fresh, &Serial);
    let z = c.layers.steps[1].zone.unwrap();
    let canvas = a.report.canvas;
    assert!(z.x > 20 && z.x + z.width < canvas.width - 20, "the zone fills the picture: {z:?}");
    for y in 0..canvas.height {
        for x in 0..z.x {
            let (sx, sy) = (x as i32 - canvas.left, y as i32 - canvas.top);
            if (0..SIZE.0 as i32).contains(&sx) && (0..SIZE.1 as i32).contains(&sy) {
                let i = (sy as usize * SIZE.0 + sx as usize) * 3;
                assert_eq!(a.at(x, y), b.at(x, y), "{x},{y}");
                assert_eq!(a.at(x, y), std::array::from_fn(|c| f64::from(left[i + c])));
            }
        }
    }
}

#[test]
fn warp_equals_a_slow_reference() {
    let (_, right, h) = pair(1.0);
    let inverse = Homography(h[1]).inverse_bounded().unwrap();
    let view = View::new(&right, SIZE.0, SIZE.1, 3);
    let mut block = warp::Block::default();
    let mut worst = 0.0f64;
    for (x0, y) in [(160, 20), (200, 100), (300, 200), (390, 120)] {
        let mut results = Vec::new();
        for avx2 in [false, Simd::detect().avx2()] {
            warp::locate(&inverse.0, x0, y, SIZE.0, SIZE.1, SIZE.0 * 3, 64, &mut block, avx2);
            let mut pixels = warp::Pixels::default();
            warp::sample(&view, &block, 64, &[16384, 12000, 20000, 0], &mut pixels, avx2);
            results.push(pixels.0);
        }
        assert_eq!(results[0], results[1], "portable and AVX2 differ");
        for i in 0..64 {
            let [u, v] = inverse.map([(x0 + i) as f64, y as f64]);
            if u < 0.0 || v < 0.0 || u > 318.0 || v > 238.0 {
                continue;
            }
            let (fu, fv) = (u - u.floor(), v - v.floor());
            let at = |dx: usize, dy: usize, c: usize| {
                f64::from(right[((v as usize + dy) * SIZE.0 + u as usize + dx) * 3 + c])
            };
            for (c, gain) in [1.0, 12000.0 / 16384.0, 20000.0 / 16384.0].into_iter().enumerate() {
                let top = at(0, 0, c) * (1.0 - fu) + at(1, 0, c) * fu;
                let bottom = at(0, 1, c) * (1.0 - fu) + at(1, 1, c) * fu;
                let truth = ((top * (1.0 - fv) + bottom * fv) * gain).min(255.0);
                worst = worst.max((f64::from(results[0][4 * i + c]) - truth).abs());
            }
        }
    }
    assert!(worst < 1.3, "largest error {worst}");
}

#[test]
fn an_exposure_difference_is_removed() {
    let (left, right, h) = pair(0.7);
    for exposure in [ExposureMethod::Gain, ExposureMethod::ChannelGain] {
        let mut c = Compositor::new(CompositeParams { exposure, ..Default::default() });
        let p = compose(&mut c, &[&left, &right], &h, GeometryState::Fresh, &Serial);
        assert!((p.report.gains[1][1] - 1.0 / 0.7).abs() < 0.02, "{:?}", p.report.gains[1]);
        let psnr = p.psnr(|_, _| true);
        assert!(psnr > 40.0, "{exposure:?}: {psnr:.1} dB");
    }
    let mut c = Compositor::new(CompositeParams { exposure: ExposureMethod::None, ..Default::default() });
    let p = compose(&mut c, &[&left, &right], &h, GeometryState::Fresh, &Serial);
    assert!(p.psnr(|_, _| true) < 30.0);
    // Without exposure compensation the blend still spreads the step: no jump between neighbours at the seam.
    let jump = |p: &Panorama| {
        let w = p.report.canvas.width;
        let z = c.layers.steps[1].zone.unwrap();
        let rows = 40..200;
        let n = rows.len() as f64;
        (z.x..z.x + z.width)
            .filter(|x| *x + 1 < w)
            .map(|x| rows.clone().map(|y| p.at(x + 1, y)[1] - p.at(x, y)[1]).sum::<f64>().abs() / n)
            .fold(0.0, f64::max)
    };
    assert!(jump(&p) < 6.0, "{}", jump(&p));
}

#[test]
fn the_canvas_never_jumps_while_the_homography_jitters() {
    let (left, right, h) = pair(1.0);
    let mut c = Compositor::new(CompositeParams::default());
    let views = [View::new(&left, SIZE.0, SIZE.1, 3), View::new(&right, SIZE.0, SIZE.1, 3)];
    let first = c.canvas(&views, &h, GeometryState::Fresh).unwrap();
    for i in 0..60 {
        let jitter = [h[0], shifted(&h[1], 10.0 * f64::from(i).sin(), 8.0 * (1.7 * f64::from(i)).cos())];
        assert_eq!(c.canvas(&views, &jitter, GeometryState::Fresh).unwrap(), first, "frame {i}");
    }
    // A single frame that leaves the canvas is clipped; a lasting move makes it grow, once.
    let far = [h[0], shifted(&h[1], 60.0, 0.0)];
    assert_eq!(c.canvas(&views, &far, GeometryState::Fresh).unwrap(), first);
    assert_eq!(c.canvas(&views, &h, GeometryState::Fresh).unwrap(), first);
    let mut sizes: Vec<Canvas> = (0..40)
        .map(|i| {
            let moved = [h[0], shifted(&h[1], 60.0 + 0.01 * f64::from(i), 0.0)];
            c.canvas(&views, &moved, GeometryState::Fresh).unwrap()
        })
        .collect();
    sizes.dedup();
    assert_eq!(sizes.len(), 2);
    assert!(sizes[1].width > first.width && sizes[1].left >= first.left);
}

#[test]
fn a_fixed_canvas_is_kept() {
    let (left, right, h) = pair(1.0);
    let mut c = Compositor::new(CompositeParams { canvas: Some((400, 200)), ..Default::default() });
    let p = compose(&mut c, &[&left, &right], &h, GeometryState::Fresh, &Serial);
    assert_eq!((p.report.canvas.width, p.report.canvas.height), (400, 200));
    assert!(p.psnr(|_, _| true) > 42.0);
}

#[test]
fn hostile_homographies_show_the_last_good_geometry_and_are_named() {
    let (left, right, h) = pair(1.0);
    let mut c = Compositor::new(CompositeParams::default());
    let good = compose(&mut c, &[&left, &right], &h, GeometryState::Fresh, &Serial);
    let bad: [([f64; 9], &str); 9] = [
        ([f64::NAN; 9], "finite"),
        ([f64::INFINITY, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "finite"),
        ([0.0; 9], "singular"),
        ([1.0, 2.0, 3.0, 2.0, 4.0, 6.0, 0.0, 0.0, 1.0], "singular"),
        ([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -0.01, 0.0, 1.0], "singular"),
        ([100.0, 0.0, 0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 1.0], "size"),
        ([1.0, 0.0, 9e3, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "size"),
        ([0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 1.0], "size"),
        ([-1.0, 0.0, 300.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "convex"),
    ];
    for (matrix, reason) in bad {
        let p = compose(&mut c, &[&left, &right], &[IDENTITY, matrix], GeometryState::Fresh, &Serial);
        assert_eq!(p.report.state, GeometryState::Lost);
        assert_eq!(p.report.canvas, good.report.canvas);
        let fault = p.report.fault.unwrap().to_string();
        assert!(fault.contains(reason), "{matrix:?}: {fault}");
        // The mark is there, and inside it the picture is the good one.
        assert_ne!(p.at(0, 0), good.at(0, 0));
        assert!(p.psnr(|x, y| x > 20 && y > 40 && x < 430 && y < 230) > 42.0);
    }
    let lost = compose(&mut c, &[&left, &right], &[IDENTITY; 2], GeometryState::Lost, &Serial);
    assert_eq!((lost.report.state, lost.report.fault), (GeometryState::Lost, None));
    let again = compose(&mut c, &[&left, &right], &h, GeometryState::Fresh, &Serial);
    assert_eq!(again.data, good.data);
}

#[test]
fn before_any_good_geometry_the_reference_view_is_shown() {
    let (left, right, h) = pair(1.0);
    let mut c = Compositor::new(CompositeParams { mark_lost: false, ..Default::default() });
    let p = compose(&mut c, &[&left, &right], &[IDENTITY, [f64::NAN; 9]], GeometryState::Fresh, &Serial);
    assert_eq!(p.report.state, GeometryState::Lost);
    assert!(p.psnr(|_, _| true) > 60.0);
    let p = compose(&mut c, &[&left, &right], &h, GeometryState::Fresh, &Serial);
    assert_eq!(p.report.state, GeometryState::Fresh);
    assert!(p.report.canvas.width > 450);
}

#[test]
fn wrong_calls_are_typed_errors() {
    let data = vec![0u8; 300];
    let view = View::new(&data, 10, 10, 3);
    let mut c = Compositor::new(CompositeParams::default());
    assert_eq!(c.canvas::<View<u8>>(&[], &[], GeometryState::Fresh), Err(CompositeError::ViewCount { views: 0 }));
    let e = c.canvas(&[view; 2], &[IDENTITY], GeometryState::Fresh);
    assert_eq!(e, Err(CompositeError::HomographyCount { views: 2, homographies: 1 }));
    for (w, h, channels) in [(0, 0, 3), (1, 1, 3), (10, 10, 1)] {
        let e = c.canvas(&[View::new(&data, w, h, channels)], &[IDENTITY], GeometryState::Fresh);
        assert_eq!(e, Err(CompositeError::View { view: 0, width: w, height: h, channels }));
    }
    let mut small = [0u8; 12];
    let e =
        c.compose(&[view], &[IDENTITY], GeometryState::Fresh, &Serial, &mut ViewMut::new(&mut small, 2, 2, 3), None);
    assert!(matches!(e, Err(CompositeError::Output { channels: 3, .. })));
}

#[test]
fn odd_sizes_do_not_fault() {
    for (w, h) in [(2, 2), (3, 5), (17, 9), (65, 2), (129, 33)] {
        let a = shoot(&IDENTITY, w, h, 1.0);
        let shift = shifted(&IDENTITY, w as f64 * 0.4 + 0.3, 0.2);
        let b = shoot(&shift, w, h, 0.9);
        for params in all_methods().flat_map(|p| [p.clone(), CompositeParams { seam_scale: 1, ..p }]) {
            let mut c = Compositor::new(params);
            let views = [View::new(&a, w, h, 3), View::new(&b, w, h, 3)];
            for _ in 0..2 {
                let canvas = c.canvas(&views, &[IDENTITY, shift], GeometryState::Fresh).unwrap();
                let mut out = vec![0; canvas.width * canvas.height * 3];
                let mut out = ViewMut::new(&mut out, canvas.width, canvas.height, 3);
                c.compose(&views, &[IDENTITY, shift], GeometryState::Fresh, &Serial, &mut out, None).unwrap();
            }
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let (left, right, h) = pair(0.8);
    let at_full_size = CompositeParams { seam_scale: 1, ..CompositeParams::default() };
    for params in all_methods().chain([at_full_size]) {
        let run = |pool: &dyn Parallel| {
            let mut c = Compositor::new(params.clone());
            let moved = [IDENTITY, shifted(&h[1], 0.7, -0.4)];
            compose(&mut c, &[&left, &right], &h, GeometryState::Fresh, pool);
            compose(&mut c, &[&left, &right], &moved, GeometryState::Fresh, pool).data
        };
        let one = run(&Serial);
        assert!(one == run(&Threads::new(2)) && one == run(&Threads::new(8)), "{:?} {:?}", params.seam, params.blend);
    }
}

#[test]
fn four_views_two_by_two() {
    let h = [
        IDENTITY,
        tilted(),
        shifted(&[0.99, -0.02, 0.0, 0.02, 1.01, 0.0, 0.0, 2e-5, 1.0], 6.0, 120.0),
        shifted(&[1.01, 0.01, 0.0, 0.01, 0.98, 0.0, -2e-5, 0.0, 1.0], 148.0, 125.0),
    ];
    let gains = [1.0, 0.85, 1.1, 0.9];
    let pictures: Vec<Vec<u8>> = h.iter().zip(gains).map(|(h, g)| shoot(h, SIZE.0, SIZE.1, g)).collect();
    let views: Vec<&[u8]> = pictures.iter().map(|p| p.as_slice()).collect();
    let p = compose(&mut Compositor::new(Default::default()), &views, &h, GeometryState::Fresh, &Threads::new(2));
    let psnr = p.psnr(|_, _| true);
    assert!(psnr > 38.0, "{psnr:.1} dB");
    let covered = p.mask.iter().filter(|m| **m == 255).count() as f64 / (SIZE.0 * SIZE.1) as f64;
    assert!(covered > 2.0, "field of view {covered:.2}");
}

#[test]
fn the_seam_avoids_what_differs_and_holds_still() {
    let (left, mut right, h) = pair(1.0);
    let inverse = Homography(h[1]).inverse_bounded().unwrap();
    // A foreign object in the right view only, in the middle of the overlap.
    let [ox, oy] = inverse.map([235.0, 120.0]);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            if (x as f64 - ox).hypot(y as f64 - oy) < 30.0 {
                right[(y * SIZE.0 + x) * 3..][..3].copy_from_slice(&[250, 10, 10]);
            }
        }
    }
    for seam in [SeamMethod::DynamicProgramming, SeamMethod::GraphCut] {
        let mut c = Compositor::new(CompositeParams { seam, seam_interval_frames: 1, ..Default::default() });
        let p = compose(&mut c, &[&left, &right], &h, GeometryState::Fresh, &Serial);
        assert!(p.report.seam_cost < 8.0, "{seam:?}: {}", p.report.seam_cost);
        let labels = c.layers.steps[1].labels.clone();
        // Noise must not move it.
        let mut state = 1u32;
        for _ in 0..5 {
            let mut noise = |v: &u8| {
                state = state.wrapping_mul(1664525).wrapping_add(1013904223);
                (i32::from(*v) + (state >> 24) as i32 % 9 - 4).clamp(0, 255) as u8
            };
            let (a, b): (Vec<u8>, Vec<u8>) =
                (left.iter().map(&mut noise).collect(), right.iter().map(&mut noise).collect());
            compose(&mut c, &[&a, &b], &h, GeometryState::Fresh, &Serial);
        }
        let changed = labels.iter().zip(&c.layers.steps[1].labels).filter(|(a, b)| a != b).count();
        assert!(changed * 50 < labels.len(), "{seam:?}: {changed} of {} cells changed", labels.len());
    }
}

#[test]
fn a_seam_at_full_size_finds_a_gap_that_a_shrunken_one_does_not() {
    let left = shoot(&IDENTITY, SIZE.0, SIZE.1, 1.0);
    let shift = shifted(&IDENTITY, 150.0, 0.0);
    let clean = shoot(&shift, SIZE.0, SIZE.1, 1.0);
    let at = |seam_scale| {
        let params = CompositeParams { seam_scale, exposure: ExposureMethod::None, ..Default::default() };
        let mut c = Compositor::new(params);
        let views = [&left, &clean].map(|v| View::new(v, SIZE.0, SIZE.1, 3));
        let canvas = c.canvas(&views, &[IDENTITY, shift], GeometryState::Fresh).unwrap();
        // The views agree in four columns alone, which no pair of cells of 2 px has for itself.
        let first = 80 + (canvas.left as usize + 150 + 80 + 1) % 2;
        let mut right = clean.clone();
        for (index, pixel) in right.chunks_exact_mut(3).enumerate() {
            let x = index % SIZE.0;
            if x < SIZE.0 - 150 && !(first..first + 4).contains(&x) {
                pixel.copy_from_slice(&[250, 10, 10]);
            }
        }
        compose(&mut c, &[&left, &right], &[IDENTITY, shift], GeometryState::Fresh, &Serial).report
    };
    let [full, half, tenth] = [1, 2, 10].map(|scale| at(scale).seam_cost);
    assert!(full < 2.0, "{full} levels at full size");
    assert!(half > 20.0 && tenth > 20.0, "{half} and {tenth} levels on shrunken overlaps");
}

#[test]
fn what_was_shown_before_leaves_no_trace() {
    // Neither hold nor running gain: the result may depend on this frame alone, whatever the work memory holds.
    let (left, right, h) = pair(0.9);
    let other: Vec<u8> = left.iter().map(|v| v.wrapping_mul(37)).collect();
    for params in all_methods() {
        let params = CompositeParams { seam_hold_levels: 0.0, seam_interval_frames: 1, exposure_rate: 1.0, ..params };
        let fixed = CompositeParams { canvas: Some((512, 272)), ..params };
        let mut used = Compositor::new(fixed.clone());
        // The first geometry places the canvas, so it is the same.
        for shift in [0.0, -9.0, 17.0] {
            let moved = [IDENTITY, shifted(&h[1], shift, -shift)];
            compose(&mut used, &[&other, &right], &moved, GeometryState::Fresh, &Serial);
        }
        let mut fresh = Compositor::new(fixed);
        let view = |c: &mut Compositor| compose(c, &[&left, &right], &h, GeometryState::Fresh, &Serial);
        let (a, b) = (view(&mut used), view(&mut fresh));
        assert_eq!(a.report.canvas, b.report.canvas);
        assert!(a.data == b.data, "{:?} {:?}", used.params.seam, used.params.blend);
    }
}
