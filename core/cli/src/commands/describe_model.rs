//! `panoscope describe MODEL.onnx`: inputs and outputs of a network, and a graph that runs it. The file is read without
//! ONNX Runtime.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::Result;
use panoscope_base::onnx::signature::{Declared, Signature, signature};
use serde_json::json;

use crate::End;
use crate::terminal::{log, out};

/// Largest file that the format allows, bytes.
const MAX_BYTES: u64 = 2 << 30;
/// Maximum number of characters shown of a metadata text.
const SHOWN: usize = 160;

/// A file that cannot be described.
#[derive(Debug, thiserror::Error)]
enum ModelFileError {
    #[error("cannot read the model {path}: {cause}", path = path.display())]
    Unreadable { path: PathBuf, cause: std::io::Error },
    #[error("{path} is not a file, or has more than {MAX_BYTES} bytes", path = path.display())]
    NotAFile { path: PathBuf },
    #[error("{path} is not a complete ONNX file: {cause}", path = path.display())]
    Malformed { path: PathBuf, cause: panoscope_base::onnx::Malformed },
}

/// Whether an argument of `describe` is a model and not a node type.
pub fn is_model(argument: &str) -> bool {
    let path = Path::new(argument);
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("onnx")) || path.is_file()
}

fn read(path: &Path) -> Result<Signature, ModelFileError> {
    let unreadable = |cause| ModelFileError::Unreadable { path: path.to_owned(), cause };
    let about = std::fs::metadata(path).map_err(unreadable)?;
    if !about.is_file() || about.len() > MAX_BYTES {
        return Err(ModelFileError::NotAFile { path: path.to_owned() });
    }
    let bytes = std::fs::read(path).map_err(unreadable)?;
    signature(&bytes).map_err(|cause| ModelFileError::Malformed { path: path.to_owned(), cause })
}

/// Shows a model and a graph to copy.
pub fn run(path: &Path, as_json: bool) -> Result<End> {
    let model = match read(path) {
        Ok(model) => model,
        Err(error) => {
            log!("error: {error}");
            return Ok(End::Wrong);
        }
    };
    let graph = graph_of(path, &model);
    if as_json {
        let values = |all: &[Declared]| -> Vec<serde_json::Value> {
            all.iter().map(|d| json!({ "name": d.name, "element": d.element, "shape": d.dims })).collect()
        };
        let metadata: serde_json::Map<String, serde_json::Value> =
            model.metadata.iter().map(|(key, text)| (key.clone(), json!(text))).collect();
        let about = json!({
            "model": path, "opset": model.opset, "inputs": values(&model.inputs), "outputs": values(&model.outputs),
            "metadata": metadata, "graph": graph,
        });
        out!("{}", serde_json::to_string_pretty(&about)?);
        return Ok(End::Done);
    }
    let opset = model.opset.map_or(String::new(), |opset| format!(", opset {opset}"));
    out!("{} (ONNX{opset})", path.display());
    for (title, all) in [("inputs", &model.inputs), ("outputs", &model.outputs)] {
        out!("");
        out!("{title}");
        all.iter().for_each(|declared| out!("  {}: {declared}", line_of(&declared.name)));
    }
    if !model.metadata.is_empty() {
        out!("");
        out!("metadata");
    }
    for (key, text) in &model.metadata {
        let shown: String = text.chars().take(SHOWN).collect();
        out!("  {}: {}{}", line_of(key), line_of(&shown), if shown.len() < text.len() { "..." } else { "" });
    }
    out!("");
    match graph {
        Some(graph) => {
            out!("A graph to copy; what inputs and outputs are was guessed from names and shapes:");
            out!("");
            graph.lines().for_each(|line| out!("{line}"));
        }
        None => out!(
            "no node takes such inputs: an image is f32, f16, u8 or i8, 1x3xHxW, 1xHxWx3 or the same with one channel"
        ),
    }
    Ok(End::Done)
}

/// An input that may be an image.
struct ImageShape {
    channels: u64,
    /// Columns and rows; `None` for any number.
    size: [Option<u64>; 2],
}

fn image_shape(declared: &Declared) -> Option<ImageShape> {
    matches!(declared.element, Some("f32" | "f16" | "u8" | "i8")).then_some(())?;
    let dims = match declared.dims[..] {
        [None | Some(1), a, b, c] => [a, b, c],
        [a, b, c] => [a, b, c],
        [height, width] => [Some(1), height, width],
        _ => return None,
    };
    let is_channels = |n: Option<u64>| matches!(n, Some(1 | 3));
    let (channels, size) = match dims {
        [c, h, w] if is_channels(c) => (c, [w, h]),
        [h, w, c] if is_channels(c) => (c, [w, h]),
        [None, h, w] => (Some(3), [w, h]),
        _ => return None,
    };
    Some(ImageShape { channels: channels.unwrap_or(3), size })
}

