//! Tests of meshes on disparities and images with ground truth.

use super::super::placement::Placement;
use super::super::warp::{Block, GROUP};
use super::super::{CompositeParams, Compositor, GeometryState, IDENTITY, SeamMethod};
use super::*;
use crate::geometry::Homography;
use crate::stereo::Lens;
use crate::stitch::RectifiedView;
use crate::{Serial, Simd, View, ViewMut};
use panoscope_base::random::lattice as random;

const SIZE: (usize, usize) = (640, 480);

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

/// Disparity of curved tissue: hills of 12 px on a slope.
fn hills(x: f64, y: f64) -> f64 {
    220.0 + x / 40.0 + 12.0 * (x / 80.0).sin() * (y / 60.0).cos()
}

/// Disparity map of what both views see; every seventh pixel is unmatched, `noise_px` is different in each frame.
fn map(disparity: impl Fn(f64, f64) -> f64, noise_px: f64, frame: i64) -> Vec<f32> {
    let mut map = vec![f32::NAN; SIZE.0 * SIZE.1];
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let d = disparity(x as f64, y as f64);
            if d <= x as f64 && (x * 31 + y * 17) % 7 != 0 {
                // Matching errs alike over its window.
                let noise = random((x / 4) as i64, (y / 4) as i64, (21 + frame) as u64) - 0.5;
                map[y * SIZE.0 + x] = (d + 3.4 * noise_px * noise) as f32;
            }
        }
    }
    map
}

fn plane() -> Homography {
    Homography::translation(232.0, 0.0)
}

fn update(follower: &mut MeshFollower, map: &[f32], plane: &Homography) -> MeshReport {
    follower.update(View::new(map, SIZE.0, SIZE.1, 1), &camera(), &camera(), plane, &Serial)
}

/// A follower whose mesh follows the disparity up to the border, also beside instruments.
fn up_to_the_border() -> MeshFollower {
    MeshFollower::new(MeshParams { zone_px: 0.0, keeps_instruments: false, ..MeshParams::default() })
}

/// A follower whose mesh follows the tissue also beside instruments.
fn of_tissue() -> MeshFollower {
    MeshFollower::new(MeshParams { keeps_instruments: false, ..MeshParams::default() })
}

/// Largest and root mean square error of the mesh at points that both views see, `rim` px inside.
fn errors(mesh: &Mesh, disparity: impl Fn(f64, f64) -> f64, rim: usize) -> (f64, f64) {
    let (mut worst, mut squares, mut count) = (0.0f64, 0.0, 0.0);
    for y in (rim..SIZE.1 - rim).step_by(7) {
        for x in (260 + rim..SIZE.0 - rim).step_by(7) {
            let (x, y) = (x as f64, y as f64);
            let [u, v] = mesh.map([x, y]).expect("inside the mesh");
            let error = (u - (x - disparity(x, y))).hypot(v - y);
            (worst, squares, count) = (worst.max(error), squares + error * error, count + 1.0);
        }
    }
    (worst, f64::sqrt(squares / count))
}

#[test]
fn the_mesh_follows_curved_tissue() {
    let mut follower = up_to_the_border();
    assert!(follower.mesh().is_none());
    let report = update(&mut follower, &map(hills, 0.3, 0), &plane());
    assert!(report.is_new && !report.is_held && report.observations > 500, "{report:?}");
    assert!(report.residual_px < 0.6, "{report:?}");
    let mesh = follower.mesh().expect("a mesh");
    let (worst, rms) = errors(mesh, hills, 12);
    assert!(rms < 0.4 && worst < 3.0, "rms {rms}, worst {worst}");
    // The plane alone is far off.
    let flat = Mesh::new(*mesh.lattice(), |[x, y]| [x - 232.0, y]).expect("a mesh");
    assert!(errors(&flat, hills, 12).1 > 5.0);
}

