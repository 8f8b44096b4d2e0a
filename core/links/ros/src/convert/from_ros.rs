//! Messages as packets.

use std::io::Cursor;

use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use panoscope_abi as abi;
use panoscope_data::calibration::ros::{CameraInfo as Info, CameraInfoError, Window};

use super::bayer;
use crate::messages::{
    CameraInfo, CompressedImage, Detection2DArray, DisparityImage, Image, JointState, PointCloud2, PointField,
    PoseStamped, point_type,
};

/// Millimetres in a metre.
const MM_PER_M: f64 = 1e3;
/// Largest side of an image.
const MAX_SIDE: u32 = 1 << 15;
/// Maximum number of pixels of an image, and points of a cloud.
const MAX_PIXELS: u64 = 1 << 27;
/// Maximum number of boxes of a message.
const MAX_BOXES: usize = 10_000;
/// Maximum memory of an image decoder, bytes.
const MAX_DECODED_BYTES: u64 = 1 << 30;

/// A message without a packet form.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ConvertError {
    /// A size that does not fit the bytes, or is too large.
    #[error("{width}x{height} with {step} bytes per row does not match {len} bytes")]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes from one row to the next.
        step: u32,
        /// Actual number of bytes.
        len: usize,
    },
    /// An unsupported image encoding.
    #[error(
        "the encoding `{encoding}` is not supported: use mono8, bgr8, rgb8, bgra8, rgba8, mono16, 16UC1, 32FC1 or bayer_*8"
    )]
    Encoding {
        /// Its name.
        encoding: String,
    },
    /// A compressed image that cannot be decoded.
    #[error("a compressed image (`{format}`) cannot be decoded: {words}")]
    Compressed {
        /// Format stated by the message.
        format: String,
        /// Description of the problem.
        words: String,
    },
    /// Points without coordinates.
    #[error("the points have no field `{field}` of floats")]
    Field {
        /// Its name.
        field: &'static str,
    },
    /// More entries than a packet can hold.
    #[error("{count} {what} exceed the limit of {most}")]
    TooMany {
        /// Number of entries.
        count: usize,
        /// Kind of the entries.
        what: &'static str,
        /// Maximum number.
        most: usize,
    },
    /// A camera without a calibration.
    #[error(transparent)]
    Camera(#[from] CameraInfoError),
}

/// Pixels in rows without padding.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The pixels.
    pub samples: Samples,
}

/// Samples of an image.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    /// One byte a pixel.
    Gray8(Vec<u8>),
    /// Blue, green, red.
    Bgr8(Vec<u8>),
    /// One word a pixel.
    Gray16(Vec<u16>),
    /// One float a pixel.
    F32(Vec<f32>),
}

fn checked(width: u32, height: u32, step: u32, row_bytes: u64, len: usize) -> Result<(), ConvertError> {
    let fits = width > 0
        && height > 0
        && width <= MAX_SIDE
        && height <= MAX_SIDE
        && u64::from(width) * u64::from(height) <= MAX_PIXELS
        && u64::from(step) >= row_bytes
        && u64::from(step) * u64::from(height - 1) + row_bytes <= len as u64;
    if fits { Ok(()) } else { Err(ConvertError::Size { width, height, step, len }) }
}

