//! A packet as messages of Foxglove.

use std::io;

use foxglove::Encode;
use foxglove::messages::{PoseInFrame, Timestamp};
use panoscope_abi::Tick;
use panoscope_base::packet;
use panoscope_data::formats::fields::{self, Fields, JsonFields};
use panoscope_data::formats::{Pixels, json};

use super::schemas::Schema;
use super::{frames, messages};
use crate::selection::Form;
use crate::value::{Picture, Value};

/// Origin of a packet.
#[derive(Clone, Copy, Debug)]
pub struct Origin<'o> {
    /// `node.output`.
    pub port: &'o str,
    /// Name of the packet's type.
    pub packet: &'o str,
    /// The tick.
    pub tick: &'o Tick,
}

/// A message of a packet.
pub struct Message<'m> {
    /// Where it is published.
    pub topic: &'m str,
    /// Name of its schema.
    pub form: Form,
    /// The schema.
    pub schema: &'m dyn Fn() -> Schema,
    /// `protobuf` or `json`.
    pub encoding: &'static str,
    /// The packet's tick.
    pub tick: &'m Tick,
    /// The encoded message.
    pub data: &'m [u8],
}

impl Message<'_> {
    /// Time of capture since 1970, or since the origin of capture times; 0 for earlier ones.
    pub fn nanoseconds(&self) -> u64 {
        nanoseconds(self.tick)
    }
}

/// Encoding of 8-bit images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pictures {
    /// As PNG, for files.
    Png,
    /// Without compression, and as JPEG on a separate topic, for live connections, where encoding must be fast.
    RawAndJpeg,
}

/// Receives messages.
pub trait Messages {
    /// Receives a message.
    ///
    /// # Errors It cannot be written.
    fn put(&mut self, message: &Message<'_>) -> io::Result<()>;

    /// Whether messages of this topic are wanted; others are not made.
    fn wants(&self, topic: &str) -> bool {
        let _ = topic;
        true
    }

    /// Encoding of 8-bit images.
    fn pictures(&self) -> Pictures {
        Pictures::Png
    }
}

/// `/node/port`: a dot would end the topic in a Foxglove message path.
pub fn topic(port: &str) -> String {
    format!("/{}", port.replace('.', "/"))
}

fn nanoseconds(tick: &Tick) -> u64 {
    u64::try_from(tick.capture_ns).unwrap_or(0)
}

fn timestamp(tick: &Tick) -> Timestamp {
    let ns = nanoseconds(tick);
    Timestamp::new(u32::try_from(ns / 1_000_000_000).unwrap_or(u32::MAX), (ns % 1_000_000_000) as u32)
}

/// Passes the messages of a packet to `out`. Returns the name of the main schema.
///
/// # Errors
/// Those of `out` and of the encoders.
pub fn encode<M: Messages>(origin: &Origin<'_>, value: Value<'_>, out: &mut M) -> io::Result<Form> {
    Encoder { tick: origin.tick, out }.take(origin, value)
}

struct Encoder<'e, M> {
    tick: &'e Tick,
    out: &'e mut M,
}

