//! Messages and the content of each type.

mod image;
mod poly_data;
mod query;
mod small;

use std::borrow::Cow;

use crate::crc::crc64;
use crate::error::{IgtlError, Result};
use crate::header::{HEADER_BYTES, Header};
use crate::metadata::{self, Entry};
use crate::time::Timestamp;

pub use image::{Coordinates, Endian, IMAGE_BYTES, Image, Scalar};
pub use poly_data::{Attribute, Cells, PolyData};
pub use query::{Query, Verb, query_name};
pub use small::{
    Capability, Orientation, Point, Position, Status, StatusCode, Text, Tool, ToolKind, Tracking, TrackingStart,
    Transform,
};

/// Names of the message types that this crate reads and writes, as CAPABILITY lists them.
pub const KINDS: [&str; 9] =
    ["IMAGE", "TRANSFORM", "POSITION", "POINT", "POLYDATA", "TDATA", "STATUS", "STRING", "CAPABILITY"];

/// Content of a message.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Content<'a> {
    /// IMAGE: pixels with their position in space.
    Image(Image<'a>),
    /// TRANSFORM: a linear transform.
    Transform(Transform),
    /// POSITION: a position with or without orientation.
    Position(Position),
    /// POINT: named points.
    Points(Vec<Point<'a>>),
    /// POLYDATA: points, cells and attributes.
    PolyData(PolyData<'a>),
    /// TDATA: tracked tools.
    Tracking(Tracking<'a>),
    /// STATUS: state of the sender.
    Status(Status<'a>),
    /// STRING: a text.
    Text(Text<'a>),
    /// CAPABILITY: message types that the sender reads.
    Capability(Capability<'a>),
    /// A request (`GET_`, `STT_`, `STP_`) or its answer (`RTS_`).
    Query(Query<'a>),
    /// A message without content, such as the answer to a request for missing data.
    Nothing,
    /// A type that this crate does not know; receivers skip it.
    Other(&'a [u8]),
}

impl Content<'_> {
    /// Name of the message type; `None` for types without a fixed one: requests, unknown and empty messages.
    pub fn kind(&self) -> Option<&'static str> {
        match self {
            Self::Image(_) => Some("IMAGE"),
            Self::Transform(_) => Some("TRANSFORM"),
            Self::Position(_) => Some("POSITION"),
            Self::Points(_) => Some("POINT"),
            Self::PolyData(_) => Some("POLYDATA"),
            Self::Tracking(_) => Some("TDATA"),
            Self::Status(_) => Some("STATUS"),
            Self::Text(_) => Some("STRING"),
            Self::Capability(_) => Some("CAPABILITY"),
            Self::Query(_) | Self::Nothing | Self::Other(_) => None,
        }
    }
}

/// One message.
#[derive(Clone, Debug, PartialEq)]
pub struct Message<'a> {
    /// Header version: 1, 2 or 3.
    pub version: u16,
    /// Message type, such as `TRANSFORM` or `GET_CAPABIL`.
    pub kind: Cow<'a, str>,
    /// Device name, at most 20 bytes.
    pub device: Cow<'a, str>,
    /// When the data was taken.
    pub time: Timestamp,
    /// Number of the message; not in version 1.
    pub message_id: u32,
    /// Keys and values; not in version 1.
    pub metadata: Vec<Entry<'a>>,
    /// The content.
    pub content: Content<'a>,
}

impl<'a> Message<'a> {
    /// A message of header version 1 with the type of its content. Contents without a fixed type need [`Self::kind`]
    /// set.
    pub fn new(device: impl Into<Cow<'a, str>>, time: Timestamp, content: Content<'a>) -> Self {
        let kind = match &content {
            Content::Query(query) => Cow::Owned(query.name()),
            other => Cow::Borrowed(other.kind().unwrap_or("")),
        };
        let (message_id, metadata) = (0, Vec::new());
        Self { version: 1, kind, device: device.into(), time, message_id, metadata, content }
    }

    /// Reads a message that fills `bytes`. Does not compare the CRC; [`crate::Reader`] does.
    ///
    /// # Errors
    /// The header is invalid, the body's length differs from the header, or does not fit its type.
    pub fn decode(bytes: &'a [u8]) -> Result<Self> {
        let header = Header::decode(bytes)?;
        let body = bytes.get(HEADER_BYTES..).unwrap_or_default();
        if body.len() as u64 != header.body_bytes {
            let expected = format!("the {} that the header announces", header.body_bytes);
            return Err(IgtlError::Length { kind: "whole", bytes: body.len(), expected });
        }
        Self::from_parts(header, body)
    }

    /// Reads the body of a header.
    ///
    /// # Errors
    /// The body does not fit its type.
    pub fn from_parts(header: Header<'a>, body: &'a [u8]) -> Result<Self> {
        let parts = match header.version {
            // Queries of version 2 without data may come without an extended header.
            1 => metadata::Parts { message_id: 0, content: body, metadata: Vec::new() },
            _ if body.is_empty() => metadata::Parts { message_id: 0, content: body, metadata: Vec::new() },
            _ => metadata::split(body)?,
        };
        let content = content(&header.kind, parts.content)?;
        let metadata::Parts { message_id, metadata, .. } = parts;
        let Header { version, kind, device, time, .. } = header;
        Ok(Self { version, kind, device, time, message_id, metadata, content })
    }

    /// Appends header and body.
    ///
    /// # Errors
    /// A name that is too long, or more entries than a count field can hold; `out` is then unchanged.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        let start = out.len();
        let result = self.append(out, start);
        if result.is_err() {
            out.truncate(start);
        }
        result
    }

    fn append(&self, out: &mut Vec<u8>, start: usize) -> Result<()> {
        if !(1..=3).contains(&self.version) {
            return Err(IgtlError::Version { version: self.version });
        }
        let (kind, device) = (Cow::Borrowed(&*self.kind), Cow::Borrowed(&*self.device));
        if kind.is_empty() || !kind.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err(IgtlError::TypeName);
        }
        Header { version: self.version, kind, device, time: self.time, body_bytes: 0, crc: 0 }.encode(out)?;
        if self.version > 1 {
            metadata::put_extended(out, self.message_id, &self.metadata)?;
        }
        match &self.content {
            Content::Image(image) => image.encode(out)?,
            Content::Transform(transform) => transform.encode(out),
            Content::Position(position) => position.encode(out),
            Content::Points(points) => points.iter().try_for_each(|point| point.encode(out))?,
            Content::PolyData(data) => data.encode(out)?,
            Content::Tracking(tracking) => tracking.encode(out)?,
            Content::Status(status) => status.encode(out)?,
            Content::Text(text) => text.encode(out)?,
            Content::Capability(capability) => capability.encode(out)?,
            Content::Query(query) => query.encode(out)?,
            Content::Nothing => {}
            Content::Other(bytes) => out.extend_from_slice(bytes),
        }
        if self.version > 1 {
            metadata::put_entries(out, &self.metadata)?;
        }
        let body = start + HEADER_BYTES;
        let (bytes, crc) = ((out.len() - body) as u64, crc64(&out[body..]));
        out[body - 16..body - 8].copy_from_slice(&bytes.to_be_bytes());
        out[body - 8..body].copy_from_slice(&crc.to_be_bytes());
        Ok(())
    }
}

/// Reads the content of a message of type `kind`.
fn content<'a>(kind: &str, bytes: &'a [u8]) -> Result<Content<'a>> {
    if let Some(query) = Query::decode(kind, bytes)? {
        return Ok(Content::Query(query));
    }
    // Points, tools and types may be none; every other content has bytes.
    let is_list = matches!(kind, "POINT" | "TDATA" | "CAPABILITY");
    if bytes.is_empty() && !is_list && KINDS.contains(&kind) {
        return Ok(Content::Nothing);
    }
    Ok(match kind {
        "IMAGE" => Content::Image(Image::decode(bytes)?),
        "TRANSFORM" => Content::Transform(Transform::decode(bytes)?),
        "POSITION" => Content::Position(Position::decode(bytes)?),
        "POINT" => Content::Points(Point::decode_all(bytes)?),
        "POLYDATA" => Content::PolyData(PolyData::decode(bytes)?),
        "TDATA" => Content::Tracking(Tracking::decode(bytes)?),
        "STATUS" => Content::Status(Status::decode(bytes)?),
        "STRING" => Content::Text(Text::decode(bytes)?),
        "CAPABILITY" => Content::Capability(Capability::decode(bytes)?),
        _ => Content::Other(bytes),
    })
}
