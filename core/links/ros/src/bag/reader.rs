//! Reads a bag, message by message, in the order of its files.
//!
//! Nothing of a bag is trusted: records and unpacked chunks have a largest length, and memory is taken as bytes come. The readers of the crate `mcap`
//! are not used, because they panic at damaged chunks, give up a chunk that is cut off, and take memory by lengths that they have not compared.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use mcap::records::op;

use super::error::BagError;

/// Longest record: a picture of 8K with four bytes a pixel is half of it.
const MAX_RECORD_BYTES: u64 = 256 << 20;
/// Bytes before the body of a record: its kind and its length.
const HEAD_BYTES: usize = 9;
/// Channels and schemas of a file.
const MAX_CHANNELS: usize = 10_000;
/// Messages of a file that [`survey`] looks at.
const SURVEYED: u64 = 2000;

/// A message as it is stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawMessage {
    /// Its topic.
    pub topic: String,
    /// Its type, such as `sensor_msgs/msg/Image`.
    pub message: String,
    /// When it was recorded.
    pub log_ns: i64,
    /// CDR.
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

/// Records of an unpacked chunk.
#[derive(Default)]
struct Chunk {
    bytes: Vec<u8>,
    at: usize,
    /// The file ended within it.
    is_cut: bool,
}

/// A file that is being read, from any stream.
struct Open<R> {
    path: PathBuf,
    input: R,
    has_begun: bool,
    chunk: Chunk,
    /// Names of types by schema.
    schemas: HashMap<u16, String>,
    /// Topic and type by channel; `None` for messages that are not in CDR.
    channels: HashMap<u16, Option<(String, String)>>,
    messages: u64,
}

impl<R: Read> Open<R> {
    fn new(path: PathBuf, input: R) -> Self {
        let (schemas, channels) = (HashMap::new(), HashMap::new());
        Self { path, input, has_begun: false, chunk: Chunk::default(), schemas, channels, messages: 0 }
    }

    fn damaged(&self, words: impl Into<String>) -> BagError {
        BagError::Damaged { path: self.path.clone(), messages: self.messages, words: words.into() }
    }

    fn cut_off(&self) -> BagError {
        BagError::CutOff { path: self.path.clone(), messages: self.messages }
    }

    /// Up to `len` bytes; fewer where the file ends.
    fn bytes(&mut self, len: u64) -> Result<Vec<u8>, BagError> {
        if len > MAX_RECORD_BYTES {
            return Err(self.damaged(format!("a record of {len} bytes is too long")));
        }
        let mut bytes = Vec::new();
        match self.input.by_ref().take(len).read_to_end(&mut bytes) {
            Ok(_) => Ok(bytes),
            Err(cause) => Err(BagError::Read { path: self.path.clone(), cause }),
        }
    }

    /// `N` bytes.
    fn array<const N: usize>(&mut self) -> Result<[u8; N], BagError> {
        self.bytes(N as u64)?.try_into().map_err(|_| self.cut_off())
    }

    /// The next record of the chunk: its kind and where its bytes are; `None` at the end of the chunk.
    fn in_chunk(&mut self) -> Result<Option<(u8, std::ops::Range<usize>)>, BagError> {
        let Chunk { bytes, at, is_cut } = &self.chunk;
        let rest = bytes.get(*at..).unwrap_or_default();
        if rest.is_empty() && !is_cut {
            return Ok(None);
        }
        let whole = rest.split_first_chunk::<HEAD_BYTES>().and_then(|([opcode, len @ ..], body)| {
            let len = usize::try_from(u64::from_le_bytes(*len)).ok().filter(|len| *len <= body.len())?;
            Some((*opcode, *at + HEAD_BYTES..*at + HEAD_BYTES + len))
        });
        match whole {
            Some((opcode, range)) => {
                self.chunk.at = range.end;
                Ok(Some((opcode, range)))
            }
            None if *is_cut => Err(self.cut_off()),
            None => Err(self.damaged("a record does not fit its chunk")),
        }
    }

