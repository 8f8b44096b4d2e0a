//! Numbers of any packet that holds some: the value of a scalar, the rows of a table.

use panoscope_abi as abi;

use super::{PacketError, Table, decode, label};

/// Largest number of columns and rows that [`Numbers::read`] copies.
const MAX_ENTRIES: usize = 4096;

/// Named numbers, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Numbers {
    /// Names of the columns, with units where the packet states them apart.
    pub names: Vec<String>,
    /// As many values per row as there are names; NaN where unknown.
    pub values: Vec<f64>,
}

impl Numbers {
    /// Reads a packet of type `packet`; `None` for types without numbers. Of large tables the first 4096 columns and
    /// rows are read.
    ///
    /// # Errors
    /// When the bytes are not a packet of that type.
    pub fn read(bytes: &[u8], packet: &str) -> Result<Option<Self>, PacketError> {
        match packet {
            "scalar" => {
                let scalar: abi::Scalar = decode(bytes)?;
                Ok(Some(Self { names: vec![label(&scalar)], values: vec![scalar.value] }))
            }
            "table" => {
                let table = Table::parse(bytes)?;
                let names: Vec<String> = table.names().take(MAX_ENTRIES).map(str::to_owned).collect();
                let rows = 0..table.rows().min(MAX_ENTRIES);
                let cells = rows.flat_map(|row| (0..names.len()).map(move |column| (row, column)));
                let values = cells.filter_map(|(row, column)| table.value(row, column)).collect();
                Ok(Some(Self { names, values }))
            }
            _ => Ok(None),
        }
    }

    /// The first row with its names.
    pub fn first_row(&self) -> Option<Vec<(String, f64)>> {
        let row = self.rows().next()?;
        Some(self.names.iter().cloned().zip(row.iter().copied()).collect())
    }

    /// Slices of one value per name.
    pub fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.names.len().max(1))
    }
}

/// Whether packets of that type hold numbers.
pub fn has_numbers(packet: &str) -> bool {
    matches!(packet, "scalar" | "table")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scalars_and_all_rows_of_tables_are_read() {
        let mut bytes = 7.5f64.to_ne_bytes().to_vec();
        bytes.extend_from_slice(b"error");
        bytes.resize(8 + 32, 0);
        bytes.extend_from_slice(b"mm");
        bytes.resize(8 + 32 + 16, 0);
        let scalar = Numbers { names: vec!["error mm".to_owned()], values: vec![7.5] };
        assert_eq!(Numbers::read(&bytes, "scalar"), Ok(Some(scalar)));
        let mut bytes = Vec::new();
        for number in [2u32, 2, 8, 0] {
            bytes.extend_from_slice(&number.to_ne_bytes());
        }
        bytes.extend_from_slice(b"x mm\ny\0\0");
        for number in [1.0f64, -2.0, 3.0, f64::INFINITY] {
            bytes.extend_from_slice(&number.to_ne_bytes());
        }
        let table = Numbers::read(&bytes, "table").unwrap().unwrap();
        assert_eq!(table.names, ["x mm", "y"]);
        assert_eq!(table.rows().collect::<Vec<_>>(), [[1.0, -2.0], [3.0, f64::INFINITY]]);
        assert_eq!(table.first_row(), Some(vec![("x mm".to_owned(), 1.0), ("y".to_owned(), -2.0)]));
        for end in 0..bytes.len() {
            assert!(Numbers::read(&bytes[..end], "table").is_err(), "{end}");
        }
        assert_eq!(Numbers::read(&bytes, "image"), Ok(None));
    }
}
