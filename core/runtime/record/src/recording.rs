//! Reads a recording: scans it once, and loads packets on demand.
//!
//! A truncated file ends at its last complete message. Damage ends it too, and its position is reported.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufReader, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use mcap::records::op;
use panoscope_abi::Frame;

use crate::check::{self, MESSAGE_HEAD_BYTES, Seal};
use crate::coding::{self, REFERENCE_BYTES};
use crate::digest::{Digests, PacketDigest, packet_hash, padded_hash};
use crate::format::{
    CHECKED_FORMAT, Coding, EVENTS, Event, FORMAT, Head, OLDEST_FORMAT, PACKET_ENCODING, PACKET_HEAD_BYTES,
    PLAIN_HEAD_BYTES, PacketHead, SCHEMAS, SUMMED_HEAD_BYTES,
};
use crate::mcap_file::CHUNK_HEAD_BYTES;
use crate::mcap_texts;
use panoscope_engine::memory::{FrameRef, memory};

/// Maximum length of the index at the end of a recording.
const MAX_INDEX: u64 = 64 << 20;
/// Bytes of MCAP's footer record.
const FOOTER_BYTES: usize = 9 + 20;
/// Maximum length of an event.
const MAX_EVENT: u64 = 256 << 20;
/// Maximum length of a packet.
const MAX_PACKET: u64 = 1 << 30;
/// Maximum length of a packet that is compressed in the file, because a short file must not exhaust memory.
const MAX_PACKED: u64 = 1 << 28;

/// A recording that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be read.
    #[error("{} cannot be read: {cause}", .file.display())]
    Unreadable {
        /// The recording.
        file: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The file is not an MCAP file.
    #[error("{} is not a recording: it does not begin like an MCAP file; give a file that `panoscope record` wrote", .file.display())]
    NoMcap {
        /// The file.
        file: PathBuf,
    },
    /// An MCAP file of another program.
    #[error("{} is an MCAP file, but not a recording of panoscope: {reason}", .file.display())]
    Foreign {
        /// The file.
        file: PathBuf,
        /// What is missing.
        reason: String,
    },
    /// The file ends before its first message.
    #[error("{} ends after {bytes} bytes, before its first message, so it contains no data: record again", .file.display())]
    Empty {
        /// The file.
        file: PathBuf,
        /// Its length.
        bytes: u64,
    },
    /// Written by another version.
    #[error("{} has recording format {found}, but this program reads formats {OLDEST_FORMAT} to {FORMAT}: use panoscope {version}", .file.display())]
    OtherFormat {
        /// The file.
        file: PathBuf,
        /// Its format.
        found: u32,
        /// Version that wrote it.
        version: String,
    },
    /// A packet is damaged.
    #[error("{} is damaged at byte {at}: packet {seq} of `{port}` was altered", .file.display())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// Offset of the damage.
        at: u64,
        /// The port.
        port: String,
        /// The tick.
        seq: u64,
    },
    /// Frame memory is exhausted.
    #[error("packet {seq} of `{port}` cannot be put into frame memory: {reason}")]
    Memory {
        /// The port.
        port: String,
        /// The tick.
        seq: u64,
        /// Description of the problem.
        reason: String,
    },
}

/// A packet and its position in the file.
#[derive(Clone, Copy, Debug)]
pub struct Packet {
    /// The packet's description.
    pub head: PacketHead,
    /// Offset in the file of its stored bytes.
    pub at: u64,
    /// Number of stored bytes.
    pub stored: u64,
    /// Storage of the bytes.
    pub coding: Coding,
}

/// A recorded tick of a source.
#[derive(Clone, Debug)]
pub struct SourceTick {
    /// Number of the tick.
    pub seq: u64,
    /// Capture time, media time.
    pub capture_ns: i64,
    /// Whether it entered the graph.
    pub admitted: bool,
    /// Whether its packets are missing because the disk was too slow.
    pub gap: bool,
    /// Port and packet; outputs that are not listed were empty.
    pub packets: Vec<(String, Packet)>,
}

