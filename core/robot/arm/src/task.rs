//! Joint velocities for several tasks with priorities: first the trocar, then the tip and the horizon.
//!
//! Two ranks of tasks: the second works in the null space of the first (Siciliano and Slotine 1991), by damped least
//! squares whose damping grows near singular poses (Nakamura and Hanafusa 1986). Joints that near a limit slow the
//! whole movement, so that it keeps its shape.

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3, Vector4};

use crate::chain::{Chain, JOINTS, JointVector, Stance};

/// Smallest singular value below which damping begins; rows are scaled to mm per rad over 100.
const SINGULAR_BELOW: f64 = 0.25;
/// Damping at a singular pose.
const MAX_DAMPING: f64 = 0.25;
/// Scale that brings rows in mm near 1.
const ROW_SCALE_MM: f64 = 100.0;
/// Maximum speed towards a joint limit per remaining distance, 1/s.
const LIMIT_RATE: f64 = 3.0;
/// Margin before joint limits, rad.
const LIMIT_ROOM_RAD: f64 = 0.03;
/// Rate at which an offset from the trocar decays, 1/s.
const PIVOT_RATE: f64 = 8.0;
/// Rate at which a roll of the horizon decays, 1/s.
const ROLL_RATE: f64 = 2.0;

/// A requested movement of the image.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// The observed point in the left camera's frame, mm.
    pub point_mm: Vector3<f64>,
    /// Velocity of the point in the camera's frame that the camera's movement must cause, mm/s.
    pub velocity_mm_s: Vector3<f64>,
}

/// Joint velocities, and how well the tasks can be met.
#[derive(Clone, Copy, Debug)]
pub struct Solution {
    /// Joint velocities, rad/s.
    pub velocity: JointVector,
    /// Smallest singular value of the second rank; 0 is a singular pose.
    pub singular: f64,
    /// Share of the movement that the joint limits allow.
    pub share: f64,
}

/// Rotation of the image about the tube's axis, relative to the direction `up` (in the base's frame), rad.
pub fn roll_rad(stance: &Stance, up: &Vector3<f64>) -> f64 {
    let seen = stance.base_from_camera.inverse_transform_vector(up);
    seen.x.atan2(-seen.y)
}

/// Solves for joint velocities; all zero when the inputs are not finite.
pub fn solve(chain: &Chain, angles_rad: &JointVector, stance: &Stance, up: &Vector3<f64>, wanted: &Wanted) -> Solution {
    let nothing = Solution { velocity: JointVector::zeros(), singular: 0.0, share: 0.0 };
    if !wanted.point_mm.iter().chain(wanted.velocity_mm_s.iter()).all(|v| v.is_finite()) {
        return nothing;
    }
    // First priority: the point of the tube at the trocar moves along the tube only.
    let trocar = chain.trocar_mm();
    let tip_turn = stance.base_from_tip.rotation.to_rotation_matrix();
    let at_trocar = stance.jacobian(&trocar);
    let linear: SMatrix<f64, 3, JOINTS> = tip_turn.matrix().transpose() * at_trocar.fixed_rows::<3>(0);
    let first: SMatrix<f64, 2, JOINTS> = linear.fixed_rows::<2>(0) / ROW_SCALE_MM;
    let off = stance.trocar_in_tip(&trocar);
    let back = Vector2::new(off.x, off.y) * (PIVOT_RATE / ROW_SCALE_MM);
    let square: Matrix2<f64> = first * first.transpose() + Matrix2::from_diagonal_element(1e-9);
    let Some(inverse) = square.try_inverse() else { return nothing };
    let first_inverse: SMatrix<f64, JOINTS, 2> = first.transpose() * inverse;
    let base = first_inverse * back;
    let free: SMatrix<f64, JOINTS, JOINTS> = SMatrix::identity() - first_inverse * first;

    // Second priority: three rows for the point, one for the horizon.
    let camera_turn = stance.base_from_camera.rotation.to_rotation_matrix();
    let point = stance.base_from_camera * nalgebra::Point3::from(wanted.point_mm);
    let at_point = stance.jacobian(&point);
    // A point that stands still moves in the frame against the frame's own velocity at that place.
    let moves: SMatrix<f64, 3, JOINTS> =
        -(camera_turn.matrix().transpose() * at_point.fixed_rows::<3>(0)) / ROW_SCALE_MM;
    let turns: SMatrix<f64, 3, JOINTS> = camera_turn.matrix().transpose() * at_point.fixed_rows::<3>(3);
    let mut second = SMatrix::<f64, 4, JOINTS>::zeros();
    second.fixed_rows_mut::<3>(0).copy_from(&moves);
    second.fixed_rows_mut::<1>(3).copy_from(&turns.row(2));
    let v = wanted.velocity_mm_s / ROW_SCALE_MM;
    let asked = Vector4::new(v.x, v.y, v.z, ROLL_RATE * roll_rad(stance, up)) - second * base;
    let reach: SMatrix<f64, 4, JOINTS> = second * free;
    let square: SMatrix<f64, 4, 4> = reach * reach.transpose();
    let singular = square.symmetric_eigenvalues().min().max(0.0).sqrt();
    let damping = if singular < SINGULAR_BELOW {
        let near = 1.0 - singular / SINGULAR_BELOW;
        MAX_DAMPING * MAX_DAMPING * near * near
    } else {
        0.0
    };
    let damped = square + SMatrix::<f64, 4, 4>::from_diagonal_element(damping + 1e-12);
    let Some(inverse) = damped.try_inverse() else { return nothing };
    let velocity = base + reach.transpose() * (inverse * asked);
    if !velocity.iter().all(|v| v.is_finite()) {
        return nothing;
    }
    let share = limit_share(chain, angles_rad, &velocity);
    Solution { velocity: velocity * share, singular, share }
}

/// Share of a movement at which every joint can still stop before its limit.
fn limit_share(chain: &Chain, angles_rad: &JointVector, velocity: &JointVector) -> f64 {
    let mut share: f64 = 1.0;
    for (k, joint) in chain.joints().iter().enumerate() {
        let speed = velocity[k];
        let left = if speed > 0.0 { joint.upper_rad - angles_rad[k] } else { angles_rad[k] - joint.lower_rad };
        let most = LIMIT_RATE * (left - LIMIT_ROOM_RAD).max(0.0);
        if speed.abs() > most {
            share = share.min(most / speed.abs());
        }
    }
    share
}

/// Errors (px, px, mm) per movement of the point (mm): the change of the image position, relative to the centre between
/// the cameras, and of the distance from the camera (Chaumette and Hutchinson 2006).
pub fn interaction(point_mm: &Vector3<f64>, focal_px: (f64, f64), centre_x_mm: f64) -> Matrix3<f64> {
    let (p, (fx, fy)) = (point_mm, focal_px);
    let (z, range) = (p.z, p.norm());
    Matrix3::new(
        fx / z,
        0.0,
        -fx * (p.x - centre_x_mm) / (z * z),
        0.0,
        fy / z,
        -fy * p.y / (z * z),
        p.x / range,
        p.y / range,
        p.z / range,
    )
}

/// One number per row of the errors.
pub type Errors = SVector<f64, 3>;
