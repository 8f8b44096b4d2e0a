//! A running graph for other programs.
//!
//! [`FoxgloveServer`] serves Foxglove's WebSocket protocol: a topic for each output, parameters of nodes. A
//! [`Gate`](gate) in front of it refuses pages of other origins. Outputs without a subscriber cost nothing: previews
//! exist only while there is a subscriber.
//!
//! Nothing listens unless the user requests it.

mod error;
mod gate;
mod outputs;
mod parameters;
mod publisher;
mod server;

pub use error::LiveServerError;
pub use gate::{Refusal, check_head};
pub use server::{FoxgloveServer, Options};
