//! Writes MCAP (<https://mcap.dev/spec>) in uncompressed chunks whose records are in the file as soon as they are
//! written.
//!
//! A chunk begins empty, so that for every reader the records after it are outside chunks, so a run that is killed
//! leaves a valid file up to its last complete record. When the chunk is full, its message indices are appended and
//! then its head is written again with its length, times and checksum. Offsets within the file are those of a file
//! without chunks, because nothing is compressed. An output that cannot seek gets no chunks.

use std::collections::BTreeMap;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};

use crc32fast::Hasher;
use mcap::records::{MessageHeader, op};

use crate::check::head_bytes;

/// Length of the records at which a chunk is full.
const CHUNK_BYTES: u64 = 4 << 20;
/// Bytes of the head of an uncompressed chunk, without those of the record: times, size, checksum, compression, length
/// of the records.
pub(crate) const CHUNK_HEAD_BYTES: usize = 40;
/// Bytes of a record before its content: kind and length.
const RECORD_HEAD_BYTES: usize = 9;

/// The destination of a recording.
pub trait Output: Write + Seek + Send {
    /// Truncates the output to `len` bytes.
    fn cut(&mut self, len: u64) -> io::Result<()>;

    /// Flushes everything to the disk, if the output is on one.
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A chunk that is being written.
struct Chunk {
    /// Offset of its record.
    at: u64,
    /// Checksum of its records.
    sum: Hasher,
    times: Times,
    /// Log time, and offset within the records, of each message by channel.
    messages: BTreeMap<u16, Vec<[u64; 2]>>,
}

impl Chunk {
    /// Offset of its first record.
    fn begin(&self) -> u64 {
        self.at + (RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES) as u64
    }
}

/// First and last log time; 0 without messages.
#[derive(Clone, Copy, Default)]
struct Times(Option<[u64; 2]>);

impl Times {
    fn add(&mut self, time: u64) {
        let [first, last] = self.0.unwrap_or([time; 2]);
        self.0 = Some([first.min(time), last.max(time)]);
    }

    fn both(self) -> [u64; 2] {
        self.0.unwrap_or_default()
    }
}

/// The content of a record.
#[derive(Default)]
struct Body(Vec<u8>);

impl Body {
    fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    fn u16(self, value: u16) -> Self {
        self.bytes(&value.to_le_bytes())
    }

    fn u32(self, value: u32) -> Self {
        self.bytes(&value.to_le_bytes())
    }

    fn u64s(self, values: &[u64]) -> Self {
        values.iter().fold(self, |body, value| body.bytes(&value.to_le_bytes()))
    }

    /// Appends bytes, preceded by their count.
    fn counted(self, bytes: &[u8]) -> Self {
        self.u32(bytes.len() as u32).bytes(bytes)
    }

    fn text(self, text: &str) -> Self {
        self.counted(text.as_bytes())
    }

