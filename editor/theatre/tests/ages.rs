//! Old pictures in the theatre say how old they are.

use crate::common::has_plugin;
use crate::common::window::Window;
use panoscope_editor_model::session::Phase;
use panoscope_graph::ParamValue;

/// A view whose light is as old as `age_ms` says.
const GRAPH: &str = r#"plugins = ["flow", "fixtures"]
[nodes.scope]
type = "aged"
params = { age_ms = 0.0, media_ms = 20.0 }
[nodes.sink]
type = "drain"
inputs = { image = "scope.image" }
[preset]
views = ["scope.image"]
"#;

#[test]
fn a_view_of_a_stream_that_buffers_says_how_old_it_is() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("ages", GRAPH);
    window.until("a fresh picture needs no notice", |t| t.has_picture() && t.notices().is_empty());
    let engine = window.theatre().session().expect("it runs here").handle().engine().expect("it runs");
    engine.set_param("scope", "age_ms", ParamValue::Float(2000.0)).expect("it is in range");
    window.until_notice("Image is 2.");
    assert_eq!(window.theatre().session().expect("it runs here").status().phase, Phase::Running);
    engine.set_param("scope", "age_ms", ParamValue::Float(0.0)).expect("it is in range");
    window.until("the notice goes with its cause", |t| t.notices().is_empty());
}
