//! Packets as messages.

use std::borrow::Cow;

use panoscope_abi as abi;
use panoscope_base::View;
use panoscope_base::packet;
use panoscope_data::calibration::ros::messages;
use panoscope_data::formats::{Pixels, still};

use crate::messages::{
    BoundingBox2D, Bytes, CameraInfo, CompressedImage, Detection2D, Detection2DArray, DisparityImage, Header, Image,
    JointState, ObjectHypothesis, ObjectHypothesisWithPose, Point, Point2D, PointCloud2, PointField, Pose, Pose2D,
    PoseStamped, Quaternion, RegionOfInterest, Time, point_type,
};
use crate::names;

/// Metres in a millimetre.
const MM: f64 = 1e-3;
/// Bytes of a point in a message.
const POINT_BYTES: usize = 16;
/// JPEG quality, percent.
const QUALITY: u8 = 90;

/// The header of data that was taken at `capture_ns`.
pub fn header(capture_ns: i64, frame_id: &str) -> Header {
    Header { stamp: Time::from_ns(capture_ns), frame_id: frame_id.to_owned() }
}

/// Rows without padding, little-endian.
fn bytes_of<'a, T: Copy, const N: usize>(view: &View<'a, T>, number: impl Fn(T) -> [u8; N]) -> Bytes<'a> {
    let mut data = Vec::with_capacity(view.width * view.height * N);
    for y in 0..view.height {
        data.extend(view.row(y).iter().flat_map(|value| number(*value)));
    }
    Bytes(Cow::Owned(data))
}

/// As [`bytes_of`]; rows without padding are borrowed.
fn plain_bytes<'a>(view: &View<'a, u8>) -> Bytes<'a> {
    let row = view.width * view.channels;
    if view.stride == row
        && let Some(data) = view.data.get(..row * view.height)
    {
        return Bytes(Cow::Borrowed(data));
    }
    let mut data = Vec::with_capacity(row * view.height);
    (0..view.height).for_each(|y| data.extend_from_slice(view.row(y)));
    Bytes(Cow::Owned(data))
}

/// An image. `scale` multiplies floats: 0.001 for depth, which is in m in ROS.
pub fn image_message<'a>(pixels: &Pixels<'a>, scale: f32, header: Header) -> Image<'a> {
    let (width, height) = pixels.size();
    let (encoding, pixel, data) = match pixels {
        Pixels::Gray8(view) => ("mono8", 1, plain_bytes(view)),
        Pixels::Bgr8(view) => ("bgr8", 3, plain_bytes(view)),
        Pixels::Rgba8(view) => ("rgba8", 4, plain_bytes(view)),
        Pixels::Gray16(view) => ("mono16", 2, bytes_of(view, u16::to_le_bytes)),
        Pixels::F32(view) => ("32FC1", 4, bytes_of(view, |value| (value * scale).to_le_bytes())),
    };
    Image {
        header,
        height: height as u32,
        width: width as u32,
        encoding: encoding.to_owned(),
        is_bigendian: 0,
        step: (width * pixel) as u32,
        data,
    }
}

/// An image of 8 bits as JPEG.
///
/// # Errors
/// The encoder's.
pub fn jpeg_message(pixels: &Pixels<'_>, header: Header) -> std::io::Result<CompressedImage<'static>> {
    let mut data = Vec::new();
    still::encode(&mut data, "jpg", pixels, QUALITY, &mut Vec::new()).map_err(std::io::Error::other)?;
    Ok(CompressedImage { header, format: "jpeg".to_owned(), data: Bytes(Cow::Owned(data)) })
}

/// The cameras, left and right.
pub fn camera_infos(calibration: &abi::Calibration, capture_ns: i64) -> [CameraInfo; 2] {
    let [left, right] = messages(calibration);
    [(left, names::LEFT), (right, names::RIGHT)].map(|(camera, frame)| CameraInfo {
        header: header(capture_ns, frame),
        height: camera.height,
        width: camera.width,
        distortion_model: camera.model.to_owned(),
        d: camera.d,
        k: camera.k,
        r: camera.r,
        p: camera.p,
        ..CameraInfo::default()
    })
}

/// A map of disparity. Without a calibration, focal length and baseline are 0.
pub fn disparity_message<'a>(
    disparity: &View<'a, f32>,
    calibration: Option<&abi::Calibration>,
    header: Header,
) -> DisparityImage<'a> {
    let image = image_message(&Pixels::F32(*disparity), 1.0, header.clone());
    let (mut low, mut high) = (f32::INFINITY, 0.0f32);
    for value in (0..disparity.height).flat_map(|y| disparity.row(y)).filter(|value| value.is_finite()) {
        (low, high) = (low.min(*value), high.max(*value));
    }
    let window = RegionOfInterest { width: image.width, height: image.height, ..RegionOfInterest::default() };
    DisparityImage {
        header,
        image,
        f: calibration.map_or(0.0, |calibration| calibration.left_projection[0] as f32),
        t: calibration.map_or(0.0, |calibration| (calibration.baseline_mm * MM) as f32),
        valid_window: window,
        min_disparity: if low.is_finite() { low } else { 0.0 },
        max_disparity: high,
        delta_d: 1.0 / 16.0,
    }
}

