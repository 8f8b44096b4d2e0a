//! Graphs whose frames stay on the GPU: the same bytes, copies only where the other side reads, also with live changes and isolated nodes.
//! Mesa's Vulkan driver plays the GPU on the processor.

use std::collections::BTreeMap;
use std::path::Path;

use panoscope_engine::memory::{DeviceMemory, open_device_by};
use panoscope_engine::{Options, Outcome, Report};
use panoscope_graph::ParamValue;
use panoscope_tests::{DisturbedRun, ready, run_disturbed, scratch};

const FRAMES: u64 = 12;

/// Views shrunk and matched; what is made of them is read by nodes on the processor.
const GRAPH: &str = r#"
mode = "batch"
plugins = ["flow", "phantom", "stereo", "stitch", "overlay"]
[nodes.scope]
type = "phantom"
params = { width = 320, height = 240 }
[nodes.views]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
params = { scale = 2, device = "DEVICE" }
[nodes.passes]
type = "pass"
inputs = { image = "views.left" }
[nodes.match]
type = "stereo_bm"
inputs = { left = "passes.image", right = "views.right" }
params = { device = "DEVICE" }
[nodes.marks]
type = "overlay"
inputs = { image = "views.left", detections = "scope.detections" }
[nodes.register]
type = "register_grid"
inputs = { left = "views.left", right = "views.right", disparity = "match.disparity", calibration = "views.calibration" }
[nodes.wide]
type = "composite"
inputs = { left = "views.left", right = "views.right", homography = "register.homography" }
params = { device = "DEVICE" }
[nodes.end]
type = "drain"
inputs = { image = "marks.image" }
[nodes.end_wide]
type = "drain"
inputs = { image = "wide.panorama" }
"#;

/// Depth, which the processor reads alone.
const DEPTH: &str = r#"
mode = "batch"
plugins = ["phantom", "stereo"]
[nodes.scope]
type = "phantom"
params = { width = WIDTH, height = HEIGHT, zoom = 0.45, distortion_k1 = 0.1 }
[nodes.views]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
params = { scale = PICTURE_SCALE, device = "DEVICE" }
[nodes.match]
type = "stereo_bm"
inputs = { left = "views.left", right = "views.right", mask_left = { from = "views.mask_left", optional = true }, mask_right = { from = "views.mask_right", optional = true } }
params = { scale = SCALE, device = "DEVICE" }
[nodes.smooth]
type = "disparity_wls"
inputs = { image = "views.left", disparity = "match.disparity", disparity_right = "match.disparity_right", mask = { from = "views.mask_left", optional = true } }
params = { scale = SCALE, device = "DEVICE" }
[nodes.points]
type = "reproject"
inputs = { image = "views.left", disparity = "smooth.disparity", calibration = "views.calibration" }
params = { device = "DEVICE" }
[nodes.length]
type = "measure"
inputs = { depth = "points.depth", calibration = "views.calibration" }
params = { points = [120, 100, 200, 140] }
"#;

