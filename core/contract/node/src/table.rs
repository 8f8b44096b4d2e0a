//! Packet `table`: named columns of numbers.

use panoscope_base::packet;

use crate::abi::{self, TableHeader};
use crate::error::{NodeError, Result};
use crate::input::{FromFrame, bytes};
use crate::output::Slot;
use crate::packet::{Plain, TableData, bytes_of};
use crate::port::nameless;

// SAFETY: repr(C), four u32.
unsafe impl Plain for TableHeader {}
const _: () = assert!(size_of::<TableHeader>() == 16);

/// Named columns of numbers.
#[derive(Clone, Copy)]
pub struct Table<'f> {
    table: packet::Table<'f>,
    values: &'f [f64],
}

impl<'f> FromFrame<'f> for Table<'f> {
    const PORT: abi::Port = nameless("table", 0, 0, 0);

    fn from_frame(frame: &'f abi::Frame) -> Result<Self> {
        let table = packet::Table::parse(bytes(frame))?;
        let cells = table.cells();
        if !cells.as_ptr().addr().is_multiple_of(align_of::<f64>()) {
            return Err(NodeError::new("the numbers of a table are not aligned to 8 bytes"));
        }
        // SAFETY: the cells are inside the frame and, as just checked, aligned; every bit pattern is a number.
        let values = unsafe { std::slice::from_raw_parts(cells.as_ptr().cast(), cells.len() / size_of::<f64>()) };
        Ok(Self { table, values })
    }
}

impl<'f> Table<'f> {
    /// Column names with their units, such as `distance_mm`.
    pub fn names(&self) -> impl Iterator<Item = &'f str> + use<'f> {
        self.table.names()
    }

    /// Rows of `columns` numbers.
    pub fn rows(&self) -> impl Iterator<Item = &'f [f64]> + use<'f> {
        self.values.chunks_exact(self.table.columns().max(1))
    }
}

impl Slot<'_, TableData> {
    /// Makes the output: `names` one per column, `values` in row order.
    pub fn set_table(&mut self, names: &[&str], values: &[f64]) -> Result<()> {
        let columns = names.len();
        if columns == 0 || !values.len().is_multiple_of(columns) {
            return Err(NodeError::new(format!("{} numbers do not fill rows of {columns}", values.len())));
        }
        let text_len: usize = names.iter().map(|name| name.len()).sum::<usize>() + columns - 1;
        let header = TableHeader {
            rows: (values.len() / columns) as u32,
            columns: columns as u32,
            names_len: text_len.next_multiple_of(8) as u32,
            reserved: 0,
        };
        let (a, b) = (bytes_of(std::slice::from_ref(&header)), bytes_of(values));
        let out = self.allocate_bytes(a.len() + header.names_len as usize + b.len())?;
        let (head, rest) = out.split_at_mut(a.len());
        head.copy_from_slice(a);
        let (text, numbers) = rest.split_at_mut(header.names_len as usize);
        text.fill(0);
        let mut at = 0;
        for (index, name) in names.iter().enumerate() {
            if index > 0 {
                text[at] = b'\n';
                at += 1;
            }
            text[at..at + name.len()].copy_from_slice(name.as_bytes());
            at += name.len();
        }
        numbers.copy_from_slice(b);
        Ok(())
    }
}
