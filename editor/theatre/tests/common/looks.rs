//! The graph of the golden images.

/// Number of ticks of each source, enough that the window receives the last one.
pub const TICKS: u64 = 40;

/// A small graph with all kinds of widgets; its ticks are the same in every run.
pub const GRAPH: &str = r#"# What is drawn for the kept pictures: two paths, numbers, a setting.
name = "looks"
plugins = ["flow"]

[nodes.camera]
type = "frames"
params = { width_px = 160, height_px = 120, rate_hz = 20.0 }

[nodes.gray]
type = "frames"
params = { width_px = 160, height_px = 120, format = "gray8", rate_hz = 20.0 }

[nodes.calm]
type = "smooth"
inputs = { image = "camera.image" }
params = { past_weight = 100 }

[nodes.level]
type = "level"
inputs = { image = "gray.image" }
params = { spots = [40, 30, 120, 90], window = [30, 20, 100, 80] }

[nodes.sink]
type = "drain"
inputs = { image = "calm.image" }

[preset]
views = [{ from = "calm.image", label = "calm view" }, "gray.image"]
pinned = [{ param = "calm.past_weight", range = [50, 150], label = "calmness" }]
"#;