#[test]
fn a_small_map_makes_a_mesh_of_large_pictures() {
    use super::super::coarse::enlarged;
    use crate::shrink::{enlarged_px, shrunk_px};
    const FACTOR: usize = 3;
    let small = camera();
    let large = RectifiedView {
        size: (SIZE.0 * FACTOR, SIZE.1 * FACTOR),
        focal_px: small.focal_px.map(|px| px * FACTOR as f64),
        centre_px: small.centre_px.map(|px| enlarged_px(px, FACTOR)),
        rectified_focal_px: small.rectified_focal_px.map(|px| px * FACTOR as f64),
        rectified_centre_px: small.rectified_centre_px.map(|px| enlarged_px(px, FACTOR)),
        ..small
    };
    let known = map(hills, 0.3, 0);
    let plane = plane();
    let [mut of_small, mut of_large] = [0, 1].map(|_| MeshFollower::new(MeshParams::default()));
    let expected = update(&mut of_small, &known, &plane);
    let view = View::new(&known[..], SIZE.0, SIZE.1, 1);
    let found = of_large.update(view, &large, &large, &enlarged(&plane, FACTOR), &Serial);
    assert_eq!((found.observations, found.is_held), (expected.observations, false));
    assert!((found.residual_px - 3.0 * expected.residual_px).abs() < 1e-3, "{found:?}, {expected:?}");
    for which in [MeshFollower::mesh, MeshFollower::reference_mesh] {
        let [small, large] = [&of_small, &of_large].map(|follower| which(follower).expect("a mesh"));
        for at in [[300.0, 50.0], [471.3, 402.9], [600.0, 240.0], [635.0, 470.0]] {
            // Each is bilinear in its own cells, which lie a third of a pixel apart.
            let expected = small.map(at).expect("inside");
            let found = large.map(at.map(|px| enlarged_px(px, FACTOR))).expect("inside");
            let off = (0..2).map(|k| (shrunk_px(found[k], FACTOR) - expected[k]).abs()).fold(0.0, f64::max);
            assert!(off < 0.05, "{off} px at {at:?}");
        }
        assert_eq!(large.doubt_px([900.0, 600.0]), small.doubt_px([300.0, 200.0]));
    }
    // What stays where it is does so exactly.
    let bounds = [&of_small, &of_large].map(|follower| follower.reference_mesh().and_then(Mesh::moved));
    let [Some([low, _]), Some([large_low, _])] = bounds else { panic!("a part is moved: {bounds:?}") };
    assert!((0..2).all(|k| (large_low[k] - 3.0 * low[k]).abs() <= 1.0), "{large_low:?}, {low:?}");
    // A map of another size starts anew.
    assert!(update(&mut of_large, &known, &plane).is_new);
}

#[test]
fn the_mesh_fades_into_the_homography_without_stretching_it() {
    let mut follower = MeshFollower::new(MeshParams::default());
    update(&mut follower, &map(hills, 0.3, 0), &plane());
    let mesh = follower.mesh().expect("a mesh").clone();
    let placed = Placement::new(plane(), Some(mesh.clone())).expect("an inverse");
    // Far from what both see, lengths are the homography's.
    let shown = vec![2u8; 900 * 480];
    let shown = View::new(&shown, 900, 480, 1);
    let far = crate::Rect::whole(780, 480);
    let stretch = placed.stretch_pct(shown, 2, far, (0, 0)).expect("a place");
    assert!(stretch < 5.0, "{stretch}");
    // Nor does the mesh bend sharply at the border of the overlap.
    for y in (24..456).step_by(24) {
        let at = |x: f64| mesh.map([x, f64::from(y)]).expect("inside")[0];
        for x in [600.0, 640.0, 680.0, 720.0] {
            let bend = at(x - 24.0) - 2.0 * at(x) + at(x + 24.0);
            assert!(bend.abs() < 4.0, "{bend} px at {x}, {y}");
        }
    }
}

