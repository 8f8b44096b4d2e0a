//! Extended header and metadata of header versions 2 and 3.
//!
//! A body is: extended header (its size, size of the metadata's index, size of the metadata's texts, message number),
//! content, index (count, then length of the key, encoding, length of the value for each entry), texts.

use std::borrow::Cow;

use crate::error::{IgtlError, Result};
use crate::fields::Fields;

const KIND: &str = "version 2 or 3";
/// Length of the extended header that is written. A longer one is skipped when read.
const EXTENDED_BYTES: u16 = 12;
/// IANA's numbers of the encodings.
const ASCII: u16 = 3;
const UTF8: u16 = 106;

/// Key and value.
pub type Entry<'a> = (Cow<'a, str>, Cow<'a, str>);

/// A body in its parts.
pub struct Parts<'a> {
    pub message_id: u32,
    pub content: &'a [u8],
    pub metadata: Vec<Entry<'a>>,
}

/// Splits the body of a message of version 2 or 3.
pub fn split(body: &[u8]) -> Result<Parts<'_>> {
    let mut fields = Fields::new(KIND, body);
    let extended = fields.u16("extended header")?;
    let index_bytes = fields.u16("extended header")?;
    let text_bytes = fields.u32("extended header")?;
    let message_id = fields.u32("extended header")?;
    let Some(skipped) = extended.checked_sub(EXTENDED_BYTES) else {
        let value = u64::from(extended);
        return Err(IgtlError::Value {
            kind: KIND,
            field: "extended header size",
            value,
            expected: "it is at least 12",
        });
    };
    fields.take("extended header", usize::from(skipped))?;
    let behind = usize::from(index_bytes).saturating_add(text_bytes as usize);
    let rest = fields.rest();
    let Some(content_bytes) = rest.len().checked_sub(behind) else {
        return Err(IgtlError::Short { kind: KIND, field: "metadata", bytes: body.len() });
    };
    let (content, behind) = rest.split_at(content_bytes);
    let (index, texts) = behind.split_at(usize::from(index_bytes));
    Ok(Parts { message_id, content, metadata: entries(index, texts)? })
}

fn entries<'a>(index: &'a [u8], texts: &'a [u8]) -> Result<Vec<Entry<'a>>> {
    if index.is_empty() {
        return Ok(Vec::new());
    }
    let (mut index, mut texts) = (Fields::new(KIND, index), Fields::new(KIND, texts));
    let count = usize::from(index.u16("metadata index")?);
    let mut list = Fields::new(KIND, index.items("metadata index", count, 8)?);
    let mut entries = Vec::with_capacity(count);
    for _ in 0..count {
        let key = list.u16("metadata index")?;
        // Other encodings are rare, and their ASCII part reads the same.
        let _encoding = list.u16("metadata index")?;
        let value = list.u32("metadata index")?;
        let key = String::from_utf8_lossy(texts.take("metadata", usize::from(key))?);
        entries.push((key, String::from_utf8_lossy(texts.take("metadata", value as usize)?)));
    }
    Ok(entries)
}

/// Appends the extended header.
///
/// # Errors
/// There is more metadata than a message holds.
pub fn put_extended(out: &mut Vec<u8>, message_id: u32, metadata: &[Entry<'_>]) -> Result<()> {
    // The index has at most 65,535 bytes.
    const MAX_COUNT: usize = (u16::MAX as usize - 2) / 8;
    if metadata.len() > MAX_COUNT {
        return Err(IgtlError::TooMany { what: "entries of metadata", count: metadata.len(), limit: MAX_COUNT });
    }
    let texts: usize = metadata.iter().map(|(key, value)| key.len() + value.len()).sum();
    let Ok(text_bytes) = u32::try_from(texts) else {
        return Err(IgtlError::TooMany { what: "bytes of metadata", count: texts, limit: u32::MAX as usize });
    };
    out.extend_from_slice(&EXTENDED_BYTES.to_be_bytes());
    out.extend_from_slice(&((2 + 8 * metadata.len()) as u16).to_be_bytes());
    out.extend_from_slice(&text_bytes.to_be_bytes());
    out.extend_from_slice(&message_id.to_be_bytes());
    Ok(())
}

/// Appends the metadata, after the content.
///
/// # Errors
/// A key that is too long.
pub fn put_entries(out: &mut Vec<u8>, metadata: &[Entry<'_>]) -> Result<()> {
    out.extend_from_slice(&(metadata.len() as u16).to_be_bytes());
    for (key, value) in metadata {
        let Ok(key_bytes) = u16::try_from(key.len()) else {
            let limit = usize::from(u16::MAX);
            return Err(IgtlError::TooMany { what: "bytes of a key", count: key.len(), limit });
        };
        out.extend_from_slice(&key_bytes.to_be_bytes());
        out.extend_from_slice(&encoding(value).to_be_bytes());
        out.extend_from_slice(&(value.len() as u32).to_be_bytes());
    }
    for (key, value) in metadata {
        out.extend_from_slice(key.as_bytes());
        out.extend_from_slice(value.as_bytes());
    }
    Ok(())
}

/// IANA's number of the narrowest encoding for a text.
pub fn encoding(text: &str) -> u16 {
    if text.is_ascii() { ASCII } else { UTF8 }
}
