//! `panoscope bench`: measures the runtime itself.

use std::path::PathBuf;

use anyhow::Result;
use panoscope_eval::{bench, figures};

use crate::session::Terminal;
use panoscope_cli::given::Given;
use panoscope_cli::terminal::raw;
use panoscope_cli::{End, allocations, beside, interrupt};

/// Benches.
#[derive(clap::Subcommand)]
pub enum Bench {
    /// Hop from node to node: inline, between threads, paced; compared with GStreamer.
    Hop(Hop),
    /// Checking and starting large graphs.
    Start(Arguments),
    /// Cost of a tick against the number of nodes.
    Scale(Arguments),
    /// The stereo chain step by step, compared with OpenCV's.
    Stereo(Stereo),
    /// Cost of the editor's window for the graph and for its own thread. Needs a screen, or Xvfb.
    Editor(Arguments),
    /// Registration, seam and blend at three sizes, compared with OpenCV.
    Stitch(Stitch),
    /// Messages of OpenIGTLink through a graph, compared with the OpenIGTLink library and pyigtl.
    Igtl(Arguments),
    /// Detector and segmenter on a 640x480 image, compared with plain ONNX Runtime in Python.
    Tools(Tools),
    /// An edge to another machine, compared with zenoh alone and dora.
    Remote(Arguments),
    /// A whole graph on views rendered beforehand: frames per second, their age at 30 per second, time per node.
    System(System),
    /// Cost of a graph by width, cameras, nodes and threads, drawn as curves, and a simulation of more cores.
    Cost(Cost),
}

/// Arguments of every bench.
#[derive(clap::Args)]
pub struct Arguments {
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
    /// Fewer frames and rounds: a quick check, not a measurement.
    #[arg(long)]
    quick: bool,
}

/// Arguments of `bench hop`.
#[derive(clap::Args)]
#[group(skip)]
pub struct Hop {
    #[command(flatten)]
    common: Arguments,
    /// Measures another program in addition, which cargo builds first. It needs the package registry.
    #[arg(long, value_name = "PROGRAM", value_parser = ["copper"])]
    peer: Option<String>,
}

/// Arguments of `bench stereo`.
#[derive(clap::Args)]
#[group(skip)]
pub struct Stereo {
    #[command(flatten)]
    common: Arguments,
    /// Draws measured lengths and depths against the true ones.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
}

/// Arguments of `bench stitch`.
#[derive(clap::Args)]
#[group(skip)]
pub struct Stitch {
    #[command(flatten)]
    common: Arguments,
    /// Image size to measure; repeatable. Default: all.
    #[arg(long, value_parser = bench::stitch::SIZE_NAMES)]
    size: Vec<String>,
    /// Draws the time of each frame at 640x480: registration, seam and the whole.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
}

/// Arguments of `bench tools`.
#[derive(clap::Args)]
// The flattened arguments bring their own group of the same name.
#[group(skip)]
pub struct Tools {
    #[command(flatten)]
    common: Arguments,
    /// Measures plain ONNX Runtime in Python in addition; default program: `python3`.
    #[arg(long, value_name = "PROGRAM", num_args = 0..=1, default_missing_value = "python3")]
    python: Option<PathBuf>,
    /// Detector; default: the shipped one.
    #[arg(long, value_name = "FILE.onnx")]
    model: Option<PathBuf>,
    /// Segmenter; default: the shipped one.
    #[arg(long, value_name = "FILE.onnx")]
    masks: Option<PathBuf>,
}

/// The graph of a bench of a whole system.
#[derive(clap::Args)]
#[group(skip)]
struct WholeGraph {
    /// Graph with a `phantom`, whose views are rendered beforehand; `parts` is next to it.
    #[arg(value_name = "GRAPH", default_value = "graphs/surgeon.toml")]
    graph: PathBuf,
    /// Sets a parameter; overrides the file; repeatable.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    given: Given,
}

/// A text that is not a size.
#[derive(Debug, thiserror::Error)]
#[error("write WIDTHxHEIGHT in px, as in 1920x1080")]
struct NoSize;