/// The points in rows of `width`, in m, unknown ones as NaN. The field `filled` is 1 for points that were filled in, 0
/// for measured ones.
pub fn points_message(
    points: impl ExactSizeIterator<Item = abi::CloudPoint>,
    width: usize,
    header: Header,
) -> PointCloud2<'static> {
    let count = points.len();
    let mut data = Vec::with_capacity(count * POINT_BYTES);
    let mut is_dense = true;
    for point in points {
        for mm in [point.x_mm, point.y_mm, point.z_mm] {
            is_dense &= mm.is_finite();
            data.extend(((f64::from(mm) * MM) as f32).to_le_bytes());
        }
        let [blue, green, red] = point.bgr;
        // A number of 32 bits, 0x00RRGGBB, that is stored as a float. Readers of colours ignore its highest byte, which is the field `filled`.
        data.extend([blue, green, red, point.filled]);
    }
    let field = |name: &str, offset, datatype| PointField { name: name.to_owned(), offset, datatype, count: 1 };
    let floats = [("x", 0), ("y", 4), ("z", 8), ("rgb", 12)].map(|(name, at)| field(name, at, point_type::FLOAT32));
    let rows = count.checked_div(width).unwrap_or(0);
    PointCloud2 {
        header,
        height: rows as u32,
        width: width as u32,
        fields: floats.into_iter().chain([field("filled", 15, point_type::UINT8)]).collect(),
        is_bigendian: false,
        point_step: POINT_BYTES as u32,
        row_step: (width * POINT_BYTES) as u32,
        data: Bytes(Cow::Owned(data)),
        is_dense,
    }
}

/// Boxes with their labels; `class_id` has the class name, `id` the track number.
pub fn detections_message<'l>(
    boxes: impl Iterator<Item = (abi::Detection, &'l str)>,
    header: Header,
) -> Detection2DArray {
    let one = |(item, label): (abi::Detection, &str)| {
        let [x, y, width, height] = [item.x_px, item.y_px, item.width_px, item.height_px].map(f64::from);
        let class_id = if label.is_empty() { item.class_index.to_string() } else { label.to_owned() };
        let hypothesis = ObjectHypothesis { class_id, score: f64::from(item.score) };
        Detection2D {
            header: header.clone(),
            results: vec![ObjectHypothesisWithPose { hypothesis, ..ObjectHypothesisWithPose::default() }],
            bbox: BoundingBox2D {
                center: Pose2D { position: Point2D { x: x + width / 2.0, y: y + height / 2.0 }, theta: 0.0 },
                size_x: width,
                size_y: height,
            },
            id: if item.track_id >= 0 { item.track_id.to_string() } else { String::new() },
        }
    };
    let detections = boxes.map(one).collect();
    Detection2DArray { header, detections }
}

/// Pose of `b` in `a`; the frame of the header is `a`.
pub fn pose_message(pose: &abi::Pose, capture_ns: i64) -> PoseStamped {
    let [w, x, y, z] = pose.a_from_b_wxyz;
    let [px, py, pz] = pose.a_from_b_mm.map(|mm| mm * MM);
    PoseStamped {
        header: header(capture_ns, &packet::name(&pose.a)),
        pose: Pose { position: Point { x: px, y: py, z: pz }, orientation: Quaternion { x, y, z, w } },
    }
}

/// Angles and speeds of the joints in use.
pub fn joint_message(joints: &abi::Joints, capture_ns: i64) -> JointState {
    let count = (joints.count as usize).min(abi::MAX_JOINTS);
    JointState {
        header: header(capture_ns, ""),
        name: (0..count).map(|at| format!("joint_{at}")).collect(),
        position: joints.position_rad[..count].to_vec(),
        velocity: joints.velocity_rad_s[..count].to_vec(),
        effort: Vec::new(),
    }
}
