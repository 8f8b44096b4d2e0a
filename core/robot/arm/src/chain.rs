//! A chain of six turning joints read from URDF: forward kinematics and the geometric Jacobian.
//!
//! Lengths in mm, angles in rad. All joints at 0 is home. The link `scope_tip` ends the tube (z along it),
//! `left_camera` is the camera (x right, y down, z forward), `trocar` is fixed to the base.

use nalgebra::{Isometry3, Point3, SMatrix, SVector, Translation3, Unit, UnitQuaternion, Vector3};
use urdf_rs::{JointType, Robot};

use crate::error::ArmError;

/// Number of joints of an arm.
pub const JOINTS: usize = 6;
/// One number per joint, from the base.
pub type JointVector = SVector<f64, JOINTS>;
/// Velocity of a frame per joint velocity: three rows of mm/s, three of rad/s.
pub type Jacobian = SMatrix<f64, 6, JOINTS>;

/// The arm that comes with Panoscope.
pub const SHIPPED_URDF: &str = include_str!("../description/panoscope_arm6.urdf");

const CAMERA: &str = "left_camera";
const TIP: &str = "scope_tip";
const TROCAR: &str = "trocar";
/// Largest distance of the trocar from the tube's axis at home, mm.
const TROCAR_OFF_AXIS_MM: f64 = 0.5;

/// One revolute joint.
#[derive(Clone, Debug)]
pub struct Joint {
    /// Name in the URDF file.
    pub name: String,
    /// Pose relative to the previous joint (or the base) at angle 0.
    parent_from_joint: Isometry3<f64>,
    axis: Unit<Vector3<f64>>,
    /// Smallest angle in rad.
    pub lower_rad: f64,
    /// Largest angle in rad.
    pub upper_rad: f64,
    /// Highest speed in rad/s.
    pub speed_rad_s: f64,
}

/// Six revolute joints, the scope on the last, and the trocar.
#[derive(Clone, Debug)]
pub struct Chain {
    joints: [Joint; JOINTS],
    last_from_tip: Isometry3<f64>,
    tip_from_camera: Isometry3<f64>,
    trocar_mm: Point3<f64>,
}

/// Number of points of [`Stance::links`].
pub const LINK_POINTS: usize = JOINTS + 3;

/// Poses of the arm's frames at some joint angles, in the base's frame.
#[derive(Clone, Copy, Debug)]
pub struct Stance {
    origins: [Point3<f64>; JOINTS],
    axes: [Vector3<f64>; JOINTS],
    /// Pose of the end of the tube.
    pub base_from_tip: Isometry3<f64>,
    /// Pose of the left camera.
    pub base_from_camera: Isometry3<f64>,
}

impl Chain {
    /// The arm that comes with Panoscope.
    ///
    /// # Errors
    /// None in practice: a test parses the same text.
    pub fn shipped() -> Result<Self, ArmError> {
        Self::from_urdf(SHIPPED_URDF)
    }

    /// Reads a URDF text.
    ///
    /// # Errors
    /// The text is not URDF, a link is missing or misplaced, the number of joints is wrong, or a limit is malformed.
    pub fn from_urdf(text: &str) -> Result<Self, ArmError> {
        let robot = urdf_rs::read_from_string(text).map_err(|error| ArmError::NoUrdf { reason: error.to_string() })?;
        let has = |link: &'static str, what: &'static str| {
            if robot.links.iter().any(|l| l.name == link) { Ok(()) } else { Err(ArmError::NoLink { link, what }) }
        };
        has(CAMERA, "the left camera")?;
        has(TIP, "the end of the scope's tube, z along the tube,")?;
        has(TROCAR, "the place where the tube passes the wall of the belly")?;
        let (mut joints, mut rest) = (Vec::new(), Isometry3::identity());
        let mut last_from_tip = None;
        for joint in path(&robot, CAMERA)? {
            rest *= origin(joint)?;
            match joint.joint_type {
                JointType::Revolute => {
                    if last_from_tip.is_some() {
                        return Err(ArmError::Misplaced {
                            link: TIP,
                            rule: "no joint turns between it and the camera".into(),
                        });
                    }
                    joints.push(turning(joint, rest)?);
                    rest = Isometry3::identity();
                }
                JointType::Fixed => {}
                ref other => return Err(ArmError::WrongKind { joint: joint.name.clone(), kind: format!("{other:?}") }),
            }
            if joint.child.link == TIP {
                last_from_tip = Some(rest);
                rest = Isometry3::identity();
            }
        }
        let Some(last_from_tip) = last_from_tip else {
            return Err(ArmError::Misplaced {
                link: TIP,
                rule: "it stands between the last joint and `left_camera`".into(),
            });
        };
        let count = joints.len();
        let joints: [Joint; JOINTS] = joints.try_into().map_err(|_| ArmError::WrongAxes { count })?;
        let mut base_from_trocar = Isometry3::identity();
        for joint in path(&robot, TROCAR)? {
            if joint.joint_type != JointType::Fixed {
                return Err(ArmError::Misplaced { link: TROCAR, rule: "it is fixed to the base".into() });
            }
            base_from_trocar *= origin(joint)?;
        }
        let trocar_mm = base_from_trocar * Point3::origin();
        let chain = Self { joints, last_from_tip, tip_from_camera: rest, trocar_mm };
        let seen = chain.stance(&JointVector::zeros()).base_from_tip.inverse_transform_point(&trocar_mm);
        let off_mm = seen.x.hypot(seen.y);
        if off_mm > TROCAR_OFF_AXIS_MM || seen.z >= 0.0 {
            let rule = format!(
                "at home it lies on the tube, behind its end; it stands {off_mm:.1} mm off the axis, {:.1} mm behind",
                -seen.z
            );
            return Err(ArmError::Misplaced { link: TROCAR, rule });
        }
        Ok(chain)
    }