/// Ports of the inputs, guessed from their names, else by their order.
fn input_ports(inputs: &[Declared]) -> Vec<Option<&'static str>> {
    let by_order: &[&'static str] = match inputs.len() {
        1 => &["image"],
        2 => &["left", "right"],
        _ => &["image", "left", "right", "previous"],
    };
    let mut ports: Vec<Option<&'static str>> = vec![None; inputs.len()];
    for (port, input) in ports.iter_mut().zip(inputs).filter(|_| inputs.len() > 1) {
        let name = input.name.to_lowercase();
        *port = ["left", "right", "previous"].into_iter().find(|port| name.contains(&port[..4]));
    }
    // With the view before goes the view.
    let has_previous = ports.contains(&Some("previous"));
    for index in 0..ports.len() {
        let free = |port: &&&'static str| !ports.contains(&Some(**port));
        let preferred: &[&'static str] = if has_previous { &["image", "left", "right"] } else { by_order };
        if ports[index].is_none() {
            ports[index] = preferred.iter().find(free).copied();
        }
    }
    ports
}

/// Port of an output, guessed from its name, else from its channels.
fn output_port(output: &Declared, is_stereo: bool) -> Option<&'static str> {
    const WORDS: [(&str, &str); 11] = [
        ("disp", "disparity"),
        ("depth", "depth"),
        ("flow", "flow"),
        ("conf", "confidence"),
        ("mask", "mask"),
        ("seg", "mask"),
        ("occl", "mask"),
        ("box", "detections"),
        ("detections", "detections"),
        ("logits", "detections"),
        ("image", "image"),
    ];
    let name = output.name.to_lowercase();
    let is_map = output.dims.len() == 4 || output.dims.len() == 2;
    let named = WORDS.iter().find(|(word, _)| name.contains(word)).map(|(_, port)| *port);
    match (named, &output.dims[..]) {
        (Some("detections"), _) | (None, [Some(1), _, _]) => Some("detections"),
        (Some(port), dims) if dims.len() >= 2 => Some(port),
        (None, [_, Some(2), _, _]) => Some("flow"),
        (None, [_, Some(3), _, _]) => Some("image"),
        (None, [_, Some(1), _, _]) if is_map => Some(if is_stereo { "disparity" } else { "depth" }),
        _ => None,
    }
}

/// A key of TOML.
fn key(name: &str) -> String {
    let is_bare = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if is_bare { name.to_owned() } else { quoted(name) }
}

/// A text of TOML on one line, without the quotes of the literal text around it.
fn quoted(text: &str) -> String {
    json!(text).to_string().replace('\'', "\\u0027")
}

