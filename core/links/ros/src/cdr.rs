//! Messages as CDR, the encoding of DDS and of bags: four bytes that name the byte order, then the fields, each at a
//! multiple of its size.

use byteorder::{BigEndian, LittleEndian};
use serde::{Deserialize, Serialize};

/// Header of little-endian CDR.
const LITTLE: [u8; 4] = [0, 1, 0, 0];

/// Bytes that are not a message of a type.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// Shorter than the head.
    #[error("a message of {len} bytes is too short for a header")]
    Short {
        /// Its length.
        len: usize,
    },
    /// An encoding other than CDR, such as XCDR2.
    #[error("a message is encoded as {number:#06x}, which is not CDR")]
    Encoding {
        /// The encoding's number.
        number: u16,
    },
    /// Fields that do not fit.
    #[error("a message is not a {message}: {words}")]
    Fields {
        /// Name of the type.
        message: &'static str,
        /// Description of the problem.
        words: String,
    },
    /// A value that cannot be encoded.
    #[error("a {message} cannot be encoded: {words}")]
    Encode {
        /// Name of the type.
        message: &'static str,
        /// Description of the problem.
        words: String,
    },
}

/// A message with its type.
pub trait Message {
    /// Name of the type, such as `sensor_msgs/msg/Image`.
    const TYPE: &'static str;

    /// Approximate encoded size in bytes, for allocation.
    fn size_hint(&self) -> usize {
        256
    }
}

/// Encodes the fields, without the head.
///
/// # Errors
/// A list is longer than the encoding allows.
pub fn encode_body<M: Message + Serialize>(message: &M) -> Result<Vec<u8>, CdrError> {
    cdr_encoding::to_vec_with_size_hint::<M, LittleEndian>(message, message.size_hint())
        .map_err(|error| CdrError::Encode { message: M::TYPE, words: error.to_string() })
}

/// Encodes a message, little-endian.
///
/// # Errors
/// A list is longer than the encoding allows.
pub fn encode<M: Message + Serialize>(message: &M) -> Result<Vec<u8>, CdrError> {
    let mut bytes = Vec::with_capacity(message.size_hint() + LITTLE.len());
    bytes.extend(LITTLE);
    bytes.extend(encode_body(message)?);
    Ok(bytes)
}

/// Decodes a message of either byte order. Pixels and points stay in `bytes`. Bytes after the last field are ignored,
/// as writers pad.
///
/// # Errors
/// The bytes are not a message of this type.
pub fn decode<'b, M: Message + Deserialize<'b>>(bytes: &'b [u8]) -> Result<M, CdrError> {
    let (head, body) = bytes.split_first_chunk::<4>().ok_or(CdrError::Short { len: bytes.len() })?;
    decode_body(u16::from_be_bytes([head[0], head[1]]), body)
}

/// Decodes the fields of a message whose head has this encoding number.
///
/// # Errors
/// As [`decode`].
pub fn decode_body<'b, M: Message + Deserialize<'b>>(number: u16, body: &'b [u8]) -> Result<M, CdrError> {
    let decoded = match number {
        1 => cdr_encoding::from_bytes::<M, LittleEndian>(body),
        0 => cdr_encoding::from_bytes::<M, BigEndian>(body),
        number => return Err(CdrError::Encoding { number }),
    };
    decoded.map(|(message, _)| message).map_err(|error| CdrError::Fields { message: M::TYPE, words: error.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{CompressedImage, Header, JointState, Time};

    #[test]
    fn fields_stand_at_multiples_of_their_size() {
        let message = JointState {
            header: Header { stamp: Time { sec: 1, nanosec: 2 }, frame_id: "ab".to_owned() },
            name: vec!["j".to_owned()],
            position: vec![1.5],
            ..JointState::default()
        };
        let bytes = encode(&message).unwrap();
        let mut wanted = vec![0, 1, 0, 0];
        wanted.extend([1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 0]);
        wanted.extend([1, 0, 0, 0, 2, 0, 0, 0, b'j', 0, 0, 0, 1, 0, 0, 0]);
        wanted.extend(1.5f64.to_le_bytes());
        wanted.extend([0; 8]);
        assert_eq!(bytes, wanted);
        assert_eq!(decode::<JointState>(&bytes).unwrap(), message);
    }

    #[test]
    fn both_byte_orders_are_read_and_pixels_are_borrowed() {
        let mut bytes = vec![0, 0, 0, 0];
        bytes.extend([
            0, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 4, b'p', b'n', b'g', 0, 0, 0, 0, 2, 9, 8,
        ]);
        let message: CompressedImage<'_> = decode(&bytes).unwrap();
        assert_eq!((message.header.stamp.sec, &*message.format, &message.data[..]), (7, "png", &[9u8, 8][..]));
        assert!(matches!(message.data.0, std::borrow::Cow::Borrowed(_)));
    }

    #[test]
    fn what_is_no_message_is_an_error() {
        assert_eq!(decode::<JointState>(&[0, 1]), Err(CdrError::Short { len: 2 }));
        assert_eq!(decode::<JointState>(&[0, 7, 0, 0]), Err(CdrError::Encoding { number: 7 }));
        // A list of four thousand million numbers in eight bytes.
        let mut bytes = vec![0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0];
        bytes.extend([0xff; 8]);
        assert!(matches!(decode::<JointState>(&bytes), Err(CdrError::Fields { .. })));
    }
}