    /// Reads and unpacks a chunk of `len` bytes. Of one that is cut off, what can be unpacked.
    fn open_chunk(&mut self, len: u64) -> Result<(), BagError> {
        let body = self.bytes(len)?;
        let is_cut = (body.len() as u64) < len;
        // Times of the first and the last message, size, checksum, name of the compression.
        let fields = body.split_first_chunk::<32>().map(|(head, rest)| (*head, rest));
        let Some((head, rest)) = fields else {
            return Err(if is_cut { self.cut_off() } else { self.damaged("a chunk has no head") });
        };
        let number = |at: usize| u64::from_le_bytes(std::array::from_fn(|byte| head[at + byte]));
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|byte| head[at + byte]));
        let (size, crc, name_len) = (number(16), word(24), word(28) as usize);
        let named =
            rest.split_at_checked(name_len).and_then(|(name, rest)| Some((name, rest.split_first_chunk::<8>()?)));
        let Some((name, (packed_len, packed))) = named else {
            return Err(if is_cut { self.cut_off() } else { self.damaged("the head of a chunk does not fit it") });
        };
        if size > MAX_RECORD_BYTES {
            return Err(self.damaged(format!("a chunk of {size} bytes is too long")));
        }
        let packed_len = usize::try_from(u64::from_le_bytes(*packed_len)).unwrap_or(usize::MAX);
        let packed = &packed[..packed_len.min(packed.len())];
        let mut bytes = Vec::new();
        let unpacked = match name {
            b"" => packed.take(size).read_to_end(&mut bytes),
            b"zstd" => {
                zstd::stream::read::Decoder::new(packed).and_then(|from| from.take(size).read_to_end(&mut bytes))
            }
            b"lz4" => lz4::Decoder::new(packed).and_then(|from| from.take(size).read_to_end(&mut bytes)),
            other => {
                let name = String::from_utf8_lossy(other).chars().take(20).collect::<String>();
                return Err(self.damaged(format!("chunks compressed with `{name}` are not read here")));
            }
        };
        if !is_cut {
            if let Err(error) = unpacked {
                return Err(self.damaged(format!("a chunk cannot be unpacked: {error}")));
            }
            if bytes.len() as u64 != size || crc != 0 && crc32fast::hash(&bytes) != crc {
                return Err(self.damaged("a chunk has other bytes than were written"));
            }
        }
        self.chunk = Chunk { bytes, at: 0, is_cut };
        Ok(())
    }

    /// The next message that is wanted; `None` at the end.
    fn next(&mut self, wants: &mut dyn FnMut(&str, &str) -> bool) -> Result<Option<RawMessage>, BagError> {
        if !self.has_begun {
            self.has_begun = true;
            if !self.array::<8>().is_ok_and(|magic| magic[..] == *mcap::MAGIC) {
                return Err(self.damaged("it does not begin like an MCAP file"));
            }
        }
        loop {
            if let Some((opcode, range)) = self.in_chunk()? {
                let bytes = std::mem::take(&mut self.chunk.bytes);
                let found = self.record(opcode, &bytes[range], wants);
                self.chunk.bytes = bytes;
                match found? {
                    Some(message) => return Ok(Some(message)),
                    None => continue,
                }
            }
            let [opcode, len @ ..] = self.array::<HEAD_BYTES>()?;
            let len = u64::from_le_bytes(len);
            match opcode {
                op::FOOTER | op::DATA_END => return Ok(None),
                op::CHUNK => self.open_chunk(len)?,
                op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                    let body = self.bytes(len)?;
                    if (body.len() as u64) < len {
                        return Err(self.cut_off());
                    }
                    if let Some(message) = self.record(opcode, &body, wants)? {
                        return Ok(Some(message));
                    }
                }
                _ => {
                    let skipped = io::copy(&mut self.input.by_ref().take(len), &mut io::sink());
                    let skipped = skipped.map_err(|cause| BagError::Read { path: self.path.clone(), cause })?;
                    if skipped < len {
                        return Err(self.cut_off());
                    }
                }
            }
        }
    }

    /// Takes a record. Returns it if it is a message that is wanted.
    fn record(
        &mut self,
        opcode: u8,
        body: &[u8],
        wants: &mut dyn FnMut(&str, &str) -> bool,
    ) -> Result<Option<RawMessage>, BagError> {
        let mut fields = Fields(body);
        let misfit = || self.damaged("a record lacks fields of its kind");
        match opcode {
            op::SCHEMA => {
                if self.schemas.len() >= MAX_CHANNELS {
                    return Err(self.damaged("it has more than 10,000 types"));
                }
                let (id, name) = fields.u16().zip(fields.text()).ok_or_else(misfit)?;
                self.schemas.insert(id, name.to_owned());
            }
            op::CHANNEL => {
                if self.channels.len() >= MAX_CHANNELS {
                    return Err(self.damaged("it has more than 10,000 topics"));
                }
                let (id, schema) = fields.u16().zip(fields.u16()).ok_or_else(misfit)?;
                let (topic, encoding) = fields.text().zip(fields.text()).ok_or_else(misfit)?;
                let known = self.schemas.get(&schema).filter(|_| encoding == "cdr");
                self.channels.insert(id, known.map(|message| (topic.to_owned(), message.clone())));
            }
            op::MESSAGE => {
                let head = (fields.u16(), fields.array::<4>(), fields.u64(), fields.u64());
                let (Some(channel), Some(_sequence), Some(log_ns), Some(_published_ns)) = head else {
                    return Err(misfit());
                };
                self.messages += 1;
                let Some(channel) = self.channels.get(&channel) else {
                    return Err(self.damaged("a message belongs to no topic"));
                };
                let Some((topic, message)) = channel else { return Ok(None) };
                if wants(topic, message) {
                    let log_ns = i64::try_from(log_ns).unwrap_or(i64::MAX);
                    let (topic, message) = (topic.clone(), message.clone());
                    return Ok(Some(RawMessage { topic, message, log_ns, data: fields.0.to_vec() }));
                }
            }
            _ => {}
        }
        Ok(None)
    }
}

