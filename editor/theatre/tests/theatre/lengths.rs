//! Lengths of the theatre and what is known of their disparities.

use eframe::egui::Key;
use egui_kittest::kittest::Queryable;
use panoscope_theatre::Theatre;

use crate::common::window::Window;
use crate::common::{has_plugin, input};

/// A surface with the confidence of its disparities.
pub const MEASURED: &str = r#"plugins = ["phantom", "stereo"]
[nodes.scope]
type = "phantom"
params = { scene = "bowel", width = 320, height = 240, speed_mm_s = 0.0, breathing_mm = 0.0 }
[nodes.match]
type = "stereo_bm"
inputs = { left = "scope.left", right = "scope.right" }
[nodes.wls]
type = "disparity_wls"
inputs = { image = "scope.left", disparity = "match.disparity", disparity_right = "match.disparity_right" }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "wls.disparity", calibration = "scope.calibration", confidence = "wls.confidence" }
[preset]
views = ["scope.left", "points.cloud"]
"#;

/// Measures a length and returns of which of its ends the confidence is known.
pub fn measure(window: &mut Window) -> Vec<bool> {
    window.key(Key::M);
    window.until_shown("Measure here");
    let rect = window.harness.get_by_label("Measure here").rect();
    for share in [0.6, 0.8] {
        input::tap(&mut window.harness, rect.min + rect.size() * share);
    }
    window.until("a distance with its error", |t| t.distance().is_some());
    let known = |t: &Theatre| {
        let points = t.tapped().iter().filter_map(|point| point.position);
        points.map(|point| point.confidence.is_some()).collect()
    };
    known(window.theatre())
}

#[test]
fn lengths_have_the_confidence_of_their_disparities() {
    if !has_plugin("phantom") || !has_plugin("stereo") {
        return;
    }
    // Where the surface is made without a confidence, nothing is known of it.
    for (name, text, is_known) in [
        ("confident", MEASURED.to_owned(), true),
        ("unknown_confidence", MEASURED.replace(", confidence = \"wls.confidence\"", ""), false),
    ] {
        let mut window = Window::open(name, &text);
        assert_eq!(measure(&mut window), [is_known; 2], "{name}");
    }
}
