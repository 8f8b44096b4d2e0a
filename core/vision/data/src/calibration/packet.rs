//! Camera models and a rectification from the `calibration` packet.

use panoscope_abi::{Calibration, Camera};
use panoscope_imaging::shrink::shrunk_px;
use panoscope_imaging::stereo::rotation::Matrix3;
use panoscope_imaging::stereo::{
    CalibrationError, CameraModel, OrderEvidence, Rectification, RectifiedCamera, RectifyParams, RowSample,
    StereoCameras, StereoError, ViewOrder,
};
use panoscope_imaging::{Parallel, Rect};

fn refuse<T>(reason: String) -> Result<T, StereoError> {
    Err(StereoError::Calibration { reason })
}

fn matrix(rows: &[f64; 9]) -> Matrix3 {
    std::array::from_fn(|row| std::array::from_fn(|column| rows[3 * row + column]))
}

fn flat(rows: &Matrix3) -> [f64; 9] {
    std::array::from_fn(|index| rows[index / 3][index % 3])
}

/// One camera of the packet, checked.
///
/// # Errors
/// [`StereoError::Calibration`] when no camera can have these parameters.
pub fn camera(camera: &Camera) -> Result<CameraModel, StereoError> {
    let size = (camera.width as usize, camera.height as usize);
    CameraModel::new(size, (camera.fx, camera.fy), (camera.cx, camera.cy), &camera.distortion)
}

/// Both cameras of a packet of raw views.
///
/// # Errors
/// As [`camera`].
pub fn cameras(packet: &Calibration) -> Result<StereoCameras, StereoError> {
    Ok(StereoCameras {
        left: camera(&packet.left)?,
        right: camera(&packet.right)?,
        rotation: matrix(&packet.right_from_left_rotation),
        translation_mm: packet.right_from_left_mm,
    })
}

/// Whether two packets describe the same cameras. The reprojection error may be NaN and changes nothing.
pub fn same(a: &Calibration, b: &Calibration) -> bool {
    Calibration { rms_px: 0.0, ..*a } == Calibration { rms_px: 0.0, ..*b }
}

/// Whether the packet states how its cameras are rectified: its projections are not empty.
pub fn states_rectification(packet: &Calibration) -> bool {
    packet.left_projection != [0.0; 12] || packet.right_projection != [0.0; 12]
}

/// How the packet rectifies its cameras: as it states, or, when its projections are empty, computed.
///
/// # Errors
/// [`StereoError::Calibration`] when the cameras or the stated rectification are impossible.
pub fn rectification(packet: &Calibration) -> Result<Rectification, StereoError> {
    if !states_rectification(packet) {
        return Rectification::new(&cameras(packet)?, RectifyParams::default());
    }
    let (left, right) = (&packet.left_projection, &packet.right_projection);
    let numbers = left.iter().chain(right).chain(&packet.rectified_from_left).chain(&packet.rectified_from_right);
    if numbers.into_iter().any(|number| !number.is_finite()) {
        return refuse("a number of its rectification is not finite".into());
    }
    let focal_px = left[0];
    if focal_px <= 0.0 {
        return refuse(format!("the rectified focal length is {focal_px} px"));
    }
    // What the views must share for a point to lie on one row in both.
    for (what, a, b) in [
        ("focal lengths", right[0], focal_px),
        ("focal lengths", left[5], focal_px),
        ("focal lengths", right[5], focal_px),
        ("principal rows", right[6], left[6]),
    ] {
        if (a - b).abs() > 1e-3 {
            return refuse(format!("the {what} of the rectified views differ: {a} and {b} px"));
        }
    }
    let baseline_mm = -right[3] / focal_px;
    if baseline_mm < 0.0 {
        return refuse("left and right are swapped: the left camera stands to the right of the right one, disparities would be negative".into());
    }
    if baseline_mm < 1e-6 {
        return refuse(format!("the baseline is {baseline_mm} mm"));
    }
    let (width, height) = (packet.left.width as usize, packet.left.height as usize);
    if (packet.right.width, packet.right.height) != (packet.left.width, packet.left.height) {
        return refuse(format!(
            "the left camera is {width}x{height}, the right one {}x{}",
            packet.right.width, packet.right.height
        ));
    }
    let view = |p: &[f64; 12]| RectifiedCamera { focal_px, cx: p[2], cy: p[6] };
    Ok(Rectification {
        width,
        height,
        rotation_left: matrix(&packet.rectified_from_left),
        rotation_right: matrix(&packet.rectified_from_right),
        left: view(left),
        right: view(right),
        baseline_mm,
        valid_left: Rect::whole(width, height),
        valid_right: Rect::whole(width, height),
    })
}