/// The pixels of an image. Alpha is dropped.
///
/// # Errors The encoding is not supported, or the size does not fit the bytes.
pub fn picture(message: &Image<'_>) -> Result<Picture, ConvertError> {
    let Image { width, height, step, .. } = *message;
    let pixel: u64 = match message.encoding.as_str() {
        "mono8" | "8UC1" => 1,
        other if bayer::is_bayer(other) => 1,
        "mono16" | "16UC1" => 2,
        "bgr8" | "rgb8" | "8UC3" => 3,
        "bgra8" | "rgba8" | "8UC4" | "32FC1" => 4,
        other => return Err(ConvertError::Encoding { encoding: other.chars().take(40).collect() }),
    };
    let row_bytes = u64::from(width) * pixel;
    checked(width, height, step, row_bytes, message.data.len())?;
    let rows = (0..height as usize).map(|row| &message.data[row * step as usize..][..row_bytes as usize]);
    let samples = match message.encoding.as_str() {
        encoding if bayer::is_bayer(encoding) => Samples::Bgr8(bayer::colours(encoding, &rows.collect::<Vec<_>>())),
        "mono8" | "8UC1" => Samples::Gray8(rows.flatten().copied().collect()),
        "bgr8" | "8UC3" => Samples::Bgr8(rows.flatten().copied().collect()),
        "rgb8" => {
            Samples::Bgr8(rows.flat_map(|row| row.as_chunks::<3>().0).flat_map(|[r, g, b]| [*b, *g, *r]).collect())
        }
        "rgba8" => {
            Samples::Bgr8(rows.flat_map(|row| row.as_chunks::<4>().0).flat_map(|[r, g, b, _]| [*b, *g, *r]).collect())
        }
        "bgra8" | "8UC4" => {
            Samples::Bgr8(rows.flat_map(|row| row.as_chunks::<4>().0).flat_map(|[b, g, r, _]| [*b, *g, *r]).collect())
        }
        "mono16" | "16UC1" => {
            let number = if message.is_bigendian == 0 { u16::from_le_bytes } else { u16::from_be_bytes };
            Samples::Gray16(rows.flat_map(|row| row.as_chunks().0).map(|bytes| number(*bytes)).collect())
        }
        _ => {
            let number = if message.is_bigendian == 0 { f32::from_le_bytes } else { f32::from_be_bytes };
            Samples::F32(rows.flat_map(|row| row.as_chunks().0).map(|bytes| number(*bytes)).collect())
        }
    };
    Ok(Picture { width: width as usize, height: height as usize, samples })
}

/// The pixels of a compressed image, JPEG or PNG by its bytes.
///
/// # Errors
/// It is neither, or damaged.
pub fn compressed(message: &CompressedImage<'_>) -> Result<Picture, ConvertError> {
    let format = || message.format.chars().take(60).collect::<String>();
    let wrong = |words: String| ConvertError::Compressed { format: format(), words };
    let kind = match message.data.get(..4) {
        Some([0x89, b'P', b'N', b'G']) => ImageFormat::Png,
        Some([0xff, 0xd8, ..]) => ImageFormat::Jpeg,
        None if message.data.is_empty() => return Err(wrong("it is empty".to_owned())),
        _ => return Err(wrong("it is neither JPEG nor PNG".to_owned())),
    };
    let mut reader = ImageReader::with_format(Cursor::new(&message.data[..]), kind);
    let mut limits = Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(MAX_SIDE), Some(MAX_SIDE));
    limits.max_alloc = Some(MAX_DECODED_BYTES);
    reader.limits(limits);
    let decoded = reader.decode().map_err(|error| wrong(error.to_string()))?;
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let samples = match decoded {
        DynamicImage::ImageLuma8(gray) => Samples::Gray8(gray.into_raw()),
        DynamicImage::ImageLuma16(gray) => Samples::Gray16(gray.into_raw()),
        other => {
            let mut pixels = other.into_rgb8().into_raw();
            pixels.as_chunks_mut::<3>().0.iter_mut().for_each(|rgb| rgb.swap(0, 2));
            Samples::Bgr8(pixels)
        }
    };
    Ok(Picture { width, height, samples })
}

/// Depth in mm; unknown is NaN. Floats are in m, 16 bits in mm with 0 for unknown (REP 118).
///
/// # Errors
/// As [`picture`]; 8-bit images are refused.
pub fn depth_mm(message: &Image<'_>) -> Result<(usize, usize, Vec<f32>), ConvertError> {
    let Picture { width, height, samples } = picture(message)?;
    let mm = match samples {
        Samples::F32(metres) => {
            let mm = |metres: f32| if metres > 0.0 && metres.is_finite() { metres * MM_PER_M as f32 } else { f32::NAN };
            metres.into_iter().map(mm).collect()
        }
        Samples::Gray16(words) => words.into_iter().map(|mm| if mm == 0 { f32::NAN } else { f32::from(mm) }).collect(),
        _ => return Err(ConvertError::Encoding { encoding: message.encoding.clone() }),
    };
    Ok((width, height, mm))
}

