//! ROS `camera_info`: files in YAML, one per camera, and messages; lengths in metres.

use panoscope_abi::{Calibration, Camera};

use crate::calibration::EYE3;
use crate::calibration::document::Node;
use crate::calibration::error::Mistake;
use crate::calibration::{EQUIDISTANT, equidistant, equidistant_of, no_camera_matrix, packet};

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
    #[error("the distortion model `{model}` is not supported: plumb_bob, rational_polynomial and equidistant are")]
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
    /// A rotation that turns nothing into nothing.
    #[error(
        "its rectification R is all zero: calibrate the cameras again, or set R to the identity if the views are rectified"
    )]
    NoRotation,
    /// A window that has no pixels.
    #[error("its binning {x} x {y} leaves no pixels of {width}x{height}")]
    Window {
        /// Columns that are one.
        x: u32,
        /// Rows that are one.
        y: u32,
        /// Columns before binning.
        width: u32,
        /// Rows before binning.
        height: u32,
    },
    /// Numbers of a camera that is not calibrated.
    #[error(
        "the cameras are not calibrated as a stereo pair: the projection of the right one has no focal length or no baseline"
    )]
    NoPair,
}

/// The coefficients of a model, in the order of the packet.
fn coefficients(model: &str, all: &[f64]) -> Result<[f64; 14], CameraInfoError> {
    if EQUIDISTANT.contains(&model) {
        let count = || CameraInfoError::Coefficients { count: all.len(), model: model.to_owned() };
        return Ok(equidistant(all.try_into().map_err(|_| count())?));
    }
    // Some drivers write one zero for a camera without distortion.
    if all.iter().all(|value| *value == 0.0) && all.len() <= 14 {
        return Ok([0.0; 14]);
    }
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

/// The part of a sensor that an image shows, as a message `sensor_msgs/msg/CameraInfo` states it. K and P are those of the whole sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Window {
    /// Columns and rows of the sensor that are one in the image; 0 is 1.
    pub binning: (u32, u32),
    /// First column and row.
    pub offset_px: (u32, u32),
    /// Columns and rows of the sensor; 0 is all.
    pub size_px: (u32, u32),
}

impl Window {
    fn binning(&self) -> (u32, u32) {
        (self.binning.0.max(1), self.binning.1.max(1))
    }

    /// Size of the image of a sensor.
    fn size_of_image(&self, sensor: (u32, u32)) -> Result<(u32, u32), CameraInfoError> {
        let (x, y) = self.binning();
        let of = |part: u32, whole: u32| if part == 0 { whole } else { part };
        let (width, height) = (of(self.size_px.0, sensor.0), of(self.size_px.1, sensor.1));
        let size = (width / x, height / y);
        // A size of 0 is not stated.
        if (width > 0 && size.0 == 0) || (height > 0 && size.1 == 0) {
            return Err(CameraInfoError::Window { x, y, width, height });
        }
        Ok(size)
    }

    /// A matrix of the whole sensor, of `N / 3` columns, as one of the image. Rows count in px of the sensor; the third column has the offset.
    fn of_image<const N: usize>(&self, mut matrix: [f64; N]) -> [f64; N] {
        let columns = N / 3;
        let (x, y) = self.binning();
        for (row, (offset, step)) in [(self.offset_px.0, x), (self.offset_px.1, y)].into_iter().enumerate() {
            let row = &mut matrix[row * columns..][..columns];
            row[2] -= f64::from(offset);
            row.iter_mut().for_each(|value| *value /= f64::from(step));
        }
        matrix
    }
}

