//! Reads a bag, message by message, in the order of their log times.
//!
//! Recorders write messages in the order of arrival, and some programs write one topic after the other. So the parts of
//! all files are found first, by the heads of their records, and opened by their times; those that overlap are open at
//! once.
//!
//! Bags are untrusted: the lengths of records and unpacked chunks are limited, and memory grows only with read bytes.
//! The readers of the crate `mcap` are not used, because they panic at damaged chunks, reject a truncated chunk, and
//! allocate unchecked lengths.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, VecDeque};
use std::fs::{self, File};
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::op;

use super::error::BagError;
use super::fields::Fields;
use super::scan::{Channels, End, Form, HEAD_BYTES, MAX_RECORD_BYTES, Part, Scan};

/// Maximum number of bytes of parts that are open at once because their times overlap.
const MAX_OPEN_BYTES: u64 = 2 << 30;
/// Number of messages that [`survey`] reads.
const SURVEYED: u64 = 2000;

/// First bytes of an individually compressed message; CDR begins with a 0.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// A stored message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawMessage {
    /// Its topic.
    pub topic: String,
    /// Its type, such as `sensor_msgs/msg/Image`.
    pub message: String,
    /// Time of recording, ns since 1970.
    pub log_ns: i64,
    /// Content in CDR.
    pub data: Vec<u8>,
}

/// A topic of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagTopic {
    /// Its name.
    pub topic: String,
    /// Type of its messages.
    pub message: String,
}

/// A file of a bag.
#[derive(Clone)]
struct Source {
    path: PathBuf,
    /// The bytes of one that is in memory.
    bytes: Option<Arc<[u8]>>,
    channels: Channels,
    /// Its end; taken once it is reported.
    end: Option<End>,
    /// Messages so far.
    messages: u64,
}

trait Input: Read + Seek + Send {}

impl<R: Read + Seek + Send> Input for R {}

impl Source {
    fn input(&self) -> io::Result<Box<dyn Input>> {
        Ok(match &self.bytes {
            Some(bytes) => Box::new(Cursor::new(Arc::clone(bytes))),
            None => Box::new(File::open(&self.path)?),
        })
    }

    fn failed(&self, cause: io::Error) -> BagError {
        BagError::Read { path: self.path.clone(), cause }
    }

    fn damaged(&self, words: impl Into<String>) -> BagError {
        BagError::Damaged { path: self.path.clone(), messages: self.messages, words: words.into() }
    }
}