    /// The joints, from the base.
    pub fn joints(&self) -> &[Joint; JOINTS] {
        &self.joints
    }

    /// The trocar, seen from the base, in mm.
    pub fn trocar_mm(&self) -> Point3<f64> {
        self.trocar_mm
    }

    /// The frames' poses at joint angles, rad.
    pub fn stance(&self, angles_rad: &JointVector) -> Stance {
        let mut at = Isometry3::identity();
        let (mut origins, mut axes) = ([Point3::origin(); JOINTS], [Vector3::zeros(); JOINTS]);
        for (k, joint) in self.joints.iter().enumerate() {
            at *= joint.parent_from_joint;
            origins[k] = at * Point3::origin();
            axes[k] = at * joint.axis.into_inner();
            at *= UnitQuaternion::from_axis_angle(&joint.axis, angles_rad[k]);
        }
        let base_from_tip = at * self.last_from_tip;
        Stance { origins, axes, base_from_tip, base_from_camera: base_from_tip * self.tip_from_camera }
    }
}

impl Stance {
    /// Points along the links in the base's frame, mm: the foot, the joints, the end of the tube, the left camera.
    pub fn links(&self) -> [Point3<f64>; LINK_POINTS] {
        let [tip, camera] = [self.base_from_tip, self.base_from_camera].map(|at| Point3::from(at.translation.vector));
        let mut out = [Point3::origin(); LINK_POINTS];
        out[1..=JOINTS].copy_from_slice(&self.origins);
        [out[JOINTS + 1], out[JOINTS + 2]] = [tip, camera];
        out
    }

    /// Velocity of a point fixed to the last link, and the link's angular velocity, per joint velocity, in the base's
    /// frame.
    pub fn jacobian(&self, point_mm: &Point3<f64>) -> Jacobian {
        let mut out = Jacobian::zeros();
        for k in 0..JOINTS {
            let linear = self.axes[k].cross(&(point_mm - self.origins[k]));
            out.fixed_view_mut::<3, 1>(0, k).copy_from(&linear);
            out.fixed_view_mut::<3, 1>(3, k).copy_from(&self.axes[k]);
        }
        out
    }

    /// The camera's velocity at a joint velocity, mm/s, in the base's frame.
    pub fn camera_velocity(&self, joint_rad_s: &JointVector) -> Vector3<f64> {
        let at = Point3::from(self.base_from_camera.translation.vector);
        (0..JOINTS).map(|k| self.axes[k].cross(&(at - self.origins[k])) * joint_rad_s[k]).sum()
    }

    /// The trocar in the frame of the tube's end, mm: x and y are the tube's distance from it, -z is the tube's depth.
    pub fn trocar_in_tip(&self, trocar_mm: &Point3<f64>) -> Vector3<f64> {
        self.base_from_tip.inverse_transform_point(trocar_mm).coords
    }
}

/// Joints from the root to a link.
fn path<'r>(robot: &'r Robot, link: &str) -> Result<Vec<&'r urdf_rs::Joint>, ArmError> {
    let (mut out, mut at) = (Vec::new(), link);
    while let Some(joint) = robot.joints.iter().find(|joint| joint.child.link == at) {
        if out.len() > robot.joints.len() {
            return Err(ArmError::Circle { link: link.to_owned() });
        }
        out.push(joint);
        at = &joint.parent.link;
    }
    out.reverse();
    Ok(out)
}

fn finite(joint: &urdf_rs::Joint, what: &'static str, value: f64) -> Result<f64, ArmError> {
    if value.is_finite() {
        return Ok(value);
    }
    Err(ArmError::BadNumber { joint: joint.name.clone(), what, value, rule: "it must be a number" })
}

fn origin(joint: &urdf_rs::Joint) -> Result<Isometry3<f64>, ArmError> {
    for value in joint.origin.xyz.iter().chain(joint.origin.rpy.iter()) {
        finite(joint, "its origin", *value)?;
    }
    let [x, y, z] = *joint.origin.xyz;
    let [roll, pitch, yaw] = *joint.origin.rpy;
    let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Ok(Isometry3::from_parts(Translation3::new(1e3 * x, 1e3 * y, 1e3 * z), turn))
}

fn turning(joint: &urdf_rs::Joint, parent_from_joint: Isometry3<f64>) -> Result<Joint, ArmError> {
    let limit = &joint.limit;
    let bad = |what, value, rule| ArmError::BadNumber { joint: joint.name.clone(), what, value, rule };
    let lower_rad = finite(joint, "the lower limit", limit.lower)?;
    let upper_rad = finite(joint, "the upper limit", limit.upper)?;
    let speed_rad_s = finite(joint, "the speed limit", limit.velocity)?;
    if lower_rad >= 0.0 || upper_rad <= 0.0 {
        let (what, value) =
            if lower_rad >= 0.0 { ("the lower limit", lower_rad) } else { ("the upper limit", upper_rad) };
        return Err(bad(what, value, "home, with all joints at 0, must be inside the limits"));
    }
    if speed_rad_s <= 0.0 {
        return Err(bad("the speed limit", speed_rad_s, "it is above 0"));
    }
    let axis = Vector3::from(*joint.axis.xyz);
    let Some(axis) = Unit::try_new(axis, 1e-6).filter(|axis| axis.iter().all(|v| v.is_finite())) else {
        return Err(bad("the axis' length", axis.norm(), "it points somewhere"));
    };
    Ok(Joint { name: joint.name.clone(), parent_from_joint, axis, lower_rad, upper_rad, speed_rad_s })
}
