//! Recording a run and playing it again, to the byte.
//!
//! A [`Recorder`] writes down what came from outside (the sources' packets, changes of the graph and of values) and what depended on time
//! (which ticks were dropped, which packets met at inputs that are not `exact`, at which tick a value or a new instance came into
//! force, which ticks a failed node missed). A [`Replay`] follows that; all else follows from the ticks, because nodes see neither clock nor
//! thread.

mod check;
pub mod compare;
mod content;
pub mod digest;
mod file;
mod file_hash;
pub mod format;
mod head;
mod recorder;
mod recording;
mod replay;
mod script;

pub use digest::Digests;
pub use file::Output;
pub use file_hash::FileHash;
pub use format::{Event, Head};
pub use head::head;
pub use recorder::{RecordError, RecordOptions, Recorded, Recorder};
pub use recording::{Cut, Packet, Recording, RecordingError, SourceTick};
pub use replay::{Replay, ReplayError, ReplayOptions};
pub use script::Script;