/// Fields of a record, in order. Lengths are compared with the bytes that are there before anything is copied.
struct Fields<'b>(&'b [u8]);

impl<'b> Fields<'b> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*head)
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Option<&'b str> {
        let len = usize::try_from(u32::from_le_bytes(self.array()?)).ok()?;
        let (text, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        std::str::from_utf8(text).ok()
    }
}

/// Reads a bag.
pub struct BagReader {
    files: VecDeque<PathBuf>,
    open: Option<Open<File>>,
}

/// The MCAP files of a bag: the file itself, or those of a folder in the order of their numbers.
fn files(path: &Path) -> Result<VecDeque<PathBuf>, BagError> {
    let read = |cause| BagError::Read { path: path.to_owned(), cause };
    if !path.is_dir() {
        fs::metadata(path).map_err(read)?;
        return Ok(VecDeque::from([path.to_owned()]));
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
    Ok(found.into())
}

impl BagReader {
    /// Opens a bag: its folder, or one MCAP file.
    ///
    /// # Errors
    /// There is none.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        Ok(Self { files: files(path)?, open: None })
    }

    /// The next message for whose topic and type `wants` is true; `None` at the end.
    ///
    /// # Errors
    /// A file cannot be read, ends early or is damaged.
    pub fn next(&mut self, mut wants: impl FnMut(&str, &str) -> bool) -> Result<Option<RawMessage>, BagError> {
        loop {
            if self.open.is_none() {
                let Some(path) = self.files.pop_front() else { return Ok(None) };
                let file = File::open(&path).map_err(|cause| BagError::Read { path: path.clone(), cause })?;
                self.open = Some(Open::new(path, file));
            }
            let Some(open) = &mut self.open else { return Ok(None) };
            match open.next(&mut wants) {
                Ok(Some(message)) => return Ok(Some(message)),
                Ok(None) => self.open = None,
                Err(error) => {
                    self.open = None;
                    return Err(error);
                }
            }
        }
    }

    /// The messages of an MCAP file that is in memory.
    ///
    /// # Errors
    /// It is damaged.
    pub fn read_bytes(bytes: &[u8], mut take: impl FnMut(RawMessage)) -> Result<(), BagError> {
        let mut open = Open::new(PathBuf::from("bytes"), bytes);
        while let Some(message) = open.next(&mut |_, _| true)? {
            take(message);
        }
        Ok(())
    }
}

/// The topics among the first messages of a bag. A bag that ends early has those before its end.
///
/// # Errors
/// There is no bag, or it is damaged before its first message.
pub fn survey(path: &Path) -> Result<Vec<BagTopic>, BagError> {
    let mut reader = BagReader::open(path)?;
    let (mut found, mut looked) = (BTreeMap::new(), 0);
    let end = reader.next(|topic, message| {
        if !found.contains_key(topic) {
            found.insert(topic.to_owned(), message.to_owned());
        }
        looked += 1;
        // The one that is wanted is the last that is read.
        looked >= SURVEYED
    });
    if let Err(error) = end
        && found.is_empty()
    {
        return Err(error);
    }
    Ok(found.into_iter().map(|(topic, message)| BagTopic { topic, message }).collect())
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