impl<M: Messages> Encoder<'_, M> {
    /// Writes a Foxglove message; `form` is the name of its schema.
    fn message<E: Encode>(
        &mut self,
        topic: &str,
        form: Form,
        make: impl FnOnce() -> io::Result<E>,
    ) -> io::Result<Form> {
        if !self.out.wants(topic) {
            return Ok(form);
        }
        let message = make()?;
        let mut data = Vec::with_capacity(message.encoded_len().unwrap_or(0));
        message.encode(&mut data).map_err(|error| io::Error::other(error.to_string()))?;
        let schema = || Schema::of(form, &[]);
        let message = Message { topic, form, schema: &schema, encoding: "protobuf", tick: self.tick, data: &data };
        self.out.put(&message)?;
        Ok(form)
    }

    fn picture(&mut self, topic: &str, picture: &Picture, frame: &str) -> io::Result<Form> {
        let (pixels, time) = (picture.pixels(), timestamp(self.tick));
        let is_deep = matches!(pixels, Pixels::F32(_) | Pixels::Gray16(_));
        match self.out.pictures() {
            Pictures::Png if !is_deep => {
                self.message(topic, "foxglove.CompressedImage", || messages::compressed(&pixels, "png", time, frame))
            }
            Pictures::RawAndJpeg if !is_deep => {
                let below = format!("{topic}/jpeg");
                self.message(&below, "foxglove.CompressedImage", || messages::compressed(&pixels, "jpg", time, frame))?;
                self.message(topic, "foxglove.RawImage", || messages::raw(&pixels, time, frame))
            }
            _ => self.message(topic, "foxglove.RawImage", || messages::raw(&pixels, time, frame)),
        }
    }

    /// Writes a JSON object whose fields `write` appends.
    fn json(
        &mut self,
        topic: &str,
        form: Form,
        columns: impl Fn() -> Vec<String>,
        write: impl FnOnce(&mut String),
    ) -> io::Result<Form> {
        if !self.out.wants(topic) {
            return Ok(form);
        }
        let mut text = format!("{{\"tick\":{},\"capture_ns\":{}", self.tick.seq, self.tick.capture_ns);
        write(&mut text);
        text.push('}');
        let schema = || Schema::of(form, &columns());
        let data = text.as_bytes();
        self.out.put(&Message { topic, form, schema: &schema, encoding: "json", tick: self.tick, data })?;
        Ok(form)
    }

    fn take(&mut self, origin: &Origin<'_>, value: Value<'_>) -> io::Result<Form> {
        let (topic, time) = (&topic(origin.port), timestamp(self.tick));
        let below = |name: &str| format!("{topic}/{name}");
        match value {
            Value::Picture(mut picture) => {
                if origin.packet == "depth" {
                    picture.scale(frames::MM as f32);
                }
                self.picture(topic, &picture, frames::of_picture(origin.port, origin.packet))
            }
            Value::Cloud(points, _) => {
                self.message(topic, "foxglove.PointCloud", || Ok(messages::cloud(&points, time)))
            }
            Value::Calibration(calibration) => {
                self.message(&below("frames"), "foxglove.FrameTransforms", || {
                    Ok(frames::of_calibration(&calibration, time))
                })?;
                let [left, right] = messages::cameras(&calibration, time);
                self.message(&below("left"), "foxglove.CameraCalibration", || Ok(left))?;
                self.message(&below("right"), "foxglove.CameraCalibration", || Ok(right))
            }
            Value::Detections(detections) => {
                if self.out.wants(&below("masks"))
                    && let Some(masks) = Picture::of_masks(&detections)
                {
                    self.picture(&below("masks"), &masks, frames::of_picture(origin.port, "mask"))?;
                }
                self.message(topic, "foxglove.ImageAnnotations", || Ok(messages::boxes(&detections, time)))
            }
            Value::Roi(roi) => self.message(topic, "foxglove.ImageAnnotations", || Ok(messages::roi(&roi, time))),
            Value::Tip(tip) => {
                if let Some(point) = messages::tip_point(&tip, time) {
                    self.message(&below("position"), "foxglove.Point3InFrame", || Ok(point))?;
                }
                self.message(topic, "foxglove.ImageAnnotations", || Ok(messages::tip_mark(&tip, time)))
            }
            Value::Pose(pose) => {
                if let Some(transform) = frames::transform(&pose, time) {
                    self.message(&below("frame"), "foxglove.FrameTransform", || Ok(transform))?;
                }
                let frame_id = packet::name(&pose.a);
                let message = PoseInFrame { timestamp: Some(time), frame_id, pose: Some(frames::pose(&pose)) };
                self.message(topic, "foxglove.PoseInFrame", || Ok(message))
            }
            Value::Joints(joints) => {
                self.message(topic, "foxglove.JointStates", || Ok(messages::joints(&joints, time)))
            }
            Value::Homography(value) => {
                let write = |out: &mut String| fields::homography(&value, &mut JsonFields(out));
                self.json(topic, "panoscope.Homography", Vec::new, write)
            }
            Value::Scalar(value) => {
                let write = |out: &mut String| fields::scalar(&value, &mut JsonFields(out));
                self.json(topic, "panoscope.Scalar", Vec::new, write)
            }
            Value::Text(text) => self.json(topic, "panoscope.Text", Vec::new, |out| JsonFields(out).text("text", text)),
            Value::Table(table) => {
                let columns = || table.names().map(str::to_owned).collect();
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
                self.json(topic, "panoscope.Table", columns, write)
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
