//! Values as messages of Foxglove.

use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::points_annotation::Type;
use foxglove::messages::{
    CameraCalibration, CircleAnnotation, Color, CompressedImage, ImageAnnotations, JointState, JointStates,
    PackedElementField, Point2, Point3, Point3InFrame, PointCloud, PointsAnnotation, Pose, Quaternion, RawImage,
    TextAnnotation, Timestamp, Vector3,
};
use panoscope_abi as abi;
use panoscope_base::packet::Detections;
use panoscope_data::calibration::ros::messages;
use panoscope_data::formats::array::{self, ArrayFormat};
use panoscope_data::formats::{Pixels, still};

use super::frames::{self, LEFT_RECTIFIED, MM};

const MARK: Color = Color { r: 0.1, g: 0.9, b: 0.3, a: 1.0 };
const LINE_PX: f64 = 2.0;
const FONT_PX: f64 = 14.0;

/// JPEG quality, percent.
const QUALITY: u8 = 90;

/// The pixels as `png` or `jpg`; 8 bits a sample.
///
/// # Errors
/// The encoder's.
pub fn compressed(
    pixels: &Pixels<'_>,
    ending: &str,
    timestamp: Timestamp,
    frame: &str,
) -> std::io::Result<CompressedImage> {
    let mut data = Vec::new();
    still::encode(&mut data, ending, pixels, QUALITY, &mut Vec::new()).map_err(std::io::Error::other)?;
    Ok(CompressedImage {
        timestamp: Some(timestamp),
        frame_id: frame.to_owned(),
        data: data.into(),
        format: if ending == "jpg" { "jpeg" } else { ending }.to_owned(),
    })
}

/// The pixels without compression: for pixels that PNG cannot hold or that Foxglove does not read from PNG. Floats and
/// 16 bits are little-endian.
///
/// # Errors
/// The encoder's.
pub fn raw(pixels: &Pixels<'_>, timestamp: Timestamp, frame: &str) -> std::io::Result<RawImage> {
    let (width, height) = pixels.size();
    let (encoding, pixel) = match pixels {
        Pixels::Gray8(_) => ("mono8", 1),
        Pixels::Bgr8(_) => ("bgr8", 3),
        Pixels::Rgba8(_) => ("rgba8", 4),
        Pixels::Gray16(_) => ("mono16", 2),
        Pixels::F32(_) => ("32FC1", 4),
    };
    let mut data = Vec::with_capacity(width * height * pixel);
    array::write(&mut data, ArrayFormat::Bare, pixels)?;
    Ok(RawImage {
        timestamp: Some(timestamp),
        frame_id: frame.to_owned(),
        width: width as u32,
        height: height as u32,
        encoding: encoding.to_owned(),
        step: (width * pixel) as u32,
        data: data.into(),
    })
}

/// The known points in m, with their colours; the field `filled` is 1 for points that were filled in, 0 for measured
/// ones.
pub fn cloud(points: &[abi::CloudPoint], timestamp: Timestamp) -> PointCloud {
    const STRIDE: usize = 17;
    let mut data = Vec::with_capacity(points.len() * STRIDE);
    for point in points.iter().filter(|point| point.is_known()) {
        for mm in [point.x_mm, point.y_mm, point.z_mm] {
            data.extend(((f64::from(mm) * MM) as f32).to_le_bytes());
        }
        let [blue, green, red] = point.bgr;
        data.extend([red, green, blue, u8::MAX, point.filled]);
    }
    let field = |name: &str, offset: u32, kind: NumericType| PackedElementField {
        name: name.to_owned(),
        offset,
        r#type: kind as i32,
    };
    let places = ["x", "y", "z"].into_iter().zip([0, 4, 8]).map(|(name, at)| field(name, at, NumericType::Float32));
    let colours = ["red", "green", "blue", "alpha", "filled"].into_iter().zip(12..);
    let colours = colours.map(|(name, at)| field(name, at, NumericType::Uint8));
    PointCloud {
        timestamp: Some(timestamp),
        frame_id: LEFT_RECTIFIED.to_owned(),
        pose: Some(Pose {
            position: Some(Vector3 { x: 0.0, y: 0.0, z: 0.0 }),
            orientation: Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
        }),
        point_stride: STRIDE as u32,
        fields: places.chain(colours).collect(),
        data: data.into(),
    }
}

