//! What the window and the process that runs the graph say to each other: messages in JSON over a socket, pixels in shared memory.
//!
//! Both are the same program, so the format has no versions. The window believes nothing: a message that does not make sense ends the process.

mod memory;

use std::collections::BTreeMap;
use std::io::{self, Read, Write};

use panoscope_editor_model::arguments::Overlay;
use panoscope_editor_model::content::{Content, Rig};
use panoscope_editor_model::observe::{Counters, Output, PreviewRequest};
use panoscope_editor_model::session::{Phase, RunProblem, Status};
use panoscope_engine::NodeWindow;
use panoscope_engine::fault::Fault;
use panoscope_graph::{GraphOptions, ParamValue};
use panoscope_host::audit::LockFacts;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

pub(crate) use memory::{Region, SLOTS};

use super::{Opened, Refusal};

/// Longest message. A graph's text is the longest part of one.
const MAX_BYTES: usize = 64 << 20;

/// What the window sends.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum Command {
    /// Check the text of the graph file with these arguments. Answered by [`Message::Prepared`].
    Prepare { file: String, given: GraphOptions },
    /// Load what the text needs, which was checked by an earlier process, under this lock. Answered by [`Message::Prepared`].
    Reload {
        file: String,
        text: String,
        given: GraphOptions,
        lock: Option<LockFacts>,
        sealed: bool,
        /// Nodes whose parameters the window shows.
        watched: Vec<String>,
    },
    /// Use what was prepared last.
    Take,
    /// Find the overlays that fit the graph. Answered by [`Message::Overlays`].
    FindOverlays { file: String, given: GraphOptions },
    /// Run a text as a change of what runs, or `anew`.
    Run { id: u64, text: String, anew: bool },
    /// Make previews of these outputs.
    Preview { requests: Vec<(Output, PreviewRequest)>, interval_ms: u64 },
    /// Set a switch of a node at once. Answered by [`Message::Set`].
    SetAtOnce { id: u64, node: String, param: String, on: bool },
    /// The pixels of a slot were read.
    Free { slot: u32 },
    /// Answered by [`Message::Report`].
    Report,
    /// Finish all files and end.
    Close,
}

/// What the process that runs the graph sends.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum Message {
    /// It is alive, and its observer has looked at the run so often.
    Beat { rounds: u64 },
    /// The graph can be opened, or why not.
    Prepared(Result<Option<Box<Opened>>, Refusal>),
    /// The overlays that fit the graph.
    Overlays(Vec<Overlay>),
    /// State of the run.
    Status(RunState),
    /// The newest counters.
    Counters(CounterState),
    /// Values of the parameters of nodes that the window shows.
    Values(Vec<(String, Vec<ParamValue>)>),
    /// A preview.
    Picture(Box<Picture>),
    /// Whether a switch was set.
    Set { id: u64, ok: bool },
    /// The run's report.
    Report(Option<serde_json::Value>),
}

/// State of a run, see [`Status`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct RunState {
    phase: Phase,
    problem: Option<RunProblem>,
    pub busy: bool,
    /// Hash of the text that runs, see [`text_hash`].
    pub running: u64,
    /// Number of the last [`Command::Run`] that it takes into account.
    pub asked: u64,
}

impl RunState {
    pub fn of(status: &Status, asked: u64) -> Self {
        Self {
            phase: status.phase.clone(),
            problem: status.problem.clone(),
            busy: status.busy,
            running: text_hash(&status.running),
            asked,
        }
    }

    pub fn status(self) -> Status {
        Status { phase: self.phase, problem: self.problem, busy: self.busy, ..Status::default() }
    }

    /// Why the newest text does not run, on one line.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_ref().map(RunProblem::line)
    }

    pub fn is_running(&self) -> bool {
        self.phase == Phase::Running
    }
}

/// Names a text of a graph; the same in both processes.
pub(crate) fn text_hash(text: &str) -> u64 {
    use std::hash::{DefaultHasher, Hash, Hasher};
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    hasher.finish()
}

/// The counters that the theatre shows.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct CounterState {
    nodes: BTreeMap<String, NodeWindow>,
    faults: Vec<Fault>,
}

impl CounterState {
    pub fn of(counters: &Counters) -> Self {
        let nodes = counters.nodes.iter().map(|(id, node)| (id.clone(), node.clone().finite())).collect();
        Self { nodes, faults: counters.faults.values().cloned().collect() }
    }

    pub fn counters(self) -> Counters {
        let faults = self.faults.into_iter().map(|fault| (fault.node.clone(), fault)).collect();
        Counters { nodes: self.nodes, faults, ..Counters::default() }
    }
}

/// Pixels or points in a slot of the shared memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Block {
    pub slot: u32,
    pub width: u32,
    pub height: u32,
}

/// A preview without its pixels.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Picture {
    pub output: Output,
    /// Width and height of the packet itself, px.
    pub size_px: (usize, usize),
    pub text: String,
    pub seq: u64,
    /// Source of its tick.
    pub source: u32,
    /// Age of its light when the message was made, ns; `None` where it is not known.
    pub age_ns: Option<i64>,
    /// When the message was made, ns of the system's monotonic clock, which all processes share.
    pub made_ns: u64,
    /// Opaque RGBA.
    pub pixels: Option<Block>,
    /// x, y, z, mm, and confidence as `f32`.
    pub cloud: Option<Block>,
    /// What the cameras are like, of a packet of a calibration.
    pub rig: Option<RigState>,
}

