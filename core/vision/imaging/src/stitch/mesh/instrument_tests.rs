//! Tests of instruments in front of tissue: each is whole, straight, and steady.

use super::super::{CompositeParams, Compositor, GeometryState, IDENTITY, SeamMethod};
use super::*;
use crate::geometry::Homography;
use crate::stereo::Lens;
use crate::stitch::RectifiedView;
use crate::{Serial, View, ViewMut};

const SIZE: (usize, usize) = (640, 480);
/// Disparity of the plane through the tissue, px.
const PLANE_PX: f64 = 232.0;
/// Disparity of the instruments, px: 26 to 65 before the tissue.
const TOOL_PX: f64 = 285.0;

fn camera() -> RectifiedView {
    RectifiedView {
        size: SIZE,
        focal_px: [750.0; 2],
        centre_px: [319.5, 239.5],
        lens: Lens::NONE,
        rectified_from_camera: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        rectified_focal_px: [750.0; 2],
        rectified_centre_px: [319.5, 239.5],
    }
}

/// Disparity of curved tissue.
fn hills(x: f64, y: f64) -> f64 {
    220.0 + x / 40.0 + 12.0 * (x / 80.0).sin() * (y / 60.0).cos()
}

/// A slanted shaft in the left view's plane: from the right, with its tip at `tip`, or from the left.
#[derive(Clone, Copy)]
struct Shaft {
    tip: f64,
    is_from_right: bool,
}

const FROM_RIGHT: Shaft = Shaft { tip: 430.0, is_from_right: true };

impl Shaft {
    fn middle(x: f64) -> f64 {
        230.0 + 0.2 * (x - 430.0)
    }

    fn covers(self, x: f64, y: f64) -> bool {
        let is_along = if self.is_from_right { x > self.tip } else { x < self.tip };
        is_along && (y - Self::middle(x)).abs() < 25.0
    }
}

/// Disparity map of tissue behind an instrument of which half is unmatched.
fn map(covers: impl Fn(f64, f64) -> bool, tool_px: impl Fn(f64, f64) -> f64) -> Vec<f32> {
    let mut map = vec![f32::NAN; SIZE.0 * SIZE.1];
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (u, v) = (x as f64, y as f64);
            let is_tool = covers(u, v);
            let d = if is_tool { tool_px(u, v) } else { hills(u, v) };
            // The right view hides this tissue behind the instrument.
            let is_hidden = !is_tool
                && (1..60).any(|step| {
                    let near = u + f64::from(step);
                    covers(near, v) && tool_px(near, v) - d >= f64::from(step)
                });
            let is_matched = !is_tool || (x / 12 + y / 12) % 2 == 0;
            if d <= u && is_matched && !is_hidden {
                map[y * SIZE.0 + x] = d as f32;
            }
        }
    }
    map
}

fn shaft_map(shaft: Shaft) -> Vec<f32> {
    map(|x, y| shaft.covers(x, y), |_, _| TOOL_PX)
}

fn update(follower: &mut MeshFollower, map: &[f32]) {
    update_by(follower, map, PLANE_PX);
}

/// Updates with a homography that displaces the right view by `plane_px`.
fn update_by(follower: &mut MeshFollower, map: &[f32], plane_px: f64) {
    let plane = Homography::translation(plane_px, 0.0);
    let report = follower.update(View::new(map, SIZE.0, SIZE.1, 1), &camera(), &camera(), &plane, &Serial);
    assert!(!report.is_held, "{report:?}");
}

fn follower(keeps_instruments: bool) -> MeshFollower {
    MeshFollower::new(MeshParams { keeps_instruments, ..MeshParams::default() })
}

/// How far the mesh draws a point of the right view to the right of where it is there, px.
fn drawn_px(mesh: &Mesh, [u, v]: Point) -> f64 {
    let mut x = u + PLANE_PX;
    for _ in 0..60 {
        x += 0.5 * (u - mesh.map([x, v]).expect("inside the mesh")[0]);
    }
    x - u
}

