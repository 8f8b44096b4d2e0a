//! Errors of this crate.

/// Bytes that are not a message, or a message that cannot be written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum IgtlError {
    /// The header's version is unknown: the stream is out of step, or not OpenIGTLink.
    #[error(
        "header version {version} is unknown (1, 2 and 3 are): the peer speaks another protocol, or the stream is out of step"
    )]
    Version {
        /// Version in the header.
        version: u16,
    },
    /// The type name in the header is empty or not printable ASCII.
    #[error("the message type is not printable ASCII: the peer speaks another protocol, or the stream is out of step")]
    TypeName,
    /// The announced body is longer than the reader's limit.
    #[error(
        "a {kind} message announces a body of {bytes} bytes, the limit is {limit}: the connection cannot be used further"
    )]
    TooLong {
        /// Message type.
        kind: String,
        /// Announced length.
        bytes: u64,
        /// Largest length that is read.
        limit: u64,
    },
    /// The body does not match its CRC64.
    #[error("a {kind} message was damaged in transit: its CRC64 is {found:016x}, the header says {announced:016x}")]
    Crc {
        /// Message type.
        kind: String,
        /// CRC of the bytes.
        found: u64,
        /// CRC in the header.
        announced: u64,
    },
    /// The body ends before a field.
    #[error("a {kind} message of {bytes} bytes is too short for its `{field}`")]
    Short {
        /// Message type.
        kind: &'static str,
        /// The field.
        field: &'static str,
        /// Length of the content.
        bytes: usize,
    },
    /// The content has a length that its type does not have.
    #[error("a {kind} message has {bytes} bytes, expected {expected}")]
    Length {
        /// Message type.
        kind: &'static str,
        /// Length of the content.
        bytes: usize,
        /// Description of the valid lengths.
        expected: String,
    },
    /// A field has a value that it must not have.
    #[error("a {kind} message has {field} = {value}: {expected}")]
    Value {
        /// Message type.
        kind: &'static str,
        /// The field.
        field: &'static str,
        /// Its value.
        value: u64,
        /// Description of the valid values.
        expected: &'static str,
    },
    /// A text is longer than its field.
    #[error("`{text}` has {bytes} bytes, but the limit of {field} is {limit}: shorten it")]
    LongText {
        /// The field.
        field: &'static str,
        /// The text.
        text: String,
        /// Its length.
        bytes: usize,
        /// Length of the field.
        limit: usize,
    },
    /// There are more entries than the count field can hold.
    #[error("{count} {what} exceed the limit of {limit} for one message")]
    TooMany {
        /// Kind of the entries.
        what: &'static str,
        /// Number of entries.
        count: usize,
        /// Maximum number of entries.
        limit: usize,
    },
}

/// The result of this crate's functions.
pub type Result<T> = std::result::Result<T, IgtlError>;