/// Disparity in px; unknown values and those below the smallest searched disparity are NaN.
///
/// # Errors
/// As [`picture`]; other formats than floats are refused.
pub fn disparity(message: &DisparityImage<'_>) -> Result<(usize, usize, Vec<f32>), ConvertError> {
    let Picture { width, height, samples } = picture(&message.image)?;
    let Samples::F32(mut values) = samples else {
        return Err(ConvertError::Encoding { encoding: message.image.encoding.clone() });
    };
    for value in &mut values {
        if !(value.is_finite() && *value > 0.0 && *value >= message.min_disparity) {
            *value = f32::NAN;
        }
    }
    Ok((width, height, values))
}

/// A number at an offset in each point.
struct Numbers {
    offset: usize,
    datatype: u8,
    is_bigendian: bool,
}

impl Numbers {
    fn of(message: &PointCloud2<'_>, name: &str, types: &[u8]) -> Option<Self> {
        let field: &PointField = message.fields.iter().find(|field| field.name == name)?;
        let bytes = match field.datatype {
            point_type::FLOAT64 => 8,
            point_type::UINT8 => 1,
            _ => 4,
        };
        let fits = types.contains(&field.datatype) && u64::from(field.offset) + bytes <= u64::from(message.point_step);
        fits.then_some(Self {
            offset: field.offset as usize,
            datatype: field.datatype,
            is_bigendian: message.is_bigendian,
        })
    }

    /// The one, four or eight bytes, little-endian.
    fn bytes<const N: usize>(&self, point: &[u8]) -> [u8; N] {
        let mut bytes = [0; N];
        if let Some(found) = point.get(self.offset..self.offset + N) {
            bytes.copy_from_slice(found);
        }
        if self.is_bigendian {
            bytes.reverse();
        }
        bytes
    }

    fn number(&self, point: &[u8]) -> f64 {
        match self.datatype {
            point_type::FLOAT64 => f64::from_le_bytes(self.bytes(point)),
            _ => f64::from(f32::from_le_bytes(self.bytes(point))),
        }
    }
}

/// Width, height and points of a cloud, in mm. Points without colours are white, points whose field `filled` is not 0
/// count as filled in.
///
/// # Errors
/// There are no coordinates, or the size does not fit the bytes.
pub fn cloud(message: &PointCloud2<'_>) -> Result<(usize, usize, Vec<abi::CloudPoint>), ConvertError> {
    let PointCloud2 { width, height, point_step, row_step, .. } = *message;
    let len = message.data.len();
    let row_bytes = u64::from(width) * u64::from(point_step);
    // A cloud without order is one long row.
    let count = u64::from(width) * u64::from(height);
    let fits = point_step > 0
        && count <= MAX_PIXELS
        && u64::from(row_step) >= row_bytes
        && (count == 0 || u64::from(row_step) * u64::from(height - 1) + row_bytes <= len as u64);
    if !fits {
        return Err(ConvertError::Size { width, height, step: row_step, len });
    }
    let floats = [point_type::FLOAT32, point_type::FLOAT64];
    let coordinate = |field| Numbers::of(message, field, &floats).ok_or(ConvertError::Field { field });
    let axes = [coordinate("x")?, coordinate("y")?, coordinate("z")?];
    let packed = [point_type::FLOAT32, point_type::UINT32];
    let colour = Numbers::of(message, "rgb", &packed).or_else(|| Numbers::of(message, "rgba", &packed));
    let filled = Numbers::of(message, "filled", &[point_type::UINT8]);
    let mut points = Vec::with_capacity(count as usize);
    for row in 0..height as usize {
        for column in 0..width as usize {
            let at = row * row_step as usize + column * point_step as usize;
            let point = &message.data[at..at + point_step as usize];
            let [x_mm, y_mm, z_mm] = [0, 1, 2].map(|axis| (axes[axis].number(point) * MM_PER_M) as f32);
            let bgr = colour.as_ref().map_or([u8::MAX; 3], |colour| {
                let [blue, green, red, _]: [u8; 4] = colour.bytes(point);
                [blue, green, red]
            });
            let filled = filled.as_ref().map_or(0, |filled| u8::from(filled.bytes(point) != [0]));
            points.push(abi::CloudPoint { x_mm, y_mm, z_mm, bgr, filled });
        }
    }
    Ok((width as usize, height as usize, points))
}

/// Boxes with their label table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Boxes {
    /// The boxes.
    pub items: Vec<abi::Detection>,
    /// Names of the classes, in order of their first appearance.
    pub labels: Vec<String>,
}