#[test]
fn lengths_are_kept_where_only_the_other_view_sees() {
    // Folds that the border of the left view cuts.
    let folds = |x: f64, y: f64| 220.0 + x / 40.0 + 12.0 * (x / 60.0).sin() * (y / 30.0).cos();
    let judge = |params: MeshParams| {
        let mut follower = MeshFollower::new(params);
        update(&mut follower, &map(folds, 0.3, 0), &plane());
        let mesh = follower.mesh().expect("a mesh").clone();
        // Left of the zone.
        let exact = errors(&mesh, folds, 64).1;
        let placed = Placement::new(plane(), Some(mesh)).expect("an inverse");
        let shown = vec![2u8; 872 * 480];
        let left = crate::Rect::whole(SIZE.0, SIZE.1);
        (placed.stretch_pct(View::new(&shown, 872, 480, 1), 2, left, (0, 0)).expect("a place"), exact)
    };
    let (stretch, exact) = judge(MeshParams::default());
    assert!(stretch < 5.0, "{stretch} %");
    assert!(exact < 0.6, "{exact} px before the zone");
    let (followed, _) = judge(MeshParams { zone_px: 0.0, ..MeshParams::default() });
    assert!(followed > 10.0, "a mesh that follows the folds to the border stretches what lies beyond: {followed} %");
}

#[test]
fn both_views_fit_where_the_mesh_leaves_the_reference_plane() {
    let folds = |x: f64, y: f64| 220.0 + x / 40.0 + 12.0 * (x / 60.0).sin() * (y / 30.0).cos();
    let mut follower = MeshFollower::new(MeshParams::default());
    update(&mut follower, &map(folds, 0.3, 0), &plane());
    let truth: Vec<f32> =
        (0..SIZE.0 * SIZE.1).map(|i| folds((i % SIZE.0) as f64, (i / SIZE.0) as f64) as f32).collect();
    let disparity = View::new(&truth, SIZE.0, SIZE.1, 1);
    let pairs = crate::stitch::evaluate::TruePairs { disparity, visible: None, along: [1.0, 0.0], step: 4 };
    let align = |reference: Option<&Mesh>| {
        let placed = Placement::new(plane(), follower.mesh().cloned()).expect("an inverse");
        placed.with_reference(reference.cloned()).alignment(&pairs).expect("pairs").0
    };
    let reference = follower.reference_mesh().expect("the left view is moved");
    let (both, right_alone) = (align(Some(reference)), align(None));
    assert!(both < 0.5 && right_alone > 1.0, "{both} px, {right_alone} px with the left view where it was");
    // It stays where it is up to the zone.
    let moved = reference.moved().expect("a zone");
    assert!(moved[0][0] >= 640.0 - 60.0 - 40.0, "{moved:?}");
    // Where nothing has to be left, nothing moves.
    let mut follower = MeshFollower::new(MeshParams { zone_px: 0.0, ..MeshParams::default() });
    update(&mut follower, &map(folds, 0.3, 0), &plane());
    assert!(follower.mesh().is_some() && follower.reference_mesh().is_none());
}

#[test]
fn pixels_that_are_not_announced_are_not_read() {
    let [mut whole, mut part] = [0, 1].map(|_| MeshFollower::new(MeshParams::default()));
    for frame in 0..3 {
        let map = map(hills, 0.3, frame);
        let [columns, rows] = part.pixels(SIZE, &camera(), &camera());
        assert!(columns.len() * rows.len() < SIZE.0 * SIZE.1 / 4, "{} x {}", columns.len(), rows.len());
        let mut seen = vec![1e9; map.len()];
        for at in rows.iter().flat_map(|y| columns.iter().map(|x| *y as usize * SIZE.0 + *x as usize)) {
            seen[at] = map[at];
        }
        let [expected, found] = [(&mut whole, &map), (&mut part, &seen)].map(|(mesh, map)| update(mesh, map, &plane()));
        assert_eq!(format!("{found:?}"), format!("{expected:?}"));
        assert_eq!(part.mesh(), whole.mesh(), "frame {frame}");
        assert!(part.mesh().is_some());
    }
}