    fn map(self, entries: impl Iterator<Item = (u16, u64)>) -> Self {
        let body = entries.fold(Self::default(), |body, (key, value)| body.u16(key).u64s(&[value]));
        self.counted(&body.0)
    }
}

/// A whole record.
fn record(kind: u8, body: &Body) -> Vec<u8> {
    let mut all = Vec::with_capacity(RECORD_HEAD_BYTES + body.0.len());
    all.push(kind);
    all.extend((body.0.len() as u64).to_le_bytes());
    all.extend(&body.0);
    all
}

/// Content of a schema.
#[derive(Clone, Copy)]
pub(crate) struct Schema {
    pub id: u16,
    pub name: &'static str,
    pub encoding: &'static str,
    pub data: &'static str,
}

impl Schema {
    /// Content of its record.
    pub fn body(&self) -> Vec<u8> {
        Body::default().u16(self.id).text(self.name).text(self.encoding).text(self.data).0
    }
}

/// Content of a chunk's head.
fn chunk_head([first, last]: [u64; 2], len: u64, sum: u32) -> Body {
    Body::default().u64s(&[first, last, len]).u32(sum).text("").u64s(&[len])
}

/// An MCAP file that is being written.
pub(crate) struct McapFile {
    out: BufWriter<Box<dyn Output>>,
    /// Length of the file, including the buffer.
    len: u64,
    /// Checksum of the bytes before the open chunk.
    sum: Hasher,
    can_seek: bool,
    chunk: Option<Chunk>,
    /// Records that are repeated in the summary.
    schemas: Vec<u8>,
    schema_count: u16,
    channels: Vec<u8>,
    chunk_index: Vec<u8>,
    chunk_count: u32,
    /// Number of messages by channel.
    counts: BTreeMap<u16, u64>,
    times: Times,
}

impl McapFile {
    /// Begins a file with its header and schemas.
    pub fn create(mut output: Box<dyn Output>, profile: &str, library: &str, schemas: &[Schema]) -> io::Result<Self> {
        let can_seek = output.stream_position().is_ok();
        let mut this = Self {
            out: BufWriter::with_capacity(1 << 20, output),
            len: 0,
            sum: Hasher::new(),
            can_seek,
            chunk: None,
            schemas: Vec::new(),
            schema_count: schemas.len() as u16,
            channels: Vec::new(),
            chunk_index: Vec::new(),
            chunk_count: 0,
            counts: BTreeMap::new(),
            times: Times::default(),
        };
        this.put(mcap::MAGIC)?;
        this.put(&record(op::HEADER, &Body::default().text(profile).text(library)))?;
        for schema in schemas {
            this.schemas.extend(record(op::SCHEMA, &Body(schema.body())));
        }
        let all = std::mem::take(&mut this.schemas);
        this.put(&all)?;
        this.schemas = all;
        Ok(this)
    }

    /// Length of the file, including the buffer.
    pub fn len(&self) -> u64 {
        self.len
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.len += bytes.len() as u64;
        self.chunk.as_mut().map_or(&mut self.sum, |chunk| &mut chunk.sum).update(bytes);
        Ok(())
    }

    /// Adds a channel; returns its number.
    pub fn channel(&mut self, schema: &Schema, topic: &str, encoding: &str) -> io::Result<u16> {
        let id = self.counts.len() as u16;
        let body = Body::default().u16(id).u16(schema.id).text(topic).text(encoding).counted(&[]);
        let record = record(op::CHANNEL, &body);
        self.put(&record)?;
        self.channels.extend(record);
        self.counts.insert(id, 0);
        Ok(id)
    }

    /// Adds a message. [`Self::end_full_chunk`] follows.
    pub fn message(&mut self, header: &MessageHeader, body: &[u8]) -> io::Result<()> {
        if self.can_seek && self.chunk.is_none() {
            // Its checksum is taken when it is whole.
            self.out.write_all(&record(op::CHUNK, &chunk_head([0; 2], 0, 0)))?;
            let chunk = Chunk { at: self.len, sum: Hasher::new(), times: Times::default(), messages: BTreeMap::new() };
            self.len = chunk.begin();
            self.chunk = Some(chunk);
        }
        let at = self.len;
        let head = head_bytes(header);
        let mut start = [0; RECORD_HEAD_BYTES];
        start[0] = op::MESSAGE;
        start[1..].copy_from_slice(&((head.len() + body.len()) as u64).to_le_bytes());
        self.put(&start)?;
        self.put(&head)?;
        self.put(body)?;
        if let Some(chunk) = &mut self.chunk {
            chunk.times.add(header.log_time);
            let offset = at - chunk.begin();
            chunk.messages.entry(header.channel_id).or_default().push([header.log_time, offset]);
        }
        self.times.add(header.log_time);
        *self.counts.entry(header.channel_id).or_default() += 1;
        Ok(())
    }

    /// Ends the chunk if it is full.
    pub fn end_full_chunk(&mut self) -> io::Result<()> {
        match &self.chunk {
            Some(chunk) if self.len - chunk.begin() >= CHUNK_BYTES => self.end_chunk(),
            _ => Ok(()),
        }
    }