/// What of a surgeon's graph the processor makes of frames on the GPU: tips, marks, lengths, a turning surface, a registration.
const PARTS: &str = r#"
mode = "batch"
plugins = ["flow", "phantom", "stereo", "stitch", "tools", "overlay"]
[nodes.scope]
type = "phantom"
params = { width = 643, height = 362, tools = 1, tool_motion = "strokes", distortion_k1 = -0.02 }
[nodes.views]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
params = { device = "gpu" }
[nodes.match]
type = "stereo_bm"
inputs = { left = "views.left", right = "views.right" }
params = { device = "gpu" }
[nodes.smooth]
type = "disparity_wls"
inputs = { image = "views.left", disparity = "match.disparity", disparity_right = "match.disparity_right" }
params = { device = "gpu" }
[nodes.points]
type = "reproject"
inputs = { image = "views.left", disparity = "smooth.disparity", confidence = "smooth.confidence", calibration = "views.calibration" }
params = { device = "gpu" }
[nodes.register]
type = "register_grid"
inputs = { disparity = "match.disparity", calibration = "views.calibration" }
[nodes.tip]
type = "tool_tip"
inputs = { detections = "scope.detections", image = "views.left", right = "views.right", disparity = "match.disparity", calibration = "views.calibration" }
[nodes.length]
type = "measure"
inputs = { cloud = "points.cloud", calibration = "views.calibration", confidence = "smooth.confidence", tips = ["tip.tip"] }
params = { kind = "depth", points = [240, 200, -1, 50, 642, 361] }
[nodes.turn]
type = "turntable"
inputs = { cloud = "points.cloud", calibration = "views.calibration" }
params = { width = 160, height = 100, step = 0 }
[nodes.way]
type = "trajectory"
inputs = { image = "views.left", tip = "tip.tip", calibration = "views.calibration", detections = "scope.detections", camera_pose = "scope.pose" }
params = { device = "DEVICE" }
[nodes.marks]
type = "overlay"
inputs = { image = "way.image", detections = "scope.detections", tip = "tip.tip", text = "way.text" }
params = { label = "tools", words = "below", device = "DEVICE" }
[nodes.screen]
type = "screen"
inputs = { main = "marks.image" }
params = { width = 240, height = 135, device = "DEVICE" }
[nodes.end]
type = "drain"
inputs = { image = "screen.image" }
[nodes.end_turn]
type = "drain"
inputs = { image = "turn.image" }
"#;

fn graph(device: &str) -> String {
    GRAPH.replace("DEVICE", device)
}

/// The graph of depth with rectified views of one size, shrunk by `picture_scale` first and by `scale` to be matched.
fn depth(device: &str, (picture_scale, scale): (usize, usize)) -> String {
    let [width, height] = [322, 241].map(|size| (size * picture_scale).to_string());
    let numbers = [("WIDTH", width), ("HEIGHT", height), ("PICTURE_SCALE", picture_scale.to_string())];
    let text = numbers.iter().fold(DEPTH.replace("DEVICE", device), |text, (name, value)| text.replace(name, value));
    text.replace("SCALE", &scale.to_string())
}

/// Views of known geometry, joined by a homography and by a mesh.
const PANORAMAS: &str = r#"
mode = "batch"
plugins = ["flow", "phantom", "stereo", "stitch"]
[nodes.scope]
type = "phantom"
params = { width = 321, height = 241, distortion_k1 = -0.1 }
[nodes.views]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
params = { device = "DEVICE" }
[nodes.wide]
type = "composite"
inputs = { left = "views.left", right = "views.right", homography = "scope.homography"MASKS }
params = { device = "DEVICE", blend = "feather"WIDE }
[nodes.bent]
type = "composite_mesh"
inputs = { left = "views.left", right = "views.right", homography = "scope.homography", disparity = "scope.disparity" }
params = { device = "DEVICE" }
[nodes.passes]
type = "pass"
inputs = { image = "wide.panorama" }
[nodes.end]
type = "drain"
inputs = { image = "passes.image" }
[nodes.shown]
type = "READER"
inputs = { image = "bent.panorama" }
"#;

/// The graph with more inputs and parameters of the composite, and a node that reads the panorama of the mesh.
fn panoramas(masks: &str, wide: &str, reader: &str) -> String {
    PANORAMAS.replace("MASKS", masks).replace("WIDE", wide).replace("READER", reader)
}

/// A panorama that was made on the GPU with text below it, on a screen next to a view from there and one from the host.
const SCREEN: &str = r#"
mode = "batch"
plugins = ["flow", "phantom", "stereo", "stitch", "overlay"]
[nodes.scope]
type = "phantom"
params = { width = 321, height = 241, distortion_k1 = -0.1 }
[nodes.views]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
params = { device = "gpu" }
[nodes.wide]
type = "composite"
inputs = { left = "views.left", right = "views.right", homography = "scope.homography" }
params = { device = "gpu" }
[nodes.state]
type = "overlay"
inputs = { image = "wide.panorama", homography = "scope.homography", text = "wide.gain_text" }
params = { label = "panorama", show_outline = false, words = "below", max_aspect = 1.45, device = "DEVICE" }
[nodes.screen]
type = "screen"
inputs = { main = "state.image", side = ["views.left", "scope.right"] }
params = { width = 240, height = 135, device = "DEVICE" }
[nodes.end]
type = "drain"
inputs = { image = "screen.image" }
"#;