/// Offset and reason of an early end of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Length of the usable part in bytes.
    pub at: u64,
    /// Content found there instead of a message.
    pub reason: String,
    /// Whether it is damaged there and not truncated, so that recorded data after this point is lost.
    pub damaged: bool,
}

/// A recording that was scanned.
#[derive(Debug)]
pub struct Recording {
    file: File,
    path: PathBuf,
    /// The first event: graph and machine.
    pub head: Head,
    /// All events except ticks and drops, which are in `sources`.
    pub events: Vec<Event>,
    /// Ticks of each source, in order.
    pub sources: BTreeMap<String, Vec<SourceTick>>,
    /// Packets of each recorded port, by `node.port`.
    pub ports: BTreeMap<String, Vec<Packet>>,
    /// Position of truncation or damage; `None` when it is complete.
    pub cut: Option<Cut>,
    /// Whether its messages have checksums; those of format 1 do not.
    pub checked: bool,
    /// Length and checksum of the data section, if it has one.
    data_sum: Option<(u64, u32)>,
}

struct Scan {
    /// The library that MCAP's header names.
    library: String,

    at: u64,
    len: u64,
    reader: BufReader<File>,
    events: Vec<Event>,
    head: Option<Head>,
    /// Topic, and whether it carries packets, by channel.
    channels: HashMap<u16, (String, bool)>,
    sources: BTreeMap<String, Vec<SourceTick>>,
    ports: BTreeMap<String, Vec<Packet>>,
    /// Packets of each node whose tick event has not been read yet.
    pending: HashMap<String, Vec<(String, Packet)>>,
    /// Length and checksum of the data section, if it has one.
    data_sum: Option<(u64, u32)>,
    /// Packets with stored bytes, by offset: storage, stored length and length.
    places: HashMap<u64, (Coding, u64, u64)>,
}

/// End of the scan.
enum Stop {
    End,
    Cut(String),
    Damaged(String),
    Io(std::io::Error),
    Foreign(String),
    OtherFormat(u32, String),
}

impl From<std::io::Error> for Stop {
    fn from(error: std::io::Error) -> Self {
        if error.kind() == std::io::ErrorKind::UnexpectedEof {
            Self::Cut("it was truncated".to_owned())
        } else {
            Self::Io(error)
        }
    }
}

