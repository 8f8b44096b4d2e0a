//! GStreamer for the plugins that read and write video: initialization, elements and their packages, errors, offers of
//! WebRTC viewers.
//!
//! `capture` and `sinks` are separate libraries that share one GStreamer in a process. Code that both need is here.

mod container;
mod decode;
mod elements;
mod encode;
mod error;
pub mod input;
pub mod offer;
mod planes;

pub use container::{Container, ContainerFile};
pub use decode::Decoder;
pub use elements::{init, is_installed, make};
pub use encode::{Encoder, EncoderSettings, Framing, Packet, RateControl, VideoCodec};
pub use error::MediaError;
pub use planes::{Component, FromYuv, Plane, yuv_to_bgr};
