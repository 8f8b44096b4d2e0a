//! Tests of the mosaic on scenes with known positions.

use super::*;
use crate::features::testing::{noise, similarity};
use crate::geometry::{Homography, Point};
use crate::{Serial, View, ViewMut};
use panoscope_base::Threads;

const SIZE: (usize, usize) = (320, 240);
/// Barrel distortion of the test camera: which makes every chain of frames drift.
const BARREL: f64 = 0.012;

/// What a camera sees, its lens distorted by `barrel` at the ends of the image's longer side.
fn frame(scene_from_image: &Homography, barrel: f64) -> Vec<u8> {
    let (cx, cy) = ((SIZE.0 as f64 - 1.0) / 2.0, (SIZE.1 as f64 - 1.0) / 2.0);
    let mut bgr = Vec::with_capacity(SIZE.0 * SIZE.1 * 3);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (dx, dy) = (x as f64 - cx, y as f64 - cy);
            // Stronger on the right, so that all steps of a chain err the same way.
            let grow = 1.0 + barrel * (dx * dx + dy * dy) / (cx * cx) * (1.0 + 0.5 * dx / cx);
            let [sx, sy] = scene_from_image.map([cx + dx * grow, cy + dy * grow]);
            let gray = noise(sx, sy).round() as u8;
            bgr.extend([gray, gray, gray]);
        }
    }
    bgr
}

fn small() -> MosaicParams {
    MosaicParams { shrink: 1, width: 480, height: 360, max_keyframes: 80, ..MosaicParams::default() }
}

fn add(mosaic: &mut Mosaic, place: &Homography, barrel: f64) -> MosaicReport {
    let bgr = frame(place, barrel);
    mosaic.add(View::new(&bgr, SIZE.0, SIZE.1, 3), &Serial).unwrap()
}

/// The camera on a ring, back where it began after `steps`.
fn on_ring(step: usize, steps: usize, radius: f64) -> Homography {
    let turn = step as f64 / steps as f64 * std::f64::consts::TAU;
    Homography::translation(radius * (1.0 - turn.cos()), radius * turn.sin())
}

/// Root mean square distance of a 3x3 grid of the frame's points between two maps.
fn off_px(a: &Homography, b: &Homography) -> f64 {
    let point = |i: usize| -> Point {
        [(i % 3) as f64 / 2.0 * (SIZE.0 as f64 - 1.0), (i / 3) as f64 / 2.0 * (SIZE.1 as f64 - 1.0)]
    };
    ((0..9).map(|i| a.squared_error(point(i), b.map(point(i)))).sum::<f64>() / 9.0).sqrt()
}

fn ring(loop_closure: bool, steps: usize, radius: f64) -> (Mosaic, MosaicReport, f64) {
    let mut mosaic = Mosaic::new(MosaicParams { loop_closure, ..small() });
    let mut last = MosaicReport::default();
    for step in 0..=steps {
        last = add(&mut mosaic, &on_ring(step, steps, radius), BARREL);
        assert_eq!(last.state, MosaicState::Fresh, "step {step}");
    }
    // The first frame lies at the scene's origin: what is true of the mosaic is the camera's position.
    let off = off_px(&last.mosaic_from_frame, &on_ring(steps, steps, radius));
    (mosaic, last, off)
}

#[test]
fn a_closed_loop_takes_the_drift_away() {
    let (_, open, open_px) = ring(false, 90, 260.0);
    let (_, closed, closed_px) = ring(true, 90, 260.0);
    assert!(open_px > 6.0, "the chain drifts: {open_px} px");
    assert!(closed_px < 1.0, "{closed_px} px with a closed loop, {open_px} px without");
    assert_eq!(open.closures, 0);
    assert!(closed.closures >= 1 && closed.redraws >= 2, "{closed:?}");
    // What the mosaic says of its own drift is what it was.
    assert!((0.4..2.5).contains(&(closed.drift_px / open_px)), "{} {open_px}", closed.drift_px);
    assert!(open.drift_px.is_nan());
}

#[test]
fn every_model_closes_the_loop_and_the_error_is_spread_over_it() {
    for model in [MosaicModel::Homography, MosaicModel::Affine, MosaicModel::Similarity] {
        let mut mosaic = Mosaic::new(MosaicParams { model, ..small() });
        let (steps, radius) = (90, 260.0);
        let mut report = MosaicReport::default();
        // Half a lap more than one: the frames now lie on keyframes of the first lap, where drift was largest.
        let mut worst: f64 = 0.0;
        for step in 0..=steps * 3 / 2 {
            report = add(&mut mosaic, &on_ring(step, steps, radius), BARREL);
            if step > steps {
                worst = worst.max(off_px(&report.mosaic_from_frame, &on_ring(step, steps, radius)));
            }
        }
        assert!(report.closures >= 1, "{model:?}: {report:?}");
        assert!(worst < 25.0, "{model:?}: {worst} px");
        let held = report.keyframes;
        // The second lap lies on the keyframes of the first one.
        assert!(held < 40, "{model:?}: {held} keyframes");
    }
}