/// Boxes with the class of the highest score; rotated boxes become upright ones of the same size.
///
/// # Errors
/// There are too many.
pub fn boxes(message: &Detection2DArray) -> Result<Boxes, ConvertError> {
    let count = message.detections.len();
    if count > MAX_BOXES {
        return Err(ConvertError::TooMany { count, what: "boxes", most: MAX_BOXES });
    }
    let mut all = Boxes::default();
    for found in &message.detections {
        let best = found.results.iter().max_by(|a, b| a.hypothesis.score.total_cmp(&b.hypothesis.score));
        // A line break would divide the table of labels.
        let label = best.map_or(String::new(), |best| best.hypothesis.class_id.replace('\n', " "));
        let class_index = all.labels.iter().position(|known| *known == label).unwrap_or_else(|| {
            all.labels.push(label);
            all.labels.len() - 1
        });
        let (centre, width, height) = (found.bbox.center.position, found.bbox.size_x, found.bbox.size_y);
        all.items.push(abi::Detection {
            x_px: (centre.x - width / 2.0) as f32,
            y_px: (centre.y - height / 2.0) as f32,
            width_px: width as f32,
            height_px: height as f32,
            score: best.map_or(0.0, |best| best.hypothesis.score as f32),
            class_index: class_index as u32,
            track_id: found.id.parse().unwrap_or(-1),
        });
    }
    Ok(all)
}

/// A name for a packet: at most 16 bytes, zero-padded.
fn padded(name: &str) -> [u8; 16] {
    let mut out = [0; 16];
    let end = name.floor_char_boundary(out.len());
    out[..end].copy_from_slice(&name.as_bytes()[..end]);
    out
}

/// The pose of `child` in the frame of the header.
pub fn pose(message: &PoseStamped, child: &str) -> abi::Pose {
    let (at, turn) = (message.pose.position, message.pose.orientation);
    abi::Pose {
        a_from_b_wxyz: [turn.w, turn.x, turn.y, turn.z],
        a_from_b_mm: [at.x, at.y, at.z].map(|metres| metres * MM_PER_M),
        a: padded(&message.header.frame_id),
        b: padded(child),
    }
}

/// The joints, in the order of the message.
///
/// # Errors
/// There are more than a packet holds.
pub fn joints(message: &JointState) -> Result<abi::Joints, ConvertError> {
    let count = message.position.len().max(message.name.len());
    if count > abi::MAX_JOINTS {
        return Err(ConvertError::TooMany { count, what: "joints", most: abi::MAX_JOINTS });
    }
    let eight = |values: &[f64]| std::array::from_fn(|at| values.get(at).copied().unwrap_or(0.0));
    Ok(abi::Joints {
        position_rad: eight(&message.position),
        velocity_rad_s: eight(&message.velocity),
        count: count as u32,
        reserved: 0,
    })
}

