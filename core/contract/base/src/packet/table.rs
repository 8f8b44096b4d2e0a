//! Packet `table`: named columns of numbers.

use panoscope_abi::TableHeader;

use super::PacketError;
use super::fields::{Field, Fields};

const NAME: &str = "table";

/// Bytes of a number.
const CELL: usize = size_of::<f64>();

/// A table whose sizes have been checked against its bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Table<'b> {
    names: &'b str,
    columns: usize,
    rows: usize,
    cells: &'b [u8],
    byte_len: usize,
}

impl<'b> Table<'b> {
    /// Reads a packet; bytes after the last number are ignored. The columns may all be unnamed.
    ///
    /// # Errors
    /// When the bytes end before the last number, or the names are not UTF-8, wrongly padded, or not one per column.
    pub fn parse(bytes: &'b [u8]) -> Result<Self, PacketError> {
        let mut fields = Fields::new(NAME, bytes);
        let header = TableHeader::read(&mut fields, NAME)?;
        let (rows, columns, names_len) = (header.rows as usize, header.columns as usize, header.names_len as usize);
        if !names_len.is_multiple_of(8) {
            return Err(PacketError::Padding { len: names_len });
        }
        let names = fields.text("names", names_len)?.trim_end_matches('\0');
        // The contract separates names; a line feed behind the last one is no further name.
        let names = names.strip_suffix('\n').unwrap_or(names);
        let count = names.split('\n').count();
        if count != columns && !names.is_empty() {
            return Err(PacketError::Names { names: count, columns });
        }
        let cells_len = rows.checked_mul(columns).and_then(|count| count.checked_mul(CELL));
        let cells = fields.take("values", cells_len)?;
        Ok(Self { names, columns, rows, cells, byte_len: fields.position() })
    }

    /// Column names with their units, such as `distance_mm`; none when several columns have no names.
    pub fn names(&self) -> impl Iterator<Item = &'b str> + use<'b> {
        let count = if self.names.is_empty() && self.columns > 1 { 0 } else { self.columns };
        self.names.split('\n').take(count)
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Index of the column called `name`.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.names().position(|other| other == name)
    }

    /// The number in a row and a column; `None` outside the table.
    pub fn value(&self, row: usize, column: usize) -> Option<f64> {
        if row >= self.rows || column >= self.columns {
            return None;
        }
        let at = (row * self.columns + column) * CELL;
        self.cells.get(at..)?.first_chunk().copied().map(f64::from_ne_bytes)
    }

    /// All numbers, row after row.
    pub fn values(&self) -> impl Iterator<Item = f64> + use<'b> {
        self.cells.as_chunks().0.iter().copied().map(f64::from_ne_bytes)
    }

    /// The numbers of a column, from the first row on; none for a column that does not exist.
    pub fn column_values(&self, column: usize) -> impl Iterator<Item = f64> + use<'b> {
        let table = *self;
        (0..self.rows).map_while(move |row| table.value(row, column))
    }

    /// The bytes of all numbers, row after row.
    pub fn cells(&self) -> &'b [u8] {
        self.cells
    }

    /// Length of the packet in bytes; bytes after it are ignored.
    pub fn byte_len(&self) -> usize {
        self.byte_len
    }
}
