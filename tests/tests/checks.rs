//! What `check` reports in graphs of the real plugins: problems that `run` would refuse or data that it would lose. Every node's own check, files,
//! folders, models.

use std::path::{Path, PathBuf};
use std::process::Command;

use panoscope_engine::{Engine, Options};
use panoscope_graph::{Diagnostics, GraphText, ParamValue, Severity, check};
use panoscope_host::loader::{self as loader, Loader};

/// The diagnostics of a graph text in `folder`.
fn diagnostics(folder: &Path, text: &str) -> Diagnostics {
    let text = GraphText::parse(&folder.join("graph.toml"), text);
    let loader = Loader::search(&loader::search_path(&text.plugin_paths()));
    check(&text, &loader.catalog_of(&text)).diagnostics
}

/// A node under test: `stage` gives its producers, and previews read its `outputs`.
struct Case {
    /// Name for messages.
    name: &'static str,
    /// Text of the node's table, after `[nodes.it]`.
    node: &'static str,
    /// Outputs that are read.
    outputs: &'static [&'static str],
    /// Severity, code, text at the underline, and part of the message.
    found: (Severity, &'static str, &'static str, &'static str),
}

const STAGE: &str = "plugins = [\"phantom\", \"capture\", \"stereo\", \"stitch\", \"tools\", \"overlay\", \"arm\", \"opencv\", \"sinks\"]\n\
    [nodes.scope]\ntype = \"phantom\"\n\
    [nodes.bm]\ntype = \"stereo_bm\"\ninputs = { left = \"scope.left\", right = \"scope.right\" }\n\
    [nodes.map]\ntype = \"register_surf\"\ninputs = { left = \"scope.left\", right = \"scope.right\" }\n";

const ERROR: Severity = Severity::Error;
const WARNING: Severity = Severity::Warning;
const PARAM: &str = "invalid-param";
const NODE: &str = "invalid-node";