/// A chunk that cannot be unpacked.
#[derive(Debug, thiserror::Error)]
enum ChunkError {
    #[error("the header of a chunk does not match it")]
    Header,
    #[error("a chunk of {size} bytes is longer than {MAX_RECORD_BYTES}")]
    TooLong { size: u64 },
    #[error("compression `{name}` of chunks is not supported")]
    Compression { name: String },
    #[error("a chunk cannot be decompressed: {0}")]
    Decompression(#[from] io::Error),
    #[error("the CRC of a chunk is wrong")]
    Checksum,
}

/// Unpacks the body of a chunk; of a truncated one, the part that can be unpacked.
fn unpack(body: &[u8], is_cut: bool) -> Result<Vec<u8>, ChunkError> {
    let mut fields = Fields(body);
    // Times of the first and the last message, size, checksum, name of the compression, size of what is packed.
    let head = (|| {
        let (_start, _end, size, crc) = (fields.u64()?, fields.u64()?, fields.u64()?, fields.u32()?);
        let name_len = fields.u32()? as usize;
        Some((size, crc, fields.bytes(name_len)?, fields.u64()?))
    })();
    let Some((size, crc, name, packed_len)) = head else {
        return if is_cut { Ok(Vec::new()) } else { Err(ChunkError::Header) };
    };
    if size > MAX_RECORD_BYTES {
        return Err(ChunkError::TooLong { size });
    }
    let packed = &fields.0[..usize::try_from(packed_len).unwrap_or(usize::MAX).min(fields.0.len())];
    let mut bytes = Vec::new();
    let unpacked = match name {
        b"" => packed.take(size).read_to_end(&mut bytes),
        b"zstd" => zstd::stream::read::Decoder::new(packed).and_then(|from| from.take(size).read_to_end(&mut bytes)),
        b"lz4" => lz4::Decoder::new(packed).and_then(|from| from.take(size).read_to_end(&mut bytes)),
        other => {
            let name = String::from_utf8_lossy(other).chars().take(20).collect::<String>();
            return Err(ChunkError::Compression { name });
        }
    };
    if !is_cut {
        unpacked?;
        if bytes.len() as u64 != size || crc != 0 && crc32fast::hash(&bytes) != crc {
            return Err(ChunkError::Checksum);
        }
    }
    Ok(bytes)
}

/// A message of a part that is open. The oldest comes first, at equal times, the one that was found first.
struct Waiting {
    log_ns: u64,
    number: u64,
    file: usize,
    channel: u16,
    /// The bytes of its part and the range of its data.
    part: Arc<Vec<u8>>,
    data: std::ops::Range<usize>,
}

impl Waiting {
    fn key(&self) -> (u64, u64) {
        (self.log_ns, self.number)
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Eq for Waiting {}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.key().cmp(&other.key())
    }
}

/// Reads a bag.
pub struct BagReader {
    files: Vec<Source>,
    /// Parts with their files that are not open yet, by their first times.
    parts: VecDeque<(usize, Part)>,
    waiting: BinaryHeap<Reverse<Waiting>>,
    /// Messages that were found so far.
    found: u64,
    /// The file that was read last.
    input: Option<(usize, Box<dyn Input>)>,
    /// Parts in memory, for their size.
    open: Vec<std::sync::Weak<Vec<u8>>>,
}

/// The MCAP files of a bag: the file itself, or those of a folder in numeric order.
fn files(path: &Path) -> Result<Vec<PathBuf>, BagError> {
    let read = |cause| BagError::Read { path: path.to_owned(), cause };
    if !path.is_dir() {
        fs::metadata(path).map_err(read)?;
        return Ok(vec![path.to_owned()]);
    }
    let all: Vec<PathBuf> = fs::read_dir(path)
        .map_err(read)?
        .map(|entry| entry.map(|e| e.path()))
        .collect::<Result<_, _>>()
        .map_err(read)?;
    let ends = |path: &Path, ending: &str| path.to_string_lossy().ends_with(ending);
    let mut found: Vec<PathBuf> = all.iter().filter(|path| ends(path, ".mcap")).cloned().collect();
    if found.is_empty() {
        let hint = if all.iter().any(|path| ends(path, ".db3") || ends(path, ".db3.zstd")) {
            "it is a bag of SQLite; convert it with `ros2 bag convert` to storage_id mcap"
        } else if all.iter().any(|path| ends(path, ".mcap.zstd")) {
            "its file is compressed as a whole; unpack it with `zstd -d`"
        } else {
            "give the folder of a bag, or an MCAP file"
        };
        return Err(BagError::NoMcap { path: path.to_owned(), hint });
    }
    // `bag_10` comes after `bag_9`.
    found.sort_by_key(|path| {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let digits = name.chars().rev().take_while(char::is_ascii_digit).count();
        let number = name[name.len() - digits..].parse::<u64>().unwrap_or(0);
        (name[..name.len() - digits].to_owned(), number)
    });
    Ok(found)
}

impl BagReader {
    /// Opens a bag: its folder, or one MCAP file.
    ///
    /// # Errors
    /// There is none, or a file cannot be read.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        Self::of(files(path)?.into_iter().map(|path| (path, None)))
    }

