//! Types with a few fields: TRANSFORM, POSITION, POINT, TDATA, STATUS, STRING, CAPABILITY.

use std::borrow::Cow;

use crate::error::{IgtlError, Result};
use crate::fields::{Fields, padded, put_floats, put_text};
use crate::header::TYPE_BYTES;
use crate::metadata::encoding;

/// TRANSFORM: a linear transform of 3-D space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    /// Columns of the 3 x 3 matrix: the images of the axes.
    pub columns: [[f32; 3]; 3],
    /// Translation, mm.
    pub translation_mm: [f32; 3],
}

impl Default for Transform {
    fn default() -> Self {
        Self { columns: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation_mm: [0.0; 3] }
    }
}

impl Transform {
    /// Length of the content.
    pub const BYTES: usize = 48;

    fn read(fields: &mut Fields<'_>) -> Result<Self> {
        let columns = [fields.floats("matrix")?, fields.floats("matrix")?, fields.floats("matrix")?];
        Ok(Self { columns, translation_mm: fields.floats("matrix")? })
    }

    pub(super) fn decode(bytes: &[u8]) -> Result<Self> {
        let mut fields = Fields::new("TRANSFORM", bytes);
        let transform = Self::read(&mut fields)?;
        fields.end(|| Self::BYTES.to_string())?;
        Ok(transform)
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) {
        self.columns.iter().for_each(|column| put_floats(out, column));
        put_floats(out, &self.translation_mm);
    }

    /// The rotation of a unit quaternion w, x, y, z, and a translation in mm.
    pub fn from_quaternion(wxyz: [f64; 4], translation_mm: [f64; 3]) -> Self {
        let [w, x, y, z] = wxyz;
        let columns = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
            [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
        ];
        Self {
            columns: columns.map(|column| column.map(|v| v as f32)),
            translation_mm: translation_mm.map(|v| v as f32),
        }
    }

    /// The unit quaternion w, x, y, z of the rotation, w not negative; `None` unless the matrix is a rotation to within
    /// 1e-3.
    pub fn quaternion(&self) -> Option<[f64; 4]> {
        const TOLERANCE: f64 = 1e-3;
        let c = self.columns.map(|column| column.map(f64::from));
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        for i in 0..3 {
            for j in 0..=i {
                let expected = if i == j { 1.0 } else { 0.0 };
                let error = (dot(c[i], c[j]) - expected).abs();
                if error.is_nan() || error > TOLERANCE {
                    return None;
                }
            }
        }
        let cross = [
            c[0][1] * c[1][2] - c[0][2] * c[1][1],
            c[0][2] * c[1][0] - c[0][0] * c[1][2],
            c[0][0] * c[1][1] - c[0][1] * c[1][0],
        ];
        if dot(cross, c[2]) < 0.0 {
            return None;
        }
        let trace = c[0][0] + c[1][1] + c[2][2];
        // From the largest of the four elements: its root loses no digits.
        let squares =
            [1.0 + trace, 1.0 + 2.0 * c[0][0] - trace, 1.0 + 2.0 * c[1][1] - trace, 1.0 + 2.0 * c[2][2] - trace];
        let largest = (0..4).fold(0, |best, k| if squares[k] > squares[best] { k } else { best });
        let s = 2.0 * squares[largest].max(0.0).sqrt();
        let (wx, wy, wz) = (c[1][2] - c[2][1], c[2][0] - c[0][2], c[0][1] - c[1][0]);
        let (xy, xz, yz) = (c[0][1] + c[1][0], c[0][2] + c[2][0], c[1][2] + c[2][1]);
        let q = match largest {
            0 => [s / 4.0, wx / s, wy / s, wz / s],
            1 => [wx / s, s / 4.0, xy / s, xz / s],
            2 => [wy / s, xy / s, s / 4.0, yz / s],
            _ => [wz / s, xz / s, yz / s, s / 4.0],
        };
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let sign = if q[0] < 0.0 { -1.0 } else { 1.0 };
        (norm > 0.5).then(|| q.map(|v| sign * v / norm))
    }
}

/// Orientation in a POSITION message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Orientation {
    /// No orientation.
    None,
    /// x, y, z of a unit quaternion whose w is not negative.
    Xyz([f32; 3]),
    /// x, y, z, w of a quaternion.
    Xyzw([f32; 4]),
}

/// POSITION: a position with or without orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// Position, mm.
    pub position_mm: [f32; 3],
    /// Orientation.
    pub orientation: Orientation,
}

impl Position {
    pub(super) fn decode(bytes: &[u8]) -> Result<Self> {
        let mut fields = Fields::new("POSITION", bytes);
        let position_mm = fields.floats("position")?;
        let orientation = match bytes.len() {
            12 => Orientation::None,
            24 => Orientation::Xyz(fields.floats("orientation")?),
            28 => Orientation::Xyzw(fields.floats("orientation")?),
            bytes => {
                return Err(IgtlError::Length { kind: "POSITION", bytes, expected: "12, 24 or 28".to_owned() });
            }
        };
        Ok(Self { position_mm, orientation })
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) {
        put_floats(out, &self.position_mm);
        match &self.orientation {
            Orientation::None => {}
            Orientation::Xyz(xyz) => put_floats(out, xyz),
            Orientation::Xyzw(xyzw) => put_floats(out, xyzw),
        }
    }