    fn end_chunk(&mut self) -> io::Result<()> {
        let Some(chunk) = self.chunk.take() else { return Ok(()) };
        let records_len = self.len - chunk.begin();
        let sum = chunk.sum.clone().finalize();
        let [first, last] = chunk.times.both();
        let mut head = record(op::CHUNK, &chunk_head([first, last], records_len, sum));
        // The record's length covers the records.
        head[1..RECORD_HEAD_BYTES].copy_from_slice(&(CHUNK_HEAD_BYTES as u64 + records_len).to_le_bytes());
        let index_at = self.len;
        let mut indices = Vec::new();
        let mut offsets = Vec::new();
        for (channel, messages) in &chunk.messages {
            offsets.push((*channel, index_at + indices.len() as u64));
            let entries = Body::default().u64s(messages.as_flattened());
            indices.extend(record(op::MESSAGE_INDEX, &Body::default().u16(*channel).counted(&entries.0)));
        }
        self.out.write_all(&indices)?;
        self.out.flush()?;
        self.len += indices.len() as u64;
        // Only now, so that an error before leaves an empty chunk and records behind it.
        let file = self.out.get_mut();
        file.seek(SeekFrom::Start(chunk.at))?;
        file.write_all(&head)?;
        file.seek(SeekFrom::Start(self.len))?;
        self.sum.update(&head);
        self.sum.combine(&chunk.sum);
        self.sum.update(&indices);
        let body = Body::default()
            .u64s(&[first, last, chunk.at, head.len() as u64 + records_len])
            .map(offsets.into_iter())
            .u64s(&[indices.len() as u64])
            .text("")
            .u64s(&[records_len, records_len]);
        self.chunk_index.extend(record(op::CHUNK_INDEX, &body));
        self.chunk_count += 1;
        Ok(())
    }

    /// Writes the buffer to the operating system.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Writes the summary and syncs the file; returns its length.
    pub fn finish(mut self) -> io::Result<u64> {
        self.end_chunk()?;
        let data_sum = self.sum.clone().finalize();
        self.put(&record(op::DATA_END, &Body::default().u32(data_sum)))?;
        let [first, last] = self.times.both();
        let statistics = Body::default()
            .u64s(&[self.counts.values().sum()])
            .u16(self.schema_count)
            .u32(self.counts.len() as u32)
            .u32(0)
            .u32(0)
            .u32(self.chunk_count)
            .u64s(&[first, last])
            .map(self.counts.iter().map(|(channel, count)| (*channel, *count)));
        let start = self.len;
        let (mut summary, mut offsets) = (Vec::new(), Vec::new());
        for (kind, group) in [
            (op::SCHEMA, std::mem::take(&mut self.schemas)),
            (op::CHANNEL, std::mem::take(&mut self.channels)),
            (op::STATISTICS, record(op::STATISTICS, &statistics)),
            (op::CHUNK_INDEX, std::mem::take(&mut self.chunk_index)),
        ] {
            if !group.is_empty() {
                let group_at = start + summary.len() as u64;
                let offset = Body::default().bytes(&[kind]).u64s(&[group_at, group.len() as u64]);
                offsets.extend(record(op::SUMMARY_OFFSET, &offset));
                summary.extend(group);
            }
        }
        let offsets_at = start + summary.len() as u64;
        summary.extend(offsets);
        let mut footer = record(op::FOOTER, &Body::default().u64s(&[start, offsets_at]).u32(0));
        footer.truncate(footer.len() - 4);
        summary.extend(footer);
        let sum = crc32fast::hash(&summary);
        summary.extend(sum.to_le_bytes());
        summary.extend(mcap::MAGIC);
        self.put(&summary)?;
        self.out.flush()?;
        self.out.get_mut().sync()?;
        Ok(self.len)
    }

    /// Returns the output; the buffer is lost.
    pub fn into_output(self) -> Box<dyn Output> {
        self.out.into_parts().0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_chunk_has_the_head_that_is_written_over_it() {
        let empty = record(op::CHUNK, &chunk_head([0; 2], 0, 0));
        assert_eq!(empty.len(), RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES);
        assert_eq!(empty.len(), record(op::CHUNK, &chunk_head([u64::MAX; 2], u64::MAX, u32::MAX)).len());
        assert_eq!(empty[1..9], (CHUNK_HEAD_BYTES as u64).to_le_bytes());
    }
}
