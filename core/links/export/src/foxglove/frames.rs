//! Coordinate frames of spatial data. Lengths are in m, as in Foxglove and ROS.

use foxglove::messages::{FrameTransform, FrameTransforms, Pose, Quaternion, Timestamp, Vector3};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use panoscope_abi as abi;
use panoscope_base::packet;

/// Metres in a millimetre.
pub const MM: f64 = 1e-3;
/// The left camera.
pub const LEFT: &str = "left";
/// The right camera.
pub const RIGHT: &str = "right";
/// The left camera after rectification: points, depth and tips are in it.
pub const LEFT_RECTIFIED: &str = "left_rectified";
/// The right camera after rectification.
const RIGHT_RECTIFIED: &str = "right_rectified";

/// The frame of an image, by the output's name.
pub fn of_picture(port: &str, packet: &str) -> &'static str {
    let output = port.rsplit_once('.').map_or(port, |(_, output)| output);
    match packet {
        "disparity" | "depth" | "confidence" => LEFT_RECTIFIED,
        _ if output.contains("right") => RIGHT,
        _ => LEFT,
    }
}

pub fn metres(mm: [f64; 3]) -> Vector3 {
    Vector3 { x: mm[0] * MM, y: mm[1] * MM, z: mm[2] * MM }
}

fn quaternion(wxyz: [f64; 4]) -> Quaternion {
    let [w, x, y, z] = wxyz;
    Quaternion { x, y, z, w }
}

/// Pose of `b` in `a`.
pub fn pose(value: &abi::Pose) -> Pose {
    Pose { position: Some(metres(value.a_from_b_mm)), orientation: Some(quaternion(value.a_from_b_wxyz)) }
}

/// A transform between two frames; `None` if one has no name.
pub fn transform(value: &abi::Pose, timestamp: Timestamp) -> Option<FrameTransform> {
    let (parent_frame_id, child_frame_id) = (packet::name(&value.a), packet::name(&value.b));
    let is_named = !parent_frame_id.is_empty() && !child_frame_id.is_empty();
    is_named.then(|| FrameTransform {
        timestamp: Some(timestamp),
        parent_frame_id,
        child_frame_id,
        translation: Some(metres(value.a_from_b_mm)),
        rotation: Some(quaternion(value.a_from_b_wxyz)),
    })
}

/// Poses of cameras and rectified cameras: the inverse of the calibration's transforms.
pub fn of_calibration(calibration: &abi::Calibration, timestamp: Timestamp) -> FrameTransforms {
    let mut transforms =
        vec![inverse(LEFT, RIGHT, &calibration.right_from_left_rotation, calibration.right_from_left_mm, timestamp)];
    if is_rectifiable(calibration) {
        let rectified = [
            (LEFT, LEFT_RECTIFIED, &calibration.rectified_from_left),
            (RIGHT, RIGHT_RECTIFIED, &calibration.rectified_from_right),
        ];
        transforms
            .extend(rectified.map(|(parent, child, rotation)| inverse(parent, child, rotation, [0.0; 3], timestamp)));
    }
    FrameTransforms { transforms }
}

/// Whether the calibration has a rectification.
pub fn is_rectifiable(calibration: &abi::Calibration) -> bool {
    calibration.left_projection != [0.0; 12]
}

/// The transform of frame `child` in `parent` from `child = rotation * parent + mm`.
fn inverse(parent: &str, child: &str, rotation: &[f64; 9], mm: [f64; 3], timestamp: Timestamp) -> FrameTransform {
    let parent_from_child = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(rotation)).inverse();
    let at = -(parent_from_child * nalgebra::Vector3::from(mm));
    let turned = UnitQuaternion::from_rotation_matrix(&parent_from_child);
    FrameTransform {
        timestamp: Some(timestamp),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child.to_owned(),
        translation: Some(metres(at.into())),
        rotation: Some(quaternion([turned.w, turned.i, turned.j, turned.k])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_of_a_picture_is_that_of_its_camera() {
        assert_eq!(of_picture("scope.left", "image"), LEFT);
        assert_eq!(of_picture("right_part/scope.left", "image"), LEFT);
        assert_eq!(of_picture("rectify.right", "image"), RIGHT);
        assert_eq!(of_picture("match.disparity", "disparity"), LEFT_RECTIFIED);
    }

    #[test]
    fn the_right_camera_stands_where_the_calibration_says() {
        // A quarter turn about z and 15 mm: right = R left + t.
        let rotation = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let transform = inverse(LEFT, RIGHT, &rotation, [-15.0, 0.0, 0.0], Timestamp::new(0, 0));
        let (at, turned) = (transform.translation.unwrap(), transform.rotation.unwrap());
        // The origin of the right camera: R^T (0 - t).
        assert!((at.x - 0.0).abs() < 1e-12 && (at.y + 0.015).abs() < 1e-12 && at.z.abs() < 1e-12, "{at:?}");
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((turned.w - half).abs() < 1e-12 && (turned.z + half).abs() < 1e-12, "{turned:?}");
    }
}