    fn of(files: impl IntoIterator<Item = (PathBuf, Option<Arc<[u8]>>)>) -> Result<Self, BagError> {
        let mut reader = Self {
            files: Vec::new(),
            parts: VecDeque::new(),
            waiting: BinaryHeap::new(),
            found: 0,
            input: None,
            open: Vec::new(),
        };
        let mut parts = Vec::new();
        for (path, bytes) in files {
            let mut source = Source { path, bytes, channels: Channels::default(), end: None, messages: 0 };
            let scan = source.input().and_then(Scan::of).map_err(|cause| source.failed(cause))?;
            let keeps_order = scan.channels.is_empty();
            let mut last_ns = 0;
            for mut part in scan.parts {
                // Topics that are only announced within chunks are known in the order of the chunks.
                last_ns = if keeps_order { part.start_ns.max(last_ns) } else { part.start_ns };
                part.start_ns = last_ns;
                parts.push((reader.files.len(), part));
            }
            (source.channels, source.end) = (scan.channels, Some(scan.end));
            reader.files.push(source);
        }
        parts.sort_by_key(|(_, part)| part.start_ns);
        reader.parts = parts.into();
        Ok(reader)
    }

    /// The bytes of a part as records.
    fn records(&mut self, file: usize, part: &Part) -> Result<Vec<u8>, BagError> {
        let source = &self.files[file];
        let mut input = match self.input.take() {
            Some((known, input)) if known == file => input,
            _ => source.input().map_err(|cause| source.failed(cause))?,
        };
        let mut body = Vec::new();
        let read =
            input.seek(SeekFrom::Start(part.at)).and_then(|_| input.by_ref().take(part.len).read_to_end(&mut body));
        read.map_err(|cause| source.failed(cause))?;
        self.input = Some((file, input));
        match part.form {
            Form::Records => Ok(body),
            form => unpack(&body, form == Form::CutChunk).map_err(|error| source.damaged(error.to_string())),
        }
    }

    /// Opens a part and queues its wanted messages.
    fn open_part(
        &mut self,
        (file, part): (usize, Part),
        wants: &mut dyn FnMut(&str, &str) -> bool,
    ) -> Result<(), BagError> {
        self.open.retain(|part| part.strong_count() > 0);
        let open_bytes: u64 = self.open.iter().filter_map(std::sync::Weak::upgrade).map(|part| part.len() as u64).sum();
        if open_bytes > MAX_OPEN_BYTES {
            let words = "more than 2 GiB of its chunks overlap in time; write it again with `ros2 bag convert`";
            return Err(self.files[file].damaged(words));
        }
        let bytes = Arc::new(self.records(file, &part)?);
        self.open.push(Arc::downgrade(&bytes));
        let source = &mut self.files[file];
        let mut at = 0;
        while at < bytes.len() {
            let record = Fields(&bytes[at..]).record();
            let body = at + HEAD_BYTES;
            let end = record.and_then(|(_, len)| body.checked_add(usize::try_from(len).ok()?));
            let (Some((opcode, _)), Some(end)) = (record, end.filter(|end| *end <= bytes.len())) else {
                return match part.form {
                    Form::CutChunk => Ok(()),
                    _ => Err(source.damaged("a record exceeds its chunk")),
                };
            };
            at = end;
            if opcode != op::MESSAGE {
                source.channels.take(opcode, &bytes[body..end]).map_err(|words| source.damaged(words))?;
                continue;
            }
            let mut fields = Fields(&bytes[body..end]);
            let head = (fields.u16(), fields.array::<4>(), fields.u64(), fields.u64());
            let (Some(channel), Some(_number), Some(log_ns), Some(_published_ns)) = head else {
                return Err(source.damaged("a record lacks fields of its kind"));
            };
            source.messages += 1;
            let Some(known) = source.channels.get(channel) else {
                return Err(source.damaged("a message belongs to no topic"));
            };
            if known.is_some_and(|(topic, message)| wants(topic, message)) {
                let (number, data) = (self.found, end - fields.0.len()..end);
                self.found += 1;
                let part = Arc::clone(&bytes);
                self.waiting.push(Reverse(Waiting { log_ns, number, file, channel, part, data }));
            }
        }
        Ok(())
    }