/// Position at which the mesh draws a point of the right view.
fn drawn_at(mesh: &Mesh, [u, v]: Point) -> Point {
    let mut at = [u + PLANE_PX, v];
    for _ in 0..60 {
        let [x, y] = mesh.map(at).expect("inside the mesh");
        at = [at[0] + 0.5 * (u - x), at[1] + 0.5 * (v - y)];
    }
    at
}

/// Maximum distances of a shaft's image in the right view from the shaft in the left one: vertically from the same line of the shaft, and
/// horizontally from where the plane has it.
fn step(mesh: &Mesh, columns: std::ops::Range<i32>) -> [f64; 2] {
    let lines = columns.step_by(12).flat_map(|u| [-25.0, 0.0, 25.0].map(|off| (f64::from(u), off)));
    lines.fold([0.0; 2], |[step, moved]: [f64; 2], (u, off)| {
        let [x, y] = drawn_at(mesh, [u, Shaft::middle(u + TOOL_PX) + off]);
        [step.max((y - Shaft::middle(x) - off).abs()), moved.max((x - u - PLANE_PX).abs())]
    })
}

/// Smallest and largest displacement of the edges of a shaft whose image in the right view ends at column `end`.
fn bend(mesh: &Mesh, shaft: Shaft, columns: std::ops::Range<i32>) -> [f64; 2] {
    let of = |u: f64| [-25.0, 0.0, 25.0].map(|off| drawn_px(mesh, [u, Shaft::middle(u + TOOL_PX) + off]));
    assert!(shaft.is_from_right);
    let all = columns.step_by(12).flat_map(|u| of(f64::from(u)));
    all.fold([f64::MAX, f64::MIN], |[low, high], px| [low.min(px), high.max(px)])
}

#[test]
fn an_instrument_is_not_bent_also_beyond_the_border() {
    // In the right view from the tip on; the left view's border cuts it off at column 355.
    let columns = (FROM_RIGHT.tip - TOOL_PX) as i32..540;
    let bent = [true, false].map(|keeps| {
        let mut follower = follower(keeps);
        for _ in 0..6 {
            update(&mut follower, &shaft_map(FROM_RIGHT));
        }
        let [low, high] = bend(follower.mesh().expect("a mesh"), FROM_RIGHT, columns.clone());
        high - low
    });
    assert!(bent[0] < 0.5, "{} px", bent[0]);
    assert!(bent[1] > 5.0, "{} px when nothing is done about it", bent[1]);
}

#[test]
fn the_tissue_beside_an_instrument_is_followed_by_both_views() {
    let mut follower = follower(true);
    for _ in 0..6 {
        update(&mut follower, &shaft_map(FROM_RIGHT));
    }
    let (mesh, reference) = (follower.mesh().expect("a mesh"), follower.reference_mesh().expect("a mesh"));
    for at in [[330.0, 100.0], [340.0, 210.0], [350.0, 330.0], [420.0, 400.0], [300.0, 230.0]] {
        let (left, right) = (reference.map(at).expect("inside"), mesh.map(at).expect("inside"));
        let error = right[0] - (left[0] - hills(left[0], left[1]));
        assert!(error.abs() < 0.7, "{error} px at {at:?}");
    }
}

/// View that the panorama shows at each pixel of the plane of the left view.
struct Shown {
    pixels: Vec<u8>,
    width: usize,
    left: i32,
    top: i32,
}

impl Shown {
    fn at(&self, x: f64, y: f64) -> u8 {
        let (u, v) = (x.round() as i32 + self.left, y.round() as i32 + self.top);
        self.pixels[v as usize * self.width + u as usize]
    }
}

fn tissue(x: f64, y: f64) -> [u8; 3] {
    let wave = 40.0 * (x / 9.0).sin() * (y / 11.0).cos();
    [80.0 + wave, 90.0 + wave, 170.0 + wave].map(|v| v as u8)
}

