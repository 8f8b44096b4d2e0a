//! Values of pictures: at a point, along a line, and how often each occurs.

use crate::common::{Folder, GRAPH, Window, has_plugin, input, nothing_lost};
use eframe::egui::{Key, Modifiers, vec2};
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::observe::Output;

const NONE: Modifiers = Modifiers::NONE;

#[test]
fn a_point_and_a_line_on_a_picture_have_its_values() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("probes");
    let text = GRAPH.replace("width_px = 64, height_px = 48,", "width_px = 64, height_px = 48, format = \"gray8\",");
    let mut window = Window::run(&folder.write("g.toml", &text));
    let output = Output::new("b", "image");
    window.select("b");
    window.until("a histogram in the panel", |app| app.probe(&output).is_some_and(|p| !p.histograms.is_empty()));
    window.until_shown("Histogram: ");
    // A ramp: every value of its range is about as frequent.
    let probe = window.app().probe(&output).expect("it is read").clone();
    assert_eq!((probe.size, probe.channels.len()), ((64, 48), 1));
    assert_eq!(probe.histograms[0].bars.iter().sum::<u32>(), 64 * 48);

    window.key(NONE, Key::V);
    window.until_shown("Viewer of b.image");
    window.until("a picture", |app| app.probe(&output).is_some());
    let viewer = window.harness.get_by_label("Viewer of b.image").rect();
    window.harness.hover_at(viewer.center());
    window.harness.step();
    window.harness.hover_at(viewer.center() + vec2(3.0, 2.0));
    window.until("the value under the pointer", |app| app.probe(&output).is_some_and(|p| p.at.is_some()));
    window.until_shown("Value at ");
    let probe = window.app().probe(&output).expect("it is read").clone();
    let sample = probe.at.expect("a point");
    // The test picture is `column + row + tick`, modulo 256.
    let expected = (sample.px.0 as u64 + sample.px.1 as u64 + probe.seq) as u8;
    assert_eq!(sample.values, [f32::from(expected)]);
    assert!((24..40).contains(&sample.px.0) && (16..32).contains(&sample.px.1), "{:?}", sample.px);

    input::drag(&mut window.harness, viewer.center() - vec2(100.0, 0.0), viewer.center() + vec2(100.0, 0.0));
    window.until("a profile", |app| app.probe(&output).is_some_and(|p| p.profile.is_some()));
    window.until_shown("Profile over");
    let profile = window.app().probe(&output).and_then(|p| p.profile.clone()).expect("a line");
    let values = &profile.values[0];
    assert!(values.len() > 8, "{values:?}");
    let mut steps = values.windows(2).map(|w| (w[1] as i32 - w[0] as i32).rem_euclid(256));
    assert!(steps.all(|step| matches!(step, 0 | 1)), "{values:?}");
    // Escape takes the line away, then closes the viewer.
    window.key(NONE, Key::Escape);
    window.steps(2);
    assert!(window.harness.query_by_label_contains("Profile over").is_none() && window.app().viewed().is_some());
    // By keys alone: a crosshair, and the ends of a line.
    for key in [Key::ArrowRight, Key::Enter, Key::ArrowDown, Key::ArrowDown, Key::Enter] {
        window.key(NONE, key);
    }
    window.until("a profile by keys", |app| app.probe(&output).is_some_and(|p| p.profile.is_some()));
    window.key(NONE, Key::Escape);
    window.key(NONE, Key::Escape);
    assert_eq!(window.app().viewed(), None);
    let report = window.close();
    nothing_lost(&folder, &report);
}