    /// The orientation as a unit quaternion w, x, y, z; `None` if there is none or its length is 0.
    pub fn quaternion(&self) -> Option<[f64; 4]> {
        let wxyz = match self.orientation {
            Orientation::None => return None,
            Orientation::Xyz(xyz) => {
                let [x, y, z] = xyz.map(f64::from);
                [(1.0 - x * x - y * y - z * z).max(0.0).sqrt(), x, y, z]
            }
            Orientation::Xyzw([x, y, z, w]) => [w, x, y, z].map(f64::from),
        };
        let norm = wxyz.iter().map(|v| v * v).sum::<f64>().sqrt();
        (norm.is_finite() && norm > 1e-6).then(|| wxyz.map(|v| v / norm))
    }
}

/// One point of a POINT message.
#[derive(Clone, Debug, PartialEq)]
pub struct Point<'a> {
    /// Name, at most 64 bytes.
    pub name: Cow<'a, str>,
    /// Kind of the point, such as `Landmark` or `Fiducial`; at most 32 bytes.
    pub group: Cow<'a, str>,
    /// Red, green, blue, alpha.
    pub rgba: [u8; 4],
    /// Position, mm.
    pub position_mm: [f32; 3],
    /// Radius, mm; may be 0. (pyigtl calls the field a diameter.)
    pub radius_mm: f32,
    /// Device name of the image that the point belongs to; at most 20 bytes, may be empty.
    pub owner: Cow<'a, str>,
}

impl<'a> Point<'a> {
    /// Length of one point.
    pub const BYTES: usize = 136;

    pub(super) fn decode_all(bytes: &'a [u8]) -> Result<Vec<Self>> {
        each("POINT", bytes, Self::BYTES, |fields| {
            Ok(Self {
                name: fields.text("name", 64)?,
                group: fields.text("group", 32)?,
                rgba: [fields.u8("colour")?, fields.u8("colour")?, fields.u8("colour")?, fields.u8("colour")?],
                position_mm: fields.floats("position")?,
                radius_mm: fields.floats::<1>("radius")?[0],
                owner: fields.text("owner", 20)?,
            })
        })
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        put_text(out, "the name of a point", &self.name, 64)?;
        put_text(out, "the group of a point", &self.group, 32)?;
        out.extend_from_slice(&self.rgba);
        put_floats(out, &self.position_mm);
        put_floats(out, &[self.radius_mm]);
        put_text(out, "the owner of a point", &self.owner, 20)
    }
}

/// Items of fixed length that fill `bytes`.
fn each<'a, T>(
    kind: &'static str,
    bytes: &'a [u8],
    item_bytes: usize,
    read: impl Fn(&mut Fields<'a>) -> Result<T>,
) -> Result<Vec<T>> {
    if !bytes.len().is_multiple_of(item_bytes) {
        return Err(IgtlError::Length { kind, bytes: bytes.len(), expected: format!("multiples of {item_bytes}") });
    }
    bytes.chunks_exact(item_bytes).map(|item| read(&mut Fields::new(kind, item))).collect()
}

/// Kind of a tracked tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolKind {
    /// A tracker itself.
    Tracker,
    /// Position and orientation.
    SixD,
    /// The position of the tip alone.
    ThreeD,
    /// Tip and direction, without the turn about it.
    FiveD,
    /// A number without a meaning in the protocol.
    Other(u8),
}

impl ToolKind {
    fn of(number: u8) -> Self {
        match number {
            1 => Self::Tracker,
            2 => Self::SixD,
            3 => Self::ThreeD,
            4 => Self::FiveD,
            other => Self::Other(other),
        }
    }

    fn number(self) -> u8 {
        match self {
            Self::Tracker => 1,
            Self::SixD => 2,
            Self::ThreeD => 3,
            Self::FiveD => 4,
            Self::Other(other) => other,
        }
    }
}

/// One tool of a TDATA message.
#[derive(Clone, Debug, PartialEq)]
pub struct Tool<'a> {
    /// Name, at most 20 bytes.
    pub name: Cow<'a, str>,
    /// Kind of the tool.
    pub kind: ToolKind,
    /// Its pose.
    pub pose: Transform,
}

/// TDATA: the tools that are in view.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tracking<'a> {
    /// One entry per tool.
    pub tools: Vec<Tool<'a>>,
}

impl<'a> Tracking<'a> {
    /// Length of one tool.
    pub const TOOL_BYTES: usize = 70;

