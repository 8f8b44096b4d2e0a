//! Finds messages in a stream of bytes.

use std::io::{self, Read};

use crate::crc::crc64;
use crate::error::{IgtlError, Result};
use crate::header::{HEADER_BYTES, Header};
use crate::message::Message;

/// Default limit of a body, bytes: an image of 8192 x 8192 px with four bytes each.
pub const DEFAULT_BODY_LIMIT: u64 = 256 << 20;

/// Minimum number of bytes per read.
const MIN_VALUE: usize = 64 << 10;
/// Maximum number of bytes per read, so that memory grows only with received data.
const MAX_COUNT: usize = 1 << 20;
/// Size above which an empty buffer is freed, bytes.
const KEPT: usize = 64 << 20;

/// Received header and body with a valid CRC.
#[derive(Clone, Debug, PartialEq)]
pub struct Raw<'a> {
    /// The header.
    pub header: Header<'a>,
    /// The body.
    pub body: &'a [u8],
    /// Header and body.
    pub bytes: &'a [u8],
}

impl<'a> Raw<'a> {
    /// Decodes the message.
    ///
    ///
    ///
    /// # Errors
    /// The body does not fit the type.
    pub fn message(&self) -> Result<Message<'a>> {
        Message::from_parts(self.header.clone(), self.body)
    }
}

/// Finds the messages in the bytes of a connection. Stores one message at a time and grows only with received bytes.
#[derive(Debug)]
pub struct Reader {
    buffer: Vec<u8>,
    /// First and last byte that were read and not yet returned.
    start: usize,
    end: usize,
    /// Bytes of the message that was returned last.
    returned: usize,
    body_limit: u64,
    is_broken: bool,
}

impl Default for Reader {
    fn default() -> Self {
        Self::new(DEFAULT_BODY_LIMIT)
    }
}

impl Reader {
    /// A reader that refuses bodies of more than `body_limit` bytes.
    pub fn new(body_limit: u64) -> Self {
        Self { buffer: Vec::new(), start: 0, end: 0, returned: 0, body_limit, is_broken: false }
    }

    /// Reads once from a connection. Returns the number of bytes; 0 at its end.
    ///
    /// # Errors
    /// Any error of the connection.
    pub fn fill(&mut self, from: &mut impl Read) -> io::Result<usize> {
        let space = self.space();
        let count = from.read(space)?.min(space.len());
        self.end += count;
        Ok(count)
    }

    /// Free space for the next bytes.
    fn space(&mut self) -> &mut [u8] {
        self.start += std::mem::take(&mut self.returned);
        let held = self.end - self.start;
        if held == 0 && self.buffer.len() > KEPT {
            self.buffer = Vec::new();
        } else {
            self.buffer.copy_within(self.start..self.end, 0);
        }
        (self.start, self.end) = (0, held);
        let missing = match self.announced() {
            Some(bytes) => bytes.saturating_sub(held as u64).min(MAX_COUNT as u64) as usize,
            None => 0,
        };
        let room = missing.max(MIN_VALUE);
        if self.buffer.len() < held + room {
            self.buffer.resize(held + room, 0);
        }
        &mut self.buffer[held..held + room]
    }

    /// Length of the message at the start of the buffer, if its header is complete.
    fn announced(&self) -> Option<u64> {
        let header = Header::decode(self.buffer[self.start..self.end].get(..HEADER_BYTES)?).ok()?;
        header.body_bytes.checked_add(HEADER_BYTES as u64)
    }

    /// The next complete message; `None` until more bytes are read.
    ///
    /// # Errors
    /// [`IgtlError::Crc`] loses that message only. After any other error the stream cannot be followed: see
    /// [`Self::is_broken`].
    pub fn next_message(&mut self) -> Result<Option<Raw<'_>>> {
        if self.is_broken {
            return Ok(None);
        }
        self.start += std::mem::take(&mut self.returned);
        let held = &self.buffer[self.start..self.end];
        let Some(first) = held.get(..HEADER_BYTES) else { return Ok(None) };
        let header = match Header::decode(first) {
            Ok(header) => header,
            Err(error) => {
                self.is_broken = true;
                return Err(error);
            }
        };
        if header.body_bytes > self.body_limit {
            self.is_broken = true;
            let (bytes, limit) = (header.body_bytes, self.body_limit);
            return Err(IgtlError::TooLong { kind: header.kind.into_owned(), bytes, limit });
        }
        // Within the limit, which fits the address space of a buffer.
        let Ok(body_bytes) = usize::try_from(header.body_bytes) else { return Ok(None) };
        let Some(bytes) = held.get(..HEADER_BYTES + body_bytes) else { return Ok(None) };
        self.returned = bytes.len();
        let body = &bytes[HEADER_BYTES..];
        let found = crc64(body);
        if found != header.crc {
            let announced = header.crc;
            return Err(IgtlError::Crc { kind: header.kind.into_owned(), found, announced });
        }
        Ok(Some(Raw { header, body, bytes }))
    }

    /// Whether the stream can no longer be parsed; its connection must be closed.
    pub fn is_broken(&self) -> bool {
        self.is_broken
    }
}