fn pictures(shaft: Shaft) -> [Vec<u8>; 2] {
    let left = |i: usize| {
        let (x, y) = ((i % SIZE.0) as f64, (i / SIZE.0) as f64);
        if shaft.covers(x, y) { [120; 3] } else { tissue(x, y) }
    };
    let right = |i: usize| {
        let (u, v) = ((i % SIZE.0) as f64, (i / SIZE.0) as f64);
        let x = (0..40).fold(u + PLANE_PX, |x, _| u + hills(x, v));
        if shaft.covers(u + TOOL_PX, v) { [120; 3] } else { tissue(x, v) }
    };
    [(0..SIZE.0 * SIZE.1).flat_map(left).collect(), (0..SIZE.0 * SIZE.1).flat_map(right).collect()]
}

fn compose(compositor: &mut Compositor, follower: &MeshFollower, shaft: Shaft) -> Shown {
    let [left, right] = pictures(shaft);
    let views = [&left, &right].map(|data| View::new(&data[..], SIZE.0, SIZE.1, 3));
    let maps = [IDENTITY, Homography::translation(PLANE_PX, 0.0).0];
    compositor.set_mesh(1, follower.mesh());
    compositor.set_mesh(0, follower.reference_mesh());
    let canvas = compositor.canvas(&views, &maps, GeometryState::Fresh).expect("a canvas");
    let mut out = vec![0; canvas.width * canvas.height * 3];
    let mut out = ViewMut::new(&mut out, canvas.width, canvas.height, 3);
    compositor.compose(&views, &maps, GeometryState::Fresh, &Serial, &mut out, None).expect("a panorama");
    let mut pixels = vec![0; canvas.width * canvas.height];
    compositor.shown(&mut ViewMut::new(&mut pixels, canvas.width, canvas.height, 1)).expect("the views shown");
    Shown { pixels, width: canvas.width, left: canvas.left, top: canvas.top }
}

fn compositor(seam: SeamMethod) -> Compositor {
    Compositor::new(CompositeParams { seam, seam_interval_frames: 1000, ..CompositeParams::default() })
}

/// Views that show what either view draws of a shaft inside the overlap, 12 px around it included.
fn views_of(shown: &Shown, shaft: Shaft) -> [usize; 3] {
    let mut counts = [0; 3];
    for x in (260..630).step_by(6) {
        for y in (140..330).step_by(6) {
            let (x, y) = (f64::from(x), f64::from(y));
            // Drawn by the left view there, by the right one up to 65 px further left.
            let is_near = (-2..=11)
                .any(|step| [-12.0, 0.0, 12.0].iter().any(|off| shaft.covers(x + 6.0 * f64::from(step), y + off)));
            counts[shown.at(x, y) as usize] += usize::from(is_near);
        }
    }
    counts
}

#[test]
fn the_seam_goes_around_an_instrument_and_follows_it_at_once() {
    for seam in [SeamMethod::DynamicProgramming, SeamMethod::GraphCut] {
        let (mut follower, mut compositor) = (follower(true), compositor(seam));
        for tip in [560.0, 545.0, 530.0, 515.0, 500.0, 485.0, 470.0, 455.0, 440.0, 425.0] {
            let shaft = Shaft { tip, ..FROM_RIGHT };
            update(&mut follower, &shaft_map(shaft));
            let shown = compose(&mut compositor, &follower, shaft);
            let [_, left, right] = views_of(&shown, shaft);
            assert!(left == 0 && right > 50, "{seam:?}, tip at {tip}: {left} from the left view, {right}");
        }
        // One from the other side comes from the left view.
        let (mut follower, mut compositor) = (self::follower(true), self::compositor(seam));
        let shaft = Shaft { tip: 420.0, is_from_right: false };
        for _ in 0..3 {
            update(&mut follower, &shaft_map(shaft));
            let shown = compose(&mut compositor, &follower, shaft);
            let [_, left, right] = views_of(&shown, shaft);
            assert!(right == 0 && left > 50, "{seam:?}: {left}, {right} from the right view");
        }
    }
}