#[test]
fn the_picture_shows_the_scene_where_it_is() {
    let mut mosaic = Mosaic::new(small());
    let mut report = MosaicReport::default();
    for step in 0..=60 {
        report = add(&mut mosaic, &on_ring(step, 60, 120.0), 0.0);
    }
    let (width, height) = (small().width, small().height);
    let mut bgr = vec![7; width * height * 3];
    mosaic.draw(&mut ViewMut::new(&mut bgr, width, height, 3), &Serial).unwrap();
    let back = report.picture_from_mosaic.inverse().unwrap();
    let (mut count, mut squares) = (0, 0.0);
    for y in (0..height).step_by(3) {
        for x in (0..width).step_by(3) {
            let pixel = &bgr[(y * width + x) * 3..][..3];
            let [sx, sy] = back.map([x as f64, y as f64]);
            // Well inside what was seen, and away from the drawn border of the newest frame.
            let centre = [119.5 + 40.0, 120.0];
            let away = (sx - centre[0] - 120.0).hypot(sy - centre[1]);
            if (60.0..150.0).contains(&away) && sx > 340.0 {
                count += 1;
                squares += (f64::from(pixel[0]) - noise(sx, sy)).powi(2);
            }
            if away > 420.0 {
                assert_eq!(pixel, [0, 0, 0], "nothing was seen at {sx}, {sy}");
            }
        }
    }
    let rms = (squares / f64::from(count)).sqrt();
    assert!(count > 300 && rms < 8.0, "{rms} gray levels over {count} pixels");
}

/// A round scope: nothing of its rim is shown, and what is at rest does not hold the mosaic.
#[test]
fn the_rim_of_a_scope_is_not_shown() {
    let mut mosaic = Mosaic::new(small());
    let mut report = MosaicReport::default();
    let radius = 125.0;
    for step in 0..=60 {
        let place = on_ring(step, 60, 60.0);
        let mut bgr = frame(&place, 0.0);
        for (index, pixel) in bgr.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let (x, y) = ((index % SIZE.0) as f64 - 159.5, (index / SIZE.0) as f64 - 119.5);
            if x.hypot(y) > radius {
                *pixel = [6; 3];
            }
        }
        report = mosaic.add(View::new(&bgr, SIZE.0, SIZE.1, 3), &Serial).unwrap();
        assert_eq!(report.state, MosaicState::Fresh, "step {step}");
        assert!(off_px(&report.mosaic_from_frame, &place) < 1.5, "step {step}");
    }
    let (width, height) = (small().width, small().height);
    let mut bgr = vec![7; width * height * 3];
    mosaic.draw(&mut ViewMut::new(&mut bgr, width, height, 3), &Serial).unwrap();
    let back = report.picture_from_mosaic.inverse().unwrap();
    let (mut seen, mut dark, mut squares) = (0, 0, 0.0);
    for y in (0..height).step_by(2) {
        for x in (0..width).step_by(2) {
            let pixel = &bgr[(y * width + x) * 3..][..3];
            let [sx, sy] = back.map([x as f64, y as f64]);
            let level = noise(sx, sy);
            // The middles of the frames lie on a circle; away from the drawn border of the newest frame.
            let away = (sx - 159.5 - 60.0).hypot(sy - 119.5);
            let is_border = ((sx - 159.5).hypot(sy - 119.5) - radius).abs() < 14.0;
            if pixel != [0; 3] && !is_border {
                seen += 1;
                dark += usize::from(f64::from(pixel[0]) < level - 40.0);
                squares += (f64::from(pixel[0]) - level).powi(2);
            }
            if away < radius + 15.0 && (sy - 119.5).abs() < 90.0 {
                assert_ne!(pixel, [0, 0, 0], "{sx}, {sy} was seen");
            }
        }
    }
    let rms = (squares / f64::from(seen)).sqrt();
    assert!(seen > 5000 && dark == 0 && rms < 10.0, "{dark} of {seen} pixels are dark, {rms} gray levels");
    // Discs of 125 px around a ring of 60 px cover about twice the area of one.
    assert!((170.0..230.0).contains(&report.coverage_pct), "{}", report.coverage_pct);
}

