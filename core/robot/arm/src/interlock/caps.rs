//! The arm's limits. They are constants: an arm's file may lower but not raise them.

use std::time::Duration;

use crate::chain::{Chain, JOINTS, JointVector, Stance};

/// Length of a step of set-points, s.
pub const STEP_S: f64 = 1e-3;
/// Length of a step of set-points, ns.
pub const STEP_NS: i64 = 1_000_000;
/// Highest speed of any joint, rad/s.
pub const SPEED_RAD_S: f64 = 0.4;
/// Highest acceleration of any joint, rad/s^2.
pub const ACCELERATION_RAD_S2: f64 = 2.0;
/// Highest jerk of any joint, rad/s^3.
pub const JERK_RAD_S3: f64 = 30.0;
/// Highest speed of the camera, mm/s.
pub const CAMERA_MM_S: f64 = 60.0;
/// Largest distance of the tube's axis from the trocar, mm.
pub const PIVOT_MM: f64 = 1.0;
/// Largest angle of the tube to its direction at home, rad.
pub const TILT_RAD: f64 = 0.6;
/// Smallest and largest depth of the tube's end beyond the trocar, mm.
pub const DEPTH_MM: (f64, f64) = (20.0, 190.0);
/// Age up to which a demand is followed. The arm must brake within 30 ms of the last demand, which leaves 6 ms for the
/// next set-point and its transmission.
pub const DEMAND_AGE: Duration = Duration::from_millis(24);
/// Largest age of a tip that a setting can allow.
pub const TIP_AGE: Duration = Duration::from_millis(300);
/// Maximum time between two calls that still counts as running.
pub const MAX_CALL: Duration = Duration::from_millis(250);

/// Margins between planned movements and the limits, because plans are checked at some steps only.
const ANGLE_MARGIN_RAD: f64 = 0.012;
const PIVOT_MARGIN_MM: f64 = 0.15;
const TILT_MARGIN_RAD: f64 = 0.01;
const DEPTH_MARGIN_MM: f64 = 1.0;
const CAMERA_ROOM: f64 = 0.93;

/// Limits of one arm.
#[derive(Clone, Debug)]
pub struct Caps {
    /// Smallest angles, rad.
    pub lower_rad: JointVector,
    /// Largest angles, rad.
    pub upper_rad: JointVector,
    /// Highest speeds, rad/s.
    pub speed: JointVector,
    /// Highest accelerations, rad/s^2.
    pub acceleration: JointVector,
    /// Highest jerks, rad/s^3.
    pub jerk: JointVector,
}

/// Pose of the tube relative to the trocar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TubePose {
    /// Distance of the tube's axis from the trocar, mm.
    pub pivot_mm: f64,
    /// Depth of the tube's end beyond the trocar, mm.
    pub depth_mm: f64,
    /// Angle of the tube to its direction at home, rad.
    pub tilt_rad: f64,
}

impl TubePose {
    /// The tube of an arm in this stance; `home` is its direction at home.
    pub fn of(chain: &Chain, stance: &Stance, home: &nalgebra::Vector3<f64>) -> Self {
        let trocar = stance.trocar_in_tip(&chain.trocar_mm());
        let along = stance.base_from_tip * nalgebra::Vector3::z();
        Self { pivot_mm: trocar.x.hypot(trocar.y), depth_mm: -trocar.z, tilt_rad: along.angle(home) }
    }

    /// Whether the pose is within the limits, optionally reduced by the margins. NaN is not allowed.
    pub fn is_allowed(&self, with_margin: bool) -> bool {
        let margin = if with_margin { 1.0 } else { 0.0 };
        self.pivot_mm <= PIVOT_MM - margin * PIVOT_MARGIN_MM
            && self.tilt_rad <= TILT_RAD - margin * TILT_MARGIN_RAD
            && self.depth_mm >= DEPTH_MM.0 + margin * DEPTH_MARGIN_MM
            && self.depth_mm <= DEPTH_MM.1 - margin * DEPTH_MARGIN_MM
    }
}

/// Largest share of its limit that a joint uses.
pub fn share(values: &JointVector, limits: &JointVector) -> f64 {
    values.iter().zip(limits.iter()).fold(0.0, |most: f64, (v, limit)| most.max(v.abs() / limit))
}

impl Caps {
    /// The constants, lowered to the limits in the arm's file where those are less.
    pub fn of(chain: &Chain) -> Self {
        let each = |of: &dyn Fn(usize) -> f64| JointVector::from_fn(|k, _| of(k));
        let joints = chain.joints();
        Self {
            lower_rad: each(&|k| joints[k].lower_rad),
            upper_rad: each(&|k| joints[k].upper_rad),
            speed: each(&|k| joints[k].speed_rad_s.min(SPEED_RAD_S)),
            acceleration: each(&|_| ACCELERATION_RAD_S2),
            jerk: each(&|_| JERK_RAD_S3),
        }
    }

    /// Whether all angles are within the limits, optionally reduced by the margin. NaN is not allowed.
    pub fn angles_allowed(&self, angles_rad: &JointVector, with_margin: bool) -> bool {
        let margin = if with_margin { ANGLE_MARGIN_RAD } else { 0.0 };
        (0..JOINTS).all(|k| angles_rad[k] >= self.lower_rad[k] + margin && angles_rad[k] <= self.upper_rad[k] - margin)
    }

    /// Whether the camera's speed is within its limit, reduced by the margin.
    pub fn camera_allowed(&self, mm_s: f64) -> bool {
        mm_s <= CAMERA_MM_S * CAMERA_ROOM
    }
}