impl Recording {
    /// Opens and scans a recording.
    ///
    /// # Errors
    /// The file is not a recording, or no part of it can be used. A truncated or damaged recording can be used up to
    /// that point, see [`Self::cut`].
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let unreadable = |cause| RecordingError::Unreadable { file: path.to_owned(), cause };
        let file = File::open(path).map_err(unreadable)?;
        let meta = file.metadata().map_err(unreadable)?;
        if meta.is_dir() {
            return Err(unreadable(std::io::Error::other("it is a folder")));
        }
        let len = meta.len();
        let mut reader = BufReader::with_capacity(1 << 16, file.try_clone().map_err(unreadable)?);
        let mut magic = Vec::new();
        (&mut reader).take(mcap::MAGIC.len() as u64).read_to_end(&mut magic).map_err(unreadable)?;
        if !mcap::MAGIC.starts_with(&magic) {
            return Err(RecordingError::NoMcap { file: path.to_owned() });
        }
        let finished = ends_with_magic(&file, len).map_err(unreadable)?;
        let mut scan = Scan {
            library: String::new(),
            at: magic.len() as u64,
            len,
            reader,
            events: Vec::new(),
            head: None,
            channels: HashMap::new(),
            sources: BTreeMap::new(),
            ports: BTreeMap::new(),
            pending: HashMap::new(),
            data_sum: None,
            places: HashMap::new(),
        };
        let stop = loop {
            if let Err(stop) = scan.record() {
                break stop;
            }
        };
        let cut = match stop {
            Stop::End => None,
            // A file with the end mark was not truncated, so a length is wrong.
            Stop::Cut(_) if finished => {
                Some(Cut { at: scan.at, reason: "a length is invalid".to_owned(), damaged: true })
            }
            Stop::Cut(reason) => Some(Cut { at: scan.at, reason, damaged: false }),
            Stop::Damaged(reason) => Some(Cut { at: scan.at, reason, damaged: true }),
            Stop::Io(cause) => return Err(unreadable(cause)),
            Stop::Foreign(reason) => return Err(RecordingError::Foreign { file: path.to_owned(), reason }),
            Stop::OtherFormat(found, version) => {
                return Err(RecordingError::OtherFormat { file: path.to_owned(), found, version });
            }
        };
        let Some(head) = scan.head else {
            return Err(match cut {
                Some(Cut { damaged: true, .. }) if !scan.is_ours() => {
                    RecordingError::Foreign { file: path.to_owned(), reason: format!("it has no `{EVENTS}`") }
                }
                Some(Cut { damaged: true, at, .. }) => {
                    let (port, seq) = (EVENTS.to_owned(), 0);
                    RecordingError::Damaged { file: path.to_owned(), at, port, seq }
                }
                Some(_) => RecordingError::Empty { file: path.to_owned(), bytes: len },
                None => RecordingError::Foreign { file: path.to_owned(), reason: format!("it has no `{EVENTS}`") },
            });
        };
        let (events, sources, ports) = (scan.events, scan.sources, scan.ports);
        let checked = head.format >= CHECKED_FORMAT;
        let data_sum = scan.data_sum;
        Ok(Self { file, path: path.to_owned(), head, events, sources, ports, cut, checked, data_sum })
    }

    /// Reads and checks every packet.
    ///
    /// # Errors
    /// [`RecordingError::Damaged`] with the first damage.
    pub fn verify(&self) -> Result<(), RecordingError> {
        if let Some(Cut { at, damaged: true, .. }) = self.cut {
            let (file, port) = (self.path.clone(), EVENTS.to_owned());
            return Err(RecordingError::Damaged { file, at, port, seq: self.events.len() as u64 });
        }
        let mut bytes = Vec::new();
        for (port, packet) in self.ports.iter().flat_map(|(port, all)| all.iter().map(move |p| (port, p))) {
            bytes.resize(packet.head.len as usize, 0);
            self.read(port, packet, &mut bytes)?;
        }
        self.verify_data().map_err(|cause| RecordingError::Unreadable { file: self.path.clone(), cause })?.map_or(
            Ok(()),
            |at| {
                let (file, port) = (self.path.clone(), EVENTS.to_owned());
                Err(RecordingError::Damaged { file, at, port, seq: self.events.len() as u64 })
            },
        )
    }

    /// Checks the data section; returns its end if its checksum is wrong.
    fn verify_data(&self) -> std::io::Result<Option<u64>> {
        let Some((len, sum)) = self.data_sum else { return Ok(None) };
        let (mut hash, mut bytes) = (crc32fast::Hasher::new(), vec![0; 1 << 20]);
        let mut at = 0;
        while at < len {
            let part = usize::try_from(len - at).unwrap_or(usize::MAX).min(bytes.len());
            let part = &mut bytes[..part];
            self.file.read_exact_at(part, at)?;
            hash.update(part);
            at += part.len() as u64;
        }
        Ok((hash.finalize() != sum).then_some(len))
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Number of ticks of all sources.
    pub fn ticks(&self) -> usize {
        self.sources.values().map(Vec::len).sum()
    }

    /// Reads and checks the bytes of a packet.
    pub fn bytes(&self, port: &str, packet: &Packet) -> Result<Vec<u8>, RecordingError> {
        let mut bytes = vec![0; packet.head.len as usize];
        self.read(port, packet, &mut bytes)?;
        Ok(bytes)
    }

    fn read(&self, port: &str, packet: &Packet, bytes: &mut [u8]) -> Result<(), RecordingError> {
        let PacketHead { format, width, height, stride_bytes, hash, padded, tick, .. } = packet.head;
        let damaged =
            || RecordingError::Damaged { file: self.path.clone(), at: packet.at, port: port.to_owned(), seq: tick.seq };
        if packet.coding == Coding::Packed {
            let mut packed = vec![0; packet.stored as usize];
            self.file.read_exact_at(&mut packed, packet.at).map_err(|_| damaged())?;
            coding::unpack(format, &packed, bytes).ok_or_else(damaged)?;
        } else {
            self.file.read_exact_at(bytes, packet.at).map_err(|_| damaged())?;
        }
        let frame = Frame { format, width, height, stride_bytes, ..Frame::EMPTY };
        let whole = packet_hash(&frame, bytes) == hash && (!self.checked || padded_hash(&frame, bytes) == padded);
        if whole { Ok(()) } else { Err(damaged()) }
    }

    /// Reads a packet into a frame of the host. Waits up to 5 s for free frame memory.
    pub fn frame(&self, port: &str, packet: &Packet) -> Result<FrameRef, RecordingError> {
        let PacketHead { format, width, height, stride_bytes, tick, len, .. } = packet.head;
        let wanted = len as usize;
        let mut remaining_ms = 5_000;
        let (buffer, data) = loop {
            match memory().allocate(wanted) {
                Ok(got) => break got,
                Err(panoscope_engine::memory::MemoryError::Exhausted { .. }) if remaining_ms > 0 => {
                    remaining_ms -= 1;
                    std::thread::sleep(std::time::Duration::from_millis(1));
                }
                Err(error) => {
                    let reason = error.to_string();
                    return Err(RecordingError::Memory { port: port.to_owned(), seq: tick.seq, reason });
                }
            }
        };
        let frame = Frame { buffer, data, len: wanted, format, width, height, stride_bytes, tick };
        // SAFETY: `allocate` returned the buffer with one reference, which this frame takes over.
        let frame = unsafe { FrameRef::adopt(frame) };
        // SAFETY: `allocate` returned at least `wanted` bytes that nothing else refers to yet.
        self.read(port, packet, unsafe { std::slice::from_raw_parts_mut(data, wanted) })?;
        Ok(frame)
    }

    /// Fingerprints of all recorded ports.
    pub fn digests(&self) -> Digests {
        let mut digests = Digests { graph: self.head.graph.name.clone(), ..Digests::default() };
        for (port, packets) in &self.ports {
            for packet in packets {
                let tick = packet.head.tick;
                digests.add(port, PacketDigest { source: tick.source, seq: tick.seq, hash: packet.head.hash });
            }
        }
        digests.finish();
        digests
    }
}

