//! Messages of ROS 2. Fields have the names, types and order of the published definitions.

use std::borrow::Cow;
use std::ops::Deref;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::cdr::Message;

/// A list of bytes that is copied in one piece.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bytes<'b>(pub Cow<'b, [u8]>);

impl Deref for Bytes<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}

impl Serialize for Bytes<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.0)
    }
}

impl<'de: 'b, 'b> Deserialize<'de> for Bytes<'b> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Borrowing;
        impl<'de> de::Visitor<'de> for Borrowing {
            type Value = Bytes<'de>;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("bytes")
            }

            fn visit_borrowed_bytes<E: de::Error>(self, bytes: &'de [u8]) -> Result<Bytes<'de>, E> {
                Ok(Bytes(Cow::Borrowed(bytes)))
            }

            fn visit_bytes<E: de::Error>(self, bytes: &[u8]) -> Result<Bytes<'de>, E> {
                Ok(Bytes(Cow::Owned(bytes.to_vec())))
            }
        }
        deserializer.deserialize_bytes(Borrowing)
    }
}

/// `builtin_interfaces/msg/Time`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds.
    pub sec: i32,
    /// Nanoseconds within the second.
    pub nanosec: u32,
}

impl Time {
    /// The time `ns` nanoseconds after 1970, or after another origin of times. Times beyond 2038 are clamped.
    pub fn from_ns(ns: i64) -> Self {
        match i32::try_from(ns.div_euclid(1_000_000_000)) {
            Ok(sec) => Self { sec, nanosec: ns.rem_euclid(1_000_000_000) as u32 },
            Err(_) if ns < 0 => Self { sec: i32::MIN, nanosec: 0 },
            Err(_) => Self { sec: i32::MAX, nanosec: 999_999_999 },
        }
    }

    /// Nanoseconds.
    pub fn ns(self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }
}

/// `std_msgs/msg/Header`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// When the data was taken.
    pub stamp: Time,
    /// Frame of the data.
    pub frame_id: String,
}

/// `sensor_msgs/msg/Image`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Image<'b> {
    /// Time and optical frame of the camera.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Such as `bgr8`, `mono8`, `16UC1`, `32FC1`.
    pub encoding: String,
    /// Whether numbers of several bytes have the highest first.
    pub is_bigendian: u8,
    /// Bytes from one row to the next.
    pub step: u32,
    /// Pixels, `step * height` bytes.
    #[serde(borrow)]
    pub data: Bytes<'b>,
}

/// `sensor_msgs/msg/CompressedImage`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CompressedImage<'b> {
    /// Time and optical frame of the camera.
    pub header: Header,
    /// `jpeg`, `png`, or a text that contains one of them.
    pub format: String,
    /// Bytes of the image file.
    #[serde(borrow)]
    pub data: Bytes<'b>,
}

/// `sensor_msgs/msg/RegionOfInterest`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionOfInterest {
    /// First column.
    pub x_offset: u32,
    /// First row.
    pub y_offset: u32,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Whether the region has to be rectified.
    pub do_rectify: bool,
}

/// `sensor_msgs/msg/CameraInfo`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Time and optical frame of the camera.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// `plumb_bob`, `rational_polynomial`, `equidistant`.
    pub distortion_model: String,
    /// Its coefficients.
    pub d: Vec<f64>,
    /// Camera matrix of the raw image, by rows.
    pub k: [f64; 9],
    /// Rotation from the camera to the rectified camera, by rows.
    pub r: [f64; 9],
    /// Projection of the rectified camera, by rows; the last column is in px times m.
    pub p: [f64; 12],
    /// Number of combined columns.
    pub binning_x: u32,
    /// Number of combined rows.
    pub binning_y: u32,
    /// Region of the sensor.
    pub roi: RegionOfInterest,
}

/// `stereo_msgs/msg/DisparityImage`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DisparityImage<'b> {
    /// Time and frame of the left rectified camera.
    pub header: Header,
    /// Disparity in px, 32FC1.
    #[serde(borrow)]
    pub image: Image<'b>,
    /// Focal length in px.
    pub f: f32,
    /// Baseline in m.
    pub t: f32,
    /// Region with values.
    pub valid_window: RegionOfInterest,
    /// Smallest disparity that was searched.
    pub min_disparity: f32,
    /// Largest disparity that was searched.
    pub max_disparity: f32,
    /// Smallest difference of disparities.
    pub delta_d: f32,
}

/// `sensor_msgs/msg/PointField`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointField {
    /// Name, such as `x`, `rgb`.
    pub name: String,
    /// Bytes from the start of a point.
    pub offset: u32,
    /// One of the constants of [`point_type`].
    pub datatype: u8,
    /// Number of values.
    pub count: u32,
}

/// Types of a field of a point.
pub mod point_type {
    /// Unsigned, 8 bits.
    pub const UINT8: u8 = 2;
    /// Unsigned, 32 bits.
    pub const UINT32: u8 = 6;
    /// Floating point, 32 bits.
    pub const FLOAT32: u8 = 7;
    /// Floating point, 64 bits.
    pub const FLOAT64: u8 = 8;
}

