//! Writes the file of a recording.

use std::borrow::Cow;
use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{self, SeekFrom};
use std::time::{SystemTime, UNIX_EPOCH};

use mcap::records::MessageHeader;

use crate::check;
use crate::coding::Packer;
use crate::digest::padded_hash;
use crate::format::{Coding, EVENTS, Event, PACKET_ENCODING, PacketHead, SCHEMAS};
use crate::mcap_file::{McapFile, Output};
use panoscope_base::secret::redact;
use panoscope_engine::memory::FrameRef;

impl Output for File {
    fn cut(&mut self, len: u64) -> io::Result<()> {
        self.set_len(len)
    }

    fn sync(&mut self) -> io::Result<()> {
        match self.sync_all() {
            // Pipes and devices cannot be synced.
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
            done => done,
        }
    }
}

impl Output for io::Cursor<Vec<u8>> {
    fn cut(&mut self, len: u64) -> io::Result<()> {
        self.get_mut().truncate(usize::try_from(len).unwrap_or(usize::MAX));
        Ok(())
    }
}

/// A recording that is being written.
pub(crate) struct RecordFile {
    mcap: McapFile,
    events: u16,
    channels: HashMap<String, (u16, u32)>,
    event_count: u32,
    buffer: Vec<u8>,
    packer: Packer,
    /// Length up to the end of the last complete message.
    complete_len: u64,
    /// Number of source ticks written to the operating system.
    ticks: u64,
    /// Offset of the end of each later source tick.
    pending_ticks: VecDeque<u64>,
}

impl RecordFile {
    pub fn create(output: Box<dyn Output>) -> io::Result<Self> {
        let library = concat!("panoscope ", env!("CARGO_PKG_VERSION"));
        let mut mcap = McapFile::create(output, "panoscope", library, &SCHEMAS)?;
        let [schema, _] = &SCHEMAS;
        let events = mcap.channel(schema, EVENTS, "json")?;
        let mut this = Self {
            mcap,
            events,
            channels: HashMap::new(),
            event_count: 0,
            buffer: Vec::new(),
            packer: Packer::new()?,
            complete_len: 0,
            ticks: 0,
            pending_ticks: VecDeque::new(),
        };
        this.flush()?;
        Ok(this)
    }

    /// Writes the buffer as a message; returns the offset of its end.
    fn message(&mut self, header: &MessageHeader) -> io::Result<u64> {
        self.mcap.message(header, &self.buffer)?;
        let end = self.mcap.len();
        self.complete_len = end;
        self.mcap.end_full_chunk()?;
        self.complete_len = self.mcap.len();
        Ok(end)
    }

    pub fn event(&mut self, event: &Event) -> io::Result<()> {
        self.buffer.clear();
        serde_json::to_writer(&mut self.buffer, event)?;
        if std::str::from_utf8(&self.buffer).is_ok_and(|text| matches!(redact(text), Cow::Owned(_))) {
            let mut whole = serde_json::from_slice(&self.buffer)?;
            without_secrets(&mut whole);
            self.buffer.clear();
            serde_json::to_writer(&mut self.buffer, &whole)?;
        }
        self.event_count += 1;
        let now = unix_ns();
        let header =
            MessageHeader { channel_id: self.events, sequence: self.event_count, log_time: now, publish_time: now };
        check::seal(EVENTS, &check::head_bytes(&header), &mut self.buffer);
        let end = self.message(&header)?;
        if matches!(event, Event::Tick { gap: false, .. }) {
            self.pending_ticks.push_back(end);
        }
        Ok(())
    }

    /// Writes a packet; with `compresses`, in compressed form if that is shorter.
    pub fn packet(&mut self, port: &str, frame: &FrameRef, hash: u64, compresses: bool) -> io::Result<()> {
        let (channel, sequence) = match self.channels.get_mut(port) {
            Some((channel, sequence)) => {
                *sequence = sequence.wrapping_add(1);
                (*channel, *sequence)
            }
            None => {
                let [_, schema] = &SCHEMAS;
                let channel = self.mcap.channel(schema, port, PACKET_ENCODING)?;
                self.channels.insert(port.to_owned(), (channel, 0));
                (channel, 0)
            }
        };
        self.buffer.clear();
        let publish_time = u64::try_from(frame.tick().capture_ns).unwrap_or(0);
        let header = MessageHeader { channel_id: channel, sequence, log_time: unix_ns(), publish_time };
        let mut head = PacketHead::of(frame.frame(), hash, padded_hash(frame.frame(), frame.bytes()));
        let place = self.packer.place_of(&head).filter(|_| compresses).map(u64::to_le_bytes);
        let packed = if place.is_some() || !compresses { None } else { self.packer.pack(head.format, frame.bytes()) };
        let stored = match (&place, packed) {
            (Some(place), _) => {
                head.coding = Coding::Reference;
                &place[..]
            }
            (None, Some(packed)) => {
                head.coding = Coding::Packed;
                packed
            }
            (None, None) => frame.bytes(),
        };
        head.write(&mut self.buffer);
        let sum = check::sum(port, &check::head_bytes(&header), &self.buffer);
        self.buffer.extend_from_slice(&sum.to_le_bytes());
        self.buffer.extend_from_slice(stored);
        let len = stored.len() as u64;
        let end = self.message(&header)?;
        if head.coding != Coding::Reference {
            self.packer.remember(&head, end - len);
        }
        Ok(())
    }

    pub fn flush(&mut self) -> io::Result<()> {
        self.mcap.flush()?;
        self.ticks += self.pending_ticks.drain(..).count() as u64;
        Ok(())
    }

    /// Number of source ticks written to the operating system.
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Writes the summary and syncs the file; returns its length.
    pub fn finish(self) -> io::Result<u64> {
        self.mcap.finish()
    }

    /// Ends the file after an error: removes an incomplete message. Returns the length of the file and the number of
    /// source ticks in it.
    pub fn give_up(self) -> (u64, u64) {
        let mut output = self.mcap.into_output();
        let len = match output.seek(SeekFrom::End(0)) {
            Ok(len) if len > self.complete_len => output.cut(self.complete_len).map_or(len, |()| self.complete_len),
            Ok(len) => len,
            Err(_) => 0,
        };
        // The caller reports the first error; a second one is ignored.
        let _ = output.sync();
        let more = self.pending_ticks.iter().filter(|end| **end <= len).count() as u64;
        (len, self.ticks + more)
    }
}

fn unix_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}
/// Hides the secrets of addresses in all texts of an event: those of the graph, of its settings and of messages. A
/// replay opens no source.
fn without_secrets(value: &mut serde_json::Value) {
    match value {
        serde_json::Value::String(text) => {
            if let Cow::Owned(hidden) = redact(text) {
                *text = hidden;
            }
        }
        serde_json::Value::Array(values) => values.iter_mut().for_each(without_secrets),
        serde_json::Value::Object(fields) => fields.values_mut().for_each(without_secrets),
        _ => {}
    }
}
