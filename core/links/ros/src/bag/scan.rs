//! Finds the parts of an MCAP file that hold messages, with their times, without unpacking them.

use std::collections::HashMap;
use std::io::{self, BufReader, Read, Seek, SeekFrom};

use mcap::records::op;

use super::fields::Fields;

/// Maximum length of a record, bytes; twice an 8K image with four bytes per pixel.
pub const MAX_RECORD_BYTES: u64 = 256 << 20;
/// First bytes of a bag of ROS 1, which is no MCAP file.
const ROS1_MAGIC: &[u8; 8] = b"#ROSBAG ";
/// Bytes before the body of a record: its kind and its length.
pub const HEAD_BYTES: usize = 9;
/// Maximum number of channels and schemas of a file.
const MAX_CHANNELS: usize = 10_000;
/// Maximum number of parts of a file.
const MAX_PARTS: usize = 10_000_000;
/// Messages outside of chunks are read together up to this size.
const MAX_RUN_BYTES: u64 = 4 << 20;
/// Bytes of a message's channel, number and two times.
const MESSAGE_HEAD_BYTES: usize = 22;

/// Encoding of a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Body of a chunk.
    Chunk,
    /// Body of a truncated chunk.
    CutChunk,
    /// Complete uncompressed records of messages.
    Records,
}

/// A part of a file that holds messages.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Time of its first message, ns.
    pub start_ns: u64,
    /// Time of its last message, ns.
    end_ns: u64,
    /// Offset of its bytes in the file.
    pub at: u64,
    /// Number of its bytes.
    pub len: u64,
    /// Encoding of its bytes.
    pub form: Form,
}

/// Names of types by schema, topics and types by channel.
#[derive(Clone, Debug, Default)]
pub struct Channels {
    schemas: HashMap<u16, String>,
    /// `None` for messages that are not in CDR.
    channels: HashMap<u16, Option<(String, String)>>,
    /// Whether a channel has the encoding of ROS 1.
    pub is_ros1: bool,
}

impl Channels {
    /// Topic and type of a channel; `Some(None)` if its messages are not in CDR, `None` if it is unknown.
    pub fn get(&self, channel: u16) -> Option<Option<(&str, &str)>> {
        let known = self.channels.get(&channel)?;
        Some(known.as_ref().map(|(topic, message)| (topic.as_str(), message.as_str())))
    }

    /// Whether no channel is known.
    pub fn is_empty(&self) -> bool {
        self.channels.is_empty()
    }

    /// Adds the body of a record if it is a schema or a channel.
    ///
    /// # Errors The record is malformed.
    pub fn take(&mut self, opcode: u8, body: &[u8]) -> Result<(), &'static str> {
        const MISFIT: &str = "a record lacks fields of its kind";
        let mut fields = Fields(body);
        match opcode {
            op::SCHEMA => {
                let (id, name) = fields.u16().zip(fields.text()).ok_or(MISFIT)?;
                if self.schemas.len() >= MAX_CHANNELS && !self.schemas.contains_key(&id) {
                    return Err("it has more than 10,000 types");
                }
                self.schemas.insert(id, name.to_owned());
            }
            op::CHANNEL => {
                let (id, schema) = fields.u16().zip(fields.u16()).ok_or(MISFIT)?;
                let (topic, encoding) = fields.text().zip(fields.text()).ok_or(MISFIT)?;
                if self.channels.len() >= MAX_CHANNELS && !self.channels.contains_key(&id) {
                    return Err("it has more than 10,000 topics");
                }
                self.is_ros1 |= encoding == "ros1";
                let known = self.schemas.get(&schema).filter(|_| encoding == "cdr");
                self.channels.insert(id, known.map(|message| (topic.to_owned(), message.clone())));
            }
            _ => {}
        }
        Ok(())
    }
}

/// End of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum End {
    /// Complete.
    Whole,
    /// In the middle of a record.
    CutOff,
    /// With bytes that are not a record; describes the damage.
    Damaged(String),
}

/// Content of a file.
#[derive(Debug)]
pub struct Scan {
    /// Its parts, in the order of the file.
    pub parts: Vec<Part>,
    /// Its channels outside of chunks.
    pub channels: Channels,
    /// Its end.
    pub end: End,
}

/// Early end of a scan.
enum ScanError {
    /// The system's error.
    Read(io::Error),
    /// Description of the problem.
    Damaged(String),
}

impl From<io::Error> for ScanError {
    fn from(cause: io::Error) -> Self {
        Self::Read(cause)
    }
}

fn damaged(words: impl Into<String>) -> ScanError {
    ScanError::Damaged(words.into())
}

/// Up to `len` bytes; fewer at the end of the file.
fn bytes(input: &mut impl Read, len: u64) -> Result<Vec<u8>, ScanError> {
    if len > MAX_RECORD_BYTES {
        return Err(damaged(format!("a record of {len} bytes is longer than {MAX_RECORD_BYTES}")));
    }
    let mut bytes = Vec::new();
    input.take(len).read_to_end(&mut bytes)?;
    Ok(bytes)
}

