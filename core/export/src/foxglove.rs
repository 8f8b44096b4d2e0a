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
//! | `instances` | `/node/port`, `/masks` | as `detections`, and the number of the box in each pixel as a picture |
//! | `tip` | `/node/port`, `/position` | `foxglove.ImageAnnotations`, `foxglove.Point3InFrame` |
//! | `pose` | `/node/port`, `/frame` | `foxglove.PoseInFrame`, `foxglove.FrameTransform`, m |
//! | `joints` | `/node/port` | `foxglove.JointStates` |
//! | `homography`, `scalar`, `table`, `text` | `/node/port` | JSON with a JSON schema |
//!
//! The time of a message is the capture time of its tick; messages are in this order. Lengths in space are in m, as Foxglove has them; numbers in
//! JSON keep the unit in their names.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::Path;

use foxglove::Encode;
use foxglove::messages::{PoseInFrame, Timestamp};
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use panoscope_abi::Tick;
use panoscope_base::packet;
use panoscope_formats::fields::{self, Fields, JsonFields};
use panoscope_formats::{Pixels, json};
use panoscope_record::Packet;
use serde_json::{Value as Json, json};

use crate::error::ExportError;
use crate::frames;
use crate::messages;
use crate::selection::{Export, Form, Port, PortReport, part_of};
use crate::value::{Kind, Picture, Value};

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
        let form = export.value(port, kind, packet, |value| target.take(port, &topic, &packet.head.tick, value))?;
        reports[index].get_or_insert_with(|| port.written(form, topic));
    }
    target.finish()?;
    fs::rename(part, path).map_err(failed)?;
    Ok(reports.into_iter().flatten().collect())
}

/// `/node/port`: a point would end the topic in a message path of Foxglove.
fn topic(port: &str) -> String {
    format!("/{}", port.replace('.', "/"))
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

/// Time since 1970, or since whatever moment capture times are counted from; 0 for earlier ones.
fn timestamp(tick: &Tick) -> Timestamp {
    let ns = nanoseconds(tick);
    Timestamp::new(u32::try_from(ns / 1_000_000_000).unwrap_or(u32::MAX), (ns % 1_000_000_000) as u32)
}

fn nanoseconds(tick: &Tick) -> u64 {
    u64::try_from(tick.capture_ns).unwrap_or(0)
}

/// The file that is being written.
struct Target<'p> {
    path: &'p Path,
    writer: Writer<BufWriter<File>>,
    /// Channels by topic and schema: a port of images may change its format.
    channels: HashMap<(String, Form), u16>,
}

