//! Windows of other machines on a running graph: their messages, and both ends of the connection.
//!
//! `panoscope run GRAPH --attachable ADDRESS` makes a graph [`Attachable`]. `panoscope edit --attach NAME` and
//! `panoscope theatre --attach NAME` open an [`Attachment`]. Neither uses the network itself: each starts
//! `panoscope-machine`, which knows zenoh and certificates, and exchanges [`tunnel`] frames with it over a socket. The
//! frames carry the messages of [`message`].
//!
//! Packets cross as the engine has them, reduced to the size at which they are shown, and the window renders them as it
//! renders those of a local engine. An output whose last packets the window has not taken yet sends none, so a slow
//! network shows fewer images and no old ones.
//!
//! A window reads. It edits where the running side allows its machine to (`--allow-edit`), within [`rules`]: it never
//! sets or releases an emergency stop, and names no new folder of plugins.

pub mod message;
mod packet;
mod program;
mod queue;
pub mod rules;
mod running;
mod target;
pub mod tunnel;
mod window;

/// Number of packets of each of two compared outputs among which one tick is searched: 130 ms of delay between the two at 120 Hz.
pub const PAIR_TICKS: usize = 16;

pub use packet::{Packet, PacketError};
pub use program::{KEYS_VARIABLE, LISTENERS};
pub use queue::{Full, Queue};
pub use running::{AttachError, Attachable, Options};
pub use target::{Target, TargetError};
pub use window::{Attachment, Clock, Contact, Edit, State};
