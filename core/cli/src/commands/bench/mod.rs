//! `panoscope bench`: what the runtime itself costs.

mod editor;
mod fit;
pub mod folder;
mod graph;
mod gstreamer;
mod hop;
mod pairs;
pub mod record;
mod scale;
mod start;
mod stereo;
mod stitch;
mod system;
mod tools;

use std::path::PathBuf;

use anyhow::Result;

use crate::{End, allocations};

/// What is measured.
#[derive(clap::Subcommand)]
pub enum Bench {
    /// From node to node: inline, between threads, paced; beside GStreamer.
    Hop(Arguments),
    /// Checking and starting large graphs.
    Start(Arguments),
    /// Cost of a tick against the number of nodes.
    Scale(Arguments),
    /// The stereo chain step by step, beside OpenCV's.
    Stereo(stereo::Arguments),
    /// What the editor's window costs the graph and its own thread. Needs a screen, or Xvfb.
    Editor(Arguments),
    /// Registration, seam and blend at three sizes, beside OpenCV.
    Stitch(stitch::Arguments),
    /// Detector and segmenter on a picture of 640x480, beside plain ONNX Runtime in Python.
    Tools(tools::Arguments),
    /// A whole graph on views rendered beforehand: pictures a second, their age at 30 a second, where the time goes.
    System(system::Arguments),
}

/// Arguments of every bench.
#[derive(clap::Args)]
pub struct Arguments {
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
    /// Fewer frames and rounds: a look, not a measurement.
    #[arg(long)]
    quick: bool,
}

/// Measures.
pub fn run(bench: &Bench) -> Result<End> {
    allocations::leave_this_thread_out();
    let (figures, arguments) = match bench {
        Bench::Hop(arguments) => (hop::measure(arguments.quick)?, arguments),
        Bench::Start(arguments) => (start::measure(arguments.quick)?, arguments),
        Bench::Scale(arguments) => (scale::measure(arguments.quick)?, arguments),
        Bench::Stereo(arguments) => (stereo::measure(arguments)?, &arguments.common),
        Bench::Editor(arguments) => (editor::measure(arguments.quick)?, arguments),
        Bench::Stitch(arguments) => (stitch::measure(arguments)?, &arguments.common),
        Bench::Tools(arguments) => (tools::measure(arguments)?, &arguments.common),
        Bench::System(arguments) => (system::measure(arguments)?, &arguments.common),
    };
    record::show(&figures);
    if let Some(path) = &arguments.json {
        record::write(path, &figures)?;
    }
    Ok(End::Done)
}
