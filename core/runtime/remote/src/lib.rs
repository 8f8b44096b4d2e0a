//! Nodes of a graph on other machines, over zenoh.
//!
//! The host of a graph starts a process for each machine, the *link*, and treats it like the process of a group of
//! isolated nodes, with pools, plugins and lanes. The link ([`link::run`]) carries the messages of the lanes to
//! `panoscope serve` on the other machine ([`serve::Server`]), which acts as the host for a real process of isolated
//! nodes there. A message is accompanied by the bytes of the frames that it names and that the other side lacks; each
//! frame crosses once. Pools have the same numbers and offsets on both machines.
//!
//! No code is sent: the other machine uses its own plugins and models, and refuses where their hashes differ. Times of
//! the host's clock are translated by the offset of the two monotonic clocks, which is measured all the time
//! ([`clock`]). Machines know each other by certificates ([`keys`]); each host may use only its own keys of zenoh.
//!
//! Windows of other machines on a running graph use the same connections: [`attachable`] listens for them, [`attach`]
//! is their end. Both carry frames of [`panoscope_host::attach::tunnel`] and do not look into them.

pub mod attach;
pub mod attachable;
pub mod clock;
pub mod error;
mod files;
mod h264;
pub mod keys;
pub mod link;
mod mirror;
pub mod network;
pub mod raw;
pub mod refused;
pub mod serve;
mod served;
mod sessions;

/// Version that both machines must share: the version of Panoscope, of the ABI, and of the messages.
pub fn version() -> String {
    use panoscope_abi::{ABI_MAJOR, ABI_MINOR};
    let (version, messages) = (env!("CARGO_PKG_VERSION"), panoscope_host::isolate::PROTOCOL);
    format!("Panoscope {version}, plugin ABI {ABI_MAJOR}.{ABI_MINOR}, messages {messages}")
}
