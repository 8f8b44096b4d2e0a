//! Numbers of a packet: the value of a scalar, the rows of a table.

use std::mem::offset_of;

use panoscope_abi as abi;

/// Limit of columns and rows that are read.
const MOST: usize = 4096;

/// Named numbers, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Numbers {
    /// Names of the columns, with units where the packet states them apart.
    pub names: Vec<String>,
    /// As many values per row as there are names; NaN where unknown.
    pub values: Vec<f64>,
}

impl Numbers {
    /// The first row with its names.
    pub fn first_row(&self) -> Option<Vec<(String, f64)>> {
        let row = self.rows().next()?;
        Some(self.names.iter().cloned().zip(row.iter().copied()).collect())
    }

    /// The rows.
    pub fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.names.len().max(1))
    }
}

/// Whether packets of this type hold numbers.
pub fn tells_numbers(packet: &str) -> bool {
    matches!(packet, "scalar" | "table")
}

fn array<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..at.checked_add(N)?)?.try_into().ok()
}

fn number(bytes: &[u8], at: usize) -> f64 {
    array(bytes, at).map_or(f64::NAN, f64::from_le_bytes)
}

fn count(bytes: &[u8], at: usize) -> usize {
    array(bytes, at).map_or(0, |b| u32::from_le_bytes(b) as usize)
}

fn text(bytes: &[u8], at: usize, len: usize) -> String {
    let bytes = at.checked_add(len).and_then(|end| bytes.get(at..end)).unwrap_or_default();
    String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned()
}

/// Reads a packet of type `packet`; `None` for types without numbers. Values beyond its end read as NaN.
pub fn read(bytes: &[u8], packet: &str) -> Option<Numbers> {
    match packet {
        "scalar" => {
            let name = text(bytes, offset_of!(abi::Scalar, name), 32);
            let unit = text(bytes, offset_of!(abi::Scalar, unit), 16);
            let name = if unit.is_empty() { name } else { format!("{name} {unit}") };
            Some(Numbers { names: vec![name], values: vec![number(bytes, offset_of!(abi::Scalar, value))] })
        }
        "table" => {
            let rows = count(bytes, offset_of!(abi::TableHeader, rows)).min(MOST);
            let columns = count(bytes, offset_of!(abi::TableHeader, columns));
            let len = count(bytes, offset_of!(abi::TableHeader, names_len));
            let start = size_of::<abi::TableHeader>();
            let names = text(bytes, start, len);
            let names: Vec<String> = names.split('\n').take(columns.min(MOST)).map(str::to_owned).collect();
            let at = |row: usize, column: usize| start + len + (row * columns + column) * 8;
            let runtimes = (0..rows).flat_map(|row| (0..names.len()).map(move |column| (row, column)));
            let values = runtimes.map(|(row, column)| number(bytes, at(row, column))).collect();
            Some(Numbers { names, values })
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scalars_and_all_rows_of_tables_are_read() {
        let mut bytes = 7.5f64.to_le_bytes().to_vec();
        bytes.extend_from_slice(b"error");
        bytes.resize(8 + 32, 0);
        bytes.extend_from_slice(b"mm");
        bytes.resize(8 + 32 + 16, 0);
        let scalar = Numbers { names: vec!["error mm".to_owned()], values: vec![7.5] };
        assert_eq!(read(&bytes, "scalar"), Some(scalar));
        let mut bytes = Vec::new();
        for number in [2u32, 2, 8, 0] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(b"x mm\ny\0\0");
        for number in [1.0f64, -2.0, 3.0, f64::INFINITY] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        let table = read(&bytes, "table").unwrap_or_default();
        assert_eq!(table.names, ["x mm", "y"]);
        assert_eq!(table.rows().collect::<Vec<_>>(), [[1.0, -2.0], [3.0, f64::INFINITY]]);
        // Truncated anywhere, it reads without harm.
        for end in 0..bytes.len() {
            read(&bytes[..end], "table");
        }
        assert_eq!(read(&bytes, "image"), None);
    }
}