#[test]
fn coverage_is_the_area_that_was_seen() {
    let mut mosaic = Mosaic::new(small());
    assert!((add(&mut mosaic, &Homography::identity(), 0.0).coverage_pct - 100.0).abs() < 1e-6);
    let mut report = MosaicReport::default();
    for step in 1..=40 {
        report = add(&mut mosaic, &Homography::translation(f64::from(step) * 8.0, 0.0), 0.0);
    }
    // Up to the last keyframe, which shares at least 70 % with the newest frame.
    assert!((165.0..=202.0).contains(&report.coverage_pct), "{}", report.coverage_pct);
    // Back again: nothing new.
    let seen = report.coverage_pct;
    for step in (0..40).rev() {
        report = add(&mut mosaic, &Homography::translation(f64::from(step) * 8.0, 0.0), 0.0);
    }
    assert!((report.coverage_pct - seen).abs() < 2.0, "{} after {seen}", report.coverage_pct);
}

#[test]
fn a_lost_camera_changes_nothing_and_is_found_again() {
    let mut mosaic = Mosaic::new(small());
    let path = |step: i32| Homography::translation(f64::from(step) * 9.0, 0.0);
    let mut good = MosaicReport::default();
    for step in 0..40 {
        good = add(&mut mosaic, &path(step), 0.0);
    }
    let poses: Vec<Homography> = mosaic.poses().collect();
    let gray = vec![128; SIZE.0 * SIZE.1 * 3];
    let mut lost = good;
    for _ in 0..6 {
        lost = mosaic.add(View::new(&gray, SIZE.0, SIZE.1, 3), &Serial).unwrap();
        assert_eq!(lost.state, MosaicState::Lost);
        assert_eq!((lost.inliers, lost.keyframes, lost.coverage_pct), (0, good.keyframes, good.coverage_pct));
    }
    assert_eq!(lost.lost_frames, 6);
    // Elsewhere on the scene, where it never was: still lost, and nothing is pasted.
    let elsewhere = add(&mut mosaic, &Homography::translation(9000.0, 5000.0), 0.0);
    assert_eq!((elsewhere.state, elsewhere.keyframes), (MosaicState::Lost, good.keyframes));
    assert!(mosaic.poses().eq(poses));
    let (width, height) = (small().width, small().height);
    let mut marked = vec![0; width * height * 3];
    mosaic.draw(&mut ViewMut::new(&mut marked, width, height, 3), &Serial).unwrap();
    assert_eq!(marked[..3], [40, 40, 230], "the border says that the camera is lost");
    // Near the start, turned: found by comparing with all keyframes in turn.
    let place = path(4).compose(&similarity(0.3, 1.0, 160.0, 120.0, 0.0, 0.0));
    let mut found = MosaicReport::default();
    for _ in 0..6 {
        found = add(&mut mosaic, &place, 0.0);
        if found.state == MosaicState::Fresh {
            break;
        }
    }
    assert_eq!((found.state, found.relocalised), (MosaicState::Fresh, 1));
    assert!(off_px(&found.mosaic_from_frame, &place) < 1.5, "{}", off_px(&found.mosaic_from_frame, &place));
}

#[test]
fn a_frame_that_is_hardly_recognised_becomes_a_keyframe_before_the_camera_is_lost() {
    // Upright features of a camera that turns: the overlap with the first frame stays large, the matches go.
    let default = small();
    let surf = crate::features::SurfParams { upright: true, ..default.surf };
    let mut mosaic = Mosaic::new(MosaicParams { keyframe_overlap: 0.3, surf, ..default });
    for step in 0..45 {
        let pose = similarity(f64::from(step) * 0.035, 1.0, 160.0, 120.0, 0.0, 0.0);
        let report = add(&mut mosaic, &pose, 0.0);
        assert_eq!(report.state, MosaicState::Fresh, "step {step}: {report:?}");
        let off = off_px(&report.mosaic_from_frame, &pose);
        assert!(off < 2.0, "step {step}: {off} px");
    }
}

#[test]
fn frames_of_something_else_are_not_pasted() {
    let mut mosaic = Mosaic::new(small());
    add(&mut mosaic, &Homography::identity(), 0.0);
    let mut pasted = 0;
    for step in 1..30 {
        let far = Homography::translation(f64::from(step) * 4000.0, f64::from(step) * -7000.0);
        pasted += i32::from(add(&mut mosaic, &far, 0.0).state == MosaicState::Fresh);
    }
    assert_eq!(pasted, 0);
}