/// Whether a file ends with MCAP's end mark, as a finished recording does.
fn ends_with_magic(file: &File, len: u64) -> std::io::Result<bool> {
    let mut end = [0; mcap::MAGIC.len()];
    // A file of only the mark has no end: its beginning is the same.
    let Some(at) = len.checked_sub(end.len() as u64).filter(|at| *at > 0) else { return Ok(false) };
    file.read_exact_at(&mut end, at)?;
    Ok(end == mcap::MAGIC)
}

impl Scan {
    /// Whether MCAP's header names this program.
    fn is_ours(&self) -> bool {
        self.library.starts_with("panoscope ")
    }

    fn skip(&mut self, bytes: u64) -> Result<(), Stop> {
        let step = i64::try_from(bytes).map_err(|_| Stop::Damaged("a length is invalid".to_owned()))?;
        self.reader.seek_relative(step)?;
        Ok(())
    }

    fn body(&mut self, len: u64) -> Result<Vec<u8>, Stop> {
        let mut body = vec![0; len as usize];
        self.reader.read_exact(&mut body)?;
        Ok(body)
    }

    /// Reads one record and moves `at` past it if it is complete.
    fn record(&mut self) -> Result<(), Stop> {
        if self.at == self.len {
            return Err(Stop::Cut("it was not finished".to_owned()));
        }
        let mut head = [0; 9];
        self.reader.read_exact(&mut head)?;
        let len = head[1..].iter().rev().fold(0u64, |n, b| n << 8 | u64::from(*b));
        let begin = self.at + 9;
        // The records of a chunk stand in the file as they would without it; the chunk may be cut off, its records before are whole.
        if head[0] == op::CHUNK && self.is_ours() && len >= CHUNK_HEAD_BYTES as u64 {
            let mut chunk = [0; CHUNK_HEAD_BYTES];
            self.reader.read_exact(&mut chunk)?;
            if chunk[28..32] != [0; 4] {
                return Err(Stop::Damaged("a compressed chunk".to_owned()));
            }
            self.at = begin + CHUNK_HEAD_BYTES as u64;
            return Ok(());
        }
        if len > self.len.saturating_sub(begin) {
            return Err(Stop::Cut("it was truncated or is damaged".to_owned()));
        }
        let damaged = |what: &str| Stop::Damaged(what.to_owned());
        match head[0] {
            op::DATA_END => return Err(self.index(len)),
            op::CHANNEL if len < 1 << 16 => {
                let body = self.body(len)?;
                let Some(channel) = mcap_texts::channel(&body) else {
                    return Err(damaged("a channel cannot be read"));
                };
                let events = channel.topic == EVENTS;
                let schema = SCHEMAS[usize::from(!events)].id;
                if self.is_ours()
                    && (![0, schema].contains(&channel.schema_id)
                        || channel.has_metadata
                        || (events && channel.message_encoding != "json"))
                {
                    return Err(damaged("a channel with an unexpected description"));
                }
                let packets = channel.message_encoding == PACKET_ENCODING;
                if packets || channel.topic == EVENTS {
                    self.channels.insert(channel.id, (channel.topic, packets));
                }
            }
            op::MESSAGE if len >= MESSAGE_HEAD_BYTES as u64 => self.message(begin, len)?,
            op::CHUNK if self.head.is_none() => return Err(Stop::Foreign("it has chunks".to_owned())),
            op::HEADER if self.at == mcap::MAGIC.len() as u64 && len < 1 << 16 => {
                let body = self.body(len)?;
                let Some((profile, library)) = mcap_texts::header(&body) else {
                    return Err(damaged("its header cannot be read"));
                };
                self.library = format!("{profile} {library}");
            }
            op::SCHEMA if self.is_ours() && len < 1 << 16 => {
                let body = self.body(len)?;
                if !SCHEMAS.iter().any(|schema| schema.body() == body) {
                    return Err(damaged("a schema was altered"));
                }
            }
            op::MESSAGE_INDEX if self.is_ours() => self.skip(len)?,
            // Only files of other programs have these records before the first event.
            op::SCHEMA | op::ATTACHMENT | op::METADATA if self.head.is_none() => self.skip(len)?,
            other => return Err(damaged(&format!("there is no record of kind {other}"))),
        }
        self.at = begin + len;
        Ok(())
    }