/// A text of a file as a line of the terminal.
fn line_of(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// The table of a model's inputs and outputs, and the ports of the outputs.
fn table_of(model: &Signature, shapes: &[ImageShape], ports: &[Option<&'static str>]) -> (String, Vec<&'static str>) {
    let mut table = String::new();
    for ((input, shape), port) in model.inputs.iter().zip(shapes).zip(ports.iter().flatten()) {
        let order = if shape.channels == 1 { "gray" } else { "rgb" };
        let range = match input.element {
            Some("u8") => "[0, 255]",
            Some("i8") => "[-128, 127]",
            _ => "[0, 1]",
        };
        let size = match shape.size {
            [Some(_), Some(_)] => String::new(),
            [None, None] => "fit = \"multiple\"\nmultiple = 32\n".to_owned(),
            [width, height] => format!("size = [{}, {}]\n", width.unwrap_or(640), height.unwrap_or(480)),
        };
        let _ = writeln!(
            table,
            "[inputs.{}]\nport = \"{port}\"\norder = \"{order}\"\nrange = {range}\n{size}",
            key(&input.name)
        );
    }
    let mut made: Vec<&'static str> = Vec::new();
    for output in &model.outputs {
        let port = output_port(output, ports.contains(&Some("right")));
        let Some(port) = port.filter(|port| *port == "detections" || !made.contains(port)) else {
            let _ = writeln!(table, "# [outputs.{}]: {output}\n# port = \"...\"\n", key(&output.name));
            continue;
        };
        made.push(port);
        let unit = match port {
            "disparity" | "flow" => "unit = \"px\"\n",
            "depth" => "unit = \"mm\"\n",
            _ => "",
        };
        let _ = writeln!(table, "[outputs.{}]\nport = \"{port}\"\n{unit}", key(&output.name));
    }
    (table, made)
}

/// The graph for a model; `None` if no node accepts its inputs.
fn graph_of(path: &Path, model: &Signature) -> Option<String> {
    let shapes: Vec<ImageShape> = model.inputs.iter().map(image_shape).collect::<Option<_>>()?;
    let task = model.metadata.iter().find(|(key, _)| key == "task").map(|(_, task)| task.as_str());
    let file = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let file = quoted(&file.to_string_lossy());
    match task {
        Some("detect") => return Some(detector_graph("yolo", "detections = \"network.detections\"", &file)),
        Some("pose") => {
            let drawn = "detections = \"network.detections\", tip = \"network.tip0\"";
            return Some(detector_graph("yolo", drawn, &file));
        }
        Some("segment") => return Some(detector_graph("mask_rcnn", "instances = \"network.instances\"", &file)),
        _ => {}
    }
    let ports = input_ports(&model.inputs);
    if shapes.is_empty() || ports.contains(&None) {
        return None;
    }
    let (table, made) = table_of(model, &shapes, &ports);
    let mut graph = String::from(
        "name = \"network\"\nmode = \"live\"\nplugins = [\"phantom\", \"stereo\", \"overlay\", \"tools\", \"sinks\"]\n\n",
    );
    graph.push_str("[nodes.scope]\ntype = \"phantom\"\nparams = { seed = 7 }\n\n");
    let is_pair = ports.contains(&Some("right"));
    if is_pair {
        graph.push_str("[nodes.rectify]\ntype = \"rectify\"\ninputs = { left = \"scope.left\", right = \"scope.right\", calibration = \"scope.calibration\" }\n\n");
    }
    let from = |port: &str| match port {
        "left" | "right" if is_pair => format!("{port} = \"rectify.{port}\""),
        "previous" => "previous = { from = \"scope.left\", delay = 1 }".to_owned(),
        _ => format!("{port} = \"scope.left\""),
    };
    let inputs: Vec<String> = ports.iter().flatten().map(|port| from(port)).collect();
    let _ = writeln!(graph, "[nodes.network]\ntype = \"onnx\"\ninputs = {{ {} }}\n", inputs.join(", "));
    let _ = writeln!(graph, "[nodes.network.params]\nmodel = {file}\ntable = '''\n{}\n'''\n", table.trim_end());
    let view = if is_pair { "rectify.left" } else { "scope.left" };
    graph.push_str(&shown(made.first().copied(), view));
    graph.push_str(ISOLATED);
    Some(graph)
}

/// A model that crashes or hangs its library ends only its own process.
const ISOLATED: &str = "[isolate]\ntools = \"networks\"\n";

/// Nodes that draw an output of a network that looks at `view` into an image file.
fn shown(port: Option<&str>, view: &str) -> String {
    let still = |from: &str| {
        format!(
            "[nodes.still]\ntype = \"write_images\"\ninputs = {{ {from} }}\nparams = {{ path = \"out/network.png\", at_end = true }}\n\n"
        )
    };
    match port {
        Some(map @ ("disparity" | "depth" | "confidence")) => {
            let colours = format!("[nodes.colours]\ntype = \"colorize\"\ninputs = {{ {map} = \"network.{map}\" }}\n\n");
            colours + &still("image = \"colours.image\"")
        }
        Some(drawn @ ("mask" | "detections")) => {
            let inputs = format!("image = \"{view}\", {drawn} = \"network.{drawn}\"");
            format!("[nodes.drawn]\ntype = \"overlay\"\ninputs = {{ {inputs} }}\n\n")
                + &still("image = \"drawn.image\"")
        }
        Some("image") => still("image = \"network.image\""),
        _ => "# Wire `network.flow_x` and `network.flow_y`, or another output, to your own node.\n\n".to_owned(),
    }
}

/// The graph for an export that `yolo` or `mask_rcnn` reads without a table.
fn detector_graph(node_type: &str, drawn: &str, file: &str) -> String {
    format!(
        "name = \"network\"\nmode = \"live\"\nplugins = [\"phantom\", \"overlay\", \"tools\", \"sinks\"]\n\n\
         [nodes.scope]\ntype = \"phantom\"\nparams = {{ seed = 7, tools = 2 }}\n\n\
         [nodes.network]\ntype = \"{node_type}\"\ninputs = {{ image = \"scope.left\" }}\nparams = {{ model = {file} }}\n\n\
         [nodes.drawn]\ntype = \"overlay\"\ninputs = {{ image = \"scope.left\", {drawn} }}\n\n\
         [nodes.still]\ntype = \"write_images\"\ninputs = {{ image = \"drawn.image\" }}\n\
         params = {{ path = \"out/network.png\", at_end = true }}\n\n{ISOLATED}"
    )
}