/// Both cameras, left and right.
pub fn cameras(calibration: &abi::Calibration, timestamp: Timestamp) -> [CameraCalibration; 2] {
    let [left, right] = messages(calibration);
    [(left, frames::LEFT), (right, frames::RIGHT)].map(|(camera, frame)| CameraCalibration {
        timestamp: Some(timestamp),
        frame_id: frame.to_owned(),
        width: camera.width,
        height: camera.height,
        // Foxglove has its own name for the lens.
        distortion_model: if camera.model == "equidistant" { "kannala_brandt" } else { camera.model }.to_owned(),
        d: camera.d,
        k: camera.k.to_vec(),
        r: camera.r.to_vec(),
        p: camera.p.to_vec(),
    })
}

/// A box on an image.
fn rectangle([x, y, width, height]: [f64; 4], timestamp: Timestamp) -> PointsAnnotation {
    let corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)];
    PointsAnnotation {
        timestamp: Some(timestamp),
        r#type: Type::LineLoop as i32,
        points: corners.into_iter().map(|(x, y)| Point2 { x, y }).collect(),
        outline_color: Some(MARK),
        thickness: LINE_PX,
        ..PointsAnnotation::default()
    }
}

/// Boxes with their labels, scores and, where tracked, numbers.
pub fn boxes(detections: &Detections<'_>, timestamp: Timestamp) -> ImageAnnotations {
    let mut annotations = ImageAnnotations { timestamp: Some(timestamp), ..ImageAnnotations::default() };
    for item in detections.items() {
        let place = [item.x_px, item.y_px, item.width_px, item.height_px].map(f64::from);
        annotations.points.push(rectangle(place, timestamp));
        let label = detections.label(item.class_index).map_or_else(|| item.class_index.to_string(), str::to_owned);
        let track = if item.track_id >= 0 { format!(" #{}", item.track_id) } else { String::new() };
        annotations.texts.push(TextAnnotation {
            timestamp: Some(timestamp),
            position: Some(Point2 { x: place[0], y: place[1] }),
            text: format!("{label} {:.2}{track}", item.score),
            font_size: FONT_PX,
            text_color: Some(MARK),
            background_color: Some(Color { r: 0.0, g: 0.0, b: 0.0, a: 0.6 }),
            ..TextAnnotation::default()
        });
    }
    annotations
}

/// A rectangle on an image.
pub fn roi(value: &abi::Roi, timestamp: Timestamp) -> ImageAnnotations {
    let place = [value.x, value.y, value.width, value.height].map(f64::from);
    let points = vec![rectangle(place, timestamp)];
    ImageAnnotations { timestamp: Some(timestamp), points, ..ImageAnnotations::default() }
}

/// The tip on the image.
pub fn tip_mark(tip: &abi::Tip, timestamp: Timestamp) -> ImageAnnotations {
    let circle = CircleAnnotation {
        timestamp: Some(timestamp),
        position: Some(Point2 { x: tip.u_px, y: tip.v_px }),
        diameter: 12.0,
        thickness: LINE_PX,
        outline_color: Some(MARK),
        ..CircleAnnotation::default()
    };
    ImageAnnotations { timestamp: Some(timestamp), circles: vec![circle], ..ImageAnnotations::default() }
}

/// The tip in space, in m; `None` if it is not known.
pub fn tip_point(tip: &abi::Tip, timestamp: Timestamp) -> Option<Point3InFrame> {
    let [x, y, z] = tip.xyz_mm.map(|mm| mm * MM);
    (tip.xyz_valid == 1).then(|| Point3InFrame {
        timestamp: Some(timestamp),
        frame_id: LEFT_RECTIFIED.to_owned(),
        point: Some(Point3 { x, y, z }),
    })
}

/// Angles in rad and speeds in rad/s of the joints in use.
pub fn joints(joints: &abi::Joints, timestamp: Timestamp) -> JointStates {
    let count = (joints.count as usize).min(abi::MAX_JOINTS);
    let states = (0..count).map(|at| JointState {
        name: format!("joint_{at}"),
        position: Some(joints.position_rad[at]),
        velocity: Some(joints.velocity_rad_s[at]),
        ..JointState::default()
    });
    JointStates { timestamp: Some(timestamp), joints: states.collect() }
}