#[test]
fn a_camera_below_is_followed_along_its_own_direction() {
    // Depth that is known everywhere, as two pairs of cameras know it together.
    let disparity: Vec<f32> =
        (0..SIZE.0 * SIZE.1).map(|i| hills((i % SIZE.0) as f64, (i / SIZE.0) as f64) as f32).collect();
    for (along, columns) in [([0.0, 1.0], 12..628), ([1.0, 1.0], 272..628)] {
        let mut follower = MeshFollower::new(MeshParams { along, zone_px: 0.0, ..MeshParams::default() });
        let plane = Homography::translation(232.0 * along[0], 232.0 * along[1]);
        let report = update(&mut follower, &disparity, &plane);
        assert!(report.is_new && !report.is_held && report.residual_px < 0.6, "{report:?}");
        let mesh = follower.mesh().expect("a mesh");
        for y in (272..468).step_by(14) {
            for x in columns.clone().step_by(14) {
                let (x, y) = (x as f64, y as f64);
                let d = hills(x, y);
                let [u, v] = mesh.map([x, y]).expect("inside");
                let error = (u - (x - along[0] * d)).hypot(v - (y - along[1] * d));
                assert!(error < 2.0, "{error} px at {x}, {y} towards {along:?}");
            }
        }
    }
}

#[test]
fn a_tool_in_front_does_not_bend_the_tissue() {
    let is_tool = |x: f64, y: f64| (420.0..560.0).contains(&x) && (200.0..240.0).contains(&y);
    let with_tool = |x: f64, y: f64| if is_tool(x, y) { 300.0 } else { hills(x, y) };
    let mesh_of = |mut follower: MeshFollower, disparity: &dyn Fn(f64, f64) -> f64| {
        update(&mut follower, &map(disparity, 0.3, 0), &plane());
        follower.mesh().expect("a mesh").clone()
    };
    let mesh = mesh_of(up_to_the_border(), &with_tool);
    // Before the border the mesh leaves the tissue on purpose: with a tool as much as without.
    let left = [&with_tool as &dyn Fn(f64, f64) -> f64, &hills].map(|d| mesh_of(of_tissue(), d));
    for (x, y) in [(300.0, 220.0), (490.0, 150.0), (490.0, 290.0), (600.0, 220.0)] {
        let [u, _] = mesh.map([x, y]).expect("inside");
        let error = u - (x - hills(x, y));
        assert!(error.abs() < 0.5, "{error} px at {x}, {y}");
        let [with, without] = [0, 1].map(|i| left[i].map([x, y]).expect("inside")[0]);
        assert!((with - without).abs() < 0.05, "{with} and {without} px at {x}, {y}");
    }
    assert!(mesh.doubt_px([490.0, 220.0]) > 8.0, "the seam must not cross the tool");
    assert!(mesh.doubt_px([490.0, 130.0]) < 2.0);
}

#[test]
fn a_large_instrument_keeps_its_shape_also_when_it_comes_in_slowly() {
    // A shaft as wide as a hand's breadth of cells, from the right border, 70 px of disparity before the tissue.
    let shaft = |tip: f64| move |x: f64, y: f64| x > tip && (180.0..290.0).contains(&y);
    let seen = |tip: f64| move |x: f64, y: f64| hills(x, y) + if shaft(tip)(x, y) { 70.0 } else { 0.0 };
    let check = |follower: &MeshFollower, what: &str| {
        let mesh = follower.mesh().expect("a mesh");
        let (mut squares, mut count) = (0.0, 0.0);
        for x in (420..640).step_by(20) {
            for y in (140..340).step_by(20) {
                let (x, y) = (f64::from(x), f64::from(y));
                let off = mesh.map([x, y]).expect("inside")[0] - (x - hills(x, y));
                if (160.0..310.0).contains(&y) {
                    // Nothing is known of the tissue behind it: the mesh goes on from beside it.
                    (squares, count) = (squares + off * off, count + 1.0);
                } else if x <= 580.0 {
                    // Before the zone in which it leaves the tissue.
                    assert!(off.abs() < 4.0, "{what}: {off} px at {x}, {y}");
                }
            }
        }
        let rms = f64::sqrt(squares / count);
        assert!(rms < 18.0, "{what}: {rms} px of the instrument's 70");
        assert!(mesh.doubt_px([520.0, 235.0]) > 8.0, "{what}: the seam must not cross it");
    };
    let mut follower = of_tissue();
    update(&mut follower, &map(seen(400.0), 0.3, 0), &plane());
    check(&follower, "at once");
    let mut follower = of_tissue();
    for frame in 0..60 {
        let tip = (660.0 - 10.0 * f64::from(frame)).max(400.0);
        update(&mut follower, &map(seen(tip), 0.3, i64::from(frame)), &plane());
    }
    check(&follower, "slowly");
}

