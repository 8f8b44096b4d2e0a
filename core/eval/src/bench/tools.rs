//! The detector and the segmenter on one 640x480 image, compared with plain ONNX Runtime in Python on the same models.
//!
//! Ours is the node's own time measured by the engine: fitting, network, decoding, suppression. Python does the same
//! with NumPy and OpenCV in the same run, alternating, with as many threads.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde::Deserialize;

use crate::error::{Context, EvalError, FileAction, OnFile, Result, chain};
use crate::figures::Figure;
use crate::inputs::{Folder, quoted, shipped_model};
use crate::run::{self, Pace, Plan};
use crate::session::{Session, note};

/// Options of [`measure`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Fewer frames and rounds: a quick check instead of a measurement.
    pub quick: bool,
    /// Measures plain ONNX Runtime in Python in addition; default program: `python3`.
    pub python: Option<PathBuf>,
    /// Detector; default: the shipped one.
    pub model: Option<PathBuf>,
    /// Segmenter; default: the shipped one.
    pub masks: Option<PathBuf>,
}

/// The peer: options are node, model, image, frames, threads.
const PEER: &str = include_str!("tools_peer.py");
const INPUT: &str = "phantom 640x480";

#[derive(Deserialize)]
struct Peer {
    frame_ms: f64,
    network_ms: f64,
    found: usize,
}

/// One image of the phantom with instruments.
fn picture(session: &dyn Session, folder: &Path) -> Result<PathBuf> {
    let file = folder.join("picture.png");
    let text = format!(
        "mode = \"batch\"\nplugins = [\"phantom\", \"sinks\"]\n\
         [nodes.scope]\ntype = \"phantom\"\nparams = {{ scene = \"liver\", tools = 3 }}\n\
         [nodes.out]\ntype = \"write_images\"\ninputs = {{ image = \"scope.left\" }}\nparams = {{ path = {} }}\n",
        quoted(&file)
    );
    let path = folder.join("bench.toml");
    run::run(session, &Plan { text: &text, path: &path, frames: Some(1), threads: 0, ports: &[], pace: Pace::Free })?;
    Ok(file)
}

/// Median time of the node, ms.
fn ours(session: &dyn Session, node: &str, model: &Path, picture: &Path, threads: usize, frames: u64) -> Result<f64> {
    let text = format!(
        "mode = \"batch\"\nplugins = [\"capture\", \"tools\", \"sinks\"]\n\
         [nodes.file]\ntype = \"capture\"\nparams = {{ left = {}, pace = \"off\", loop = true }}\n\
         [nodes.find]\ntype = \"{node}\"\nbudget_ms = 60000\ninputs = {{ image = \"file.left\" }}\nparams = {{ model = {} }}\n",
        quoted(picture),
        quoted(model)
    );
    let path = Path::new("bench.toml");
    let seen =
        run::run(session, &Plan { text: &text, path, frames: Some(frames), threads, ports: &[], pace: Pace::Alone })?;
    let report = seen.report.nodes.get("find").filter(|n| n.faults == 0 && n.count > 0);
    Ok(report.with_context(|| format!("`{node}` failed"))?.p50_ms)
}

fn peer(python: &Path, node: &str, model: &Path, picture: &Path, threads: usize, frames: u64) -> Result<Peer> {
    let mut child = Command::new(python)
        .arg("-")
        .arg(node)
        .args([model, picture])
        .args([frames.to_string(), threads.to_string()])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .on_file(FileAction::Start, python)?;
    if let Some(mut input) = child.stdin.take() {
        // A Python that ended already says why below.
        let _ = input.write_all(PEER.as_bytes());
    }
    let output = child.wait_with_output()?;
    let words = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        let reason = words.lines().last().unwrap_or("no reason given").to_owned();
        return Err(EvalError::Peer {
            reason: format!("{}: {reason}; it needs onnxruntime, numpy and opencv-python-headless", python.display()),
        });
    }
    serde_json::from_slice(&output.stdout).context("the output of the peer is malformed")
}

/// Measures; with `--quick` fewer frames and rounds.
pub fn measure(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let (frames, rounds) = if options.quick { (40, 2) } else { (150, 5) };
    let scratch = Folder::new("panoscope-bench-tools")?;
    let picture = picture(session, scratch.path())?;
    let mut figures = Vec::new();
    let mut no_peer: Option<EvalError> = None;
    let models = [
        ("yolo", options.model.clone().or_else(|| shipped_model("instruments.onnx")), "--model"),
        ("mask_rcnn", options.masks.clone().or_else(|| shipped_model("instrument_masks.onnx")), "--masks"),
    ];
    for (node, model, option) in models {
        let name = if node == "yolo" { "yolo_frame" } else { "mask_frame" };
        let Some(model) = model else {
            note!(session, "skipped: {name}: no model; name one with {option}");
            continue;
        };
        for threads in [1, 2] {
            // The best median of the rounds: whatever else the machine does only adds.
            let (mut own, mut theirs, mut network) = (f64::INFINITY, f64::INFINITY, f64::INFINITY);
            for _ in 0..rounds {
                own = own.min(ours(session, node, &model, &picture, threads, frames)?);
                let Some(python) = options.python.as_ref().filter(|_| no_peer.is_none()) else { continue };
                match peer(python, node, &model, &picture, threads, frames) {
                    Ok(p) => {
                        theirs = theirs.min(p.frame_ms);
                        network = network.min(p.network_ms);
                        if p.found == 0 {
                            note!(
                                session,
                                "the peer of {name} finds nothing in the picture: the time of its last steps says little"
                            );
                        }
                    }
                    Err(error) => no_peer = Some(error),
                }
            }
            let finite = |v: f64| v.is_finite().then_some(v);
            let file = model.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let input = format!("{INPUT}, {file}, {threads} threads");
            figures.push(
                Figure::new(&format!("{name}/{threads}"), own, "ms", &input)
                    .beside("onnxruntime, Python", finite(theirs)),
            );
            if let Some(network) = finite(network) {
                figures.push(Figure::new(&format!("{name}_network_python/{threads}"), network, "ms", &input));
            }
            // The name that others read: two threads.
            if threads == 2 {
                figures.push(Figure::new(name, own, "ms", &input).beside("onnxruntime, Python", finite(theirs)));
            }
        }
    }
    if let Some(error) = no_peer {
        note!(session, "no peer: {}", chain(&error));
    } else if options.python.is_none() {
        note!(session, "no peer asked for: --python measures plain ONNX Runtime in Python beside it");
    }
    Ok(figures)
}
