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

/// What this crate and the plugin `ros2`, which the program does not link, can listen on. All of it is off by default.
pub const LISTENERS: &[Listener] = &[
    Listener {
        option: "run --foxglove PORT|IP:PORT",
        what: "WebSocket, outputs and parameters for Foxglove",
        default_address: "127.0.0.1",
        access: "reads outputs and parameters; sets numbers, switches and choices only with --foxglove-set",
    },
    Listener {
        option: "nodes `ros2_publish` and `ros2_subscribe`",
        what: "DDS over UDP, ports 7400 + 250 * domain and the following 250",
        default_address: "the loopback device; others with `networks = \"all\"`",
        access: "reads what is published, sends to topics that are subscribed to; no password",
    },
];
