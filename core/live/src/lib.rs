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

use panoscope_graph::Listener;

/// What this crate can listen on, off by default. Nodes that listen: [`panoscope_graph::listening`].
pub const LISTENERS: &[Listener] = &[Listener {
    option: "run --foxglove PORT|IP:PORT",
    what: "WebSocket, outputs and parameters for Foxglove",
    default_address: "127.0.0.1",
    access: "reads outputs and parameters; sets numbers, switches and choices only with --foxglove-set",
}];