impl CameraInfo {
    /// From the fields of a message `sensor_msgs/msg/CameraInfo`: size in px, model, its coefficients, the matrices K, R and P by rows, and the part
    /// of the sensor that is in the image.
    ///
    /// # Errors
    /// The model or its coefficients are unknown, R is all zero, or no pixels are left.
    pub fn of_message(
        size: (u32, u32),
        model: &str,
        coefficients_of_model: &[f64],
        (k, r, p): (&[f64; 9], &[f64; 9], &[f64; 12]),
        window: Window,
    ) -> Result<Self, CameraInfoError> {
        let distortion = coefficients(model, coefficients_of_model)?;
        if *r == [0.0; 9] {
            return Err(CameraInfoError::NoRotation);
        }
        let (width, height) = window.size_of_image(size)?;
        let k = window.of_image(*k);
        let camera = Camera { width, height, fx: k[0], fy: k[4], cx: k[2], cy: k[5], distortion };
        Ok(Self { camera, rectification: *r, projection: window.of_image(*p) })
    }

    /// Whether its images are rectified already: no distortion, no rotation, and the projection of the camera itself.
    fn is_rectified(&self) -> bool {
        let Camera { fx, fy, cx, cy, distortion, .. } = self.camera;
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-6 * fx.abs();
        let p = &self.projection;
        distortion == [0.0; 14]
            && self.rectification.iter().zip(&EYE3).all(|(a, b)| (a - b).abs() <= 1e-9)
            && near(p[0], fx)
            && near(p[5], fy)
            && near(p[2], cx)
            && near(p[6], cy)
    }
}

/// The fields of a message `sensor_msgs/msg/CameraInfo` that describe a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraMessage {
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// `plumb_bob`, `rational_polynomial` or `equidistant`.
    pub model: &'static str,
    /// Its coefficients.
    pub d: Vec<f64>,
    /// Camera matrix, by rows.
    pub k: [f64; 9],
    /// Rotation from the camera to the rectified one, by rows.
    pub r: [f64; 9],
    /// Projection of the rectified camera, by rows; the last column in px times m.
    pub p: [f64; 12],
}

/// Both cameras for messages, left and right.
///
/// Messages have no other place for the pose between the cameras than R and P, so a calibration without a rectification gets one. A pair that cannot
/// be rectified becomes two cameras that know nothing of each other: R is the identity, and P has the raw camera.
pub fn messages(calibration: &Calibration) -> [CameraMessage; 2] {
    let mut given = *calibration;
    if !packet::states_rectification(calibration) {
        given = match packet::rectification(calibration) {
            Ok(rectification) => packet::with_rectification(calibration, &rectification),
            Err(_) => {
                let p = |c: &Camera| [c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0];
                let (left_projection, right_projection) = (p(&given.left), p(&given.right));
                let (rectified_from_left, rectified_from_right) = (EYE3, EYE3);
                Calibration { left_projection, right_projection, rectified_from_left, rectified_from_right, ..given }
            }
        };
    }
    [
        message(&given.left, given.rectified_from_left, given.left_projection),
        message(&given.right, given.rectified_from_right, given.right_projection),
    ]
}

fn message(camera: &Camera, r: [f64; 9], mut p: [f64; 12]) -> CameraMessage {
    let Camera { width, height, fx, fy, cx, cy, distortion } = *camera;
    let used = distortion.iter().rposition(|value| *value != 0.0).map_or(0, |last| last + 1);
    let (model, count) = match used {
        _ if equidistant_of(camera).is_some() => (EQUIDISTANT[0], 4),
        0..=5 => ("plumb_bob", 5),
        6..=8 => ("rational_polynomial", 8),
        9..=12 => ("rational_polynomial", 12),
        _ => ("rational_polynomial", 14),
    };
    // The last column is that of a length: the offset of the cameras times the focal length.
    [3, 7, 11].into_iter().for_each(|at| p[at] /= MM_PER_M);
    let k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
    CameraMessage { height, width, model, d: distortion[..count].to_vec(), k, r, p }
}