#[test]
fn wrong_matches_do_not_count() {
    // A tenth of the map is wrong, in speckles and all along the lower rim.
    let mut wrong = map(hills, 0.3, 0);
    for y in 0..SIZE.1 {
        for x in 300..SIZE.0 {
            let is_speckle = random((x / 16) as i64, (y / 16) as i64, 5) < 0.08;
            if is_speckle || y >= 472 {
                wrong[y * SIZE.0 + x] = 180.0 + 110.0 * random((x / 8) as i64, (y / 8) as i64, 6) as f32;
            }
        }
    }
    let mut follower = MeshFollower::new(MeshParams::default());
    update(&mut follower, &wrong, &plane());
    let (worst, rms) = errors(follower.mesh().expect("a mesh"), hills, 12);
    assert!(rms < 0.8 && worst < 8.0, "rms {rms}, worst {worst}");
}

#[test]
fn chance_matches_in_patches_do_not_count_and_are_reported_as_blind() {
    // From row 300 down the views match by chance only, in patches of 18 px that lie anywhere.
    let mut lost = map(hills, 0.3, 0);
    for y in 300..SIZE.1 {
        for x in 0..SIZE.0 {
            let chance = random((x / 18) as i64, (y / 18) as i64, 9);
            lost[y * SIZE.0 + x] = if chance < 0.6 { f32::NAN } else { (400.0 * chance - 90.0) as f32 };
        }
    }
    let kept = MeshParams { zone_px: 0.0, min_patch: 40, ..MeshParams::default() };
    let at_the_bottom = |params: MeshParams| {
        let mut follower = MeshFollower::new(params);
        let report = update(&mut follower, &lost, &plane());
        let mesh = follower.mesh().expect("a mesh");
        let off = |x: f64, y: f64| (mesh.map([x, y]).expect("inside")[0] - (x - hills(x, y))).abs();
        assert!(off(400.0, 200.0) < 1.0 && off(600.0, 250.0) < 1.0);
        let worst = (280..640).step_by(20).map(|x| off(f64::from(x), 440.0)).fold(0.0, f64::max);
        (worst, report)
    };
    let (worst, report) = at_the_bottom(kept);
    assert!(worst < 15.0, "{worst} px");
    assert!((0.3..0.45).contains(&report.blind), "{report:?}");
    let (misled, report) = at_the_bottom(MeshParams { min_patch: 0, ..kept });
    assert!(misled > 1.5 * worst && report.blind < 0.3, "{misled} px, {report:?}");
    let mut follower = MeshFollower::new(MeshParams::default());
    assert!(update(&mut follower, &map(hills, 0.3, 0), &plane()).blind < 1e-9);
}

#[test]
fn where_the_mesh_guessed_it_follows_what_is_observed_later() {
    // Unknown at first: from row 300 down the tissue comes 60 px nearer.
    let near = |x: f64, y: f64| hills(x, y) + 60.0 * ((y - 300.0) / 100.0).clamp(0.0, 1.0);
    let whole = map(near, 0.3, 1);
    let mut upper = map(near, 0.3, 0);
    upper[300 * SIZE.0..].fill(f32::NAN);
    let mut follower = up_to_the_border();
    update(&mut follower, &upper, &plane());
    let off = |follower: &MeshFollower| {
        let mesh = follower.mesh().expect("a mesh");
        (mesh.map([560.0, 440.0]).expect("inside")[0] - (560.0 - near(560.0, 440.0))).abs()
    };
    assert!(off(&follower) > 20.0, "{} px: nothing was known there", off(&follower));
    let report = update(&mut follower, &whole, &plane());
    assert!(report.is_new && off(&follower) < 2.0, "{} px, {report:?}", off(&follower));
    assert!(!update(&mut follower, &whole, &plane()).is_new);
}