/// A [`Rig`]; `None` for a number that is not known, as JSON has no NaN.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct RigState {
    focal_px: Option<f64>,
    baseline_mm: Option<f64>,
    rms_px: Option<f64>,
    stated_error: u32,
}

impl RigState {
    pub fn of(content: &Content) -> Option<Self> {
        let &Content::Rig(Rig { focal_px, baseline_mm, rms_px, stated_error }) = content else { return None };
        let [focal_px, baseline_mm, rms_px] =
            [focal_px, baseline_mm, rms_px].map(|number| Some(number).filter(|n| n.is_finite()));
        Some(Self { focal_px, baseline_mm, rms_px, stated_error })
    }

    pub fn content(self) -> Content {
        let [focal_px, baseline_mm, rms_px] =
            [self.focal_px, self.baseline_mm, self.rms_px].map(|number| number.unwrap_or(f64::NAN));
        Content::Rig(Rig { focal_px, baseline_mm, rms_px, stated_error: self.stated_error })
    }
}

/// Time of the system's monotonic clock, ns.
pub(crate) fn monotonic_ns() -> u64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a valid `timespec` for the call to write to.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
    time.tv_sec.unsigned_abs() * 1_000_000_000 + time.tv_nsec.unsigned_abs()
}

/// Writes a message: its length in bytes, 32 bits, little-endian; then JSON.
///
/// # Errors
/// The other side is gone.
pub(crate) fn send<T: Serialize>(to: &mut impl Write, message: &T) -> io::Result<()> {
    let mut bytes = vec![0; 4];
    serde_json::to_writer(&mut bytes, message)?;
    let len = bytes.len() - 4;
    if len > MAX_BYTES {
        return Err(io::Error::other("the message is too long"));
    }
    bytes[..4].copy_from_slice(&(len as u32).to_le_bytes());
    to.write_all(&bytes)?;
    to.flush()
}

/// Reads a message; `None` at the end.
///
/// # Errors
/// The message is cut off, too long, or is malformed.
pub(crate) fn receive<T: DeserializeOwned>(from: &mut impl Read) -> io::Result<Option<T>> {
    let mut len = [0; 4];
    match from.read_exact(&mut len) {
        Ok(()) => {}
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        Err(error) => return Err(error),
    }
    let len = u32::from_le_bytes(len) as usize;
    if len > MAX_BYTES {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "the message is too long"));
    }
    let mut bytes = Vec::new();
    from.take(len as u64).read_to_end(&mut bytes)?;
    if bytes.len() < len {
        return Ok(None);
    }
    serde_json::from_slice(&bytes).map(Some).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_arrive_as_they_were_sent() {
        let mut bytes = Vec::new();
        send(&mut bytes, &Command::Run { id: 1, text: "[nodes.a]\n".to_owned(), anew: false })
            .expect("memory takes it");
        send(&mut bytes, &Command::SetAtOnce { id: 7, node: "arm".into(), param: "stop".into(), on: true })
            .expect("too");
        let mut from = bytes.as_slice();
        assert!(matches!(receive(&mut from), Ok(Some(Command::Run { text, .. })) if text == "[nodes.a]\n"));
        assert!(matches!(receive(&mut from), Ok(Some(Command::SetAtOnce { id: 7, on: true, .. }))));
        assert!(matches!(receive::<Command>(&mut from), Ok(None)), "the end");
        // Cut off in a message: the end, too.
        assert!(matches!(receive::<Command>(&mut &bytes[..9]), Ok(None)));
    }

    #[test]
    fn what_makes_no_sense_is_an_error() {
        let text = b"\x05\0\0\0{\"x\":";
        assert!(receive::<Message>(&mut text.as_slice()).is_err());
        assert!(receive::<Message>(&mut [0xFF; 8].as_slice()).is_err(), "too long");
    }

    #[test]
    fn counters_and_a_rig_with_unknown_numbers_survive_the_way() {
        let mut counters = Counters::default();
        let metrics = vec![("drifted".to_owned(), 1.0), ("skill".to_owned(), f64::NAN)];
        counters.nodes.insert("a".to_owned(), NodeWindow { faults: 3, metrics, ..NodeWindow::default() });
        let mut bytes = Vec::new();
        send(&mut bytes, &Message::Counters(CounterState::of(&counters))).expect("memory takes it");
        let Ok(Some(Message::Counters(state))) = receive(&mut bytes.as_slice()) else { panic!("counters") };
        let there = state.counters();
        assert_eq!((there.nodes["a"].faults, there.nodes["a"].metrics.len()), (3, 1));
        let rig = Rig { focal_px: 700.0, baseline_mm: 4.0, rms_px: f64::NAN, stated_error: 77 };
        let picture = Picture {
            output: Output::new("a", "b"),
            size_px: (1, 1),
            text: String::new(),
            seq: 0,
            source: 0,
            age_ns: None,
            made_ns: 0,
            pixels: None,
            cloud: None,
            rig: RigState::of(&Content::Rig(rig)),
        };
        let mut bytes = Vec::new();
        send(&mut bytes, &picture).expect("memory takes it");
        let there: Picture = receive(&mut bytes.as_slice()).expect("it is read").expect("it is there");
        assert!(
            matches!(there.rig.map(RigState::content), Some(Content::Rig(r)) if r.focal_px == 700.0 && r.rms_px.is_nan() && r.stated_error == 77)
        );
    }
}
