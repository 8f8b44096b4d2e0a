//! Reads a bag, message by message, in the order of its files.
//!
//! Nothing of a bag is trusted: records have a largest length, chunks are unpacked piece by piece, and names are cut.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::error::BagError;

/// Longest record: a picture of 8K with four bytes a pixel is half of it.
const MAX_RECORD_BYTES: usize = 256 << 20;
/// Bytes that are read at once.
const MOST_AT_ONCE: usize = 1 << 20;
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

/// A file that is being read, from any stream.
struct Open<R> {
    path: PathBuf,
    input: R,
    reader: LinearReader,
    /// Names of types by schema.
    schemas: HashMap<u16, String>,
    /// Topic and type by channel; `None` for messages that are not in CDR.
    channels: HashMap<u16, Option<(String, String)>>,
    messages: u64,
}

impl<R: Read> Open<R> {
    fn new(path: PathBuf, input: R) -> Self {
        // The index at the end is not needed, and is not there in a file that its recorder did not finish.
        let options =
            LinearReaderOptions::default().with_validate_chunk_crcs(true).with_record_length_limit(MAX_RECORD_BYTES);
        let reader = LinearReader::new_with_options(options);
        Self { path, input, reader, schemas: HashMap::new(), channels: HashMap::new(), messages: 0 }
    }

    fn wrong(&self, error: McapError) -> BagError {
        let (path, messages) = (self.path.clone(), self.messages);
        match error {
            McapError::UnexpectedEof => BagError::CutOff { path, messages },
            McapError::Io(cause) if cause.kind() == io::ErrorKind::UnexpectedEof => BagError::CutOff { path, messages },
            McapError::Io(cause) => BagError::Read { path, cause },
            other => BagError::Damaged { path, messages, words: other.to_string() },
        }
    }

    fn damaged(&self, words: &str) -> BagError {
        BagError::Damaged { path: self.path.clone(), messages: self.messages, words: words.to_owned() }
    }

    /// The next message that is wanted; `None` at the end.
    fn next(&mut self, wants: &mut dyn FnMut(&str, &str) -> bool) -> Result<Option<RawMessage>, BagError> {
        loop {
            let record = match self.reader.next_event() {
                None => return Ok(None),
                Some(Err(error)) => return Err(self.wrong(error)),
                Some(Ok(LinearReadEvent::ReadRequest(need))) => {
                    let buffer = self.reader.insert(need.min(MOST_AT_ONCE));
                    match self.input.read(buffer) {
                        Ok(read) => self.reader.notify_read(read),
                        Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                        Err(cause) => return Err(BagError::Read { path: self.path.clone(), cause }),
                    }
                    continue;
                }
                Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                    if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
                        continue;
                    }
                    match mcap::parse_record(opcode, data) {
                        Ok(record) => record.into_owned(),
                        Err(error) => return Err(self.wrong(error)),
                    }
                }
            };
            match record {
                Record::Schema { header, .. } => {
                    if self.schemas.len() >= MAX_CHANNELS {
                        return Err(self.damaged("it has more than 10,000 types"));
                    }
                    self.schemas.insert(header.id, header.name);
                }
                Record::Channel(channel) => {
                    if self.channels.len() >= MAX_CHANNELS {
                        return Err(self.damaged("it has more than 10,000 topics"));
                    }
                    let message = self.schemas.get(&channel.schema_id).cloned();
                    let known = message.filter(|_| channel.message_encoding == "cdr");
                    self.channels.insert(channel.id, known.map(|message| (channel.topic, message)));
                }
                Record::Message { header, data } => {
                    self.messages += 1;
                    let Some(channel) = self.channels.get(&header.channel_id) else {
                        return Err(self.damaged("a message belongs to no topic"));
                    };
                    let Some((topic, message)) = channel else { continue };
                    if wants(topic, message) {
                        let log_ns = i64::try_from(header.log_time).unwrap_or(i64::MAX);
                        let (topic, message) = (topic.clone(), message.clone());
                        return Ok(Some(RawMessage { topic, message, log_ns, data: data.into_owned() }));
                    }
                }
                _ => {}
            }
        }
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
