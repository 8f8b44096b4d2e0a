//! Messages of each type, and bytes that other programs wrote.

use std::borrow::Cow;

use panoscope_igtl::message::{
    Attribute, Capability, Cells, Coordinates, Endian, Image, Orientation, Point, PolyData, Position, Query, Scalar,
    Status, Text, Tool, ToolKind, Tracking, TrackingStart, Transform, Verb,
};
use panoscope_igtl::{Content, Message, Timestamp};

/// Written by the library of Debian 12 (libopenigtlink 1.11), see `golden/write_golden.cpp`.
pub const LIBRARY: &str = include_str!("../golden/library.txt");
/// Written by pyigtl 0.3.4, see `golden/write_golden.py`.
pub const PYIGTL: &str = include_str!("../golden/pyigtl.txt");

/// Names and bytes of a file of golden bytes.
pub fn golden(text: &str) -> Vec<(&str, Vec<u8>)> {
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).expect("ASCII"), 16).expect("hexadecimal");
    let lines = text.lines().map(|text| text.split_once(' ').expect("a name and bytes"));
    lines.map(|(name, hex)| (name, hex.as_bytes().chunks_exact(2).map(byte).collect())).collect()
}

pub fn time() -> Timestamp {
    Timestamp { seconds: 1_700_000_000, fraction: 0x4000_0000 }
}

fn quarter_turn(scale: f32) -> Transform {
    let columns = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    Transform { columns, translation_mm: [10.0 * scale, 20.0 * scale, 30.0 * scale] }
}

fn points() -> Vec<Point<'static>> {
    let first = Point {
        name: "Target".into(),
        group: "Landmark".into(),
        rgba: [255, 128, 0, 255],
        position_mm: [1.5, -2.5, 3.5],
        radius_mm: 4.0,
        owner: "Picture".into(),
    };
    let second = Point {
        name: "Entry".into(),
        group: "Fiducial".into(),
        rgba: [0, 0, 255, 64],
        position_mm: [7.0, 8.0, 9.0],
        radius_mm: 0.0,
        owner: "".into(),
    };
    vec![first, second]
}

const STEPS_MM: [[f32; 3]; 3] = [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]];
const COLOURS: [u8; 18] = [0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 110, 120, 130, 140, 150, 160, 170];
const GRAYS: [u8; 24] = [0, 0, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0, 7, 0, 8, 0, 9, 0, 10, 0, 11, 0];

fn colours(centre_mm: [f32; 3]) -> Image<'static> {
    let size = [3, 2, 1];
    Image {
        components: 3,
        scalar: Scalar::Uint8,
        endian: Endian::Little,
        coordinates: Coordinates::Ras,
        size,
        steps_mm: STEPS_MM,
        centre_mm,
        part_start: [0; 3],
        part_size: size,
        pixels: &COLOURS,
    }
}

fn cells(list: &[&[u32]]) -> Cells {
    let mut cells = Cells::default();
    list.iter().for_each(|cell| cells.push(cell));
    cells
}