impl Target<'_> {
    fn failed(&self, error: McapError) -> ExportError {
        self.broken(io_error(error))
    }

    fn broken(&self, cause: io::Error) -> ExportError {
        ExportError::Write { path: self.path.to_owned(), cause }
    }

    fn finish(mut self) -> Result<(), ExportError> {
        self.writer.finish().map_err(|error| self.failed(error))?;
        let path = self.path;
        let failed = |cause| ExportError::Write { path: path.to_owned(), cause };
        let file = self.writer.into_inner().into_inner().map_err(|error| failed(error.into_error()))?;
        match file.sync_all() {
            // Pipes and devices cannot be synced.
            Err(error) if error.kind() != io::ErrorKind::InvalidInput => Err(failed(error)),
            _ => Ok(()),
        }
    }

    fn write(
        &mut self,
        topic: &str,
        form: Form,
        schema: impl FnOnce() -> (String, Vec<u8>),
        encoding: &str,
        tick: &Tick,
        data: &[u8],
    ) -> Result<(), ExportError> {
        let known = self.channels.get(&(topic.to_owned(), form)).copied();
        let channel_id = match known {
            Some(channel) => channel,
            None => {
                let (schema_encoding, text) = schema();
                let id = self.writer.add_schema(form, &schema_encoding, &text).map_err(|error| self.failed(error))?;
                let channel = self.writer.add_channel(id, topic, encoding, &BTreeMap::new());
                let channel = channel.map_err(|error| self.failed(error))?;
                self.channels.insert((topic.to_owned(), form), channel);
                channel
            }
        };
        let log_time = nanoseconds(tick);
        let header = MessageHeader { channel_id, sequence: tick.seq as u32, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, data).map_err(|error| self.failed(error))
    }

    /// Writes a message of Foxglove; `form` is the name of its schema.
    fn message<M: Encode>(&mut self, topic: &str, form: Form, tick: &Tick, message: &M) -> Result<Form, ExportError> {
        let mut data = Vec::with_capacity(message.encoded_len().unwrap_or(0));
        message.encode(&mut data).map_err(|error| self.broken(io::Error::other(error.to_string())))?;
        let schema = || {
            let schema = M::get_schema();
            debug_assert!(schema.as_ref().is_some_and(|schema| schema.name == form), "{form}");
            schema.map(|schema| (schema.encoding, schema.data.into_owned())).unwrap_or_default()
        };
        self.write(topic, form, schema, &M::get_message_encoding(), tick, &data)?;
        Ok(form)
    }

    fn picture(&mut self, topic: &str, tick: &Tick, picture: &Picture, frame: &str) -> Result<Form, ExportError> {
        let pixels = picture.pixels();
        if let Pixels::F32(_) | Pixels::Gray16(_) = pixels {
            let message = messages::raw(&pixels, timestamp(tick), frame).map_err(|error| self.broken(error))?;
            return self.message(topic, "foxglove.RawImage", tick, &message);
        }
        let message = messages::png(&pixels, timestamp(tick), frame).map_err(|error| self.broken(error))?;
        self.message(topic, "foxglove.CompressedImage", tick, &message)
    }

    /// Writes an object whose fields `write` appends, and which `properties` describe.
    fn json(
        &mut self,
        topic: &str,
        form: Form,
        tick: &Tick,
        properties: impl FnOnce() -> Json,
        write: impl FnOnce(&mut String),
    ) -> Result<Form, ExportError> {
        let mut text = format!("{{\"tick\":{},\"capture_ns\":{}", tick.seq, tick.capture_ns);
        write(&mut text);
        text.push('}');
        let schema = || {
            let mut properties = properties();
            properties["tick"] = json!({ "type": "integer" });
            properties["capture_ns"] = json!({ "type": "integer" });
            let schema = json!({ "title": form, "type": "object", "properties": properties });
            ("jsonschema".to_owned(), schema.to_string().into_bytes())
        };
        self.write(topic, form, schema, "json", tick, text.as_bytes())?;
        Ok(form)
    }

    /// Writes the value of a packet. Returns the name of the schema.
    fn take(&mut self, port: &Port<'_>, topic: &str, tick: &Tick, value: Value<'_>) -> Result<Form, ExportError> {
        let time = timestamp(tick);
        let below = |name: &str| format!("{topic}/{name}");
        let number = || json!({ "type": ["number", "null"] });
        match value {
            Value::Picture(mut picture) => {
                if port.packet == "depth" {
                    picture.scale(frames::MM as f32);
                }
                self.picture(topic, tick, &picture, frames::of_picture(port.name, &port.packet))
            }
            Value::Cloud(points, _) => {
                self.message(topic, "foxglove.PointCloud", tick, &messages::cloud(&points, time))
            }
            Value::Calibration(calibration) => {
                self.message(
                    &below("frames"),
                    "foxglove.FrameTransforms",
                    tick,
                    &frames::of_calibration(&calibration, time),
                )?;
                let [left, right] = messages::cameras(&calibration, time);
                self.message(&below("left"), "foxglove.CameraCalibration", tick, &left)?;
                self.message(&below("right"), "foxglove.CameraCalibration", tick, &right)
            }
            Value::Detections(detections) => {
                if let Some(masks) = Picture::of_masks(&detections) {
                    self.picture(&below("masks"), tick, &masks, frames::of_picture(port.name, "mask"))?;
                }
                self.message(topic, "foxglove.ImageAnnotations", tick, &messages::boxes(&detections, time))
            }
            Value::Roi(roi) => self.message(topic, "foxglove.ImageAnnotations", tick, &messages::roi(&roi, time)),
            Value::Tip(tip) => {
                if let Some(point) = messages::tip_point(&tip, time) {
                    self.message(&below("position"), "foxglove.Point3InFrame", tick, &point)?;
                }
                self.message(topic, "foxglove.ImageAnnotations", tick, &messages::tip_mark(&tip, time))
            }
            Value::Pose(pose) => {
                if let Some(transform) = frames::transform(&pose, time) {
                    self.message(&below("frame"), "foxglove.FrameTransform", tick, &transform)?;
                }
                let frame_id = packet::name(&pose.a);
                let message = PoseInFrame { timestamp: Some(time), frame_id, pose: Some(frames::pose(&pose)) };
                self.message(topic, "foxglove.PoseInFrame", tick, &message)
            }
            Value::Joints(joints) => {
                self.message(topic, "foxglove.JointStates", tick, &messages::joints(&joints, time))
            }
            Value::Homography(value) => {
                let properties = || {
                    json!({
                        "left_from_right": { "type": "array", "items": number() },
                        "rms_px": number(), "inliers": number(), "state": { "type": "string" },
                    })
                };
                let write = |out: &mut String| fields::homography(&value, &mut JsonFields(out));
                self.json(topic, "panoscope.Homography", tick, properties, write)
            }
            Value::Scalar(value) => {
                let text = || json!({ "type": "string" });
                let properties = || json!({ "name": text(), "value": number(), "unit": text() });
                let write = |out: &mut String| fields::scalar(&value, &mut JsonFields(out));
                self.json(topic, "panoscope.Scalar", tick, properties, write)
            }
            Value::Text(text) => {
                let properties = || json!({ "text": { "type": "string" } });
                self.json(topic, "panoscope.Text", tick, properties, |out| JsonFields(out).text("text", text))
            }
            Value::Table(table) => {
                let properties = || {
                    let columns: serde_json::Map<String, Json> =
                        table.names().map(|name| (name.to_owned(), number())).collect();
                    json!({ "rows": { "type": "array", "items": { "type": "object", "properties": columns } } })
                };
                let write = |out: &mut String| {
                    json::key(out, "rows");
                    out.push('[');
                    for row in 0..table.rows() {
                        out.push_str(if row == 0 { "{" } else { ",{" });
                        for (column, name) in table.names().enumerate() {
                            JsonFields(out).number(name, table.value(row, column).unwrap_or(f64::NAN));
                        }
                        out.push('}');
                    }
                    out.push(']');
                };
                self.json(topic, "panoscope.Table", tick, properties, write)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_have_no_points() {
        assert_eq!(topic("stereo/match.disparity"), "/stereo/match/disparity");
    }

    #[test]
    fn times_before_the_first_moment_are_that_moment() {
        let tick = |capture_ns| Tick { source: 0, flags: 0, seq: 0, capture_ns };
        assert_eq!(timestamp(&tick(-1)), Timestamp::new(0, 0));
        assert_eq!(timestamp(&tick(2_000_000_003)), Timestamp::new(2, 3));
    }
}
