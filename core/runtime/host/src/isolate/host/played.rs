//! A fake process, played by a thread with arbitrary messages, for tests of how the host handles violations of the
//! protocol.
//!
//! Not for programs: a played process runs no plugin.

use std::ffi::c_void;
use std::path::Path;
use std::sync::{Arc, Mutex};

use panoscope_abi::{self as abi, NodeType, Plugin, Status};
use panoscope_engine::isolation::{Group, GroupError, GroupReport, GroupSettings, Isolator};
use panoscope_engine::memory::{Domain, SharedFrames};

use super::process::Process;
use super::{PluginImage, Totals, describer, lock, remote};
use crate::isolate::description;
use crate::isolate::lane::{Lane, Side};
use crate::isolate::wire::lane::{Kind, Made, TickRequest};
use crate::isolate::wire::{BadMessage, encoded, put_bytes, whole};

/// Length of the name of a buffer in a message; a frame begins with its buffer.
const BUFFER_BYTES: usize = 12;

/// A part of a message.
#[derive(Clone, Debug)]
pub enum Piece {
    /// Literal bytes.
    Raw(Vec<u8>),
    /// A part preceded by its length.
    Counted(Vec<Piece>),
    /// The first input of the tick, as the host sent it.
    Input,
    /// The buffer of that input.
    InputBuffer,
    /// The buffer that the host reserved for the first output.
    Stock,
    /// The frame in the host's last answer.
    Made,
}

/// A message of the played process.
#[derive(Clone, Debug)]
pub struct Step {
    /// Number of the message's kind.
    pub kind: u32,
    /// Stated length; `None` for the actual one.
    pub stated_len: Option<u32>,
    /// Its content.
    pub pieces: Vec<Piece>,
}

/// Processes that answer each message of the host with the next step of a script and end after the last one.
#[derive(Debug)]
pub struct Played(pub Arc<[Step]>);

impl Isolator for Played {
    fn group(&self, _: &GroupSettings) -> Result<Arc<dyn Group>, GroupError> {
        let frames = SharedFrames::begin()?;
        let domain = Domain::written_elsewhere()?;
        let (script, process) = (Arc::clone(&self.0), Mutex::default());
        Ok(Arc::new(PlayedGroup { script, process, domain, totals: Arc::default(), _frames: frames }))
    }
}

struct PlayedGroup {
    script: Arc<[Step]>,
    process: Mutex<Option<Arc<Process>>>,
    domain: Domain,
    totals: Arc<Totals>,
    _frames: SharedFrames,
}

impl Group for PlayedGroup {
    fn proxy(&self, entry: &'static NodeType) -> &'static NodeType {
        let address = std::ptr::from_ref(entry).addr();
        let mut proxies = lock(&super::PROXIES);
        proxies.entry(address).or_insert_with(|| Box::leak(Box::new(remote::proxy_of(entry))))
    }

    unsafe fn open(&self, _: &'static NodeType, call: *mut abi::OpenCall, instance: *mut *mut c_void) -> Status {
        let script = Arc::clone(&self.script);
        let process = Process::played(self.domain.number(), &self.totals, move |lane| play(lane, &script));
        let Ok(process) = process else { return abi::STATUS_ERROR };
        *lock(&self.process) = Some(Arc::clone(&process));
        let nothing = PluginImage::new(Path::new("/dev/null"), Path::new("/dev/null"), None);
        // SAFETY: the caller's promise.
        unsafe { remote::open(process, &nothing, None, 0, call, instance) }
    }

    fn not_enforced(&self) -> Vec<&'static str> {
        Vec::new()
    }

    fn counts(&self) -> GroupReport {
        GroupReport::default()
    }

    fn domain(&self) -> u32 {
        self.domain.number()
    }

    fn kill(&self, reason: &str) {
        if let Some(process) = &*lock(&self.process) {
            process.kill(reason);
        }
    }
}

/// Parts of the host's messages that a process may send back.
#[derive(Default)]
struct Sent {
    input: Vec<u8>,
    stock: Vec<u8>,
    made: Vec<u8>,
}

/// Takes turns with the host until the script ends or the lane is closed.
fn play(lane: &Lane, script: &[Step]) {
    let (mut message, mut out, mut sent) = (Vec::new(), Vec::new(), Sent::default());
    for Step { kind, stated_len, pieces } in script {
        let Ok(asked) = lane.receive(Side::Child, &mut message) else { return };
        // A tick without inputs, or an answer without a frame: what was sent before stays.
        let _ = sent.note(asked, &message);
        out.clear();
        sent.write(pieces, &mut out);
        lane.post_as(Side::Child, *kind, stated_len.unwrap_or(out.len() as u32), &out);
    }
    // The host has its answer before the process ends.
    let _ = lane.receive(Side::Child, &mut message);
}

impl Sent {
    fn note(&mut self, asked: Kind, message: &[u8]) -> Result<(), BadMessage> {
        match asked {
            Kind::Answer => self.made = encoded(&whole::<Made>(message)?.frame),
            Kind::Process => {
                let request = whole::<TickRequest>(message)?;
                if let Some(input) = request.inputs.first() {
                    self.input = encoded(input);
                }
                if let Some(reserved) = request.stock.first() {
                    self.stock = encoded(&reserved.buffer);
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn write(&self, pieces: &[Piece], out: &mut Vec<u8>) {
        for piece in pieces {
            match piece {
                Piece::Raw(bytes) => out.extend_from_slice(bytes),
                Piece::Counted(pieces) => {
                    let mut inside = Vec::new();
                    self.write(pieces, &mut inside);
                    put_bytes(&inside, out);
                }
                Piece::Input => out.extend_from_slice(&self.input),
                Piece::InputBuffer => out.extend_from_slice(self.input.get(..BUFFER_BYTES).unwrap_or_default()),
                Piece::Stock => out.extend_from_slice(&self.stock),
                Piece::Made => out.extend_from_slice(&self.made),
            }
        }
    }
}

/// Decodes a process's description of its plugin and passes the resulting descriptor to the closure; `None` if it is
/// malformed.
pub fn with_description<R>(bytes: &[u8], read: impl FnOnce(*const Plugin) -> R) -> Option<R> {
    let described = description::read(bytes).ok()?;
    let pointers: Vec<*const NodeType> = described.node_types.iter().map(std::ptr::from_ref).collect();
    Some(read(&raw const *Box::new(describer::descriptor("played", &pointers))))
}

/// Encodes node types as a process does.
///
/// # Safety
/// As for the descriptors of a plugin that stays mapped.
pub unsafe fn description_of(node_types: &[&NodeType]) -> Vec<u8> {
    let mut bytes = Vec::new();
    // SAFETY: the caller's promise.
    unsafe { description::write(node_types, &mut bytes) };
    bytes
}

/// Decodes a process's answer to a check of parameters; returns the status, `None` if it is malformed.
///
/// # Safety
/// The handle of the call stays valid until this returns.
pub unsafe fn problems(answer: &[u8], call: &abi::ValidateCall) -> Option<Status> {
    // SAFETY: the caller's promise.
    unsafe { describer::report(answer, call) }.ok()
}

/// Numbers of the kinds of messages that a process sends.
pub fn kinds() -> Vec<u32> {
    (Kind::Done as u32..=Kind::Flush as u32).collect()
}
