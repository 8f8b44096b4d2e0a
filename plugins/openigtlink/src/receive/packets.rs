//! Converts contents of messages to packets.

use std::borrow::Cow;
use std::collections::BTreeMap;

use panoscope_igtl::message::{Attribute, Endian, Image, PolyData, Scalar, Transform};
use panoscope_igtl::{Content, Message};
use panoscope_node::abi::{CloudPoint, Pose};
use panoscope_node::{AnyFormat, Bgr8, Gray8, Gray16, GrayF32, NodeError, PointCloud, Result, Rgba8, Slot, name16};

use super::Out;

/// Columns of `points`.
pub const COLUMNS: [&str; 4] = ["x_mm", "y_mm", "z_mm", "radius_mm"];
/// Maximum number of devices whose images are kept for later partial images.
const MAX_PICTURES: usize = 8;
/// Maximum size of an image that is assembled from parts, bytes.
const MAX_PICTURE_BYTES: usize = 64 << 20;

/// Names of the frames of a pose, from the parameters.
#[derive(Clone, Copy)]
pub struct Frames<'a> {
    /// The frame to which the pose maps.
    pub a: &'a str,
    /// The frame from which the pose maps.
    pub b: &'a str,
}

impl Frames<'_> {
    /// The names for a message of `device`.
    fn of(self, device: &str) -> ([u8; 16], [u8; 16]) {
        // The last `To` with something on both sides: `ToolToTracker`.
        let parts = device.rmatch_indices("To").find_map(|(at, _)| {
            let (b, a) = (&device[..at], &device[at + 2..]);
            (!a.is_empty() && !b.is_empty()).then_some((b, a))
        });
        let (b, a) = parts.unwrap_or((device, ""));
        let pick = |given: &str, found: &str| name16(if given.is_empty() { found } else { given });
        (pick(self.a, a), pick(self.b, b))
    }
}

/// An image that is assembled from parts.
#[derive(Debug, PartialEq)]
struct Whole {
    size: [u16; 3],
    components: u8,
    scalar: Scalar,
    pixels: Vec<u8>,
}

/// Converts messages to packets; keeps what later messages complete.
#[derive(Default)]
pub struct Packets {
    wholes: BTreeMap<String, Whole>,
    rows: Vec<f64>,
    names: String,
}

/// Why content is not passed on; `None` when it was.
type Refusal = Option<String>;

impl Packets {
    /// Writes an image, complete or in parts.
    pub fn image(&mut self, image: &Image<'_>, device: &str, out: &mut Slot<'_, AnyFormat>) -> Result<Refusal> {
        let [width, height, depth] = image.size.map(usize::from);
        if depth != 1 || width == 0 || height == 0 {
            return Ok(Some(format!("it has {width} x {height} x {depth} pixels, but an image has one slice")));
        }
        if image.is_whole() {
            return write(image, image.pixels, out);
        }
        let pixel = usize::from(image.components) * image.scalar.bytes();
        let bytes = width * height * pixel;
        if bytes > MAX_PICTURE_BYTES {
            return Ok(Some(format!(
                "it comes in parts, and its {bytes} bytes exceed the limit of {MAX_PICTURE_BYTES}"
            )));
        }
        let same = |whole: &Whole| {
            (whole.size, whole.components, whole.scalar) == (image.size, image.components, image.scalar)
        };
        if !self.wholes.get(device).is_some_and(same) {
            if self.wholes.len() >= MAX_PICTURES && !self.wholes.contains_key(device) {
                self.wholes.clear();
            }
            let Image { size, components, scalar, .. } = *image;
            self.wholes.insert(device.to_owned(), Whole { size, components, scalar, pixels: vec![0; bytes] });
        }
        let Some(whole) = self.wholes.get_mut(device) else { return Ok(None) };
        let row = usize::from(image.part_size[0]) * pixel;
        if row > 0 {
            let (left, top) = (usize::from(image.part_start[0]) * pixel, usize::from(image.part_start[1]));
            for (y, part) in image.pixels.chunks_exact(row).enumerate() {
                let at = (top + y) * width * pixel + left;
                whole.pixels[at..at + row].copy_from_slice(part);
            }
        }
        write(image, &whole.pixels, out)
    }

    /// Writes poses and points.
    pub fn places(&mut self, message: &Message<'_>, frames: Frames<'_>, out: &mut Out<'_>) -> Result<Refusal> {
        self.rows.clear();
        self.names.clear();
        let mut pose = None;
        let mut refusal = None;
        match &message.content {
            Content::Transform(transform) => {
                self.row(&message.device, transform.translation_mm, 0.0);
                pose = rigid(transform);
                if pose.is_none() {
                    refusal = Some("it is not a pose: the transform is not a rotation with a translation".to_owned());
                }
            }
            Content::Position(position) => {
                self.row(&message.device, position.position_mm, 0.0);
                let at = position.position_mm.map(f64::from);
                pose = position.quaternion().filter(|_| at.iter().all(|mm| mm.is_finite())).map(|turn| (turn, at));
            }
            Content::Tracking(tracking) => {
                for tool in &tracking.tools {
                    self.row(&tool.name, tool.pose.translation_mm, 0.0);
                }
                pose = tracking.tools.first().and_then(|tool| rigid(&tool.pose));
            }
            Content::Points(points) => {
                for point in points {
                    self.row(&point.name, point.position_mm, f64::from(point.radius_mm));
                }
            }
            _ => {}
        }
        if let Some((a_from_b_wxyz, a_from_b_mm)) = pose {
            let name = match &message.content {
                Content::Tracking(tracking) => tracking.tools.first().map_or("", |tool| &tool.name),
                _ => &message.device,
            };
            let (a, b) = frames.of(name);
            out.pose.set(Pose { a_from_b_wxyz, a_from_b_mm, a, b })?;
        }
        out.points.set_table(&COLUMNS, &self.rows)?;
        out.names.set_text(&self.names)?;
        Ok(refusal)
    }

