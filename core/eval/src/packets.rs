//! Reads packets from nodes' outputs.

use panoscope_abi::Calibration;
use panoscope_base::packet;
use panoscope_engine::memory::FrameRef;

use crate::error::{Context, EvalError, Result};

/// A packet of type `table`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Column names with their units.
    pub names: Vec<String>,
    /// Rows with a value per column.
    pub rows: Vec<Vec<f64>>,
}

impl Table {
    /// Reads a packet; `None` if it is not a complete table.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let table = packet::Table::parse(bytes).ok()?;
        let values: Vec<f64> = table.values().collect();
        let rows = values.chunks_exact(table.columns().max(1)).map(<[f64]>::to_vec).collect();
        Some(Self { names: table.names().map(str::to_owned).collect(), rows })
    }

    /// Reads the table of an evaluating node from its newest packet.
    ///
    /// # Errors
    /// There is no packet, or it is not a complete table.
    pub fn of_judge(packet: Option<&FrameRef>) -> Result<Self> {
        let packet = packet.context("the evaluating node received no packets")?;
        Self::read(packet.bytes()).context("the table of the evaluating node is malformed")
    }

    /// All values of a column; `table` names whose table it is.
    ///
    /// # Errors
    /// The column is missing.
    pub fn required(&self, table: &'static str, name: &str) -> Result<Vec<f64>> {
        self.column(name).ok_or_else(|| EvalError::Column { table, column: name.to_owned() })
    }

    /// All values of a column.
    pub fn column(&self, name: &str) -> Option<Vec<f64>> {
        let index = self.names.iter().position(|n| n == name)?;
        Some(self.rows.iter().map(|row| row[index]).collect())
    }
}

/// The bytes of an image, row by row without padding. `None` if the buffer is too short for the frame.
pub fn bytes(frame: &FrameRef, channels: usize) -> Option<Vec<u8>> {
    let (described, bytes) = (frame.frame(), frame.bytes());
    let (width, height, stride) =
        (described.width as usize, described.height as usize, described.stride_bytes as usize);
    let mut out = Vec::with_capacity(width * height * channels);
    for y in 0..height {
        out.extend_from_slice(bytes.get(y * stride..y * stride + channels * width)?);
    }
    Some(out)
}

/// The values of a frame of floats, row by row without padding. `None` if the buffer is too short for the frame.
pub fn floats(frame: &FrameRef) -> Option<Vec<f32>> {
    let (described, bytes) = (frame.frame(), frame.bytes());
    let (width, height) = (described.width as usize, described.height as usize);
    let stride = described.stride_bytes as usize;
    let mut out = Vec::with_capacity(width * height);
    for y in 0..height {
        let row = bytes.get(y * stride..y * stride + 4 * width)?;
        out.extend(row.as_chunks::<4>().0.iter().map(|value| f32::from_ne_bytes(*value)));
    }
    Some(out)
}

/// Reads a packet of type `calibration`. `None` if it is truncated.
pub fn calibration(bytes: &[u8]) -> Option<Calibration> {
    packet::decode(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calibrations_are_read_field_by_field() {
        // As many numbers as the packet has, counted up; the sizes of the pictures are words.
        let mut bytes = Vec::new();
        let mut next = 0.0f64;
        let mut numbers = |bytes: &mut Vec<u8>, count: usize| {
            for _ in 0..count {
                next += 1.0;
                bytes.extend(next.to_ne_bytes());
            }
        };
        for size in [[640u32, 480], [800, 600]] {
            size.iter().for_each(|word| bytes.extend(word.to_ne_bytes()));
            numbers(&mut bytes, 18);
        }
        numbers(&mut bytes, 56);
        [1u32, 0].iter().for_each(|word| bytes.extend(word.to_ne_bytes()));
        assert_eq!(bytes.len(), size_of::<Calibration>());
        let read = calibration(&bytes).expect("it is whole");
        assert_eq!((read.left.width, read.left.height, read.right.width), (640, 480, 800));
        assert_eq!((read.left.fx, read.right.distortion[13], read.right_from_left_rotation[0]), (1.0, 36.0, 37.0));
        assert_eq!((read.baseline_mm, read.rms_px, read.is_rectified), (91.0, 92.0, 1));
        assert!(calibration(&bytes[..bytes.len() - 1]).is_none());
    }

    #[test]
    fn tables_are_read_as_nodes_write_them() {
        let mut bytes = Vec::new();
        for word in [2u32, 2, 8, 0] {
            bytes.extend(word.to_ne_bytes());
        }
        bytes.extend(b"a\nb_px\0\0");
        for number in [1.0f64, 2.0, 3.0, 4.5] {
            bytes.extend(number.to_ne_bytes());
        }
        let table = Table::read(&bytes).unwrap();
        assert_eq!(table.column("b_px"), Some(vec![2.0, 4.5]));
        assert_eq!(table.column("c"), None);
        assert_eq!(Table::read(&bytes[..bytes.len() - 1]), None, "cut off");
    }
}
