//! Packets of the contract, decoded from untrusted bytes.
//!
//! Recordings, previews and other processes hand over bytes: they may be cut off, too long, or garbage. Nothing here
//! panics on them or reads outside of them, and no alignment is needed. Every error names the field that does not fit.
//!
//! Plain packets ([`decode`]) become the structs of the contract. [`Table`], [`Detections`] and [`Cloud`] stay views of
//! the bytes.

mod cloud;
mod detections;
mod fields;
mod numbers;
mod plain;
mod table;

pub use cloud::Cloud;
pub use detections::{Detections, mask_len};
pub use numbers::{Numbers, has_numbers};
pub use plain::{Decode, decode, label, name};
pub use table::Table;

/// Bytes that are not a valid packet.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// The bytes end inside a field.
    #[error("packet `{packet}` is truncated: field `{field}` ends at byte {end}, but {len} bytes arrived")]
    Short {
        /// Packet type.
        packet: &'static str,
        /// The field.
        field: &'static str,
        /// Where the field would end; `usize::MAX` when that overflows.
        end: usize,
        /// Bytes that arrived.
        len: usize,
    },
    /// A text is not UTF-8.
    #[error("packet `{packet}`: field `{field}` is not UTF-8 text")]
    Text {
        /// Packet type.
        packet: &'static str,
        /// The field.
        field: &'static str,
    },
    /// The column names of a table are not padded as the contract says.
    #[error("packet `table`: field `names_len` is {len}, which is not a multiple of 8")]
    Padding {
        /// Its value.
        len: usize,
    },
    /// A table has another number of names than columns.
    #[error("packet `table`: field `names` has {names} names for {columns} columns")]
    Names {
        /// Names in the text.
        names: usize,
        /// Columns in the header.
        columns: usize,
    },
    /// The description of a frame contradicts itself or its length.
    #[error("packet `{packet}`: {width}x{height} with {stride_bytes} bytes per row does not match {len} bytes")]
    Geometry {
        /// Packet type.
        packet: &'static str,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes from one row to the next.
        stride_bytes: usize,
        /// Bytes that arrived.
        len: usize,
    },
}

#[cfg(test)]
mod tests;
