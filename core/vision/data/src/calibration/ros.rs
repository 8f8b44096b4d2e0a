//! ROS `camera_info`: files in YAML, one per camera, and messages; lengths in metres.

use panoscope_abi::{Calibration, Camera};

use crate::calibration::document::Node;
use crate::calibration::error::Mistake;

const MM_PER_M: f64 = 1000.0;

/// Whether the document is a `camera_info`.
pub(crate) fn is(document: &Node) -> bool {
    document.get("projection_matrix").is_some() && document.get("rectification_matrix").is_some()
}

/// What a `camera_info` states of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraInfo {
    /// The raw camera.
    pub camera: Camera,
    /// Rotation from the camera to the rectified one, by rows.
    pub rectification: [f64; 9],
    /// Projection of the rectified camera, by rows; the last column in px times m.
    pub projection: [f64; 12],
}

/// Why a message is no camera of a calibration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CameraInfoError {
    /// Another distortion model.
    #[error("the distortion model `{model}` is not supported: plumb_bob and rational_polynomial are")]
    Model {
        /// Its name.
        model: String,
    },
    /// A number of coefficients that the model does not have.
    #[error("{count} distortion coefficients do not belong to the model {model}")]
    Coefficients {
        /// How many there are.
        count: usize,
        /// Name of the model.
        model: String,
    },
    /// Numbers of a camera that is not calibrated.
    #[error(
        "the cameras are not calibrated as a stereo pair: the projection of the right one has no focal length or no baseline"
    )]
    NoPair,
}

/// The coefficients of a model, in the order of the packet.
fn coefficients(model: &str, all: &[f64]) -> Result<[f64; 14], CameraInfoError> {
    let longest = match model {
        "plumb_bob" | "" => 5,
        "rational_polynomial" => 14,
        _ => return Err(CameraInfoError::Model { model: model.to_owned() }),
    };
    if all.len() > longest || ![0, 4, 5, 8, 12, 14].contains(&all.len()) {
        return Err(CameraInfoError::Coefficients { count: all.len(), model: model.to_owned() });
    }
    let mut distortion = [0.0; 14];
    distortion[..all.len()].copy_from_slice(all);
    Ok(distortion)
}

impl CameraInfo {
    /// From the fields of a message `sensor_msgs/msg/CameraInfo`: size in px, model, its coefficients, and the matrices K, R and P by rows.
    ///
    /// # Errors
    /// The model or its coefficients are unknown.
    pub fn of_message(
        (width, height): (u32, u32),
        model: &str,
        coefficients_of_model: &[f64],
        (k, r, p): (&[f64; 9], &[f64; 9], &[f64; 12]),
    ) -> Result<Self, CameraInfoError> {
        let distortion = coefficients(model, coefficients_of_model)?;
        let camera = Camera { width, height, fx: k[0], fy: k[4], cx: k[2], cy: k[5], distortion };
        Ok(Self { camera, rectification: *r, projection: *p })
    }

    /// The model and the matrices of a camera for a message: model, coefficients, K, R, P. Without a rectification in the calibration R is the
    /// identity and P has the raw camera.
    pub fn to_message(
        camera: &Camera,
        (rectified_from_camera, projection): (&[f64; 9], &[f64; 12]),
    ) -> (&'static str, Vec<f64>, [f64; 9], [f64; 9], [f64; 12]) {
        let Camera { fx, fy, cx, cy, distortion, .. } = *camera;
        let used = distortion.iter().rposition(|value| *value != 0.0).map_or(0, |last| last + 1);
        let (model, count) = match used {
            0..=5 => ("plumb_bob", 5),
            6..=8 => ("rational_polynomial", 8),
            9..=12 => ("rational_polynomial", 12),
            _ => ("rational_polynomial", 14),
        };
        let (r, p) = if *projection == [0.0; 12] {
            ([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0])
        } else {
            // The last column is that of a length: the offset of the cameras times the focal length.
            let p = std::array::from_fn(|at| if at % 4 == 3 { projection[at] / MM_PER_M } else { projection[at] });
            (*rectified_from_camera, p)
        };
        (model, distortion[..count].to_vec(), [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], r, p)
    }
}

fn info(document: &Node) -> Result<CameraInfo, Mistake> {
    let get = |key: &str| {
        document.get(key).ok_or_else(|| {
            Mistake::whole(format!("`{key}` is missing: the file is cut off, or no camera_info of a stereo pair"))
        })
    };
    let k: [f64; 9] = get("camera_matrix")?.exactly("camera_matrix")?;
    let mut distortion = [0.0; 14];
    if let Some(node) = document.get("distortion_coefficients") {
        let all = node.numbers("distortion_coefficients")?;
        let model = document.get("distortion_model").and_then(Node::text).unwrap_or("plumb_bob");
        distortion = coefficients(model, &all).map_err(|error| node.mistake(error.to_string()))?;
    }
    Ok(CameraInfo {
        camera: Camera {
            width: get("image_width")?.pixels("image_width")?,
            height: get("image_height")?.pixels("image_height")?,
            fx: k[0],
            fy: k[4],
            cx: k[2],
            cy: k[5],
            distortion,
        },
        rectification: get("rectification_matrix")?.exactly("rectification_matrix")?,
        projection: get("projection_matrix")?.exactly("projection_matrix")?,
    })
}

/// Converts a left and a right file to the packet; a mistake comes with the index of its file.
pub(crate) fn packet(left: &Node, right: &Node) -> Result<Calibration, (usize, Mistake)> {
    Ok(pair(&info(left).map_err(|m| (0, m))?, &info(right).map_err(|m| (1, m))?))
}

/// The calibration of two cameras whose messages came together.
///
/// # Errors
/// They are not calibrated as a pair.
pub fn calibration(left: &CameraInfo, right: &CameraInfo) -> Result<Calibration, CameraInfoError> {
    let calibration = pair(left, right);
    let is_pair = calibration.baseline_mm.is_finite() && calibration.baseline_mm > 0.0;
    if is_pair { Ok(calibration) } else { Err(CameraInfoError::NoPair) }
}

fn pair(left: &CameraInfo, right: &CameraInfo) -> Calibration {
    let (r1, r2) = (&left.rectification, &right.rectification);
    // Right from left goes by way of the rectified frame, in which the cameras differ by the baseline alone.
    let turn = |row: usize, column: usize| (0..3).map(|k| r2[3 * k + row] * r1[3 * k + column]).sum::<f64>();
    let rotation = std::array::from_fn(|index| turn(index / 3, index % 3));
    let shift_mm = right.projection[3] / right.projection[0] * MM_PER_M;
    let in_mm = |mut projection: [f64; 12]| {
        projection[3] *= MM_PER_M;
        projection
    };
    Calibration {
        left: left.camera,
        right: right.camera,
        right_from_left_rotation: rotation,
        right_from_left_mm: [r2[0] * shift_mm, r2[1] * shift_mm, r2[2] * shift_mm],
        rectified_from_left: *r1,
        rectified_from_right: *r2,
        left_projection: in_mm(left.projection),
        right_projection: in_mm(right.projection),
        baseline_mm: shift_mm.abs(),
        rms_px: f64::NAN,
        is_rectified: 0,
        reserved: 0,
    }
}
