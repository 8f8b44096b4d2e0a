//! The window shows what is recorded.

use std::time::{Duration, Instant};

use crate::common::window::{GRAPH, Window};
use crate::common::{PATIENCE, has_plugin};
use egui_kittest::kittest::Queryable;
use panoscope_theatre::Theatre;

#[test]
fn files_that_the_graph_writes_are_shown_with_their_size() {
    if !has_plugin("flow") || !has_plugin("sinks") {
        return;
    }
    let mut window = Window::open("no_sinks", GRAPH);
    window.until("a picture", Theatre::has_picture);
    assert!(window.harness.query_by_label_contains("The graph writes files").is_none());
    drop(window);
    let sink = "\n[nodes.film]\ntype = \"write_video\"\ninputs = { image = \"camera.image\" }\nparams = { path = \"film.mkv\" }\n";
    let text = GRAPH
        .replace("\"fixtures\"]", "\"fixtures\", \"sinks\"]")
        .replace("width_px = 64, height_px = 48", "width_px = 640, height_px = 480")
        + sink;
    let mut window = Window::open("sinks", &text);
    window.until_shown("The graph writes files: film ");
    let until = Instant::now() + PATIENCE;
    while window.harness.query_by_label_contains("film 0 MB").is_some() {
        assert!(Instant::now() < until, "its size does not grow");
        std::thread::sleep(Duration::from_millis(15));
        window.harness.step();
    }
    let film = window.folder.0.join("film.mkv");
    assert!(std::fs::metadata(film).is_ok_and(|film| film.len() > 500_000));
}