#[test]
fn an_instrument_that_neither_view_sees_whole_goes_on_without_a_step() {
    let (mut follower, mut compositor) = (follower(true), compositor(SeamMethod::DynamicProgramming));
    // The right view ends at column 285 of the instrument in the left one.
    for tip in [360.0, 345.0, 330.0, 315.0, 300.0, 285.0, 270.0, 255.0, 255.0, 255.0, 255.0, 255.0] {
        let shaft = Shaft { tip, ..FROM_RIGHT };
        update(&mut follower, &shaft_map(shaft));
        let shown = compose(&mut compositor, &follower, shaft);
        let [_, left, right] = views_of(&shown, shaft);
        // The seam may pass beside the end of the shaft.
        let is_whole = left > 50 && 100 * right < left;
        assert!(is_whole || tip > 285.0, "tip at {tip}: {left} from the left view, {right} from the right one");
    }
    // The left view ends at column 355 of the right one. The shaft goes on without a step, although it looks the same along itself and is not moved
    // by its whole displacement of 53 px, which would bend the tissue.
    let is_whole = |follower: &MeshFollower, when: &str| {
        let [step, moved] = step(follower.mesh().expect("a mesh"), 355..540);
        assert!(step < 1.0 && moved < 20.0, "{when}: {step} px across, moved {moved} px");
    };
    // The part beyond the border has glided along itself.
    for _ in 0..24 {
        update(&mut follower, &shaft_map(Shaft { tip: 255.0, ..FROM_RIGHT }));
    }
    is_whole(&follower, "found");
    let nothing = map(|_, _| false, |_, _| TOOL_PX);
    for frame in 0..3 {
        update(&mut follower, &nothing);
        is_whole(&follower, &format!("missing for {frame} frames"));
    }
}

#[test]
fn an_instrument_does_not_jump_when_its_view_changes() {
    let mut follower = follower(true);
    // Towards the border of the right view and back; nearer to the camera along itself.
    let tips = (0..70).map(|frame| 430.0 - 2.0 * f64::from(frame)).chain([290.0; 30]);
    let tips = tips.chain((0..110).map(|frame| 290.0 + 2.0 * f64::from(frame)));
    let (mut before, mut worst_px, mut views) = ([0.0; 2], 0.0f64, Vec::new());
    for (frame, tip) in tips.enumerate() {
        let shaft = Shaft { tip, ..FROM_RIGHT };
        let tool_px = |x: f64| 262.0 + 0.12 * (x - tip);
        update(&mut follower, &map(|x, y| shaft.covers(x, y), |x, _| tool_px(x)));
        let mesh = follower.mesh().expect("a mesh");
        // Where the panorama shows two places of the shaft, from where the left view does.
        let off = [20.0, 90.0].map(|along| {
            let (x, y) = (tip + along, Shaft::middle(tip + along));
            let view = mesh.kept_at([x as f32, y as f32]).view;
            views.push(view);
            if view == Kept::Other { drawn_at(mesh, [x - tool_px(x), y])[0] - x } else { 0.0 }
        });
        if frame > 0 {
            worst_px = off.iter().zip(before).fold(worst_px, |worst, (now, then)| worst.max((now - then).abs()));
        }
        before = off;
    }
    assert!([Kept::Reference, Kept::Other].iter().all(|view| views.contains(view)) && !views.contains(&Kept::Free));
    assert!(before[1] < -30.0, "{before:?} px from the left view in the end");
    assert!(worst_px < 4.0, "{worst_px} px in one frame");
}