    pub(super) fn decode(bytes: &'a [u8]) -> Result<Self> {
        let tools = each("TDATA", bytes, Self::TOOL_BYTES, |fields| {
            let name = fields.text("name", 20)?;
            let kind = ToolKind::of(fields.u8("type")?);
            fields.u8("reserved")?;
            Ok(Tool { name, kind, pose: Transform::read(fields)? })
        })?;
        Ok(Self { tools })
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        for tool in &self.tools {
            put_text(out, "the name of a tool", &tool.name, 20)?;
            out.extend_from_slice(&[tool.kind.number(), 0]);
            tool.pose.encode(out);
        }
        Ok(())
    }
}

/// Options of STT_TDATA.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackingStart<'a> {
    /// Minimum time between two messages, ms; 0 is as fast as possible.
    pub interval_ms: i32,
    /// Coordinate system; empty for the sender's own. At most 32 bytes.
    pub coordinates: Cow<'a, str>,
}

impl<'a> TrackingStart<'a> {
    pub(super) fn decode(bytes: &'a [u8]) -> Result<Self> {
        let mut fields = Fields::new("STT_TDATA", bytes);
        let interval_ms = fields.u32("resolution")? as i32;
        // Some senders leave the name out.
        let coordinates = if fields.rest().is_empty() { Cow::Borrowed("") } else { fields.text("coordinates", 32)? };
        fields.end(|| "4 or 36".to_owned())?;
        Ok(Self { interval_ms, coordinates })
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        out.extend_from_slice(&self.interval_ms.to_be_bytes());
        put_text(out, "a coordinate system", &self.coordinates, 32)
    }
}

/// The protocol's numbers for the state of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum StatusCode {
    /// No error.
    Ok = 1,
    /// An error without a specific number.
    UnknownError = 2,
    /// The requested data does not exist.
    NotFound = 4,
    /// A message was damaged.
    ChecksumError = 9,
    /// The command is unknown.
    UnknownInstruction = 12,
    /// Starting up.
    NotReady = 13,
    /// Shutting down.
    ShuttingDown = 19,
}

/// STATUS: state of the sender.
#[derive(Clone, Debug, PartialEq)]
pub struct Status<'a> {
    /// Number of the state: 1 is well, see [`StatusCode`].
    pub code: u16,
    /// A device-specific number.
    pub sub_code: i64,
    /// Name of the error, at most 20 bytes.
    pub name: Cow<'a, str>,
    /// A message for the user.
    pub text: Cow<'a, str>,
}

impl<'a> Status<'a> {
    pub(super) fn decode(bytes: &'a [u8]) -> Result<Self> {
        let mut fields = Fields::new("STATUS", bytes);
        let code = fields.u16("code")?;
        let sub_code = fields.u64("sub code")? as i64;
        let name = fields.text("error name", 20)?;
        Ok(Self { code, sub_code, name, text: padded(fields.rest()) })
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        out.extend_from_slice(&self.code.to_be_bytes());
        out.extend_from_slice(&self.sub_code.to_be_bytes());
        put_text(out, "the name of an error", &self.name, 20)?;
        // The library ends the text with a zero and counts it.
        out.extend_from_slice(self.text.split('\0').next().unwrap_or_default().as_bytes());
        out.push(0);
        Ok(())
    }
}

/// STRING: a text.
#[derive(Clone, Debug, PartialEq)]
pub struct Text<'a> {
    /// The text, at most 65,535 bytes.
    pub text: Cow<'a, str>,
}

impl<'a> Text<'a> {
    /// Maximum number of bytes of a text.
    pub const MAX_COUNT: usize = u16::MAX as usize;

    pub(super) fn decode(bytes: &'a [u8]) -> Result<Self> {
        let mut fields = Fields::new("STRING", bytes);
        // ASCII and UTF-8 read the same; of other encodings the ASCII part is readable.
        let _encoding = fields.u16("encoding")?;
        let len = fields.u16("length")?;
        let text = fields.take("text", usize::from(len))?;
        fields.end(|| format!("{}, 4 more than its length says,", 4 + usize::from(len)))?;
        Ok(Self { text: String::from_utf8_lossy(text) })
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        let Ok(len) = u16::try_from(self.text.len()) else {
            return Err(IgtlError::TooMany { what: "bytes of text", count: self.text.len(), limit: Self::MAX_COUNT });
        };
        out.extend_from_slice(&encoding(&self.text).to_be_bytes());
        out.extend_from_slice(&len.to_be_bytes());
        out.extend_from_slice(self.text.as_bytes());
        Ok(())
    }
}

/// CAPABILITY: the message types that the sender reads.
#[derive(Clone, Debug, PartialEq)]
pub struct Capability<'a> {
    /// Names of types, at most 12 bytes each.
    pub kinds: Vec<Cow<'a, str>>,
}

impl<'a> Capability<'a> {
    pub(super) fn decode(bytes: &'a [u8]) -> Result<Self> {
        Ok(Self { kinds: each("CAPABILITY", bytes, TYPE_BYTES, |fields| fields.text("type", TYPE_BYTES))? })
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        self.kinds.iter().try_for_each(|kind| put_text(out, "a message type", kind, TYPE_BYTES))
    }
}
