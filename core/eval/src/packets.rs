//! Reading packets that nodes put out.

use panoscope_abi::{Calibration, Camera};
use panoscope_engine::memory::FrameRef;

/// A packet of type `table`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Column names with their units.
    pub names: Vec<String>,
    /// Rows of as many numbers.
    pub rows: Vec<Vec<f64>>,
}

impl Table {
    /// Reads a packet: rows, columns, length of the names, reserved (u32 each), the names, the numbers.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let word = |index: usize| {
            let part = bytes.get(index * 4..index * 4 + 4)?;
            Some(u32::from_ne_bytes(part.try_into().ok()?) as usize)
        };
        let (rows, columns, names_len) = (word(0)?, word(1)?, word(2)?);
        let names = std::str::from_utf8(bytes.get(16..16 + names_len)?).ok()?.trim_end_matches('\0');
        let numbers = bytes.get(16 + names_len..)?;
        let numbers = numbers.get(..rows.checked_mul(columns)?.checked_mul(8)?)?;
        let number = |part: &[u8]| part.try_into().map_or(f64::NAN, f64::from_ne_bytes);
        let values: Vec<f64> = numbers.chunks_exact(8).map(number).collect();
        let rows = values.chunks_exact(columns.max(1)).map(<[f64]>::to_vec).collect();
        Some(Self { names: names.lines().map(str::to_owned).collect(), rows })
    }

    /// All values of a column.
    pub fn column(&self, name: &str) -> Option<Vec<f64>> {
        let index = self.names.iter().position(|n| n == name)?;
        Some(self.rows.iter().map(|row| row[index]).collect())
    }
}

/// The values of a frame of floats, row by row without padding. `None` if the buffer is shorter than the frame says.
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

/// Reads a packet of type `calibration`. `None` if it is cut off.
pub fn calibration(bytes: &[u8]) -> Option<Calibration> {
    let mut fields = Fields(bytes);
    let calibration = Calibration {
        left: fields.camera()?,
        right: fields.camera()?,
        right_from_left_rotation: fields.numbers()?,
        right_from_left_mm: fields.numbers()?,
        rectified_from_left: fields.numbers()?,
        rectified_from_right: fields.numbers()?,
        left_projection: fields.numbers()?,
        right_projection: fields.numbers()?,
        baseline_mm: fields.number()?,
        rms_px: fields.number()?,
        is_rectified: fields.word()?,
        reserved: fields.word()?,
    };
    Some(calibration)
}

/// The fields of a packet in order, of which none needs padding.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    fn word(&mut self) -> Option<u32> {
        self.take().map(u32::from_ne_bytes)
    }

    fn number(&mut self) -> Option<f64> {
        self.take().map(f64::from_ne_bytes)
    }

    fn numbers<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number()?;
        }
        Some(numbers)
    }

    fn camera(&mut self) -> Option<Camera> {
        Some(Camera {
            width: self.word()?,
            height: self.word()?,
            fx: self.number()?,
            fy: self.number()?,
            cx: self.number()?,
            cy: self.number()?,
            distortion: self.numbers()?,
        })
    }
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