/// Offers the device that the processor plays; `false`, reported as a skip, without one.
fn has_device() -> bool {
    open_device_by(|| Ok(panoscope_gpu::Gpu::open(Some("software")).map_err(|e| e.to_string())?.into_table()));
    match DeviceMemory::open() {
        Ok(_) => true,
        Err(reason) => {
            panoscope_testing::skipped!("{reason}; install mesa-vulkan-drivers for a device that the processor plays");
            false
        }
    }
}

fn disturbed(folder: &Path, text: &str) -> DisturbedRun {
    let run = run_disturbed(folder, text, Options { frames: Some(FRAMES), ..Options::default() }, |_| ());
    assert_eq!(run.outcome, Outcome::Done, "{:?}", run.faults);
    assert!(run.faults.is_empty(), "{:?}", run.faults);
    run
}

/// A run that nobody listens to: copies are those of the nodes.
fn plain(folder: &Path, text: &str) -> Report {
    let ready = ready(&folder.join("graph.toml"), text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let options = Options { frames: Some(FRAMES), threads: 2, ..Options::default() };
    let live = ready.start(options).unwrap_or_else(|error| panic!("{error}"));
    while !live.engine().wait(None) {}
    live.engine().close(std::time::Duration::from_secs(30));
    live.engine().report()
}

/// Ports whose frames do not depend on the device to the last bit.
const SAME: [&str; 4] = ["views.left", "views.right", "passes.image", "marks.image"];

#[test]
fn frames_on_the_gpu_are_those_of_the_processor() {
    if !has_device() {
        return;
    }
    let folder = scratch("gpu-same");
    let [cpu, gpu] = ["cpu", "gpu"].map(|device| disturbed(&folder, &graph(device)));
    for port in SAME {
        assert_eq!(gpu.port(port), cpu.port(port), "{port}");
        assert_eq!(gpu.port(port).len(), FRAMES as usize, "{port}");
    }
    let again = disturbed(&folder, &graph("gpu"));
    assert_eq!(again.packets, gpu.packets, "two runs on one device");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn frames_are_copied_only_where_the_other_side_reads() {
    if !has_device() {
        return;
    }
    let folder = scratch("gpu-copies");
    let [cpu, gpu] = ["cpu", "gpu"].map(|device| plain(&folder, &graph(device)));
    let copies = |report: &Report, node: &str| report.nodes[node].copies;
    assert_eq!(copies(&gpu, "views"), 2 * FRAMES, "both views reach the GPU once");
    assert_eq!(copies(&gpu, "passes"), 0, "a frame that is handed on stays where it is");
    let all = |report: &Report| report.nodes.values().map(|node| node.copies).sum::<u64>();
    // The first disparity map comes back, of the others the registration reads a part; views and panorama do not.
    assert_eq!(
        all(&gpu) - all(&cpu),
        2 * FRAMES + 1,
        "{:?}",
        gpu.nodes.iter().map(|(id, n)| (id, n.copies)).collect::<Vec<_>>()
    );
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn panoramas_of_views_on_the_gpu_are_made_there() {
    if !has_device() {
        return;
    }
    let folder = scratch("gpu-panoramas");
    let copies = |masks: &str, wide: &str, reader: &str| {
        let text = panoramas(masks, wide, reader);
        let [cpu, gpu] = ["cpu", "gpu"].map(|device| plain(&folder, &text.replace("DEVICE", device)));
        let all = |report: &Report| report.nodes.values().map(|node| node.copies).sum::<u64>();
        all(&gpu) - all(&cpu)
    };
    let masks = ", mask_left = \"scope.visible\", mask_right = \"scope.visible\"";
    let crop = ", crop = \"filled\"";
    // Both views reach the GPU.
    assert_eq!(copies("", "", "drain"), 2 * FRAMES);
    assert_eq!(copies("", "", "transpose"), 3 * FRAMES, "a panorama that is read on the processor comes back");
    assert_eq!(copies("", ", border = \"fade\"", "drain"), 2 * FRAMES, "what the processor fades is no frame yet");
    assert_eq!(copies(masks, crop, "drain"), 2 * FRAMES, "masks say what of the views is lit");
    // Without masks the processor looks at both views, every quarter of a second: at frames 0 and 8.
    assert_eq!(copies("", crop, "drain"), 2 * FRAMES + 4);
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn depth_stays_on_the_gpu() {
    if !has_device() {
        return;
    }
    let folder = scratch("gpu-depth");
    // Both views reach the GPU; lengths read parts of the depth.
    let check = |report: &Report| {
        // The mask of what the left camera covers is made once.
        let expected = [("views", 2 * FRAMES), ("match", 0), ("smooth", 1), ("points", 0), ("length", 0)];
        for (node, copies) in expected {
            assert_eq!(report.nodes[node].copies, copies, "{node}");
        }
    };
    for scales in [(1, 1), (1, 2), (2, 3)] {
        let [cpu, gpu] = ["cpu", "gpu"].map(|device| plain(&folder, &depth(device, scales)));
        assert!(cpu.nodes.values().all(|node| node.copies == 0));
        check(&gpu);
        assert!(gpu.nodes["match"].metrics["matched_pct"] > 10.0, "{scales:?}: {:?}", gpu.nodes["match"].metrics);
    }
    // Of a cloud too, also where holes are filled.
    let cloud = depth("gpu", (1, 2)).replace("depth = \"points.depth\"", "cloud = \"points.cloud\"");
    check(&plain(&folder, &cloud));
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_panorama_on_the_gpu_reaches_the_screen_without_being_read() {
    if !has_device() {
        return;
    }
    let folder = scratch("gpu-screen");
    let texts = ["cpu", "gpu"].map(|device| SCREEN.replace("DEVICE", device));
    let [cpu, gpu] = texts.each_ref().map(|text| {
        let copies = plain(&folder, text).nodes.into_iter().map(|(node, seen)| (node, seen.copies));
        copies.filter(|(_, copies)| *copies > 0).collect::<BTreeMap<_, _>>()
    });
    let counts = |list: &[(&str, u64)]| list.iter().map(|(node, copies)| ((*node).to_owned(), *copies)).collect();
    // Both views reach the GPU. The processor reads the panorama for the bar, and the view for the screen.
    assert_eq!(cpu, counts(&[("views", 2 * FRAMES), ("state", FRAMES), ("screen", FRAMES)]));
    assert_eq!(gpu, counts(&[("views", 2 * FRAMES)]));
    let [cpu, gpu] = texts.each_ref().map(|text| disturbed(&folder, text));
    for port in ["state.image", "screen.image"] {
        assert_eq!(gpu.port(port), cpu.port(port), "{port}");
        assert_eq!(gpu.port(port).len(), FRAMES as usize, "{port}");
    }
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn the_processor_reads_parts_of_frames_on_the_gpu() {
    if !has_device() {
        return;
    }
    let folder = scratch("gpu-parts");
    let text = PARTS.replace("DEVICE", "gpu");
    let copies = plain(&folder, &text).nodes.into_iter().map(|(node, seen)| (node, seen.copies));
    let copies: BTreeMap<_, _> = copies.filter(|(_, copies)| *copies > 0).collect();
    // Both views reach the GPU; the first map comes back to find what the views share.
    let readers = copies.get("register").or(copies.get("tip"));
    assert_eq!((copies.get("views"), readers, copies.len()), (Some(&(2 * FRAMES)), Some(&1), 2), "{copies:?}");
    // In a process of their own nodes get whole frames.
    let mut whole = PARTS.replace("DEVICE", "cpu");
    for node in ["register", "tip", "length", "turn"] {
        let name = format!("[nodes.{node}]\n");
        whole = whole.replace(&name, &format!("{name}isolate = \"apart\"\n"));
    }
    let [expected, seen] = [&whole, &text].map(|text| disturbed(&folder, text));
    for port in
        ["register.homography", "tip.tip", "length.table", "turn.image", "way.image", "marks.image", "screen.image"]
    {
        assert_eq!(seen.port(port), expected.port(port), "{port}");
        assert!(!seen.port(port).is_empty(), "{port}");
    }
    let _ = std::fs::remove_dir_all(&folder);
}

/// Views with padded rows on the GPU, of which one is counted and summed up.
const DIGEST: &str = r#"
mode = "batch"
plugins = ["flow", "phantom", "stereo"]
[nodes.scope]
type = "phantom"
params = { width = 322, height = 242 }
[nodes.views]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
params = { scale = 2, device = "DEVICE" }
[nodes.end]
type = "drain"
inputs = { image = "views.left" }
params = { digest = true }
"#;

#[test]
fn a_digest_does_not_depend_on_the_device() {
    if !has_device() {
        return;
    }
    let folder = scratch("gpu-digest");
    let [cpu, gpu] = ["cpu", "gpu"].map(|device| plain(&folder, &DIGEST.replace("DEVICE", device)).nodes);
    assert_eq!(gpu["end"].metrics["digest"], cpu["end"].metrics["digest"]);
    assert_eq!(gpu["end"].copies, FRAMES, "what is summed up is read");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_device_can_be_changed_while_the_graph_runs() {
    if !has_device() {
        return;
    }
    let folder = scratch("gpu-live");
    let of_depth = ["views", "match", "smooth", "points"];
    for (text, nodes) in [
        (graph("cpu"), &["views", "match", "wide"][..]),
        (depth("cpu", (1, 1)), &of_depth),
        (depth("cpu", (1, 2)), &of_depth),
    ] {
        let cpu = disturbed(&folder, &text);
        let mut turn = 0;
        let options = Options { frames: Some(FRAMES), ..Options::default() };
        let changed = run_disturbed(&folder, &text, options, |engine| {
            turn += 1;
            let device = ["cpu", "gpu"][turn % 2];
            for node in nodes {
                engine
                    .set_param(node, "device", ParamValue::Choice { index: turn % 2, name: device.into() })
                    .expect("a parameter");
            }
        });
        assert!(changed.faults.is_empty() && turn > 0, "{:?}", changed.faults);
        for port in cpu.packets.keys() {
            assert_eq!(changed.port(port).len(), cpu.port(port).len(), "{port}");
        }
        let masks = ["views.mask_left", "views.mask_right"];
        for port in SAME.iter().chain(&masks).filter(|port| cpu.packets.contains_key(**port)) {
            assert_eq!(changed.port(port), cpu.port(port), "{port}");
        }
    }
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn an_isolated_node_computes_on_a_device_of_its_process() {
    if !has_device() {
        return;
    }
    let folder = scratch("gpu-isolated");
    let cpu = disturbed(&folder, &graph("cpu"));
    // SAFETY: this test is the only thread of the process that reads or writes the environment.
    unsafe { std::env::set_var(panoscope_gpu::CHOICE, "software") };
    let text = graph("gpu").replace("type = \"rectify\"", "type = \"rectify\"\nisolate = \"gpu\"");
    let isolated = disturbed(&folder, &text);
    for port in SAME {
        assert_eq!(isolated.port(port), cpu.port(port), "{port}");
    }
    let text = panoramas("", "", "drain").replace("DEVICE", "gpu");
    let here = disturbed(&folder, &text);
    let isolated = disturbed(&folder, &text.replace("type = \"composite", "isolate = \"gpu\"\ntype = \"composite"));
    for port in ["wide.panorama", "bent.panorama"] {
        assert_eq!(isolated.port(port), here.port(port), "{port}");
        assert_eq!(here.port(port).len(), FRAMES as usize, "{port}");
    }
    let _ = std::fs::remove_dir_all(&folder);
}