    fn row(&mut self, name: &str, at_mm: [f32; 3], radius_mm: f64) {
        if !self.rows.is_empty() {
            self.names.push('\n');
        }
        // One line per row.
        self.names.extend(name.chars().map(|c| if c == '\n' { ' ' } else { c }));
        self.rows.extend(at_mm.map(f64::from));
        self.rows.push(radius_mm);
    }
}

/// Rotation as quaternion w, x, y, z, and translation in mm; `None` if the transform is not rigid.
fn rigid(transform: &Transform) -> Option<([f64; 4], [f64; 3])> {
    let at = transform.translation_mm.map(f64::from);
    Some((transform.quaternion()?, at)).filter(|_| at.iter().all(|mm| mm.is_finite()))
}

/// Writes `pixels`, which has the size of the complete image.
fn write(image: &Image<'_>, pixels: &[u8], out: &mut Slot<'_, AnyFormat>) -> Result<Refusal> {
    let [width, height, _] = image.size.map(usize::from);
    let is_big = image.endian == Endian::Big;
    match (image.components, image.scalar) {
        (1, Scalar::Uint8) => {
            let mut view = out.alloc_as::<Gray8>(width, height)?;
            pixels.chunks_exact(width).enumerate().for_each(|(y, row)| view.row_mut(y).copy_from_slice(row));
        }
        (3, Scalar::Uint8) => {
            let mut view = out.alloc_as::<Bgr8>(width, height)?;
            for (y, row) in pixels.chunks_exact(width * 3).enumerate() {
                for (to, from) in view.row_mut(y).chunks_exact_mut(3).zip(row.chunks_exact(3)) {
                    to.copy_from_slice(&[from[2], from[1], from[0]]);
                }
            }
        }
        (4, Scalar::Uint8) => {
            let mut view = out.alloc_as::<Rgba8>(width, height)?;
            pixels.chunks_exact(width * 4).enumerate().for_each(|(y, row)| view.row_mut(y).copy_from_slice(row));
        }
        (1, Scalar::Uint16) => {
            let mut view = out.alloc_as::<Gray16>(width, height)?;
            for (y, row) in pixels.chunks_exact(width * 2).enumerate() {
                for (to, from) in view.row_mut(y).iter_mut().zip(row.chunks_exact(2)) {
                    let bytes = [from[0], from[1]];
                    *to = if is_big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) };
                }
            }
        }
        (1, scalar) => {
            let size = scalar.bytes();
            let mut view = out.alloc_as::<GrayF32>(width, height)?;
            for (y, row) in pixels.chunks_exact(width * size).enumerate() {
                for (to, from) in view.row_mut(y).iter_mut().zip(row.chunks_exact(size)) {
                    *to = number(scalar, from, is_big);
                }
            }
        }
        (components, scalar) => {
            return Ok(Some(format!("{components} components of {scalar:?} are not a supported image format")));
        }
    }
    Ok(None)
}

/// Reads one number of a pixel.
fn number(scalar: Scalar, bytes: &[u8], is_big: bool) -> f32 {
    let mut ordered = [0; 8];
    let ordered = &mut ordered[..bytes.len()];
    ordered.copy_from_slice(bytes);
    if !is_big {
        ordered.reverse();
    }
    let whole = ordered.iter().fold(0_u64, |value, byte| value << 8 | u64::from(*byte));
    match scalar {
        Scalar::Int8 => f32::from(whole as u8 as i8),
        Scalar::Uint8 => f32::from(whole as u8),
        Scalar::Int16 => f32::from(whole as u16 as i16),
        Scalar::Uint16 => f32::from(whole as u16),
        Scalar::Int32 => whole as u32 as i32 as f32,
        Scalar::Uint32 => whole as u32 as f32,
        Scalar::Float32 => f32::from_bits(whole as u32),
        Scalar::Float64 => f64::from_bits(whole) as f32,
    }
}

/// Writes the points of a surface.
pub fn cloud(data: &PolyData<'_>, out: &mut Slot<'_, PointCloud>) -> Result<Refusal> {
    let count = data.points_mm.len();
    if count == 0 {
        return Ok(Some("it has no points".to_owned()));
    }
    let colours = colours(data);
    let mut view = out.alloc_cloud(count, 1).map_err(|error| NodeError::new(format!("{count} points: {error}")))?;
    for (index, (to, [x_mm, y_mm, z_mm])) in view.row_mut(0).iter_mut().zip(&data.points_mm).enumerate() {
        let bgr = match &colours {
            Some((step, values)) => {
                let byte = |k: usize| (values[index * step + k].clamp(0.0, 1.0) * 255.0).round() as u8;
                [byte(2), byte(1), byte(0)]
            }
            None => [200; 3],
        };
        *to = CloudPoint { x_mm: *x_mm, y_mm: *y_mm, z_mm: *z_mm, bgr, filled: 0 };
    }
    Ok(None)
}

/// Numbers per point, and the colours of all points: red, green, blue from 0 to 1.
fn colours<'a>(data: &'a PolyData<'_>) -> Option<(usize, Cow<'a, [f32]>)> {
    let of_points = |attribute: &&Attribute<'_>| {
        let is_colour = matches!(attribute.kind, Attribute::POINT_SCALARS | Attribute::POINT_COLOURS);
        let step = usize::from(attribute.components);
        is_colour && (3..=4).contains(&step) && attribute.values.len() == step * data.points_mm.len()
    };
    let found = data.attributes.iter().find(of_points)?;
    Some((usize::from(found.components), Cow::Borrowed(&found.values)))
}