/// The packet of views that were shrunk by a whole factor, each pixel the mean of a block.
pub fn shrunk(packet: &Calibration, factor: u32) -> Calibration {
    if factor <= 1 {
        return *packet;
    }
    let scale = f64::from(factor);
    let center = |px: f64| shrunk_px(px, factor as usize);
    let camera = |of: &Camera| Camera {
        width: of.width / factor,
        height: of.height / factor,
        fx: of.fx / scale,
        fy: of.fy / scale,
        cx: center(of.cx),
        cy: center(of.cy),
        distortion: of.distortion,
    };
    let projection = |of: &[f64; 12]| {
        let mut small = *of;
        // An empty one stays empty: the rectification is computed.
        if *of != [0.0; 12] {
            small[..8].iter_mut().for_each(|entry| *entry /= scale);
            (small[2], small[6]) = (center(of[2]), center(of[6]));
        }
        small
    };
    Calibration {
        left: camera(&packet.left),
        right: camera(&packet.right),
        left_projection: projection(&packet.left_projection),
        right_projection: projection(&packet.right_projection),
        rms_px: packet.rms_px / scale,
        stated_error: CalibrationError::of_bits(packet.stated_error).map_or(0, |stated| stated.shrunk(scale).bits()),
        ..*packet
    }
}

/// The packet of the raw views with `rectification` written into it.
pub fn with_rectification(packet: &Calibration, rectification: &Rectification) -> Calibration {
    let target = rectified(packet, rectification);
    Calibration {
        rectified_from_left: flat(&rectification.rotation_left),
        rectified_from_right: flat(&rectification.rotation_right),
        left_projection: target.left_projection,
        right_projection: target.right_projection,
        baseline_mm: rectification.baseline_mm,
        ..*packet
    }
}

/// The packet that describes the views after `rectification`: pinhole cameras side by side.
pub fn rectified(packet: &Calibration, rectification: &Rectification) -> Calibration {
    const EYE: Matrix3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let pinhole = |of: RectifiedCamera| Camera {
        width: rectification.width as u32,
        height: rectification.height as u32,
        fx: of.focal_px,
        fy: of.focal_px,
        cx: of.cx,
        cy: of.cy,
        distortion: [0.0; 14],
    };
    let projection = |of: RectifiedCamera, shift_mm: f64| {
        let focal = of.focal_px;
        [focal, 0.0, of.cx, focal * shift_mm, 0.0, focal, of.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    };
    Calibration {
        left: pinhole(rectification.left),
        right: pinhole(rectification.right),
        right_from_left_rotation: flat(&EYE),
        right_from_left_mm: [-rectification.baseline_mm, 0.0, 0.0],
        rectified_from_left: flat(&EYE),
        rectified_from_right: flat(&EYE),
        left_projection: projection(rectification.left, 0.0),
        right_projection: projection(rectification.right, -rectification.baseline_mm),
        baseline_mm: rectification.baseline_mm,
        rms_px: packet.rms_px,
        is_rectified: 1,
        stated_error: packet.stated_error,
    }
}

/// The rectified cameras of a packet that describes rectified views.
///
/// # Errors
/// [`StereoError::Calibration`] when the packet describes raw views, or as [`rectification`].
pub fn of_rectified_views(packet: &Calibration) -> Result<Rectification, StereoError> {
    if packet.is_rectified == 0 {
        return refuse(
            "it describes views that are not rectified, disparities belong to rectified ones: connect `calibration` of a `rectify` node".into(),
        );
    }
    rectification(packet)
}

/// The cameras of two views as a packet describes them, against which the features of the views are held.
#[derive(Clone, Debug)]
pub struct ViewCameras {
    packet: Calibration,
    is_level: bool,
    models: [CameraModel; 2],
    rectification: Rectification,
}

impl ViewCameras {
    /// `is_level`: the views are rectified already, whatever the packet says.
    ///
    /// # Errors
    /// As [`rectification`] and [`camera`].
    pub fn new(packet: &Calibration, is_level: bool) -> Result<Self, StereoError> {
        let rectification = rectification(packet)?;
        if !is_level {
            let models = [camera(&packet.left)?, camera(&packet.right)?];
            return Ok(Self { packet: *packet, is_level, models, rectification });
        }
        let level = rectified(packet, &rectification);
        let models = [camera(&level.left)?, camera(&level.right)?];
        Ok(Self { packet: *packet, is_level, models, rectification: of_rectified_views(&level)? })
    }

    /// Whether they were made by [`Self::new`] from these.
    pub fn are_of(&self, packet: &Calibration, is_level: bool) -> bool {
        self.is_level == is_level && same(&self.packet, packet)
    }

    /// Which view is which, by the features that `order` has found.
    pub fn compare(&self, order: &mut ViewOrder, pool: &dyn Parallel) -> OrderEvidence {
        order.compare(self.models.each_ref(), &self.rectification, pool)
    }

    /// The features of the last comparison in the left view that was taken `step_s` later.
    pub fn row_samples(&self, order: &mut ViewOrder, step_s: f64, pool: &dyn Parallel) -> Vec<RowSample> {
        order.row_samples(self.models.each_ref(), &self.rectification, step_s, pool)
    }
}