/// Reads a size in px, as in 1920x1080.
fn size(text: &str) -> Result<(u32, u32), NoSize> {
    let numbers = text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    numbers.ok_or(NoSize)
}

/// Arguments of this bench.
#[derive(clap::Args)]
#[group(skip)]
pub struct System {
    #[command(flatten)]
    common: Arguments,
    #[command(flatten)]
    whole: WholeGraph,
    /// Size of the views; default: that of the graph's `phantom`.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<(u32, u32)>,
    /// Frames per second of the cameras.
    #[arg(long, value_name = "HZ", default_value_t = bench::CAMERA_HZ, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rate_hz: u32,
    /// Writes what each thread did at the cameras' rate, for the viewer at ui.perfetto.dev.
    #[arg(long, value_name = "FILE.json")]
    trace: Option<PathBuf>,
}

/// Arguments of this bench.
#[derive(clap::Args)]
#[group(skip)]
pub struct Cost {
    #[command(flatten)]
    common: Arguments,
    #[command(flatten)]
    whole: WholeGraph,
    /// Draws the curves.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
}

/// Measures, and shows and writes the figures.
pub fn run(bench: &Bench) -> Result<End> {
    allocations::exclude_this_thread();
    let (found, arguments) = measure(bench)?;
    raw(&figures::table(&found));
    if let Some(path) = &arguments.json {
        figures::write(path, &found)?;
    }
    Ok(End::Done)
}

fn measure(bench: &Bench) -> Result<(Vec<figures::Figure>, &Arguments)> {
    let session = &Terminal;
    Ok(match bench {
        Bench::Hop(Hop { common, peer }) => {
            interrupt::listen();
            (bench::hop::measure(session, bench::hop::Options { quick: common.quick, copper: peer.is_some() })?, common)
        }
        Bench::Start(arguments) => (bench::start::measure(arguments.quick)?, arguments),
        Bench::Scale(arguments) => (bench::scale::measure(session, arguments.quick)?, arguments),
        Bench::Stereo(Stereo { common, plot }) => {
            let options = bench::stereo::Options { quick: common.quick, plot: plot.clone() };
            (bench::stereo::measure(session, &options)?, common)
        }
        Bench::Editor(arguments) => {
            let (program, editor) = (beside::file(beside::PROGRAM)?, beside::file(beside::EDITOR)?);
            (bench::editor::measure(&bench::editor::Options { program, editor, quick: arguments.quick })?, arguments)
        }
        Bench::Remote(arguments) => {
            interrupt::listen();
            let options = bench::remote::Options { program: beside::file(beside::PROGRAM)?, quick: arguments.quick };
            (bench::remote::measure(session, &options)?, arguments)
        }
        Bench::Stitch(Stitch { common, size, plot }) => {
            interrupt::listen();
            let options = bench::stitch::Options { quick: common.quick, sizes: size.clone(), plot: plot.clone() };
            (bench::stitch::measure(session, &options)?, common)
        }
        Bench::Igtl(arguments) => {
            let options = bench::igtl::Options { program: beside::file(beside::PROGRAM)?, quick: arguments.quick };
            (bench::igtl::measure(session, &options)?, arguments)
        }
        Bench::Tools(Tools { common, python, model, masks }) => {
            let (python, model, masks) = (python.clone(), model.clone(), masks.clone());
            (
                bench::tools::measure(session, &bench::tools::Options { quick: common.quick, python, model, masks })?,
                common,
            )
        }
        Bench::System(System { common, whole: WholeGraph { graph, set, given }, size, rate_hz, trace }) => {
            interrupt::listen();
            let (graph, given, trace) = (graph.clone(), given.options(set), trace.clone());
            let (size, rate_hz) = (*size, *rate_hz);
            let options = bench::system::Options { quick: common.quick, graph, given, size, rate_hz, trace };
            (bench::system::measure(session, &options)?, common)
        }
        Bench::Cost(Cost { common, whole: WholeGraph { graph, set, given }, plot }) => {
            interrupt::listen();
            let (graph, given, plot) = (graph.clone(), given.options(set), plot.clone());
            let options = bench::cost::Options { quick: common.quick, graph, given, plot };
            (bench::cost::measure(session, &options)?, common)
        }
    })
}
