//! Foreign models are opened in a child process first: a file that exhausts memory or crashes its reader does so there.
//!
//! `panoscope check` starts this program again with the hidden command `probe-node GRAPH NODE`, which limits its own memory and processor
//! time and opens that one node.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use panoscope_engine::{Engine, Options, StartError};
use panoscope_graph::{Diagnostics, Graph, GraphOptions, GraphText, ParamKind, ParamValue, Severity};
use serde::{Deserialize, Serialize};

use crate::given::Given;
use crate::trust::OwnPlugins;
use crate::{End, terminal};
use panoscope_eval::graph_file::Ready;

/// Name of the hidden command.
pub const COMMAND: &str = "probe-node";
/// How long a model may take to open.
const PATIENCE: Duration = Duration::from_secs(20);
/// Memory that the child may map: ONNX Runtime and OpenCV alone reserve about two.
const MEMORY_BYTES: u64 = 6 << 30;

/// Arguments of the hidden command.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file.
    graph: PathBuf,
    /// Node to open.
    node: String,
    #[command(flatten)]
    given: Given,
    #[command(flatten)]
    own_plugins: OwnPlugins,
}

/// The child's result, as one line of JSON.
#[derive(Serialize, Deserialize)]
struct Answer {
    /// Why the node cannot be opened.
    reason: Option<String>,
}

fn limit(resource: libc::__rlimit_resource_t, most: u64) {
    let limit = libc::rlimit { rlim_cur: most, rlim_max: most };
    // SAFETY: only reads the struct. A limit that cannot be set leaves the parent's clock.
    unsafe { libc::setrlimit(resource, &raw const limit) };
}

/// The child's part.
pub fn run(arguments: &Arguments) -> Result<End> {
    // A signal that ends the parent ends this process, too.
    // SAFETY: a plain system call.
    unsafe { libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL) };
    limit(libc::RLIMIT_AS, MEMORY_BYTES);
    limit(libc::RLIMIT_CPU, 2 * PATIENCE.as_secs());
    limit(libc::RLIMIT_CORE, 0);
    let options = GraphOptions { allow_missing_args: true, ..arguments.given.options(&[]) };
    let Ok(Ready { graph, catalog, loader, .. }) = arguments.own_plugins.open(&arguments.graph, &options) else {
        return Ok(End::Wrong);
    };
    let position = graph.node(&arguments.node).context("no such node")?;
    let alone = Graph {
        nodes: vec![graph.nodes[position].clone()],
        edges: Vec::new(),
        order: vec![0],
        preset: panoscope_graph::Preset::default(),
        ..graph
    };
    let options = Options {
        threads: 2,
        frames: Some(1),
        graph_dir: arguments.graph.parent().unwrap_or(Path::new("")).to_owned(),
        ..Options::default()
    };
    let reason = match Engine::start(alone, &catalog, &loader, options) {
        Ok(_) => None,
        Err(StartError::Open { reason, .. }) => Some(reason),
        Err(other) => Some(other.to_string()),
    };
    terminal::out!("{}", serde_json::to_string(&Answer { reason })?);
    Ok(End::Done)
}

/// How the child ended if it gave no result.
fn died(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match status.signal() {
        Some(libc::SIGXCPU | libc::SIGKILL) => "opening it takes too much processor time".to_owned(),
        Some(libc::SIGABRT) => {
            "opening it ended the process (out of memory, or a fault inside ONNX Runtime)".to_owned()
        }
        Some(signal) => format!("opening it ended the process with signal {signal}"),
        None => "opening it gave no answer".to_owned(),
    }
}

/// Why the node cannot be opened, if it cannot.
fn ask(graph: &Path, node: &str, given: &Given, own_plugins: OwnPlugins) -> Result<Option<String>> {
    let program = std::env::current_exe().context("this program's own file")?;
    let mut child = Command::new(program)
        .arg(COMMAND)
        .arg(graph)
        .arg(node)
        .args(given.words())
        .args(own_plugins.words())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .context("cannot start a process to open it in")?;
    let begun = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if begun.elapsed() > PATIENCE || crate::interrupt::asked() {
            // It may have ended meanwhile.
            let _ = child.kill();
            let _ = child.wait();
            return Ok(Some(format!("opening it takes more than {} s", PATIENCE.as_secs())));
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let mut text = String::new();
    if let Some(mut out) = child.stdout.take() {
        out.read_to_string(&mut text)?;
    }
    let answer = text.lines().last().and_then(|line| serde_json::from_str::<Answer>(line).ok());
    Ok(match answer {
        Some(answer) => answer.reason,
        None => Some(died(status)),
    })
}

/// Opens, each in a child process, the nodes of a checked graph that read a network from a file.
pub fn models(path: &Path, text: &GraphText, ready: &Ready, given: &Given, own_plugins: OwnPlugins) -> Diagnostics {
    let mut all = Diagnostics::default();
    for node in &ready.graph.nodes {
        let node_type = node.node_type(&ready.catalog);
        let is_model = |value: &ParamValue| matches!(value, ParamValue::Path(file) if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("onnx")));
        let named = node_type
            .params
            .iter()
            .zip(&node.params)
            .find(|(p, value)| matches!(p.kind, ParamKind::Path { .. }) && is_model(value));
        let Some((param, _)) = named else { continue };
        let (severity, code, reason) = match ask(path, &node.id, given, own_plugins) {
            Ok(None) => continue,
            // The graph may be right where the library is.
            Ok(Some(reason)) if reason.starts_with("ONNX Runtime's shared library") => {
                (Severity::Warning, "model-unchecked", reason)
            }
            Ok(Some(reason)) => (Severity::Error, "model-refused", reason),
            Err(error) => (Severity::Warning, "model-unchecked", format!("{error:#}")),
        };
        let message = format!("`{}` of `{}` ({}) cannot be used: {reason}", param.name, node.id, node.type_name);
        let help = if severity == Severity::Error {
            "name a model that this node reads; see `panoscope describe`"
        } else {
            "the model was not looked at"
        };
        all.extend(text.about_param(severity, code, (&node.id, &param.name), message, help));
    }
    all
}
