//! A fixed catalog after the node table of the design, so that messages do not change when a plugin does.
#![allow(dead_code)]

pub mod graphs;

use panoscope_graph::{
    Catalog, NodeKind, NodeSetup, NodeType, Offer, PacketType, Param, ParamKind, ParamProblem, ParamValue, Pick,
    PluginProblem, Port, Severity, Validator,
};

/// `name: packet [format...]`, with `?` after the name for an optional and `*` for a list input.
fn port(text: &str) -> Port {
    let (name, packet) = text.split_once(": ").expect("name: packet");
    let mut words = packet.split(' ');
    Port {
        name: name.trim_end_matches(['?', '*']).to_owned(),
        doc: format!("The {} of the node.", name.trim_end_matches(['?', '*'])),
        packet: PacketType {
            name: words.next().expect("a packet").to_owned(),
            formats: words.map(str::to_owned).collect(),
            layout_hash: 0,
        },
        optional: name.contains('?'),
        list: name.contains('*'),
    }
}

fn node(plugin: &str, name: &str, inputs: &[&str], outputs: &[&str]) -> NodeType {
    NodeType {
        name: name.to_owned(),
        plugin: plugin.to_owned(),
        family: plugin.to_owned(),
        doc: format!("Node `{name}` of the test catalog."),
        inputs: inputs.iter().map(|p| port(p)).collect(),
        outputs: outputs.iter().map(|p| port(p)).collect(),
        ..NodeType::default()
    }
}

fn source(mut node: NodeType) -> NodeType {
    node.source = true;
    node.kind = NodeKind::Blocking;
    node
}

fn sink(mut node: NodeType) -> NodeType {
    node.side_effects = true;
    node.kind = NodeKind::Blocking;
    node
}

fn with(mut node: NodeType, params: Vec<Param>) -> NodeType {
    node.params = params;
    node
}

fn param(name: &str, unit: &str, doc: &str, kind: ParamKind) -> Param {
    Param {
        name: name.to_owned(),
        doc: doc.to_owned(),
        unit: unit.to_owned(),
        kind,
        reopen: false,
        pick: Pick::None,
        writes: false,
        shipped: false,
    }
}

fn int(name: &str, unit: &str, doc: &str, default: i64, min: i64, max: i64, step: Option<i64>) -> Param {
    param(name, unit, doc, ParamKind::Int { default, min: Some(min), max: Some(max), step })
}

fn float(name: &str, unit: &str, doc: &str, default: f64, min: f64, max: f64) -> Param {
    param(name, unit, doc, ParamKind::Float { default, min: Some(min), max: Some(max), step: None })
}

fn bool(name: &str, doc: &str, default: bool) -> Param {
    param(name, "", doc, ParamKind::Bool { default })
}

fn path(name: &str, doc: &str, default: &str, must_exist: bool) -> Param {
    param(name, "", doc, ParamKind::Path { default: default.to_owned(), must_exist })
}

fn written(name: &str, doc: &str, default: &str) -> Param {
    Param { writes: true, ..path(name, doc, default, false) }
}