#[test]
fn an_instrument_stands_still_when_the_homography_is_measured_anew() {
    let mut follower = follower(true);
    let map = shaft_map(FROM_RIGHT);
    let tip = |follower: &MeshFollower| drawn_at(follower.mesh().expect("a mesh"), [160.0, 235.0])[0];
    for _ in 0..6 {
        update(&mut follower, &map);
    }
    let (first, mut worst_px) = (tip(&follower), 0.0f64);
    for plane_px in [PLANE_PX + 2.0, PLANE_PX + 2.0, PLANE_PX - 1.0, PLANE_PX - 1.0, PLANE_PX] {
        update_by(&mut follower, &map, plane_px);
        worst_px = worst_px.max((tip(&follower) - first).abs());
    }
    assert!(worst_px < 0.4, "{worst_px} px");
}

#[test]
fn an_instrument_that_both_views_see_whole_keeps_its_view() {
    // From below, to and fro across the middle of what both see.
    let mut follower = follower(true);
    let mut views = Vec::new();
    for frame in 0..60 {
        let at = 450.0 + 120.0 * (f64::from(frame) / 8.0).sin();
        let covers = |x: f64, y: f64| y > 200.0 && (x - at).abs() < 25.0;
        update(&mut follower, &map(covers, |_, _| TOOL_PX));
        views.push(follower.mesh().expect("a mesh").kept_at([at as f32, 330.0]).view);
    }
    assert!(views[0] != Kept::Free && views.iter().all(|view| *view == views[0]), "{views:?}");
}

#[test]
fn an_instrument_is_kept_while_it_is_not_matched_for_a_few_frames() {
    let mut follower = follower(true);
    let kept = |follower: &MeshFollower| follower.mesh().expect("a mesh").kept_at([520.0, 248.0]).view;
    for _ in 0..3 {
        update(&mut follower, &shaft_map(FROM_RIGHT));
    }
    assert_eq!(kept(&follower), Kept::Other);
    let nothing = map(|_, _| false, |_, _| TOOL_PX);
    for frame in 0..20 {
        update(&mut follower, &nothing);
        if frame == 3 {
            assert_eq!(kept(&follower), Kept::Other, "frame {frame}");
        }
    }
    assert_eq!(kept(&follower), Kept::Free);
    assert!(!follower.mesh().expect("a mesh").keeps_any());
}

#[test]
fn a_detector_finds_instruments_near_the_tissue() {
    // 8 px before the tissue: too near to be separated from a fold, but not in the box of an instrument.
    let near = map(|x, y| FROM_RIGHT.covers(x, y), |x, y| hills(x, y) + 8.0);
    let kept = |hint: &dyn Fn(&mut InstrumentHints)| {
        let mut follower = follower(true);
        for _ in 0..3 {
            follower.hints_mut().clear();
            hint(follower.hints_mut());
            update(&mut follower, &near);
        }
        follower.mesh().expect("a mesh").kept_at([520.0, 248.0]).view
    };
    assert_eq!(kept(&|_| {}), Kept::Free);
    assert_eq!(kept(&|hints| hints.push_box([420.0, 195.0], [220.0, 110.0])), Kept::Other);
    let mask: Vec<u8> =
        (0..SIZE.0 * SIZE.1).map(|i| u8::from(FROM_RIGHT.covers((i % SIZE.0) as f64, (i / SIZE.0) as f64))).collect();
    assert_eq!(kept(&|hints| hints.add_mask(View::new(&mask, SIZE.0, SIZE.1, 1))), Kept::Other);
}

#[test]
fn tissue_without_instruments_is_free() {
    let mut follower = follower(true);
    let tissue = map(|_, _| false, |_, _| TOOL_PX);
    for _ in 0..3 {
        update(&mut follower, &tissue);
        assert!(!follower.mesh().expect("a mesh").keeps_any());
    }
    // The mesh is what it is without looking for instruments.
    let mut other = self::follower(false);
    for _ in 0..3 {
        update(&mut other, &tissue);
    }
    assert_eq!(follower.mesh(), other.mesh());
}
