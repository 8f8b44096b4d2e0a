//! A recording as an MCAP file with the schemas of Foxglove (<https://docs.foxglove.dev/docs/sdk/schemas>).
//!
//! | packets | topic | schema |
//! |---|---|---|
//! | `image`, `mask` | `/node/port` | `foxglove.CompressedImage` (PNG); `foxglove.RawImage` for 16 bits and floats |
//! | `disparity`, `confidence` | `/node/port` | `foxglove.RawImage`, 32FC1 |
//! | `depth` | `/node/port` | `foxglove.RawImage`, 32FC1, m |
//! | `cloud` | `/node/port` | `foxglove.PointCloud`, m, known points |
//! | `calibration` | `/node/port/left`, `/right`, `/frames` | `foxglove.CameraCalibration`, `foxglove.FrameTransforms` |
//! | `detections`, `roi` | `/node/port` | `foxglove.ImageAnnotations` |
//! | `instances` | `/node/port`, `/masks` | as `detections`, and the number of the box in each pixel as an image |
//! | `tip` | `/node/port`, `/position` | `foxglove.ImageAnnotations`, `foxglove.Point3InFrame` |
//! | `pose` | `/node/port`, `/frame` | `foxglove.PoseInFrame`, `foxglove.FrameTransform`, m |
//! | `joints` | `/node/port` | `foxglove.JointStates` |
//! | `homography`, `scalar`, `table`, `text` | `/node/port` | JSON with a JSON schema |
//!
//! The time of a message is the capture time of its tick; messages are in this order. Lengths in space are in m, as
//! Foxglove has them; numbers in JSON keep the unit in their names.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use panoscope_record::Packet;

use crate::error::ExportError;
use crate::selection::{Export, Form, PortReport, part_of};
use crate::value::Kind;

mod encode;
mod frames;
mod messages;
mod schemas;

pub use encode::{Message, Messages, Origin, Pictures, encode, topic};
pub use schemas::{Schema, Topic, topics};

/// Writes a file. It has its name only when it is complete. With `replaces`, one of that name is replaced.
///
/// # Errors
/// The file exists or is the recording, it cannot be written, or the recording is damaged.
pub fn write(export: &Export<'_>, path: &Path, replaces: bool) -> Result<Vec<PortReport>, ExportError> {
    if export.is_recording(path) {
        return Err(ExportError::IsRecording { path: path.to_owned() });
    }
    if path.exists() && !replaces {
        return Err(ExportError::Exists { path: path.to_owned() });
    }
    let part = part_of(path);
    let done = write_to(export, path, &part);
    if done.is_err() {
        let _ = fs::remove_file(&part);
    }
    done
}

fn write_to(export: &Export<'_>, path: &Path, part: &Path) -> Result<Vec<PortReport>, ExportError> {
    let failed = |cause: io::Error| ExportError::Write { path: path.to_owned(), cause };
    let file = File::create(part).map_err(failed)?;
    // Chunks have an index, by which viewers jump to a time.
    let options =
        WriteOptions::new().compression(None).profile("").library(concat!("panoscope ", env!("CARGO_PKG_VERSION")));
    let writer = options.create(BufWriter::with_capacity(1 << 20, file)).map_err(|error| failed(io_error(error)))?;
    let mut target = Target { path, writer, channels: HashMap::new() };
    let mut reports: Vec<Option<PortReport>> = vec![None; export.ports.len()];
    let mut order: Vec<(usize, Kind, &Packet)> = Vec::new();
    for (index, port) in export.ports.iter().enumerate() {
        match &port.kind {
            Ok(kind) => order.extend(port.packets.iter().map(|packet| (index, *kind, *packet))),
            Err(why) => reports[index] = Some(port.left_out(why.clone())),
        }
    }
    order.sort_by_key(|(index, _, packet)| (packet.head.tick.capture_ns, packet.head.tick.seq, *index));
    for (index, kind, packet) in order {
        let port = &export.ports[index];
        let topic = topic(port.name);
        let origin = Origin { port: port.name, packet: &port.packet, tick: &packet.head.tick };
        let form = export.value(port, kind, packet, |value| {
            encode(&origin, value, &mut target).map_err(|cause| ExportError::Write { path: path.to_owned(), cause })
        })?;
        reports[index].get_or_insert_with(|| port.written(form, topic));
    }
    target.finish()?;
    fs::rename(part, path).map_err(failed)?;
    Ok(reports.into_iter().flatten().collect())
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

/// The file that is being written.
struct Target<'p> {
    path: &'p Path,
    writer: Writer<BufWriter<File>>,
    /// Channels by topic and schema: a port of images may change its format.
    channels: HashMap<(String, Form), u16>,
}

impl Target<'_> {
    fn finish(mut self) -> Result<(), ExportError> {
        let path = self.path;
        let failed = |cause| ExportError::Write { path: path.to_owned(), cause };
        self.writer.finish().map_err(|error| failed(io_error(error)))?;
        let file = self.writer.into_inner().into_inner().map_err(|error| failed(error.into_error()))?;
        match file.sync_all() {
            // Pipes and devices cannot be synced.
            Err(error) if error.kind() != io::ErrorKind::InvalidInput => Err(failed(error)),
            _ => Ok(()),
        }
    }
}

impl Messages for Target<'_> {
    fn put(&mut self, message: &Message<'_>) -> io::Result<()> {
        let key = (message.topic.to_owned(), message.form);
        let channel_id = match self.channels.get(&key) {
            Some(channel) => *channel,
            None => {
                let schema = (message.schema)();
                let id = self.writer.add_schema(message.form, schema.encoding, &schema.data).map_err(io_error)?;
                let channel = self.writer.add_channel(id, message.topic, message.encoding, &BTreeMap::new());
                *self.channels.entry(key).or_insert(channel.map_err(io_error)?)
            }
        };
        let log_time = message.nanoseconds();
        let header = MessageHeader { channel_id, sequence: message.tick.seq as u32, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, message.data).map_err(io_error)
    }
}
