//! Records a run and replays it to the byte.
//!
//! A [`Recorder`] records input from outside (the sources' packets, changes of the graph and of values) and decisions
//! that depended on time (which ticks were dropped, which packets met at inputs that are not `exact`, from which tick
//! on a value or a new instance was used, which ticks a failed node skipped). A [`Replay`] repeats these. Everything
//! else depends on the ticks only, because nodes have no access to clock or threads.

mod check;
mod coding;
pub mod compare;
mod content;
pub mod digest;
mod file;
mod file_hash;
pub mod format;
mod head;
mod mcap_file;
mod mcap_texts;
mod port_types;
mod recorder;
mod recording;
mod replay;
mod script;
pub mod timeline;

pub use digest::Digests;
pub use file_hash::{FileHash, hash as hash_file};
pub use format::{Coding, Event, Head};
pub use head::head;
pub use mcap_file::Output;
pub use port_types::{PortTypeError, PortTypes, own_folders};
pub use recorder::{RecordError, RecordOptions, Recorded, Recorder};
pub use recording::{Cut, Packet, Recording, RecordingError, SourceTick};
pub use replay::{Replay, ReplayError, ReplayOptions, StaleError};
pub use script::Script;
