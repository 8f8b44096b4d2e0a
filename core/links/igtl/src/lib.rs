//! OpenIGTLink messages, which image-guided therapy programs such as 3D Slicer, PLUS and MITK exchange over TCP.
//!
//! A message is a [`Header`] of 58 bytes and a body with a CRC64 ([`crc`]). Header version 1 is that of protocol
//! versions 1 and 2. Versions 2 and 3 add an extended header before the content and metadata after it
//! ([`Message::metadata`]). All numbers are big-endian; pixels state their own order.
//!
//! [`Message::decode`] borrows from the bytes, [`Message::encode`] appends to a buffer, [`Reader`] finds the messages
//! of a stream. Lengths from outside are compared with the bytes that are there before anything is allocated, and
//! [`Reader`] refuses bodies above its limit.
//!
//! Lengths are mm. Rotations travel as the columns of a matrix, quaternions as x, y, z, w.
//!
//! Source: the documents of protocol 3.0 in the repository of the OpenIGTLink library, and the bytes that the library
//! and pyigtl write (`tests/golden.rs`).

#![forbid(unsafe_code)]

pub mod crc;
mod error;
mod fields;
mod header;
pub mod message;
mod metadata;
mod reader;
mod time;

pub use error::IgtlError;
pub use header::{HEADER_BYTES, Header, NAME_BYTES, TYPE_BYTES};
pub use message::{Content, Message};
pub use reader::{DEFAULT_BODY_LIMIT, Raw, Reader};
pub use time::Timestamp;

/// TCP port that is registered for the protocol.
pub const DEFAULT_PORT: u16 = 18944;