fn info(document: &Node) -> Result<CameraInfo, Mistake> {
    let get = |key: &str| {
        document.get(key).ok_or_else(|| {
            Mistake::whole(format!("`{key}` is missing: the file is cut off, or no camera_info of a stereo pair"))
        })
    };
    let k: [f64; 9] = get("camera_matrix")?.exactly("camera_matrix")?;
    if let Some(words) = no_camera_matrix(&k) {
        return Err(get("camera_matrix")?.mistake(format!("`camera_matrix` {words}")));
    }
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
pub(crate) fn packet_of_files(left: &Node, right: &Node) -> Result<Calibration, (usize, Mistake)> {
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
        is_rectified: u32::from(left.is_rectified() && right.is_rectified()),
        stated_error: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const K: [f64; 9] = [400.0, 0.0, 320.0, 0.0, 410.0, 240.0, 0.0, 0.0, 1.0];
    const P: [f64; 12] = [400.0, 0.0, 320.0, -2.0, 0.0, 410.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0];

    fn info(d: &[f64], r: &[f64; 9], window: Window) -> Result<CameraInfo, CameraInfoError> {
        CameraInfo::of_message((640, 480), "plumb_bob", d, (&K, r, &P), window)
    }

    #[test]
    fn matrices_are_those_of_the_image_that_is_sent() {
        let window = Window { binning: (2, 2), offset_px: (40, 20), size_px: (320, 240) };
        let found = info(&[], &EYE3, window).unwrap();
        let Camera { width, height, fx, fy, cx, cy, .. } = found.camera;
        assert_eq!((width, height, fx, fy, cx, cy), (160, 120, 200.0, 205.0, 140.0, 110.0));
        // The baseline stays.
        assert_eq!((found.projection[3] / found.projection[0], found.projection[2]), (-0.005, 140.0));
        let whole = info(&[], &EYE3, Window::default()).unwrap();
        assert_eq!((whole.camera.width, whole.camera.cx, whole.projection), (640, 320.0, P));
        let wrong = Window { binning: (1000, 1), ..Window::default() };
        assert!(matches!(info(&[], &EYE3, wrong), Err(CameraInfoError::Window { .. })));
    }

    #[test]
    fn no_distortion_may_be_written_in_any_length_and_no_rotation_is_an_error() {
        assert_eq!(info(&[0.0], &EYE3, Window::default()).unwrap().camera.distortion, [0.0; 14]);
        let count = info(&[0.1], &EYE3, Window::default());
        assert!(matches!(count, Err(CameraInfoError::Coefficients { count: 1, .. })));
        assert_eq!(info(&[], &[0.0; 9], Window::default()), Err(CameraInfoError::NoRotation));
    }

    #[test]
    fn the_pose_between_cameras_survives_messages() {
        // Of files that state no rectification: a right camera turned by 0.02 rad about y.
        let (sin, cos) = 0.02_f64.sin_cos();
        let camera =
            Camera { width: 640, height: 480, fx: 400.0, fy: 410.0, cx: 320.0, cy: 240.0, distortion: [0.0; 14] };
        let turn = [cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos];
        let given = crate::calibration::packet_of([camera, camera], turn, [-15.0, 0.2, 0.1]);
        let [left, right] = messages(&given).map(|m| {
            CameraInfo::of_message((m.width, m.height), m.model, &m.d, (&m.k, &m.r, &m.p), Window::default()).unwrap()
        });
        let read = calibration(&left, &right).unwrap();
        let same = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(same(&read.right_from_left_rotation, &turn), "{read:?}");
        assert!(same(&read.right_from_left_mm, &given.right_from_left_mm), "{read:?}");
        assert_eq!((read.left, read.is_rectified), (given.left, 0));
        // Cameras above one another are no pair of this program; each is described.
        let [_, right] = messages(&Calibration { right_from_left_mm: [0.0, -15.0, 0.0], ..given });
        assert_eq!((right.r, right.p[3], right.p[0]), (EYE3, 0.0, 400.0));
    }

    #[test]
    fn cameras_of_rectified_views_say_so() {
        let of = |d: &[f64]| {
            let left = info(d, &EYE3, Window::default()).unwrap();
            calibration(&left, &left).unwrap().is_rectified
        };
        assert_eq!((of(&[0.0; 5]), of(&[0.1, 0.0, 0.0, 0.0, 0.0])), (1, 0));
    }
}