/// The camera in a message.
///
/// # Errors The distortion model is unknown, or its numbers are invalid.
pub fn camera_info(message: &CameraInfo) -> Result<Info, ConvertError> {
    let size = (message.width, message.height);
    let matrices = (&message.k, &message.r, &message.p);
    let (roi, binning) = (&message.roi, (message.binning_x, message.binning_y));
    let window = Window { binning, offset_px: (roi.x_offset, roi.y_offset), size_px: (roi.width, roi.height) };
    Ok(Info::of_message(size, &message.distortion_model, &message.d, matrices, window)?)
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use panoscope_base::View;
    use panoscope_data::formats::Pixels;

    use super::*;
    use crate::convert::{detections_message, disparity_message, header, image_message, points_message};
    use crate::messages::Bytes;

    fn image(encoding: &str, width: u32, height: u32, step: u32, data: &[u8]) -> Image<'static> {
        let data = Bytes(Cow::Owned(data.to_vec()));
        Image { encoding: encoding.to_owned(), width, height, step, data, ..Image::default() }
    }

    #[test]
    fn colours_and_padding_are_read_in_any_order() {
        let bgr = Samples::Bgr8(vec![3, 2, 1, 6, 5, 4]);
        assert_eq!(picture(&image("rgb8", 1, 2, 4, &[1, 2, 3, 99, 4, 5, 6])).unwrap().samples, bgr);
        assert_eq!(picture(&image("rgba8", 1, 2, 4, &[1, 2, 3, 9, 4, 5, 6, 9])).unwrap().samples, bgr);
        assert_eq!(picture(&image("bgr8", 2, 1, 6, &[3, 2, 1, 6, 5, 4])).unwrap().samples, bgr);
        let mut deep = image("16UC1", 1, 1, 2, &[1, 2]);
        assert_eq!(picture(&deep).unwrap().samples, Samples::Gray16(vec![513]));
        deep.is_bigendian = 1;
        assert_eq!(picture(&deep).unwrap().samples, Samples::Gray16(vec![258]));
    }

    #[test]
    fn sizes_that_do_not_fit_are_errors() {
        for wrong in [
            image("mono8", 2, 2, 2, &[0; 3]),
            image("mono8", 2, 2, 1, &[0; 9]),
            image("mono8", 0, 2, 2, &[0; 9]),
            image("bgr8", u32::MAX, u32::MAX, u32::MAX, &[0; 9]),
        ] {
            assert!(matches!(picture(&wrong), Err(ConvertError::Size { .. })), "{wrong:?}");
        }
        assert!(matches!(picture(&image("yuv422", 1, 1, 2, &[0; 2])), Err(ConvertError::Encoding { .. })));
        let cloud_of = |width, height| PointCloud2 { width, height, point_step: 16, ..PointCloud2::default() };
        assert!(matches!(cloud(&cloud_of(1, 1)), Err(ConvertError::Size { .. })));
        assert!(matches!(cloud(&cloud_of(u32::MAX, u32::MAX)), Err(ConvertError::Size { .. })));
    }

    #[test]
    fn maps_points_and_boxes_come_back() {
        let values = [20.0, f32::NAN, 30.5, 40.0];
        let message = disparity_message(&View::new(&values, 2, 2, 1), None, header(7, "f"));
        let (_, _, read) = disparity(&message).unwrap();
        assert!(read[1].is_nan() && (read[0], read[2], read[3]) == (20.0, 30.5, 40.0));
        let depth = image_message(&Pixels::F32(View::new(&values, 2, 2, 1)), 1e-3, header(0, "f"));
        let (_, _, read) = depth_mm(&depth).unwrap();
        assert!(read[1].is_nan() && (read[2] - 30.5).abs() < 1e-5);
        let point = abi::CloudPoint { x_mm: 1.0, y_mm: -2.0, z_mm: f32::NAN, bgr: [1, 2, 3], filled: 0 };
        let guess = abi::CloudPoint { filled: 1, ..point };
        let message = points_message([point, guess].into_iter(), 2, header(0, "f"));
        assert!(!message.is_dense);
        let (width, height, points) = cloud(&message).unwrap();
        assert_eq!((width, height, points[1].bgr), (2, 1, [1, 2, 3]));
        assert_eq!(points.iter().map(|point| point.filled).collect::<Vec<u8>>(), [0, 1]);
        // Without the field the fourth byte of a colour means nothing.
        let mut fields = message.fields.clone();
        fields.retain(|field| field.name != "filled");
        let (_, _, points) = cloud(&PointCloud2 { fields, ..message }).unwrap();
        assert!(points.iter().all(|point| point.filled == 0));
        assert!((points[1].x_mm - 1.0).abs() < 1e-6 && points[1].z_mm.is_nan());
        let found = abi::Detection {
            x_px: 1.0,
            y_px: 2.0,
            width_px: 30.0,
            height_px: 40.0,
            score: 0.5,
            class_index: 1,
            track_id: 9,
        };
        let message = detections_message([(found, "hook")].into_iter(), header(0, "f"));
        let read = boxes(&message).unwrap();
        assert_eq!(read.labels, ["hook"]);
        assert_eq!(read.items, [abi::Detection { class_index: 0, ..found }]);
    }

    #[test]
    fn compressed_pictures_that_are_none_are_errors() {
        let of = |data: &[u8]| CompressedImage { data: Bytes(Cow::Owned(data.to_vec())), ..CompressedImage::default() };
        for data in [&b""[..], b"GIF89a", &[0xff, 0xd8, 0xff, 0xe0, 0], b"\x89PNG\r\n\x1a\n"] {
            assert!(matches!(compressed(&of(data)), Err(ConvertError::Compressed { .. })), "{data:?}");
        }
    }
}