/// `sensor_msgs/msg/PointCloud2`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PointCloud2<'b> {
    /// Time and frame.
    pub header: Header,
    /// Rows; 1 for points without order.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Fields of a point.
    pub fields: Vec<PointField>,
    /// Whether numbers have the highest byte first.
    pub is_bigendian: bool,
    /// Bytes of a point.
    pub point_step: u32,
    /// Bytes of a row.
    pub row_step: u32,
    /// The points.
    #[serde(borrow)]
    pub data: Bytes<'b>,
    /// Whether all points are known.
    pub is_dense: bool,
}

/// `geometry_msgs/msg/Point`, `Vector3`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// x, m.
    pub x: f64,
    /// y, m.
    pub y: f64,
    /// z, m.
    pub z: f64,
}

/// `geometry_msgs/msg/Quaternion`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// First imaginary part.
    pub x: f64,
    /// Second imaginary part.
    pub y: f64,
    /// Third imaginary part.
    pub z: f64,
    /// Real part.
    pub w: f64,
}

/// `geometry_msgs/msg/Pose`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position, m.
    pub position: Point,
    /// Orientation, a unit quaternion.
    pub orientation: Quaternion,
}

/// `geometry_msgs/msg/PoseStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// Time, and the frame that the pose is in.
    pub header: Header,
    /// The pose.
    pub pose: Pose,
}

/// `geometry_msgs/msg/PoseWithCovariance`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// The pose.
    pub pose: Pose,
    /// 6 x 6 numbers, by rows. Stored as two halves, because serde does not support arrays of more than 32.
    pub covariance: [[f64; 18]; 2],
}

/// `sensor_msgs/msg/JointState`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// Time.
    pub header: Header,
    /// Names of the joints.
    pub name: Vec<String>,
    /// Angles, rad.
    pub position: Vec<f64>,
    /// Speeds, rad/s.
    pub velocity: Vec<f64>,
    /// Torques, Nm.
    pub effort: Vec<f64>,
}

/// `vision_msgs/msg/Point2D`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point2D {
    /// x, px.
    pub x: f64,
    /// y, px.
    pub y: f64,
}

/// `vision_msgs/msg/Pose2D`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose2D {
    /// Position, px.
    pub position: Point2D,
    /// Rotation, rad.
    pub theta: f64,
}

/// `vision_msgs/msg/BoundingBox2D`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BoundingBox2D {
    /// Centre.
    pub center: Pose2D,
    /// Width in px.
    pub size_x: f64,
    /// Height in px.
    pub size_y: f64,
}

/// `vision_msgs/msg/ObjectHypothesis`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectHypothesis {
    /// Name of the class.
    pub class_id: String,
    /// Score, 0 to 1.
    pub score: f64,
}

/// `vision_msgs/msg/ObjectHypothesisWithPose`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectHypothesisWithPose {
    /// Class and score.
    pub hypothesis: ObjectHypothesis,
    /// Not used by boxes on images.
    pub pose: PoseWithCovariance,
}

/// `vision_msgs/msg/Detection2D`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Detection2D {
    /// Time and frame.
    pub header: Header,
    /// Classes with their scores.
    pub results: Vec<ObjectHypothesisWithPose>,
    /// The box.
    pub bbox: BoundingBox2D,
    /// Number of the track; empty without one.
    pub id: String,
}

/// `vision_msgs/msg/Detection2DArray`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Detection2DArray {
    /// Time and frame.
    pub header: Header,
    /// The boxes.
    pub detections: Vec<Detection2D>,
}

impl Message for Image<'_> {
    const TYPE: &'static str = "sensor_msgs/msg/Image";

    fn size_hint(&self) -> usize {
        self.data.len() + 256
    }
}

impl Message for CompressedImage<'_> {
    const TYPE: &'static str = "sensor_msgs/msg/CompressedImage";

    fn size_hint(&self) -> usize {
        self.data.len() + 256
    }
}

impl Message for CameraInfo {
    const TYPE: &'static str = "sensor_msgs/msg/CameraInfo";
}

impl Message for DisparityImage<'_> {
    const TYPE: &'static str = "stereo_msgs/msg/DisparityImage";

    fn size_hint(&self) -> usize {
        self.image.data.len() + 512
    }
}

impl Message for PointCloud2<'_> {
    const TYPE: &'static str = "sensor_msgs/msg/PointCloud2";

    fn size_hint(&self) -> usize {
        self.data.len() + 512
    }
}

impl Message for PoseStamped {
    const TYPE: &'static str = "geometry_msgs/msg/PoseStamped";
}

impl Message for JointState {
    const TYPE: &'static str = "sensor_msgs/msg/JointState";
}

impl Message for Detection2DArray {
    const TYPE: &'static str = "vision_msgs/msg/Detection2DArray";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_go_there_and_back() {
        for ns in [0, 1, -1, 1_700_000_000_123_456_789, -2_000_000_001] {
            assert_eq!(Time::from_ns(ns).ns(), ns);
        }
        assert_eq!(Time::from_ns(i64::MAX), Time { sec: i32::MAX, nanosec: 999_999_999 });
    }
}
