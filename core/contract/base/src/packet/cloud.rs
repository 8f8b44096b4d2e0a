//! Packet `cloud`: a grid of coloured points.

use panoscope_abi::{self as abi, CloudPoint};

use super::PacketError;
use crate::format;

const POINT: usize = size_of::<CloudPoint>();

/// A cloud whose rows have been checked against its bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cloud<'b> {
    bytes: &'b [u8],
    width: usize,
    height: usize,
    stride_bytes: usize,
}

impl<'b> Cloud<'b> {
    /// The points of a frame that has the format `cloud`.
    ///
    /// # Errors
    /// When the rows overlap or do not fit the bytes.
    pub fn parse(bytes: &'b [u8], width: usize, height: usize, stride_bytes: usize) -> Result<Self, PacketError> {
        match format::image_bytes(width, height, stride_bytes, format::pixel_bytes(abi::FORMAT_CLOUD)) {
            Some(need) if need <= bytes.len() => Ok(Self { bytes, width, height, stride_bytes }),
            _ => Err(PacketError::Geometry { packet: "cloud", width, height, stride_bytes, len: bytes.len() }),
        }
    }

    /// Points per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The point in a column and a row, coordinates NaN where unknown; `None` outside the cloud.
    #[inline]
    pub fn point(&self, column: usize, row: usize) -> Option<CloudPoint> {
        if column >= self.width || row >= self.height {
            return None;
        }
        let bytes: &[u8; POINT] = self.bytes.get(row * self.stride_bytes + column * POINT..)?.first_chunk()?;
        let number = |at: usize| f32::from_ne_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let [.., blue, green, red, filled] = *bytes;
        Some(CloudPoint { x_mm: number(0), y_mm: number(4), z_mm: number(8), bgr: [blue, green, red], filled })
    }
}