impl Scan {
    /// Reads the heads of all records. Parts before damage are found.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of(input: impl Read + Seek) -> io::Result<Self> {
        let mut scan = Self { parts: Vec::new(), channels: Channels::default(), end: End::CutOff };
        scan.end = match scan.walk(&mut BufReader::with_capacity(1 << 16, input)) {
            Ok(end) => end,
            Err(ScanError::Damaged(words)) => End::Damaged(words),
            Err(ScanError::Read(cause)) => return Err(cause),
        };
        Ok(scan)
    }

    fn walk(&mut self, input: &mut BufReader<impl Read + Seek>) -> Result<End, ScanError> {
        let size = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(0))?;
        let magic = bytes(input, 8)?;
        if magic[..] == *ROS1_MAGIC {
            self.channels.is_ros1 = true;
            return Ok(End::Whole);
        }
        if magic[..] != *mcap::MAGIC {
            return Err(damaged("it does not begin like an MCAP file"));
        }
        let mut at = 8;
        while at < size {
            let head = bytes(input, HEAD_BYTES as u64)?;
            let Some((opcode, len)) = Fields(&head).record() else { return Ok(End::CutOff) };
            let body = at + HEAD_BYTES as u64;
            let rest = size.saturating_sub(body);
            if matches!(opcode, op::DATA_END | op::FOOTER) {
                // The summary repeats all channels. A damaged one takes nothing from the messages.
                let _ = input.seek_relative(len.min(rest).cast_signed()).map(|()| self.summary(input));
                return Ok(End::Whole);
            }
            let is_whole = len <= rest;
            let read = match opcode {
                op::CHUNK => {
                    let head = bytes(input, len.min(16))?;
                    self.chunk(&head, (body, len.min(rest)), is_whole)?;
                    head.len()
                }
                op::MESSAGE if is_whole => {
                    let head = bytes(input, len.min(MESSAGE_HEAD_BYTES as u64))?;
                    self.message(&head, (at, body + len))?;
                    head.len()
                }
                op::SCHEMA | op::CHANNEL if is_whole => {
                    let body = bytes(input, len)?;
                    self.channels.take(opcode, &body).map_err(damaged)?;
                    body.len()
                }
                _ => 0,
            };
            if !is_whole {
                return Ok(End::CutOff);
            }
            input.seek_relative((len - read as u64).cast_signed())?;
            at = body + len;
        }
        Ok(End::CutOff)
    }

    fn push(&mut self, part: Part) -> Result<(), ScanError> {
        if self.parts.len() >= MAX_PARTS {
            return Err(damaged("it has more than 10,000,000 chunks"));
        }
        self.parts.push(part);
        Ok(())
    }

    fn chunk(&mut self, head: &[u8], (at, len): (u64, u64), is_whole: bool) -> Result<(), ScanError> {
        let mut fields = Fields(head);
        let Some((start_ns, end_ns)) = fields.u64().zip(fields.u64()) else {
            return if is_whole { Err(damaged("a chunk has no header")) } else { Ok(()) };
        };
        if len > MAX_RECORD_BYTES {
            return Err(damaged(format!("a record of {len} bytes is longer than {MAX_RECORD_BYTES}")));
        }
        // Of a chunk that is cut off nobody knows which messages are missing.
        let form = if is_whole { Form::Chunk } else { Form::CutChunk };
        self.push(Part { start_ns, end_ns, at, len, form })
    }

    /// Adds a message whose record is between two offsets.
    fn message(&mut self, head: &[u8], (at, end): (u64, u64)) -> Result<(), ScanError> {
        let mut fields = Fields(head);
        let (Some(_channel), Some(_number), Some(log_ns)) = (fields.u16(), fields.array::<4>(), fields.u64()) else {
            return Err(damaged("a record lacks fields of its kind"));
        };
        if end - at > MAX_RECORD_BYTES {
            return Err(damaged(format!("a record of {} bytes is longer than {MAX_RECORD_BYTES}", end - at)));
        }
        if let Some(last) = self.parts.last_mut()
            && last.form == Form::Records
            && last.at + last.len == at
            && log_ns >= last.end_ns
            && end - last.at <= MAX_RUN_BYTES
        {
            (last.len, last.end_ns) = (end - last.at, log_ns);
            return Ok(());
        }
        self.push(Part { start_ns: log_ns, end_ns: log_ns, at, len: end - at, form: Form::Records })
    }

    fn summary(&mut self, input: &mut impl Read) -> Result<(), ScanError> {
        loop {
            let head = bytes(input, HEAD_BYTES as u64)?;
            let Some((opcode, len)) = Fields(&head).record() else { return Ok(()) };
            if opcode == op::FOOTER {
                return Ok(());
            }
            let body = bytes(input, len)?;
            self.channels.take(opcode, &body).map_err(damaged)?;
        }
    }
}