#[test]
fn a_steep_fold_is_followed() {
    // 40 px within 60: disparities of a cell differ by more than what agrees.
    let fold = |x: f64, y: f64| hills(x, y) + 20.0 * ((y - 240.0 - 0.1 * x) / 20.0).tanh();
    let mut follower = up_to_the_border();
    let report = update(&mut follower, &map(fold, 0.3, 0), &plane());
    let (worst, rms) = errors(follower.mesh().expect("a mesh"), fold, 12);
    assert!(rms < 0.8 && worst < 6.0, "rms {rms}, worst {worst}, {report:?}");
}

#[test]
fn a_still_scene_has_a_still_mesh() {
    let mut follower = MeshFollower::new(MeshParams::default());
    let (mut previous, mut worst) = (None::<Placement>, 0.0f64);
    for frame in 0..30 {
        update(&mut follower, &map(hills, 0.5, frame), &plane());
        let placed = Placement::new(plane(), follower.mesh().cloned()).expect("an inverse");
        if let Some(previous) = previous.filter(|_| frame > 5) {
            worst = worst.max(placed.motion_px(&previous, SIZE).expect("inside"));
        }
        previous = Some(placed);
    }
    assert!(worst < 0.1, "{worst} px from frame to frame");
}

#[test]
fn a_moving_scene_is_followed_at_once() {
    let mut follower = up_to_the_border();
    for frame in 0..12 {
        let moved = |x: f64, y: f64| hills(x, y) + 1.5 * frame as f64;
        let report = update(&mut follower, &map(moved, 0.3, frame), &plane());
        assert_eq!(report.is_new, frame == 0);
        let (_, rms) = errors(follower.mesh().expect("a mesh"), moved, 12);
        assert!(rms < 0.6, "rms {rms} in frame {frame}");
    }
}

#[test]
fn the_mesh_holds_when_depth_is_lost_and_starts_afresh_after_a_jump() {
    let mut follower = up_to_the_border();
    let nothing = vec![f32::NAN; SIZE.0 * SIZE.1];
    assert!(update(&mut follower, &nothing, &plane()).is_held);
    assert!(follower.mesh().is_none());
    update(&mut follower, &map(hills, 0.3, 0), &plane());
    let before = follower.mesh().expect("a mesh").clone();
    assert!(update(&mut follower, &nothing, &plane()).is_held);
    assert_eq!(follower.mesh().map(Mesh::source), Some(before.source()));
    // The homography moves by two pixels: so does the mesh.
    update(&mut follower, &nothing, &Homography::translation(234.0, 0.0));
    let moved = follower.mesh().expect("a mesh").map([500.0, 200.0]).expect("inside");
    let old = before.map([500.0, 200.0]).expect("inside");
    assert!((moved[0] - old[0] + 2.0).abs() < 1e-3, "{moved:?} after {old:?}");
    let jumped = |x: f64, y: f64| hills(x, y) - 40.0;
    let report = update(&mut follower, &map(jumped, 0.3, 1), &Homography::translation(192.0, 0.0));
    assert!(report.is_new, "{report:?}");
    let (_, rms) = errors(follower.mesh().expect("a mesh"), jumped, 12);
    assert!(rms < 0.5, "rms {rms}");
}

#[test]
fn a_homography_without_an_inverse_leaves_no_mesh() {
    let mut follower = MeshFollower::new(MeshParams::default());
    update(&mut follower, &map(hills, 0.3, 0), &plane());
    update(&mut follower, &map(hills, 0.3, 1), &Homography([0.0; 9]));
    assert!(follower.mesh().is_none());
}

/// Texture of the tissue at a position of the left view.
fn tissue(x: f64, y: f64) -> [f64; 3] {
    let wave = 45.0 * (0.21 * x + 0.9 * (0.05 * y).sin()).sin() + 35.0 * (0.17 * y + 0.08 * x).sin();
    [110.0 + wave, 90.0 + 0.8 * wave, 140.0 + 0.5 * wave]
}

