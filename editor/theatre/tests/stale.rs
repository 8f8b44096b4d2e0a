//! An image that is too old is never shown as a present one: it is dimmed and framed, or another one stands in for it.

use std::time::{Duration, Instant};

use crate::common::has_plugin;
use crate::common::program::signal;
use crate::common::window::{GRAPH, Window};
use eframe::egui::epaint::ClippedShape;
use eframe::egui::{Color32, Rect, Shape, TextureId};
use egui_kittest::kittest::Queryable;
use panoscope_graph::ParamValue;
use panoscope_theatre::Theatre;

/// From the last image on, no image is bright after this time.
const DIMMED_AFTER: Duration = Duration::from_millis(1200);
/// How long it is looked at.
const WATCHED: Duration = Duration::from_secs(3);

/// Two cameras; one of them falls silent on request. Two stages depend on it.
const TWO: &str = r#"plugins = ["flow", "fixtures"]
[nodes.second]
type = "chaos_source"
params = { harm = "nothing", first = 1000000000, ticks = 1000000000 }
[nodes.camera]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 30.0 }
[nodes.late]
type = "pass_blocking"
inputs = { image = "second.image" }
[nodes.more]
type = "pass_blocking"
inputs = { image = "second.image" }
[nodes.a]
type = "drain"
inputs = { image = "late.image" }
[nodes.b]
type = "drain"
inputs = { image = "more.image" }
[nodes.c]
type = "drain"
inputs = { image = "camera.image" }
[preset]
views = ["late.image", "more.image", "second.image", "camera.image"]
"#;

/// The images of a frame: where each is, and what it is multiplied with.
fn images(shapes: &[ClippedShape]) -> Vec<(Rect, Color32)> {
    fn collect(shape: &Shape, found: &mut Vec<(Rect, Color32)>) {
        match shape {
            Shape::Mesh(mesh) if mesh.texture_id != TextureId::default() => {
                found.push((mesh.calc_bounds(), mesh.vertices[0].color));
            }
            Shape::Vec(all) => all.iter().for_each(|one| collect(one, found)),
            _ => {}
        }
    }
    let mut found = Vec::new();
    shapes.iter().for_each(|clipped| collect(&clipped.shape, &mut found));
    found
}

fn shown(window: &Window) -> Vec<(Rect, Color32)> {
    images(&window.harness.output().shapes)
}

/// Draws until a number of bright images is shown.
fn until_bright(window: &mut Window, count: usize) {
    let until = Instant::now() + crate::common::PATIENCE;
    while shown(window).iter().filter(|(_, tint)| *tint == Color32::WHITE).count() < count {
        assert!(Instant::now() < until, "{count} images: {:?}", shown(window));
        std::thread::sleep(Duration::from_millis(15));
        window.harness.step();
    }
}

fn set(window: &Window, node: &str, param: &str, value: ParamValue) {
    let engine = window.theatre().session().expect("it runs here").handle().engine().expect("it runs");
    engine.set_param(node, param, value).expect("it is in range");
}

#[test]
fn views_of_a_lost_camera_are_dimmed_or_withdrawn_and_the_living_one_is_shown() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("stale_lost", TWO);
    until_bright(&mut window, 4);
    set(&window, "second", "first", ParamValue::Int(0));
    let silent = Instant::now();
    let mut frames = 0;
    while silent.elapsed() < WATCHED {
        // Of the frame that is drawn from here on.
        let is_late = silent.elapsed() > DIMMED_AFTER;
        window.harness.step();
        if !is_late {
            continue;
        }
        frames += 1;
        let living: Vec<Rect> =
            window.harness.query_all_by_label_contains("View Camera").map(|view| view.rect()).collect();
        let all = shown(&window);
        for (image, tint) in &all {
            assert!(
                *tint != Color32::WHITE || living.iter().any(|view| view.contains(image.center())),
                "bright {:?} after the last image: {image:?}, the living camera at {living:?}",
                silent.elapsed()
            );
        }
        // In place of the main view, and at its own place.
        assert_eq!(all.iter().filter(|(_, tint)| *tint == Color32::WHITE).count(), 2, "{all:?}");
        let withdrawn = window.harness.get_by_label("View More").rect();
        assert!(all.iter().all(|(image, _)| !withdrawn.contains(image.center())), "{withdrawn:?} of {all:?}");
        let lost = window.harness.get_by_label("View Second").rect();
        assert!(all.iter().any(|(image, _)| lost.contains(image.center())), "it stays, dimmed: {all:?}");
        assert!(window.harness.query_by_label("View Camera image camera (in place of Late)").is_some());
    }
    assert!(frames > 3, "{frames} frames");
    assert!(window.notices()[0].starts_with("Second image camera lost"), "{:?}", window.notices());
    // All is bright again when it is back.
    set(&window, "second", "first", ParamValue::Int(1_000_000_000));
    window.until("nothing is wrong", |t| t.notices().is_empty());
    until_bright(&mut window, 4);
}

#[test]
fn a_stream_that_delivers_old_light_is_dimmed() {
    if !has_plugin("flow") {
        return;
    }
    let text = "plugins = [\"flow\", \"fixtures\"]\n[nodes.scope]\ntype = \"aged\"\nparams = { age_ms = 0.0, media_ms = 20.0 }\n[nodes.sink]\ntype = \"drain\"\ninputs = { image = \"scope.image\" }\n[preset]\nviews = [\"scope.image\"]\n";
    let mut window = Window::open("stale_light", text);
    until_bright(&mut window, 1);
    set(&window, "scope", "age_ms", ParamValue::Float(5000.0));
    window.until_notice("Image is 5.");
    for _ in 0..20 {
        window.harness.step();
        assert!(shown(&window).iter().all(|(_, tint)| *tint != Color32::WHITE), "{:?}", shown(&window));
    }
}

#[test]
fn a_process_that_stands_still_shows_nothing_bright_and_old() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::guarded("stale_process", GRAPH);
    window.until_spare();
    until_bright(&mut window, 2);
    signal(window.worker(), "STOP");
    let stopped = Instant::now();
    while stopped.elapsed() < WATCHED {
        let is_late = stopped.elapsed() > DIMMED_AFTER;
        window.harness.step();
        // A camera's image that is newer comes from the process that took over.
        let is_old = window.theatre().camera_age_ms().is_some_and(|age| age > 1200.0);
        if is_late && is_old {
            assert!(shown(&window).iter().all(|(_, tint)| *tint != Color32::WHITE), "{:?}", shown(&window));
        }
    }
    window.until("all views are back", |t: &Theatre| t.outage().is_none() && t.has_picture());
}