/// The content that a name of a golden file stands for.
pub fn content(name: &str) -> Content<'static> {
    match name {
        "transform" => Content::Transform(quarter_turn(1.0)),
        "position" => Content::Position(Position {
            position_mm: [1.0, 2.0, 3.0],
            orientation: Orientation::Xyzw([0.0, 0.0, 0.6, 0.8]),
        }),
        "image" => Content::Image(colours([0.0; 3])),
        "image_centred" => Content::Image(colours([0.5, 0.25, 0.0])),
        "image16" => {
            let size = [4, 3, 1];
            Content::Image(Image {
                components: 1,
                scalar: Scalar::Uint16,
                endian: Endian::Little,
                coordinates: Coordinates::Lps,
                size,
                steps_mm: STEPS_MM,
                centre_mm: [0.75, 0.5, 0.0],
                part_start: [0; 3],
                part_size: size,
                pixels: &GRAYS,
            })
        }
        "image_part" => Content::Image(Image {
            components: 1,
            scalar: Scalar::Uint16,
            endian: Endian::Big,
            coordinates: Coordinates::Lps,
            size: [4, 3, 1],
            steps_mm: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            centre_mm: [0.0; 3],
            part_start: [1, 2, 0],
            part_size: [2, 1, 1],
            pixels: &[1, 2, 3, 4],
        }),
        "point" => Content::Points(points()),
        "point_owned" => {
            let mut points = points();
            (points[1].radius_mm, points[1].group, points[1].owner) = (1.0, "Landmark".into(), "Picture".into());
            Content::Points(points)
        }
        "polydata" => {
            let values: Vec<f32> = (0..12).map(|k| 0.25 * k as f32).collect();
            let attribute = |kind, components, name: &'static str, values: &[f32]| Attribute {
                kind,
                components,
                name: Cow::Borrowed(name),
                values: values.to_vec(),
            };
            Content::PolyData(PolyData {
                points_mm: (0..4).map(|k| [k as f32, 2.0 * k as f32, 3.0 * k as f32]).collect(),
                vertices: cells(&[&[3]]),
                lines: cells(&[&[0, 1]]),
                polygons: cells(&[&[0, 1, 2], &[0, 1, 2, 3]]),
                strips: cells(&[&[0, 1, 2, 3]]),
                attributes: vec![attribute(0, 1, "heat", &values[..4]), attribute(2, 3, "up", &values)],
            })
        }
        "polydata_triangle" => Content::PolyData(PolyData {
            points_mm: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            polygons: cells(&[&[0, 1, 2]]),
            ..PolyData::default()
        }),
        "tdata" => {
            let tool = |name: &'static str, kind, scale| Tool { name: name.into(), kind, pose: quarter_turn(scale) };
            let tools = vec![tool("Grasper", ToolKind::SixD, 1.0), tool("Tip", ToolKind::ThreeD, 2.0)];
            Content::Tracking(Tracking { tools })
        }
        "status" => {
            Content::Status(Status { code: 4, sub_code: -42, name: "Missing".into(), text: "no such file".into() })
        }
        "string" => Content::Text(Text { text: "a text".into() }),
        "capability" => {
            Content::Capability(Capability { kinds: vec!["IMAGE".into(), "TRANSFORM".into(), "GET_STATUS".into()] })
        }
        "stt_tdata" => {
            let start = TrackingStart { interval_ms: 50, coordinates: "Patient".into() };
            Content::Query(Query::new(Verb::StartTracking(start), "TDATA"))
        }
        "stp_tdata" => Content::Query(Query::new(Verb::Stop, "TDATA")),
        "rts_tdata" => Content::Query(Query::new(Verb::Answer { is_granted: false }, "TDATA")),
        "get_capabil" => Content::Query(Query::new(Verb::Get, "CAPABILITY")),
        other => panic!("there is no content `{other}`"),
    }
}

/// The message that a line of [`LIBRARY`] holds.
pub fn of_library(name: &str) -> Message<'static> {
    Message::new("Device", time(), content(name))
}

/// The message that a line of [`PYIGTL`] holds.
pub fn of_pyigtl(name: &str) -> Message<'static> {
    let (name, version) = name.split_once("_v").expect("a version");
    let version: u16 = version.parse().expect("a number");
    let name = match name {
        "image" => "image_centred",
        "point" => "point_owned",
        "polydata" => "polydata_triangle",
        other => other,
    };
    let mut message = Message::new("Device", time(), content(name));
    message.version = version;
    if version > 1 {
        message.message_id = 7;
    }
    if version > 2 {
        message.metadata = vec![("TransformStatus".into(), "OK".into()), ("frame".into(), "12".into())];
    }
    message
}

/// Bytes of all golden messages.
pub fn all() -> Vec<Vec<u8>> {
    golden(LIBRARY).into_iter().chain(golden(PYIGTL)).map(|(_, bytes)| bytes).collect()
}
