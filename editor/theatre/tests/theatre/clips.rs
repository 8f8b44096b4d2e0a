//! Clips of the shown views.

use crate::common::has_plugin;
use crate::common::window::{GRAPH, Window};
use eframe::egui::Key;

#[test]
fn a_clip_that_lacks_frames_goes_on() {
    if !has_plugin("flow") || !has_plugin("sinks") {
        return;
    }
    // Takes each third frame or less, and drops the others for all.
    let slow = "\n[nodes.slow]\ntype = \"pass_blocking\"\ninputs = { image = \"camera.image\" }\nparams = { wait_ms = 100.0 }\n[nodes.slow_end]\ntype = \"drain\"\ninputs = { image = \"slow.image\" }\n";
    let mut window = Window::open("lacking", &(GRAPH.to_owned() + slow));
    window.until("a picture", |t| t.has_picture());
    window.key(Key::R);
    window.until("the clip goes on for two seconds", |t| {
        let engine = t.session().expect("it runs here").handle().engine().expect("it runs");
        engine.report().nodes.get("theatre_clip").is_some_and(|clip| clip.lacking > 5 && clip.count > 20)
    });
    assert!(window.theatre().clip_file().is_some());
}