    /// The next message whose topic and type `wants` accepts; `None` at the end.
    ///
    /// # Errors
    /// A file cannot be read, ends early or is damaged.
    pub fn next(&mut self, mut wants: impl FnMut(&str, &str) -> bool) -> Result<Option<RawMessage>, BagError> {
        loop {
            let first_ns = self.waiting.peek().map(|Reverse(waiting)| waiting.log_ns);
            let is_due = |(_, part): &(usize, Part)| first_ns.is_none_or(|first_ns| part.start_ns <= first_ns);
            if self.parts.front().is_some_and(is_due)
                && let Some(part) = self.parts.pop_front()
            {
                self.open_part(part, &mut wants)?;
                continue;
            }
            let Some(Reverse(Waiting { log_ns, file, channel, part, data, .. })) = self.waiting.pop() else {
                return self.end().map_or(Ok(None), Err);
            };
            let source = &self.files[file];
            if let Some(Some((topic, message))) = source.channels.get(channel) {
                if part[data.clone()].starts_with(&ZSTD) {
                    return Err(BagError::PackedMessage { path: source.path.clone(), topic: topic.to_owned() });
                }
                return Ok(Some(RawMessage {
                    topic: topic.to_owned(),
                    message: message.to_owned(),
                    log_ns: i64::try_from(log_ns).unwrap_or(i64::MAX),
                    data: part[data].to_vec(),
                }));
            }
        }
    }

    /// The error at the end of a file, reported once per file.
    fn end(&mut self) -> Option<BagError> {
        self.files.iter_mut().find_map(|source| match source.end.take()? {
            End::Whole => None,
            End::CutOff => Some(BagError::CutOff { path: source.path.clone(), messages: source.messages }),
            End::Damaged(words) => Some(source.damaged(words)),
        })
    }

    /// The topics among the first messages. If a bag ends early, those before its end. The reading position is
    /// unchanged.
    ///
    /// # Errors It is damaged before its first message, or has no readable messages.
    pub fn survey(&self) -> Result<Vec<BagTopic>, BagError> {
        let mut ahead = Self {
            files: self.files.clone(),
            parts: self.parts.clone(),
            waiting: BinaryHeap::new(),
            found: 0,
            input: None,
            open: Vec::new(),
        };
        let (mut found, mut read) = (BTreeMap::new(), 0);
        while read < SURVEYED {
            let next = ahead.next(|topic, message| {
                if !found.contains_key(topic) {
                    found.insert(topic.to_owned(), message.to_owned());
                }
                true
            });
            match next {
                Ok(Some(_)) => read += 1,
                Err(error) if found.is_empty() || matches!(error, BagError::PackedMessage { .. }) => return Err(error),
                Ok(None) | Err(_) => break,
            }
        }
        if let Some(file) = ahead.files.iter().find(|file| found.is_empty() && file.channels.is_ros1) {
            return Err(BagError::Ros1 { path: file.path.clone() });
        }
        Ok(found.into_iter().map(|(topic, message)| BagTopic { topic, message }).collect())
    }

    /// The messages of an MCAP file that is in memory.
    ///
    /// # Errors
    /// It is damaged.
    pub fn read_bytes(bytes: &[u8], mut take: impl FnMut(RawMessage)) -> Result<(), BagError> {
        let mut reader = Self::of([(PathBuf::from("bytes"), Some(bytes.into()))])?;
        while let Some(message) = reader.next(|_, _| true)? {
            take(message);
        }
        Ok(())
    }
}

