//! The 58 bytes before each body.

use std::borrow::Cow;

use crate::error::{IgtlError, Result};
use crate::fields::{Fields, padded, put_text};
use crate::time::Timestamp;

/// Length of the header.
pub const HEADER_BYTES: usize = 58;
/// Longest message type.
pub const TYPE_BYTES: usize = 12;
/// Longest device name.
pub const NAME_BYTES: usize = 20;

/// Header of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header<'a> {
    /// Version 1, 2 or 3. From version 2 on, the body begins with an extended header.
    pub version: u16,
    /// Message type, such as `TRANSFORM`.
    pub kind: Cow<'a, str>,
    /// Device name.
    pub device: Cow<'a, str>,
    /// When the data was taken.
    pub time: Timestamp,
    /// Length of the body that follows.
    pub body_bytes: u64,
    /// CRC64 of the body.
    pub crc: u64,
}

impl<'a> Header<'a> {
    /// Reads the first [`HEADER_BYTES`] of `bytes`.
    ///
    /// # Errors
    /// There are fewer bytes, the version is unknown, or the type is not printable ASCII, as in a stream that is out of
    /// step.
    pub fn decode(bytes: &'a [u8]) -> Result<Self> {
        let mut fields = Fields::new("header", bytes);
        let version = fields.u16("version")?;
        let kind = fields.take("type", TYPE_BYTES)?;
        let device = fields.text("device name", NAME_BYTES)?;
        let time = Timestamp::from_bits(fields.u64("timestamp")?);
        let body_bytes = fields.u64("body size")?;
        let crc = fields.u64("CRC")?;
        if !(1..=3).contains(&version) {
            return Err(IgtlError::Version { version });
        }
        let kind = padded(kind);
        if kind.is_empty() || !kind.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err(IgtlError::TypeName);
        }
        Ok(Self { version, kind, device, time, body_bytes, crc })
    }

    /// Appends the header.
    ///
    /// # Errors
    /// A name that is too long.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        out.extend_from_slice(&self.version.to_be_bytes());
        put_text(out, "a message type", &self.kind, TYPE_BYTES)?;
        put_text(out, "a device name", &self.device, NAME_BYTES)?;
        out.extend_from_slice(&self.time.to_bits().to_be_bytes());
        out.extend_from_slice(&self.body_bytes.to_be_bytes());
        out.extend_from_slice(&self.crc.to_be_bytes());
        Ok(())
    }
}
