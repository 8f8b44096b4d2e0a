//! Reading and writing of big-endian fields at known positions.

use std::borrow::Cow;

use crate::error::{IgtlError, Result};

/// Takes fields from the front of a message's content.
pub struct Fields<'a> {
    kind: &'static str,
    whole: usize,
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    /// `kind` is the message type for errors.
    pub fn new(kind: &'static str, bytes: &'a [u8]) -> Self {
        Self { kind, whole: bytes.len(), rest: bytes }
    }

    /// The remaining bytes.
    pub fn rest(&self) -> &'a [u8] {
        self.rest
    }

    pub fn take(&mut self, field: &'static str, bytes: usize) -> Result<&'a [u8]> {
        match self.rest.split_at_checked(bytes) {
            Some((taken, rest)) => {
                self.rest = rest;
                Ok(taken)
            }
            None => Err(IgtlError::Short { kind: self.kind, field, bytes: self.whole }),
        }
    }

    /// As [`Self::take`], for `count` items of `each` bytes.
    pub fn items(&mut self, field: &'static str, count: usize, each: usize) -> Result<&'a [u8]> {
        self.take(field, count.saturating_mul(each))
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N]> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(field, N)?);
        Ok(out)
    }

    pub fn u8(&mut self, field: &'static str) -> Result<u8> {
        self.array::<1>(field).map(|[byte]| byte)
    }

    pub fn u16(&mut self, field: &'static str) -> Result<u16> {
        self.array(field).map(u16::from_be_bytes)
    }

    pub fn u32(&mut self, field: &'static str) -> Result<u32> {
        self.array(field).map(u32::from_be_bytes)
    }

    pub fn u64(&mut self, field: &'static str) -> Result<u64> {
        self.array(field).map(u64::from_be_bytes)
    }

    pub fn floats<const N: usize>(&mut self, field: &'static str) -> Result<[f32; N]> {
        let mut out = [0.0; N];
        for value in &mut out {
            *value = f32::from_be_bytes(self.array(field)?);
        }
        Ok(out)
    }

    /// A text in a field of `bytes` bytes that is padded with zeros.
    pub fn text(&mut self, field: &'static str, bytes: usize) -> Result<Cow<'a, str>> {
        self.take(field, bytes).map(padded)
    }

    /// Checks that no bytes remain.
    pub fn end(&self, expected: impl FnOnce() -> String) -> Result<()> {
        match self.rest.is_empty() {
            true => Ok(()),
            false => Err(IgtlError::Length { kind: self.kind, bytes: self.whole, expected: expected() }),
        }
    }
}

/// The text before the first zero. Bytes that are not UTF-8 become U+FFFD, so that names in other encodings stay partly
/// readable.
pub fn padded(bytes: &[u8]) -> Cow<'_, str> {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end])
}

/// Appends a text in a field of `bytes` bytes, padded with zeros.
pub fn put_text(out: &mut Vec<u8>, field: &'static str, text: &str, bytes: usize) -> Result<()> {
    if text.len() > bytes {
        return Err(IgtlError::LongText { field, text: text.to_owned(), bytes: text.len(), limit: bytes });
    }
    out.extend_from_slice(text.as_bytes());
    out.resize(out.len() + bytes - text.len(), 0);
    Ok(())
}

/// Appends floats.
pub fn put_floats(out: &mut Vec<u8>, values: &[f32]) {
    values.iter().for_each(|value| out.extend_from_slice(&value.to_be_bytes()));
}

/// Items of a packed list, read one at a time.
pub fn floats3(bytes: &[u8]) -> impl ExactSizeIterator<Item = [f32; 3]> + '_ {
    bytes.chunks_exact(12).map(|item| {
        let number = |at: usize| f32::from_be_bytes([item[at], item[at + 1], item[at + 2], item[at + 3]]);
        [number(0), number(4), number(8)]
    })
}