fn shoot(position: impl Fn(f64, f64) -> Point) -> Vec<u8> {
    let pixels = (0..SIZE.0 * SIZE.1).map(|i| position((i % SIZE.0) as f64, (i / SIZE.0) as f64));
    pixels.flat_map(|[x, y]| tissue(x, y).map(|v| (v + 0.5).clamp(0.0, 255.0) as u8)).collect()
}

/// The point of the left view that a pixel of the right one shows.
fn seen_by_right(u: f64, v: f64) -> Point {
    let mut x = u + 230.0;
    for _ in 0..60 {
        x = u + hills(x, v);
    }
    [x, v]
}

struct Panorama {
    data: Vec<u8>,
    canvas: super::super::Canvas,
}

fn compose(mesh: Option<&Mesh>, seam: SeamMethod) -> Panorama {
    let (left, right) = (shoot(|x, y| [x, y]), shoot(seen_by_right));
    let views = [View::new(&left, SIZE.0, SIZE.1, 3), View::new(&right, SIZE.0, SIZE.1, 3)];
    let mut compositor = Compositor::new(CompositeParams { seam, ..CompositeParams::default() });
    compositor.set_mesh(1, mesh);
    let maps = [IDENTITY, plane().0];
    let canvas = compositor.canvas(&views, &maps, GeometryState::Fresh).expect("views that fit");
    let mut data = vec![0; canvas.width * canvas.height * 3];
    let mut out = ViewMut::new(&mut data, canvas.width, canvas.height, 3);
    compositor.compose(&views, &maps, GeometryState::Fresh, &Serial, &mut out, None).expect("a panorama");
    Panorama { data, canvas }
}

/// Root mean square difference from the tissue in the overlap, levels.
fn difference(panorama: &Panorama) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for y in 20..SIZE.1 - 20 {
        for x in 280..SIZE.0 - 20 {
            let (u, v) = (x as i32 + panorama.canvas.left, y as i32 + panorama.canvas.top);
            let at = (v as usize * panorama.canvas.width + u as usize) * 3;
            for (shown, truth) in panorama.data[at..at + 3].iter().zip(tissue(x as f64, y as f64)) {
                squares += (f64::from(*shown) - truth).powi(2);
                count += 1.0;
            }
        }
    }
    f64::sqrt(squares / count)
}

#[test]
fn a_panorama_by_a_mesh_is_whole_where_one_by_a_plane_breaks() {
    let mut follower = MeshFollower::new(MeshParams::default());
    update(&mut follower, &map(hills, 0.1, 0), &plane());
    let mesh = follower.mesh();
    for seam in [SeamMethod::None, SeamMethod::DynamicProgramming, SeamMethod::GraphCut] {
        let (whole, broken) = (difference(&compose(mesh, seam)), difference(&compose(None, seam)));
        assert!(whole < 6.0 && broken > 2.0 * whole, "{seam:?}: {whole} levels with the mesh, {broken} without");
    }
}

#[test]
fn the_reference_view_is_drawn_where_its_mesh_moves_it() {
    let (left, right) = (shoot(|x, y| [x, y]), shoot(seen_by_right));
    let views = [View::new(&left, SIZE.0, SIZE.1, 3), View::new(&right, SIZE.0, SIZE.1, 3)];
    let lattice = Lattice { cell_px: 20, first: [20, -2], columns: 30, rows: 29 };
    // From column 500 on it moves right, by 12 px at the border.
    let moved = |x: f64| 12.0 * ((x - 500.0) / 140.0).clamp(0.0, 1.0);
    let mesh = Mesh::new(lattice, |[x, y]| [x - moved(x), y]).expect("a mesh");
    let mut compositor = Compositor::new(CompositeParams { seam: SeamMethod::None, ..CompositeParams::default() });
    compositor.set_mesh(0, Some(&mesh));
    // The right view far off, so that the left one is seen.
    let maps = [IDENTITY, Homography::translation(700.0, 0.0).0];
    let canvas = compositor.canvas(&views, &maps, GeometryState::Fresh).expect("views that fit");
    let mut data = vec![0; canvas.width * canvas.height * 3];
    let mut out = ViewMut::new(&mut data, canvas.width, canvas.height, 3);
    compositor.compose(&views, &maps, GeometryState::Fresh, &Serial, &mut out, None).expect("a panorama");
    for y in (4..SIZE.1 - 4).step_by(9) {
        for x in 4..SIZE.0 + 8 {
            let at = ((y as i32 + canvas.top) as usize * canvas.width + (x as i32 + canvas.left) as usize) * 3;
            let truth = tissue(x as f64 - moved(x as f64), y as f64);
            for (shown, truth) in data[at..at + 3].iter().zip(truth) {
                assert!((f64::from(*shown) - truth).abs() < 4.0, "{shown} for {truth} at {x}, {y}");
            }
        }
    }
}