    fn message(&mut self, begin: u64, len: u64) -> Result<(), Stop> {
        let damaged = |what: &str| Stop::Damaged(what.to_owned());
        let mut message = [0; MESSAGE_HEAD_BYTES];
        self.reader.read_exact(&mut message)?;
        let channel = u16::from_le_bytes([message[0], message[1]]);
        let rest = len - MESSAGE_HEAD_BYTES as u64;
        let Some((topic, packets)) = self.channels.get(&channel).cloned() else {
            return if self.head.is_some() { Err(damaged("a message has no channel")) } else { self.skip(rest) };
        };
        if !packets {
            if rest > MAX_EVENT {
                return Err(damaged("an event is too long"));
            }
            let mut body = self.body(rest)?;
            let seal = check::unseal(&topic, &message, &mut body);
            let checked = self.head.as_ref().is_some_and(|h| h.format >= CHECKED_FORMAT);
            if seal == Seal::Broken || (seal == Seal::None && checked) {
                return Err(damaged("an event was altered"));
            }
            let event = serde_json::from_slice(&body).map_err(|_| damaged("an event cannot be read"));
            return match event {
                Ok(Event::Head(head)) if seal == Seal::None && head.format >= CHECKED_FORMAT => {
                    Err(damaged("its head was altered"))
                }
                Ok(event) => self.event(event),
                Err(stop) if self.head.is_some() => Err(stop),
                Err(_) => Err(self.foreign_head(&body)),
            };
        }
        let checked = self.head.as_ref().is_some_and(|h| h.format >= CHECKED_FORMAT);
        let head_bytes = if checked { PACKET_HEAD_BYTES } else { PLAIN_HEAD_BYTES };
        if rest < head_bytes as u64 {
            return Err(damaged("a packet has no head"));
        }
        let mut packet_head = [0; PACKET_HEAD_BYTES];
        self.reader.read_exact(&mut packet_head[..head_bytes])?;
        let (plain, more) = packet_head.split_at(PLAIN_HEAD_BYTES);
        let plain = plain.try_into().map_err(|_| damaged("a packet has no head"))?;
        let Some(mut head) = PacketHead::read(plain) else {
            return Err(damaged("the storage of a packet is unknown"));
        };
        if checked {
            let eight = |at: usize| more[at..at + 8].iter().rev().fold(0u64, |n, b| n << 8 | u64::from(*b));
            head.padded = eight(0);
            if check::sum(&topic, &message, &packet_head[..SUMMED_HEAD_BYTES]) != eight(8) {
                return Err(damaged("the description of a packet was altered"));
            }
        }
        let stored = rest - head_bytes as u64;
        let (fits, longest) = match head.coding {
            Coding::Plain => (head.len == stored, MAX_PACKET),
            Coding::Packed => (stored < head.len, MAX_PACKED),
            Coding::Reference => (stored == REFERENCE_BYTES, MAX_PACKED),
        };
        if !fits || head.len > longest || self.head.is_none() {
            return Err(damaged("a packet has a wrong length"));
        }
        let at = begin + (MESSAGE_HEAD_BYTES + head_bytes) as u64;
        let packet = if head.coding == Coding::Reference {
            let mut place = [0; REFERENCE_BYTES as usize];
            self.reader.read_exact(&mut place)?;
            let Some(&(coding, stored, len)) = self.places.get(&u64::from_le_bytes(place)) else {
                return Err(damaged("a packet refers to a missing one"));
            };
            if len != head.len {
                return Err(damaged("a packet refers to one of another length"));
            }
            Packet { head, at: u64::from_le_bytes(place), stored, coding }
        } else {
            self.skip(stored)?;
            self.places.insert(at, (head.coding, stored, head.len));
            Packet { head, at, stored, coding: head.coding }
        };
        let Some((node, port)) = topic.split_once('.') else { return Err(damaged("a port has no node")) };
        self.pending.entry(node.to_owned()).or_default().push((port.to_owned(), packet));
        self.ports.entry(topic).or_default().push(packet);
        Ok(())
    }