fn checked(
    mut node: NodeType,
    check: impl Fn(&NodeSetup<'_>) -> Vec<ParamProblem> + Send + Sync + 'static,
) -> NodeType {
    node.validator = Some(Validator::new(check));
    node
}

fn problem(severity: Severity, param: Option<usize>, message: String, help: &str) -> ParamProblem {
    ParamProblem { severity, param, message, help: help.to_owned() }
}

/// As `rectify` does.
fn wants_calibration(setup: &NodeSetup<'_>) -> Vec<ParamProblem> {
    let message = "input `calibration` is not connected: there is nothing to rectify by".to_owned();
    match setup.wiring.map(|w| w.connections[2]) {
        Some(0) => vec![problem(Severity::Error, None, message, "connect it, or set bypass = true")],
        _ => Vec::new(),
    }
}

/// As `stereo_sgbm` does; odd window sides are warned of too.
fn penalties_in_order(setup: &NodeSetup<'_>) -> Vec<ParamProblem> {
    let [ParamValue::Int(small), ParamValue::Int(large), ParamValue::Path(mask)] = setup.params else {
        return Vec::new();
    };
    let mut problems = Vec::new();
    if small >= large {
        let message = format!("`small_penalty` is {small}, not below `large_penalty`, which is {large}");
        problems.push(problem(Severity::Error, Some(0), message, "lower `small_penalty` or raise `large_penalty`"));
    }
    if *large > 110 {
        let message = format!("`large_penalty` is {large}: edges bleed above 110");
        problems.push(problem(Severity::Warning, Some(1), message, ""));
    }
    if mask.extension().is_some_and(|e| e == "jpg") {
        problems.push(problem(Severity::Error, Some(2), "`mask` is a JPEG, which blurs".to_owned(), "give a .png"));
    }
    problems
}

fn choice(name: &str, doc: &str, choices: &[&str]) -> Param {
    let choices: Vec<String> = choices.iter().map(|c| (*c).to_owned()).collect();
    param(name, "", doc, ParamKind::Choice { default: choices[0].clone(), choices })
}

/// The catalog of all tests.
pub fn catalog() -> Catalog {
    let stamp = |mut node: NodeType, hash| {
        for port in node.inputs.iter_mut().chain(&mut node.outputs).filter(|p| p.packet.name == "vitals") {
            port.packet.layout_hash = hash;
        }
        node
    };
    let reopen = |mut param: Param| {
        param.reopen = true;
        param
    };
    let mut node_types = vec![
        with(
            source(node(
                "capture",
                "capture",
                &[],
                &["left: image bgr8", "right: image bgr8", "calibration: calibration"],
            )),
            vec![
                param(
                    "source",
                    "",
                    "Device, file, image pattern or pipeline.",
                    ParamKind::Text { default: "0".to_owned() },
                ),
                bool("loop", "Start again at the end of a file.", true),
                float("rate_hz", "Hz", "Frames per second; 0 for the source's own.", 0.0, 0.0, 240.0),
            ],
        ),
        with(
            source(node(
                "phantom",
                "phantom",
                &["camera_pose?: pose"],
                &[
                    "left: image bgr8",
                    "right: image bgr8",
                    "calibration: calibration",
                    "disparity: disparity",
                    "depth: depth",
                    "pose: pose",
                    "homography: homography",
                    "wide: image bgr8",
                    "detections: detections",
                    "instances: instances",
                    "tip: tip",
                    "thermal: image f32",
                ],
            )),
            vec![int("seed", "", "Seed of texture and motion.", 1, 0, 1_000_000, None)],
        ),
        checked(
            node(
                "stereo",
                "rectify",
                &["left: image", "right: image", "calibration?: calibration"],
                &["left: image bgr8", "right: image bgr8", "calibration: calibration"],
            ),
            wants_calibration,
        ),
        checked(
            with(
                node("stereo", "stereo_sgbm", &["left: image gray8", "right: image gray8"], &["disparity: disparity"]),
                vec![
                    int("small_penalty", "", "Charge for a change of disparity by one.", 10, 1, 120, None),
                    int("large_penalty", "", "Charge for a larger change.", 100, 1, 120, None),
                    path("mask", "Picture of what is matched.", "", false),
                ],
            ),
            penalties_in_order,
        ),
        with(
            node(
                "stereo",
                "stereo_bm",
                &["left: image gray8", "right: image gray8", "roi?: roi"],
                &["disparity: disparity", "disparity_right: disparity"],
            ),
            vec![
                reopen(int("search_px", "px", "Width of the disparity search.", 64, 16, 256, Some(16))),
                int("block_px", "px", "Side of the compared block.", 15, 5, 51, Some(2)),
                param(
                    "roi",
                    "px",
                    "Region searched: x, y, width, height.",
                    ParamKind::Floats { default: vec![], min_len: 0, max_len: Some(4) },
                ),
            ],
        ),
        with(
            node("stereo", "measure", &["cloud?: cloud", "depth?: depth"], &["table: table"]),
            vec![param(
                "points",
                "px",
                "Pixels to measure between: x and y of each.",
                ParamKind::Floats { default: vec![0.0, 0.0, 1.0, 1.0], min_len: 4, max_len: Some(16) },
            )],
        ),
        node(
            "stereo",
            "reproject",
            &["image: image bgr8", "disparity: disparity", "calibration: calibration"],
            &["cloud: cloud", "depth: depth"],
        ),
        with(
            node(
                "stitch",
                "register_surf",
                &["left: image gray8", "right: image gray8"],
                &["homography: homography", "roi_left: roi", "roi_right: roi"],
            ),
            vec![
                bool("roi", "Search only where the views overlapped before.", true),
                int("scale", "", "Images are reduced by this before the search.", 1, 1, 8, None),
                float("ratio", "", "Ratio test of the matches.", 0.7, 0.1, 1.0),
                choice("method", "How outliers are refused.", &["ransac", "lmeds", "prosac"]),
            ],
        ),
        with(
            node(
                "stitch",
                "composite",
                &[
                    "left?: image bgr8",
                    "right?: image bgr8",
                    "homography?: homography",
                    "views?*: image bgr8",
                    "homographies?*: homography",
                ],
                &["panorama: image bgr8", "mask: mask"],
            ),
            vec![int("blend_px", "px", "Width of the blend along the seam.", 20, 0, 40, None)],
        ),
        with(
            node("tools", "yolo", &["image: image bgr8"], &["detections: detections"]),
            vec![
                reopen(path("model", "ONNX file.", "", true)),
                float("threshold", "", "Lowest score kept.", 0.5, 0.0, 1.0),
            ],
        ),
        node(
            "tools",
            "tool_tip",
            &["detections?: detections", "instances?: instances", "disparity?: disparity", "depth?: depth"],
            &["tip: tip"],
        ),
        node("arm", "arm_pid", &["tip: tip", "joints?: joints"], &["joints: joints"]),
        node("arm", "arm_sim", &["joints: joints"], &["joints: joints", "camera_pose: pose"]),
        node("arm", "arm_strict", &["tip: tip", "joints: joints"], &["joints: joints"]),
        node(
            "overlay",
            "overlay",
            &["image: image bgr8", "detections?: detections", "tip?: tip", "table?: table"],
            &["image: image bgr8"],
        ),
        with(
            sink(node("sinks", "write_video", &["image: image bgr8 gray8"], &[])),
            vec![
                written("path", "File to write.", "out/video.mkv"),
                float("fps", "Hz", "Frames per second of the file.", 30.0, 1.0, 240.0),
            ],
        ),
        with(
            sink(node("sinks", "write_images", &["images*: image"], &[])),
            vec![written("path", "Files to write; {seq} is the tick.", "out/{seq}.png")],
        ),
        sink(node("sinks", "write_table", &["table: table"], &[])),
        sink(node("sinks", "preview", &["packet: any"], &[])),
        // Two plugins with a node type of one name, and two with other ideas of one packet.
        node("filters_c", "edges", &["image: image gray8"], &["image: image gray8"]),
        node("filters_cpp", "edges", &["image: image gray8"], &["image: image gray8"]),
        stamp(source(node("monitor", "vitals", &[], &["vitals: vitals"])), 0x1111),
        stamp(node("monitor_view", "vitals_view", &["vitals: vitals"], &["image: image bgr8"]), 0x2222),
    ];
    node_types.push(with(
        node("tools", "classify", &["image: image bgr8"], &["detections: detections"]),
        vec![path("labels", "Names of the classes.", "labels.txt", true)],
    ));
    let plugins = [
        "arm",
        "capture",
        "filters_c",
        "filters_cpp",
        "monitor",
        "monitor_view",
        "overlay",
        "phantom",
        "sinks",
        "stereo",
        "stitch",
        "tools",
    ];
    Catalog {
        offers: vec![Offer {
            plugin: "segment".to_owned(),
            node_types: vec!["superpixels".to_owned(), "watershed".to_owned()],
        }],
        plugins: plugins.iter().map(|p| (*p).to_owned()).collect(),
        node_types,
        passed_over: Vec::new(),
        problems: vec![
            PluginProblem {
                plugin: "old_filters".to_owned(),
                file: "plugins/libold_filters.so".to_owned(),
                message: "it was built for ABI 1, this program speaks ABI 2".to_owned(),
                help: "build the plugin again with this version's headers".to_owned(),
            },
            PluginProblem {
                plugin: "torn".to_owned(),
                file: "plugins/libtorn.so".to_owned(),
                message: "the file is cut off: its sections end at byte 81920, the file at 4096".to_owned(),
                help: "copy or build it again".to_owned(),
            },
        ],
    }
}
