//! The node `composite` while a registration is lost.

use panoscope_node::Bgr8;
use panoscope_node::abi::{Homography, STATE_FRESH, STATE_LOST};
use panoscope_node::harness::{Harness, Setup};
use panoscope_stitch::composite::Composite;

const SIZE: (usize, usize) = (160, 120);

/// A view with enough texture for a seam.
fn view(shift: usize) -> Vec<u8> {
    (0..SIZE.0 * SIZE.1 * 3).map(|i| ((i / 3 % SIZE.0 + shift) * 7 + i / (3 * SIZE.0) * 5 + i % 3 * 40) as u8).collect()
}

fn shifted(x_px: f64, state: u32) -> Homography {
    Homography { left_from_right: [1.0, 0.0, x_px, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], rms_px: 0.5, inliers: 40, state }
}

fn node(params: &str) -> Harness<Composite> {
    Harness::open(Setup::new(&format!("params = {{ {params} }}"))).unwrap()
}

/// Whether a tick with this registration makes a panorama and a mask.
fn composes(node: &mut Harness<Composite>, homography: Homography) -> (bool, bool) {
    node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &view(0));
    node.input_image::<Bgr8>("right", SIZE.0, SIZE.1, &view(60));
    let out = node.input_value("homography", homography).process().unwrap();
    (!out.is_empty("panorama").unwrap(), !out.is_empty("mask").unwrap())
}

#[test]
fn a_lost_frame_is_composed_from_the_last_good_one_or_skipped() {
    // A quadrilateral that folds over is as bad as none (thesis 2.4.3), whatever its state says.
    let mut folded = shifted(60.0, STATE_FRESH);
    folded.left_from_right[6] = -0.02;
    for (on_lost, shown) in [("last", true), ("skip", false)] {
        let mut node = node(&format!("on_lost = \"{on_lost}\""));
        assert_eq!(composes(&mut node, shifted(60.0, STATE_LOST)).0, shown, "{on_lost}: before any good frame");
        assert_eq!(composes(&mut node, shifted(60.0, STATE_FRESH)), (true, true), "{on_lost}");
        assert_eq!(composes(&mut node, shifted(60.0, STATE_LOST)), (shown, shown), "{on_lost}");
        assert_eq!(composes(&mut node, folded).0, shown, "{on_lost}: a folded view");
        assert_eq!(composes(&mut node, shifted(61.0, STATE_FRESH)), (true, true), "{on_lost}: the next good frame");
    }
}

#[test]
fn cost_and_hold_of_the_seam_change_the_panorama() {
    let panorama = |params: &str| {
        let mut node = node(params);
        node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &view(0));
        node.input_image::<Bgr8>("right", SIZE.0, SIZE.1, &view(47));
        let out = node.input_value("homography", shifted(60.0, STATE_FRESH)).process().unwrap();
        out.plane::<Bgr8>("panorama").unwrap().data.to_vec()
    };
    assert!(panorama("seam_cost = \"color\"") != panorama("seam_cost = \"color_gradient\""));
    assert!(panorama("seam_hold = 0.5") == panorama(""), "0.5 levels are the default");
}