    /// Checks MCAP's index after the data, which has its own checksum. Returns how the recording ends.
    fn index(&mut self, end_len: u64) -> Stop {
        let read = |this: &mut Self, len: u64| if len > MAX_INDEX { Ok(Vec::new()) } else { this.body(len) };
        let end = match read(self, end_len) {
            Ok(end) => end,
            Err(stop) => return stop,
        };
        let rest = match read(self, self.len.saturating_sub(self.at + 9 + end_len)) {
            Ok(rest) => rest,
            Err(stop) => return stop,
        };
        let Some(index) = rest.strip_suffix(mcap::MAGIC).filter(|index| index.len() >= FOOTER_BYTES) else {
            // If the footer is where a complete file has it, only the end mark is wrong.
            let footer = rest.len().checked_sub(FOOTER_BYTES + mcap::MAGIC.len()).and_then(|at| rest.get(at..at + 9));
            let whole = footer.is_some_and(|f| f[0] == op::FOOTER && f[1..] == 20u64.to_le_bytes());
            let reason = "its end mark is missing".to_owned();
            return if whole { Stop::Damaged(reason) } else { Stop::Cut(reason) };
        };
        let (summed, sum) = index.split_at(index.len() - 4);
        let known = sum.iter().rev().fold(0u32, |n, b| n << 8 | u32::from(*b));
        let Ok(data_sum) = end.try_into().map(u32::from_le_bytes) else {
            return Stop::Damaged("the end of its data is not what was recorded".to_owned());
        };
        // Before format 5 there is none, because every message has its own.
        self.data_sum = (data_sum != 0).then_some((self.at, data_sum));
        let whole = known == 0 || known == crc32fast::hash(summed);
        if whole { Stop::End } else { Stop::Damaged("its index is not what was recorded".to_owned()) }
    }