const CASES: &[Case] = &[
    // --- capture
    Case {
        name: "a crop of three numbers",
        node: "type = \"capture\"\nparams = { left = \"wide.png\", crop = [1, 2, 3] }",
        outputs: &["left"],
        found: (ERROR, PARAM, "[1, 2, 3]", "`crop` has 3 numbers"),
    },
    Case {
        name: "a negative crop",
        node: "type = \"capture\"\nparams = { left = \"wide.png\", crop = [-1, 0, 10, 10] }",
        outputs: &["left"],
        found: (ERROR, PARAM, "[-1, 0, 10, 10]", "as integers in px, not negative"),
    },
    Case {
        name: "a negative crop of a pipeline, whose size is not known",
        node: "type = \"capture\"\nparams = { left = \"videotestsrc ! appsink\", crop = [0, 0, -4, 10] }",
        outputs: &["left"],
        found: (ERROR, PARAM, "[0, 0, -4, 10]", "as integers in px, not negative"),
    },
    Case {
        name: "a crop outside",
        node: "type = \"capture\"\nparams = { left = \"wide.png\", crop = [60, 0, 8, 8] }",
        outputs: &["left"],
        found: (ERROR, PARAM, "[60, 0, 8, 8]", "extends beyond the frame of 64x32"),
    },
    Case {
        name: "a crop outside its half",
        node: "type = \"capture\"\nparams = { left = \"wide.png\", split = \"side_by_side\", crop = [20, 0, 20, 8] }",
        outputs: &["left", "right"],
        found: (ERROR, PARAM, "[20, 0, 20, 8]", "extends beyond the frame of 32x32"),
    },
    Case {
        name: "an absent calibration",
        node: "type = \"capture\"\nparams = { left = \"wide.png\", calibration = \"stereo.yaml\" }",
        outputs: &["left"],
        found: (ERROR, PARAM, "\"stereo.yaml\"", "calibration: "),
    },
    Case {
        name: "a file that is not there",
        node: "type = \"capture\"\nparams = { left = \"film.mkv\" }",
        outputs: &["left"],
        found: (ERROR, PARAM, "\"film.mkv\"", "does not exist"),
    },
    Case {
        name: "a pattern that matches nothing",
        node: "type = \"capture\"\nparams = { left = \"wide.png\", right = \"img_*.jpg\" }",
        outputs: &["left", "right"],
        found: (ERROR, PARAM, "\"img_*.jpg\"", "no image matches "),
    },
    Case {
        name: "no source at all",
        node: "type = \"capture\"",
        outputs: &["left"],
        found: (ERROR, PARAM, "it", "no source is given: set `left`"),
    },
    Case {
        name: "a split of two sources",
        node: "type = \"capture\"\nparams = { left = \"wide.png\", right = \"wide.png\", split = \"top_bottom\" }",
        outputs: &["left", "right"],
        found: (ERROR, PARAM, "\"top_bottom\"", "`split` divides one frame into both views"),
    },
    Case {
        name: "a camera that is not there",
        node: "type = \"capture\"\nparams = { left = \"/dev/video4711\" }",
        outputs: &["left"],
        found: (WARNING, PARAM, "\"/dev/video4711\"", "the camera /dev/video4711 does not exist"),
    },
    Case {
        name: "an element that GStreamer does not have",
        node: "type = \"capture\"\nparams = { left = \"videotestsorce ! videoconvert ! appsink\" }",
        outputs: &["left"],
        found: (ERROR, PARAM, "\"videotestsorce ! videoconvert ! appsink\"", "the pipeline names `videotestsorce`"),
    },
    Case {
        name: "a right view that never comes",
        node: "type = \"capture\"\nparams = { left = \"wide.png\" }",
        outputs: &["left", "right"],
        found: (WARNING, NODE, "it", "output `right` is connected but stays empty"),
    },
    // --- stereo
    Case {
        name: "penalties out of order",
        node: "type = \"stereo_sgbm\"\ninputs = { left = \"scope.left\", right = \"scope.right\" }\n\
               params = { small_penalty = 60, large_penalty = 50 }",
        outputs: &["disparity"],
        found: (ERROR, PARAM, "60", "`small_penalty` is 60, not below `large_penalty`, which is 50"),
    },
    Case {
        name: "rectification without calibration",
        node: "type = \"rectify\"\ninputs = { left = \"scope.left\", right = \"scope.right\" }",
        outputs: &["left"],
        found: (ERROR, NODE, "it", "there is no calibration to rectify by"),
    },
    Case {
        name: "no depth between near and far",
        node: "type = \"reproject\"\ninputs = { image = \"scope.left\", disparity = \"bm.disparity\", calibration = \"scope.calibration\" }\n\
               params = { near_mm = 600 }",
        outputs: &["depth"],
        found: (ERROR, PARAM, "600", "no depth lies between them"),
    },
    Case {
        name: "depth without rays",
        node: "type = \"measure\"\ninputs = { depth = \"scope.depth\" }\nparams = { points = [1, 2, 3, 4] }",
        outputs: &["table"],
        found: (ERROR, NODE, "it", "`depth` alone has no rays"),
    },
    Case {
        name: "half a point",
        node: "type = \"measure\"\ninputs = { depth = \"scope.depth\", calibration = \"scope.calibration\" }\nparams = { points = [1, 2, 3] }",
        outputs: &["table"],
        found: (WARNING, PARAM, "[1, 2, 3]", "half a point is left over"),
    },
    // --- stitch
    Case {
        name: "views without their homographies",
        node: "type = \"composite\"\ninputs = { views = [\"scope.left\", \"scope.right\", \"scope.left\"], homographies = [\"map.homography\"] }",
        outputs: &["panorama"],
        found: (ERROR, NODE, "it", "3 views need 2 homographies, but 1 are connected"),
    },
    // --- tools
    Case {
        name: "labels that are not there",
        node: "type = \"yolo\"\ninputs = { image = \"scope.left\" }\nparams = { labels = \"names.txt\" }",
        outputs: &["detections"],
        found: (ERROR, PARAM, "\"names.txt\"", "cannot read the labels"),
    },
    Case {
        name: "tips of nothing",
        node: "type = \"tool_tip\"\ninputs = { image = \"scope.left\" }",
        outputs: &["tip"],
        found: (WARNING, NODE, "it", "neither `detections` nor `instances` is connected"),
    },
    // --- overlay
    Case {
        name: "half an offset",
        node: "type = \"overlay\"\ninputs = { image = \"scope.left\" }\nparams = { offset_px = [4] }",
        outputs: &["image"],
        found: (ERROR, PARAM, "[4]", "`offset_px` needs two numbers"),
    },
    Case {
        name: "two maps to colour",
        node: "type = \"colorize\"\ninputs = { disparity = \"bm.disparity\", depth = \"scope.depth\" }",
        outputs: &["image"],
        found: (ERROR, NODE, "it", "more than one map is connected"),
    },
    // --- arm
    Case {
        name: "an arm that is not there",
        node: "type = \"arm_pid\"\ninputs = { tip = \"scope.tip\" }\nparams = { arm = \"robot.urdf\" }",
        outputs: &["joints"],
        found: (ERROR, PARAM, "\"robot.urdf\"", "cannot read "),
    },
    Case {
        name: "an arm that is none",
        node: "type = \"arm_sim\"\nparams = { arm = \"words.txt\" }\ninputs = { tip = \"scope.tip\" }",
        outputs: &["joints"],
        found: (ERROR, PARAM, "\"words.txt\"", "words.txt: "),
    },
    Case {
        name: "a serial line that is not there",
        node: "type = \"arm_serial\"\nparams = { port = \"/dev/ttyNONE9\" }\ninputs = { tip = \"scope.tip\" }",
        outputs: &["joints"],
        found: (WARNING, PARAM, "\"/dev/ttyNONE9\"", "the serial line /dev/ttyNONE9 does not exist"),
    },
    Case {
        name: "a robot without a description",
        node: "type = \"arm_ur\"\nparams = { arm = \"\" }\ninputs = { tip = \"scope.tip\" }",
        outputs: &["joints"],
        found: (ERROR, PARAM, "\"\"", "no description of the robot is given"),
    },
    Case {
        name: "a robot whose home is not six angles",
        node: concat!(
            "type = \"arm_ur\"\nparams = { home_deg = \"0, 90\", arm = \"",
            env!("CARGO_MANIFEST_DIR"),
            "/../core/robot/arm/description/panoscope_arm6.urdf\" }\ninputs = { tip = \"scope.tip\" }"
        ),
        outputs: &["joints"],
        found: (ERROR, PARAM, "\"0, 90\"", "is not 6 angles"),
    },
    // --- phantom
    Case {
        name: "an instrument that does not exist",
        node: "type = \"phantom\"\nparams = { tool_kinds = \"spoon\" }",
        outputs: &["left"],
        found: (ERROR, PARAM, "\"spoon\"", "there is no instrument `spoon`"),
    },
    Case {
        name: "a wide picture that is too wide",
        node: "type = \"phantom\"\nparams = { width = 3840, wide_factor = 4.0 }",
        outputs: &["wide"],
        found: (ERROR, PARAM, "4.0", "the limit of 8192 px"),
    },
    Case {
        name: "a lens that folds",
        node: "type = \"phantom\"\nparams = { distortion_k1 = -0.5, distortion_k2 = -0.5 }",
        outputs: &["left"],
        found: (ERROR, PARAM, "-0.5", "distortion"),
    },
    // --- opencv
    Case {
        name: "a board that is none",
        node: "type = \"calibrate_stereo\"\ninputs = { left = \"scope.left\", right = \"scope.right\" }\nparams = { board = \"chess\" }",
        outputs: &["calibration"],
        found: (ERROR, PARAM, "\"chess\"", "chess"),
    },
    Case {
        name: "a calibration that would never be solved",
        node: "type = \"calibrate_stereo\"\ninputs = { left = \"scope.left\", right = \"scope.right\" }\nparams = { solve_at = 3 }",
        outputs: &["calibration"],
        found: (ERROR, PARAM, "3", "before 5 views"),
    },
    Case {
        name: "a window that OpenCV refuses",
        node: "type = \"stereo_opencv\"\ninputs = { left = \"scope.left\", right = \"scope.right\" }\nparams = { block_px = 3 }",
        outputs: &["disparity"],
        found: (ERROR, PARAM, "3", "needs at least 5"),
    },
    // --- sinks
    Case {
        name: "raw numbers in a JPEG",
        node: "type = \"write_raw\"\ninputs = { depth = \"scope.depth\" }\nparams = { path = \"out/q.jpg\" }",
        outputs: &[],
        found: (ERROR, PARAM, "\"out/q.jpg\"", "the extension `jpg` is not supported"),
    },
    Case {
        name: "a picture as a table",
        node: "type = \"write_images\"\ninputs = { image = \"scope.left\" }\nparams = { path = \"out/q.csv\" }",
        outputs: &[],
        found: (ERROR, PARAM, "\"out/q.csv\"", "the extension `csv` is not supported"),
    },
    Case {
        name: "a video without an ending",
        node: "type = \"write_video\"\ninputs = { image = \"scope.left\" }\nparams = { path = \"out/q\" }",
        outputs: &[],
        found: (ERROR, PARAM, "\"out/q\"", "the extension `` is not supported"),
    },
    Case {
        name: "a codec that its file cannot hold",
        node: "type = \"write_video\"\ninputs = { image = \"scope.left\" }\nparams = { path = \"out/q.webm\", codec = \"h264\" }",
        outputs: &[],
        found: (ERROR, PARAM, "\"h264\"", "a .webm file cannot hold the chosen `codec`"),
    },
    Case {
        name: "a path through a file",
        node: "type = \"write_cloud\"\ninputs = { cloud = \"points.cloud\" }\nparams = { path = \"words.txt/q.ply\" }\n\
               [nodes.points]\ntype = \"reproject\"\ninputs = { image = \"scope.left\", disparity = \"bm.disparity\", calibration = \"scope.calibration\" }",
        outputs: &[],
        found: (ERROR, PARAM, "\"words.txt/q.ply\"", "is a file, not a folder"),
    },
    Case {
        name: "other numbers in a COCO file",
        node: "type = \"write_table\"\ninputs = { tip = \"scope.tip\" }\nparams = { path = \"out/q.json\" }",
        outputs: &[],
        found: (ERROR, PARAM, "\"out/q.json\"", "not input `tip`"),
    },
    Case {
        name: "a last picture that never comes",
        node: "type = \"write_images\"\ninputs = { mask = \"m.mask\" }\nparams = { at_end = true }\n\
               [nodes.m]\ntype = \"composite\"\ninputs = { left = \"scope.left\", right = \"scope.right\", homography = \"map.homography\" }",
        outputs: &[],
        found: (ERROR, PARAM, "true", "`at_end` needs input `image`"),
    },
];

