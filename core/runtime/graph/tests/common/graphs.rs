//! Valid graphs of the nodes in [`super::catalog`].

/// The example of the documents.
pub const PANORAMA: &str = r#"# Wide view from two cameras.
name = "panorama"
mode = "live"                 # live: the newest frame wins
plugins = ["phantom", "stitch", "sinks"]

[nodes.scope]
type = "phantom"
params = { seed = 7 }

[nodes.register]
type = "register_surf"
inputs = { left = "scope.left", right = "scope.right" }
params = { roi = true, scale = 2 }

[nodes.wide]
type = "composite"
inputs = { left = "scope.left", right = "scope.right", homography = "register.homography" }

[nodes.out]
type = "write_video"
inputs = { image = "wide.panorama" }
params = { path = "out/panorama.mkv" }

[preset]                       # what a surgeon may touch, and how far
pinned = [ { param = "wide.blend_px", range = [0, 40], label = "Seam softness" } ]
views = ["wide.panorama", { from = "scope.left", label = "Left camera" }]
"#;

/// Every key that nodes and inputs can have.
pub const EVERY_KEY: &str = r#"
mode = "batch"
plugins = ["phantom", "tools", "arm", "overlay", "sinks", "capture", "filters_c", "filters_cpp"]
[editor]
scope = { x = 1.5, y = 2 }
[nodes.show]
type = "overlay"
inputs.image = "scope.left"
inputs.tip = { from = "tip.tip", align = "latest", queue = 3 }
on_fault = "bypass"
budget_ms = 4
max_rate_hz = 12.5
cpu = 1
[nodes.scope]
type = "phantom"
inputs.camera_pose = { from = "arm.camera_pose", delay = 1 }
[nodes.tip]
type = "tool_tip"
inputs = { detections = "scope.detections", depth = { from = "scope.depth", align = "exact" } }
[nodes.pid]
type = "arm_pid"
inputs = { tip = "tip.tip", joints = { from = "arm.joints", delay = 1 } }
[nodes.arm]
type = "arm_sim"
inputs.joints = "pid.joints"
[nodes.room]
type = "capture"
[nodes.edge]
type = "filters_c/edges"
inputs.image = "room.left"
[nodes.pics]
type = "write_images"
inputs.images = ["show.image", { from = "scope.right" }, { from = "edge.image", align = "nearest", tolerance_ms = 5 }]
[nodes.see]
type = "preview"
inputs.packet = { from = "tip.tip", align = "latest", trigger = true }
"#;
