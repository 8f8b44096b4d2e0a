//! A running graph for other programs.
//!
//! [`FoxgloveServer`] serves Foxglove's WebSocket protocol: a topic for each output, parameters of nodes. A [`Gate`](gate) in front of it refuses
//! pages of other origins. Outputs without a subscriber cost nothing: previews exist only while somebody is subscribed.
//!
//! Nothing here listens unless the user asks for it; [`LISTENERS`] says what can.

mod error;
mod gate;
mod outputs;
mod parameters;
mod publisher;
mod server;

pub use error::LiveServerError;
pub use gate::{Refusal, check_head};
pub use server::{FoxgloveServer, Options};

/// Something that can listen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Listener {
    /// What asks for it.
    pub option: &'static str,
    /// Protocol and purpose.
    pub what: &'static str,
    /// Where it listens when only a port is given.
    pub default_address: &'static str,
    /// What others may do.
    pub access: &'static str,
}

/// What this crate can listen on, off by default. Nodes that listen: [`panoscope_graph::listening`].
pub const LISTENERS: &[Listener] = &[Listener {
    option: "run --foxglove PORT|IP:PORT",
    what: "WebSocket, outputs and parameters for Foxglove",
    default_address: "127.0.0.1",
    access: "reads outputs and parameters; sets numbers, switches and choices only with --foxglove-set",
}];
