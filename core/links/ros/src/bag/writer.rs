//! Writes a bag.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use panoscope_base::files;
use serde::Serialize;

use super::error::BagError;
use crate::cdr::{self, Message};
use crate::definitions;

/// Quality of service: reliable, volatile, keep the last 10, in the format of rosbag2 version 5.
const QOS: &str = "- history: 1\n  depth: 10\n  reliability: 1\n  durability: 2\n  deadline:\n    sec: 9223372036\n    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: 1\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  avoid_ros_namespace_conventions: false";

struct Topic {
    channel: u16,
    message: &'static str,
    count: u64,
}

/// A bag that is being written. It is complete when [`Self::finish`] has returned.
pub struct BagWriter {
    folder: PathBuf,
    file: String,
    writer: Writer<BufWriter<File>>,
    topics: BTreeMap<String, Topic>,
    first_ns: u64,
    last_ns: u64,
    count: u64,
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

impl BagWriter {
    /// Makes the folder and begins its one MCAP file. With `replaces`, the bag's files are replaced if the folder
    /// exists.
    ///
    /// # Errors
    /// The folder exists, or cannot be made.
    pub fn create(folder: &Path, replaces: bool) -> Result<Self, BagError> {
        let failed = |path: &Path, cause| BagError::Write { path: path.to_owned(), cause };
        let is_taken = match fs::read_dir(folder) {
            Ok(mut entries) => entries.next().is_some(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => false,
            Err(cause) => return Err(failed(folder, cause)),
        };
        if is_taken && !replaces {
            return Err(BagError::Exists { path: folder.to_owned() });
        }
        fs::create_dir_all(folder).map_err(|cause| failed(folder, cause))?;
        let stem = folder.file_name().map_or("bag".into(), |name| name.to_string_lossy());
        // The name stands in YAML between quotes.
        let stem: String =
            stem.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
        let file = format!("{stem}_0.mcap");
        let path = folder.join(&file);
        let out = File::create(&path).map_err(|cause| failed(&path, cause))?;
        let options = WriteOptions::new()
            .compression(None)
            .profile("ros2")
            .library(concat!("panoscope ", env!("CARGO_PKG_VERSION")));
        let writer =
            options.create(BufWriter::with_capacity(1 << 20, out)).map_err(|error| failed(&path, io_error(error)))?;
        let folder = folder.to_owned();
        Ok(Self { folder, file, writer, topics: BTreeMap::new(), first_ns: u64::MAX, last_ns: 0, count: 0 })
    }

    fn failed(&self, error: McapError) -> BagError {
        BagError::Write { path: self.folder.join(&self.file), cause: io_error(error) }
    }

    /// Appends a message, logged at the time of its data. Times before 1970 are clamped.
    ///
    /// # Errors
    /// It cannot be encoded or written.
    pub fn write<M: Message + Serialize>(&mut self, topic: &str, time_ns: i64, message: &M) -> Result<(), BagError> {
        let data = cdr::encode(message)?;
        if !self.topics.contains_key(topic) {
            let text = definitions::of(M::TYPE).ok_or(BagError::NoDefinition { message: M::TYPE })?;
            let schema = self.writer.add_schema(M::TYPE, "ros2msg", text.as_bytes()).map_err(|e| self.failed(e))?;
            let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), QOS.to_owned())]);
            let channel = self.writer.add_channel(schema, topic, "cdr", &metadata).map_err(|e| self.failed(e))?;
            self.topics.insert(topic.to_owned(), Topic { channel, message: M::TYPE, count: 0 });
        }
        let Some(known) = self.topics.get_mut(topic) else { return Ok(()) };
        let log_time = u64::try_from(time_ns).unwrap_or(0);
        let sequence = u32::try_from(known.count).unwrap_or(u32::MAX);
        let header = MessageHeader { channel_id: known.channel, sequence, log_time, publish_time: log_time };
        known.count += 1;
        self.writer.write_to_known_channel(&header, &data).map_err(|error| self.failed(error))?;
        self.count += 1;
        self.first_ns = self.first_ns.min(log_time);
        self.last_ns = self.last_ns.max(log_time);
        Ok(())
    }

    /// Completes the file and writes `metadata.yaml`.
    ///
    /// # Errors
    /// Something cannot be written.
    pub fn finish(mut self) -> Result<(), BagError> {
        self.writer.finish().map_err(|error| self.failed(error))?;
        let text = self.metadata();
        let path = self.folder.join(&self.file);
        let failed = |path: &Path, cause| BagError::Write { path: path.to_owned(), cause };
        let file = self.writer.into_inner().into_inner().map_err(|error| failed(&path, error.into_error()))?;
        file.sync_all().map_err(|cause| failed(&path, cause))?;
        let path = self.folder.join("metadata.yaml");
        files::replace(&path, text.as_bytes()).map_err(|cause| failed(&path, cause))
    }

    /// Text of `metadata.yaml`, version 5, which every distribution since Humble reads.
    fn metadata(&self) -> String {
        let first = if self.count == 0 { 0 } else { self.first_ns };
        let duration = self.last_ns.saturating_sub(first);
        let (count, file) = (self.count, &self.file);
        let mut out = format!(
            "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration:\n    nanoseconds: {duration}\n  \
             starting_time:\n    nanoseconds_since_epoch: {first}\n  message_count: {count}\n  topics_with_message_count:\n"
        );
        if self.topics.is_empty() {
            out = out.replace("topics_with_message_count:\n", "topics_with_message_count: []\n");
        }
        for (name, Topic { message, count, .. }) in &self.topics {
            let qos = QOS.replace('\n', "\\n");
            let _ = write!(
                out,
                "    - topic_metadata:\n        name: {name}\n        type: {message}\n        serialization_format: cdr\n        \
                 offered_qos_profiles: \"{qos}\"\n      message_count: {count}\n"
            );
        }
        let _ = write!(
            out,
            "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - \"{file}\"\n  files:\n    - path: \"{file}\"\n      \
             starting_time:\n        nanoseconds_since_epoch: {first}\n      duration:\n        nanoseconds: {duration}\n      \
             message_count: {count}\n"
        );
        out
    }
}