#[test]
fn a_mesh_of_a_homography_draws_what_the_homography_draws() {
    let lattice = Lattice { cell_px: 24, first: [6, -3], columns: 36, rows: 26 };
    let mesh = Mesh::new(lattice, |at| plane().inverse().expect("an inverse").map(at)).expect("a mesh");
    let (by_mesh, by_plane) = (compose(Some(&mesh), SeamMethod::GraphCut), compose(None, SeamMethod::GraphCut));
    assert_eq!(by_mesh.canvas, by_plane.canvas);
    let worst = by_mesh.data.iter().zip(&by_plane.data).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(worst <= Some(2), "{worst:?} levels");
}

#[test]
fn positions_and_coverage_agree_on_all_paths() {
    let lattice = Lattice { cell_px: 24, first: [-2, -1], columns: 12, rows: 9 };
    let mesh =
        Mesh::new(lattice, |[x, y]| [0.9 * x + 6.0 * (y / 30.0).sin() - 8.0, 1.1 * y - 4.0 + 3.0 * (x / 25.0).cos()])
            .expect("a mesh");
    let grid = Mapping::Mesh(MeshGrid { mesh: &mesh, origin: [-40.0, -20.0], step: 1.0 });
    let (width, height) = (120, 90);
    let mut spans = Vec::new();
    grid.coverage((width, height), 280, 160, &mut spans);
    for (y, span) in spans.iter().enumerate() {
        let inside = |x: usize| {
            let at = mesh.map([x as f64 - 40.0, y as f64 - 20.0]);
            at.is_some_and(|[u, v]| u >= 0.0 && v >= 0.0 && u <= width as f64 - 1.0 && v <= height as f64 - 1.0)
        };
        for x in span.start as usize..span.end as usize {
            let mut block = [Block::default(), Block::default()];
            for (block, avx2) in block.iter_mut().zip([Simd::detect().avx2(), false]) {
                grid.locate((x, y), (width, height, width * 3), 1, block, avx2);
            }
            // What stands behind a group has no meaning.
            assert_eq!(block[0].offset[..GROUP], block[1].offset[..GROUP]);
            assert_eq!(block[0].weights[..GROUP], block[1].weights[..GROUP]);
            let Some([u, v]) = mesh.map([x as f64 - 40.0, y as f64 - 20.0]) else { continue };
            let [column, row] = [block[0].offset[0] as usize / 3 % width, block[0].offset[0] as usize / 3 / width];
            let across = f64::from(block[0].weights[0] >> 8 & 255) / 64.0 + column as f64;
            let down = f64::from(block[0].weights[0] >> 16) / 16384.0 + row as f64;
            let (u, v) = (u.clamp(0.0, width as f64 - 1.0), v.clamp(0.0, height as f64 - 1.0));
            assert!((across - u).abs() < 0.02 && (down - v).abs() < 0.02, "{across}, {down} for {u}, {v}");
        }
        let covered: Vec<usize> = (0..280).filter(|x| inside(*x)).collect();
        if let (Some(first), Some(last)) = (covered.first(), covered.last()) {
            assert!(span.start as usize <= *first && span.end as usize > *last, "{span:?} in row {y}");
            assert!(*first - span.start as usize <= 1 && span.end as usize - *last <= 2, "{span:?} in row {y}");
        }
    }
    assert!(spans.iter().filter(|span| !span.is_empty()).count() > 60);
}