#[test]
fn an_instrument_that_moves_with_the_camera_does_not_hold_it() {
    // A textured bar at the picture's border, the same in every frame, over a scene without texture.
    let bar = frame(&Homography::identity(), 0.0);
    let mut mosaic = Mosaic::new(small());
    let mut only_bar = vec![90; SIZE.0 * SIZE.1 * 3];
    for y in 0..SIZE.1 {
        let row = y * SIZE.0 * 3;
        only_bar[row..row + 36 * 3].copy_from_slice(&bar[row..row + 36 * 3]);
    }
    add(&mut mosaic, &Homography::identity(), 0.0);
    let report = mosaic.add(View::new(&only_bar, SIZE.0, SIZE.1, 3), &Serial).unwrap();
    assert_eq!(report.state, MosaicState::Lost, "{report:?}");
}

#[test]
fn the_oldest_keyframes_make_room_and_are_counted() {
    let max_keyframes = 4;
    let mut mosaic = Mosaic::new(MosaicParams { max_keyframes, ..small() });
    let mut report = MosaicReport::default();
    let mut newest_dropped = 0;
    for step in 0..120 {
        let place = Homography::translation(f64::from(step) * 9.0, 0.0);
        report = add(&mut mosaic, &place, 0.0);
        assert_eq!(report.state, MosaicState::Fresh, "{step}");
        assert!(report.keyframes <= max_keyframes && report.dropped >= newest_dropped);
        newest_dropped = report.dropped;
    }
    assert!(report.dropped >= 5, "{report:?}");
    // The oldest went: what is left lies around the newest frame.
    let oldest = mosaic.poses().next().unwrap().map([0.0, 0.0])[0];
    assert!(oldest > 500.0, "{oldest}");
    assert!(report.coverage_pct < 250.0, "{}", report.coverage_pct);
    // What was dropped is gone from the picture too: it shows no more than the keyframes and the newest frame.
    let (width, height) = (small().width, small().height);
    let mut bgr = vec![0; width * height * 3];
    mosaic.draw(&mut ViewMut::new(&mut bgr, width, height, 3), &Serial).unwrap();
    let scale = report.picture_from_mosaic.0[0];
    let shown = bgr.chunks_exact(3).filter(|p| p.iter().any(|v| *v != 0)).count() as f64;
    let frames = shown / (scale * scale * (SIZE.0 * SIZE.1) as f64);
    assert!(frames < report.coverage_pct / 100.0 + 0.35, "{frames} frames are shown, {} % kept", report.coverage_pct);
}

#[test]
fn fewer_keyframes_allowed_later_drop_the_oldest() {
    let mut mosaic = Mosaic::new(small());
    for step in 0..60 {
        add(&mut mosaic, &Homography::translation(f64::from(step) * 9.0, 0.0), 0.0);
    }
    mosaic.set_params(MosaicParams { max_keyframes: 2, ..small() }, &Serial);
    let report = add(&mut mosaic, &Homography::translation(540.0, 0.0), 0.0);
    assert!(report.keyframes == 2 && report.dropped >= 2, "{report:?}");
    mosaic.reset();
    assert_eq!(mosaic.poses().count(), 0);
}

#[test]
fn threads_do_not_change_the_mosaic() {
    let run = |pool: &dyn crate::Parallel| {
        let mut mosaic = Mosaic::new(small());
        let mut reports = Vec::new();
        for step in 0..30 {
            let bgr = frame(&on_ring(step, 90, 260.0), BARREL);
            reports.push(mosaic.add(View::new(&bgr, SIZE.0, SIZE.1, 3), pool).unwrap().mosaic_from_frame);
        }
        let (width, height) = (small().width, small().height);
        let mut bgr = vec![0; width * height * 3];
        mosaic.draw(&mut ViewMut::new(&mut bgr, width, height, 3), pool).unwrap();
        (reports, bgr)
    };
    assert!(run(&Serial) == run(&Threads::new(3)));
}

#[test]
fn frames_that_do_not_fit_are_named() {
    let mut mosaic = Mosaic::new(small());
    let gray = vec![0; 64 * 64];
    let wrong = mosaic.add(View::new(&gray, 64, 64, 1), &Serial);
    assert_eq!(wrong, Err(MosaicError::Channels { channels: 1 }));
    assert!(matches!(mosaic.add(View::new(&gray, 20, 20, 3), &Serial), Err(MosaicError::TooSmall { .. })));
    add(&mut mosaic, &Homography::identity(), 0.0);
    let other = vec![0; 100 * 80 * 3];
    let error = mosaic.add(View::new(&other, 100, 80, 3), &Serial).unwrap_err();
    assert!(error.to_string().contains("100x80") && error.to_string().contains("320x240"), "{error}");
    // What was there is still there.
    assert_eq!(add(&mut mosaic, &Homography::translation(5.0, 0.0), 0.0).state, MosaicState::Fresh);
}