    /// The reason why a head cannot be read, such as another version.
    fn foreign_head(&self, body: &[u8]) -> Stop {
        let value: serde_json::Value = serde_json::from_slice(body).unwrap_or_default();
        let format = value.get("format").and_then(serde_json::Value::as_u64);
        let version = value.get("version").and_then(serde_json::Value::as_str).unwrap_or("?").to_owned();
        match format.and_then(|f| u32::try_from(f).ok()).filter(|f| !(OLDEST_FORMAT..=FORMAT).contains(f)) {
            Some(found) => Stop::OtherFormat(found, version),
            None => Stop::Damaged("its head cannot be read".to_owned()),
        }
    }

    fn event(&mut self, event: Event) -> Result<(), Stop> {
        match event {
            Event::Head(head) if self.head.is_none() => {
                if !(OLDEST_FORMAT..=FORMAT).contains(&head.format) {
                    return Err(Stop::OtherFormat(head.format, head.version));
                }
                if head.format >= CHECKED_FORMAT && self.library != format!("panoscope panoscope {}", head.version) {
                    return Err(Stop::Damaged("its header was altered".to_owned()));
                }
                self.head = Some(*head);
            }
            _ if self.head.is_none() => return Err(Stop::Foreign("its first message is not a head".to_owned())),
            Event::Tick { node, seq, capture_ns, packets: count, gap } => {
                let packets = self.pending.remove(&node).unwrap_or_default();
                if !gap && packets.len() != count as usize {
                    return Err(Stop::Damaged(format!("packets of tick {seq} of `{node}` are missing")));
                }
                let tick = SourceTick { seq, capture_ns, admitted: true, gap, packets };
                self.sources.entry(node).or_default().push(tick);
            }
            Event::Dropped { node, seq } => {
                let ticks = self.sources.get_mut(&node).into_iter().flatten().rev();
                if let Some(tick) = ticks.into_iter().find(|t| t.seq == seq) {
                    tick.admitted = false;
                }
            }
            event => {
                if let Event::Edit { applied, admitted, .. } = &event {
                    for removed in &applied.removed {
                        self.drop_unadmitted(removed, admitted);
                    }
                }
                self.events.push(event);
            }
        }
        Ok(())
    }

    /// Marks the ticks of a removed source that had not entered before the change as not admitted.
    fn drop_unadmitted(&mut self, source: &str, admitted: &[(String, u64)]) {
        let Some((_, count)) = admitted.iter().find(|(head, _)| head == source) else { return };
        let ticks = self.sources.get_mut(source).into_iter().flatten();
        let entered = ticks.filter(|t| t.admitted);
        entered.skip(*count as usize).for_each(|t| t.admitted = false);
    }
}
