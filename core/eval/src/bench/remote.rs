//! Cost of an edge to another machine, compared with zenoh alone and dora. The other machine is a process on this one,
//! reached over TCP.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use super::dora;
use super::graph::{self, Pace};
use crate::error::{EvalError, FileAction, OnFile, Result};
use crate::figures::Figure;
use crate::session::{Session, note};

/// Options of the bench.
#[derive(Clone, Debug)]
pub struct Options {
    /// The program `panoscope`.
    pub program: PathBuf,
    /// Fewer frames.
    pub quick: bool,
}

const SIZES: [(&str, u32, u32); 2] = [("640x480", 640, 480), ("1920x1080", 1920, 1080)];
const BYTES_PER_PIXEL: usize = 3;
const RATE_HZ: f64 = 60.0;

/// A `panoscope serve` on this machine. It ends when this is dropped.
struct Machine {
    child: Child,
    port: u16,
}

impl Drop for Machine {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn system(what: &str, cause: &dyn std::fmt::Display) -> EvalError {
    EvalError::Peer { reason: format!("{what}: {cause}") }
}

fn free_port() -> Result<u16> {
    let port = || Ok::<_, std::io::Error>(TcpListener::bind("127.0.0.1:0")?.local_addr()?.port());
    port().map_err(|cause| system("no port is free", &cause))
}

impl Machine {
    fn start(program: &Path) -> Result<Self> {
        let port = free_port()?;
        let mut command = Command::new(program);
        command.args(["serve", "--name", "rack", "--listen", &format!("tcp/127.0.0.1:{port}")]);
        let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
        let mut this = Self { child: child.map_err(|cause| system("`panoscope serve` does not start", &cause))?, port };
        let listens = this.child.stdout.take().and_then(|out| BufReader::new(out).lines().next());
        match listens {
            Some(Ok(_)) => Ok(this),
            _ => Err(system("`panoscope serve`", &"it does not listen")),
        }
    }

    /// A graph with one of its nodes on the machine.
    fn on(&self, text: &str, node: &str, (width, height): (u32, u32)) -> String {
        let text = text.replacen(&format!("[nodes.{node}]\n"), &format!("[nodes.{node}]\non = \"rack\"\n"), 1);
        let text = text.replace("rate_hz", &format!("width_px = {width}, height_px = {height}, rate_hz"));
        format!("{text}[machines.rack]\naddress = \"tcp/127.0.0.1:{}\"\n", self.port)
    }
}

/// Seconds for `count` messages from one zenoh session to another.
fn zenoh_alone_s(program: &Path, bytes: usize, count: u64) -> Result<f64> {
    let mut command = Command::new(program.with_file_name(panoscope_host::isolate::MACHINE_PROGRAM));
    command.args(["bench", &free_port()?.to_string(), &bytes.to_string(), &count.to_string()]);
    let done = command.output().map_err(|cause| system("zenoh alone", &cause))?;
    let written = String::from_utf8_lossy(&done.stdout).trim().parse();
    written.map_err(|_| system("zenoh alone", &String::from_utf8_lossy(&done.stderr).trim()))
}

/// Measures both sizes.
///
/// # Errors
/// The other process does not start, or a run fails.
pub fn measure(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let folder = std::env::temp_dir().join(format!("panoscope-bench-remote-{}", std::process::id()));
    std::fs::create_dir_all(&folder).on_file(FileAction::Create, &folder)?;
    let machine = Machine::start(&options.program)?;
    let (frames, rounds) = if options.quick { (200, 2) } else { (1000, 5) };
    let has_dora = dora::is_there();
    if !has_dora {
        note!(session, "skipped: dora: no `dora` (pip install dora-rs dora-rs-cli pyarrow)");
    }
    let mut figures = Vec::new();
    for (size, width, height) in SIZES {
        let bytes = (width * height) as usize * BYTES_PER_PIXEL;
        let [mut edge_ms, mut zenoh_ms, mut trip_ms] = [f64::INFINITY; 3];
        let mut dora_ms: Option<f64> = None;
        for _ in 0..rounds {
            let text = machine.on(&graph::chain("pass", 0, None, Pace::Saturated), "sink", (width, height));
            edge_ms = edge_ms.min(graph::run(session, &text, frames)?.ns_per_tick() / 1e6);
            zenoh_ms = zenoh_ms.min(zenoh_alone_s(&options.program, bytes, frames)? * 1e3 / frames as f64);
            let text = machine.on(&graph::chain("pass", 1, None, Pace::Hz(RATE_HZ)), "n0", (width, height));
            let run = graph::run(session, &text, frames.min(300))?;
            trip_ms = trip_ms.min(run.report.nodes.get("n0").map_or(f64::INFINITY, |node| node.p50_ms));
            if has_dora && let Some(ns) = dora::round_trip_ns(&folder, width, height, frames.min(300))? {
                dora_ms = Some(dora_ms.map_or(ns / 1e6, |least| least.min(ns / 1e6)));
            }
        }
        let input = format!("{size} bgr8 to a node on another machine, as fast as it takes them: time per frame");
        figures.push(
            Figure::new(&format!("remote_edge/{size}"), edge_ms, "ms", &input).beside("zenoh alone", Some(zenoh_ms)),
        );
        let input = format!("{size} bgr8 to a node on another machine and its answer, at {RATE_HZ} Hz, p50");
        let figure = Figure::new(&format!("remote_round_trip/{size}"), trip_ms, "ms", &input);
        figures.push(figure.beside("dora, to a node in Python and back on one machine", dora_ms));
    }
    let _ = std::fs::remove_dir_all(&folder);
    Ok(figures)
}