/// A folder with an image of 64 x 32 px and a text file.
fn folder(name: &str) -> PathBuf {
    let folder = panoscope_tests::scratch(name);
    image::RgbImage::new(64, 32).save(folder.join("wide.png")).expect("a picture");
    std::fs::write(folder.join("words.txt"), "words").expect("a file");
    folder
}

#[test]
fn every_node_refuses_at_check_what_it_would_refuse_when_it_runs() {
    let folder = folder("cases");
    let mut wrong = Vec::new();
    for case in CASES {
        let text = format!("{STAGE}[nodes.it]\n{}\n{}", case.node, readers(case));
        let found = diagnostics(&folder, &text);
        let (severity, code, at, words) = case.found;
        let fits = |d: &panoscope_graph::Diagnostic| {
            d.severity == severity && d.code == code && &text[d.span.clone()] == at && d.message.contains(words)
        };
        if !found.iter().any(fits) || found.errors() != usize::from(severity == ERROR) {
            wrong.push(format!(
                "--- {}: expected {severity:?} {code} at {at}: {words}\n{}",
                case.name,
                found.render(false)
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    std::fs::remove_dir_all(folder).expect("removed");
}

/// Sinks that read the outputs of a case, by their packet type.
fn readers(case: &Case) -> String {
    let mut out = String::new();
    for output in case.outputs {
        let take = match *output {
            "left" | "right" | "image" | "panorama" | "wide" => ("write_images", "image", "png"),
            "disparity" => ("write_raw", "disparity", "pfm"),
            "depth" => ("write_raw", "depth", "pfm"),
            "detections" => ("write_table", "detections", "jsonl"),
            "joints" => ("write_table", "joints", "jsonl"),
            "tip" => ("write_table", "tip", "jsonl"),
            "table" => ("write_table", "table", "jsonl"),
            // Calibrations are read by `rectify`.
            _ => {
                out.push_str(&format!(
                    "[nodes.read_{output}]\ntype = \"rectify\"\ninputs = {{ left = \"scope.left\", right = \"scope.right\", calibration = {{ from = \"it.{output}\", align = \"latest\" }} }}\n\
                     [nodes.see_{output}]\ntype = \"write_images\"\ninputs = {{ image = \"read_{output}.left\" }}\nparams = {{ path = \"out/seen.png\" }}\n"
                ));
                continue;
            }
        };
        out.push_str(&format!(
            "[nodes.read_{output}]\ntype = \"{}\"\ninputs = {{ {} = \"it.{output}\" }}\nparams = {{ path = \"out/read_{output}.{}\" }}\n",
            take.0, take.1, take.2
        ));
    }
    out
}

/// `check` reports exactly what `open` refuses: each parameter error above also ends a run, with the same message.
#[test]
fn a_run_refuses_with_the_same_words() {
    let folder = folder("open");
    let graph = folder.join("graph.toml");
    std::fs::write(
        &graph,
        "plugins = [\"phantom\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.out]\ntype = \"write_raw\"\n\
         inputs = { depth = \"scope.depth\" }\nparams = { path = \"q.jpg\" }\n",
    )
    .expect("a graph");
    let Some(program) = std::env::var_os("PANOSCOPE_BIN") else {
        panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
        return;
    };
    for command in ["check", "run"] {
        let output = Command::new(&program).arg(command).arg(&graph).output().expect("the program starts");
        let words = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{command}: {words}");
        assert!(words.contains("error[invalid-param]") && words.contains("graph.toml:7:19"), "{command}: {words}");
    }
    assert_eq!(std::fs::read_dir(&folder).expect("a folder").count(), 3, "nothing is written");
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn two_real_sinks_with_one_path_are_refused() {
    let folder = folder("twice");
    let text = format!(
        "{STAGE}[nodes.a]\ntype = \"write_video\"\ninputs = {{ image = \"scope.left\" }}\n\
         [nodes.b]\ntype = \"write_video\"\ninputs = {{ image = \"scope.right\" }}\nparams = {{ path = \"./out/video.mkv\" }}\n"
    );
    let found = diagnostics(&folder, &text);
    let codes: Vec<_> = found.iter().filter(|d| d.severity == ERROR).map(|d| d.code).collect();
    assert_eq!(codes, ["written-twice"], "{}", found.render(false));
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_type_of_an_installed_plugin_says_which_to_list() {
    let folder = folder("unlisted");
    let text = "plugins = [\"phantom\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.find]\ntype = \"yolo\"\ninputs = { image = \"scope.left\" }\n\
                [nodes.out]\ntype = \"write_table\"\ninputs = { detections = \"find.detections\" }\n";
    let rendered = diagnostics(&folder, text).render(false);
    assert!(
        rendered.contains("node type `yolo` belongs to plugin `tools`, which `plugins` does not list"),
        "{rendered}"
    );
    assert!(rendered.contains("write plugins = [\"phantom\", \"tools\", \"sinks\"]"), "{rendered}");
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn the_shipped_models_are_found_from_any_folder() {
    let folder = folder("models");
    let text = "plugins = [\"phantom\", \"tools\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n\
                [nodes.find]\ntype = \"yolo\"\ninputs = { image = \"scope.left\" }\n\
                [nodes.cut]\ntype = \"mask_rcnn\"\ninputs = { image = \"scope.left\" }\n\
                [nodes.out]\ntype = \"write_table\"\ninputs = { detections = \"find.detections\", instances = \"cut.instances\" }\n";
    let found = diagnostics(&folder, text);
    assert!(!found.has_errors(), "{}", found.render(false));
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_running_node_refuses_what_check_would_refuse() {
    let folder = folder("set");
    let text = "mode = \"batch\"\nplugins = [\"phantom\", \"stereo\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\nparams = { width = 128, height = 96 }\n\
                [nodes.match]\ntype = \"stereo_sgbm\"\ninputs = { left = \"scope.left\", right = \"scope.right\" }\n\
                [nodes.out]\ntype = \"write_raw\"\ninputs = { disparity = \"match.disparity\" }\nparams = { path = \"out/d.pfm\" }\n";
    let path = folder.join("graph.toml");
    let (graph, catalog, loader) = panoscope_tests::load(&path, text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let options = Options { threads: 2, graph_dir: folder.clone(), ..Options::default() };
    let engine = Engine::start(graph, &catalog, &loader, options).expect("it starts");
    let set = |param: &str, value: i64| engine.set_param("match", param, ParamValue::Int(value));
    let refused = set("small_penalty", 100).expect_err("not below 100").to_string();
    assert!(
        refused.starts_with("`match.small_penalty`: `small_penalty` is 100, not below `large_penalty`"),
        "{refused}"
    );
    let values = engine.param_values("match").expect("a node");
    assert!(values.contains(&ParamValue::Int(10)), "the old value stays: {values:?}");
    set("large_penalty", 110).expect("it is above");
    set("small_penalty", 100).expect("now it is below");
    // A path that cannot be written is refused before the file in use is touched.
    let refused = engine.set_param("out", "path", ParamValue::Path(folder.join("q.jpg"))).expect_err("no such format");
    assert!(refused.to_string().contains("the extension `jpg` is not supported"), "{refused}");
    engine.close(std::time::Duration::from_secs(30));
    std::fs::remove_dir_all(folder).expect("removed");
}