/// The topics among the first messages of a bag, see [`BagReader::survey`].
///
/// # Errors
/// There is no bag, or as [`BagReader::survey`].
pub fn survey(path: &Path) -> Result<Vec<BagTopic>, BagError> {
    BagReader::open(path)?.survey()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::BagWriter;
    use crate::cdr;
    use crate::messages::{JointState, PoseStamped};

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("panoscope-ros-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        folder
    }

    #[test]
    fn what_is_written_is_read() {
        let folder = folder("there-and-back");
        let mut writer = BagWriter::create(&folder, false).unwrap();
        let joints = JointState { name: vec!["a".to_owned()], position: vec![0.5], ..JointState::default() };
        for tick in 0..3 {
            writer.write("/joints", tick * 1000, &joints).unwrap();
            writer.write("/pose", tick * 1000, &PoseStamped::default()).unwrap();
        }
        writer.finish().unwrap();
        assert!(matches!(BagWriter::create(&folder, false), Err(BagError::Exists { .. })));
        let topics: Vec<String> = survey(&folder).unwrap().into_iter().map(|topic| topic.topic).collect();
        assert_eq!(topics, ["/joints", "/pose"]);
        let mut reader = BagReader::open(&folder).unwrap();
        let mut times = Vec::new();
        while let Some(message) = reader.next(|topic, _| topic == "/joints").unwrap() {
            assert_eq!(cdr::decode::<JointState>(&message.data).unwrap(), joints);
            times.push(message.log_ns);
        }
        assert_eq!(times, [0, 1000, 2000]);
        let file = fs::read_dir(&folder).unwrap().flatten().find(|e| e.path().extension().is_some_and(|e| e == "mcap"));
        let bytes = fs::read(file.unwrap().path()).unwrap();
        let mut cut = 0;
        let error = BagReader::read_bytes(&bytes[..bytes.len() / 2], |_| cut += 1).unwrap_err();
        assert!(matches!(error, BagError::CutOff { .. } | BagError::Damaged { .. }), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }

    /// A file with a message of each topic at these times, written in this order, in chunks or without.
    fn unsorted(times: &[(&str, u64)], chunk_bytes: Option<u64>, is_whole: bool) -> Vec<u8> {
        let options = mcap::WriteOptions::new().compression(None).use_chunks(chunk_bytes.is_some());
        let options = options.chunk_size(chunk_bytes).emit_summary_records(is_whole);
        let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
        let schema = writer.add_schema("geometry_msgs/msg/PoseStamped", "ros2msg", b"").unwrap();
        for (topic, log_time) in times {
            let channel_id = writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap();
            let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: *log_time, publish_time: 0 };
            writer.write_to_known_channel(&header, &[0; 40]).unwrap();
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }

    #[test]
    fn messages_come_in_the_order_of_their_log_times() {
        let left = (0..40).map(|at| ("/left", 10 * at));
        let times: Vec<(&str, u64)> = left.chain((0..40).map(|at| ("/right", 10 * at + 1))).collect();
        for chunk_bytes in [None, Some(100), Some(900), Some(1 << 20)] {
            let mut read = Vec::new();
            let bytes = unsorted(&times, chunk_bytes, true);
            BagReader::read_bytes(&bytes, |message| read.push((message.log_ns, message.topic))).unwrap();
            assert!(read.len() == 80 && read.is_sorted(), "{chunk_bytes:?}: {read:?}");
            // Without a summary the topic of the second half is only known in the order of the chunks.
            let mut read = 0;
            BagReader::read_bytes(&unsorted(&times, chunk_bytes, false), |_| read += 1).unwrap();
            assert_eq!(read, 80, "{chunk_bytes:?}");
        }
    }

    #[test]
    fn what_is_no_bag_is_named() {
        let folder = folder("none");
        fs::create_dir_all(&folder).unwrap();
        assert!(BagReader::open(&folder).err().unwrap().to_string().contains("give the folder of a bag"));
        fs::write(folder.join("a_0.db3"), "").unwrap();
        assert!(BagReader::open(&folder).err().unwrap().to_string().contains("ros2 bag convert"));
        fs::write(folder.join("a_0.mcap"), "no MCAP at all").unwrap();
        assert!(matches!(survey(&folder), Err(BagError::Damaged { .. })));
        assert!(matches!(BagReader::open(&folder.join("missing")), Err(BagError::Read { .. })));
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn files_are_in_the_order_of_their_numbers() {
        let folder = folder("order");
        fs::create_dir_all(&folder).unwrap();
        for name in ["b_10.mcap", "b_9.mcap", "b_0.mcap"] {
            fs::write(folder.join(name), "").unwrap();
        }
        let names: Vec<String> = files(&folder)
            .unwrap()
            .iter()
            .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
            .collect();
        assert_eq!(names, ["b_0.mcap", "b_9.mcap", "b_10.mcap"]);
        fs::remove_dir_all(&folder).unwrap();
    }
}
