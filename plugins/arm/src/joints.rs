//! Converts packets of joints and poses to and from the types of `panoscope_arm_core`.

use std::path::Path;

use nalgebra::Isometry3;
use panoscope_arm_core::chain::{LINK_POINTS, Stance};
use panoscope_arm_core::{Chain, JOINTS, JointVector};
use panoscope_node::abi::{Joints, LINK_COLUMNS, MAX_JOINTS, Pose};
use panoscope_node::{Result, Slot, TableData, Validation, error, name16};

/// The arm that a URDF file describes, or the shipped arm when `file` is empty.
///
/// # Errors
/// The file cannot be read or does not describe an arm of six axes.
pub fn arm_of(file: &Path) -> Result<Chain> {
    if file.as_os_str().is_empty() {
        return Ok(Chain::shipped()?);
    }
    let text = std::fs::read_to_string(file).map_err(|e| error!("cannot read {}: {e}", file.display()))?;
    Chain::from_urdf(&text).map_err(|e| error!("{}: {e}", file.display()))
}

/// Reports an arm file that [`arm_of`] refuses.
pub fn check_arm(check: &mut Validation<'_>, file: &Path) {
    if let Err(error) = arm_of(file) {
        check.error("arm", error.message(), "name a URDF file of six axes, or leave it empty for the shipped arm");
    }
}

/// Joint angles of a packet, rad.
///
/// # Errors
/// The packet has another number of joints than the arm.
pub fn angles(packet: &Joints) -> Result<JointVector> {
    if packet.count as usize != JOINTS {
        return Err(error!(
            "the joints packet has {} axes, but the arm has {JOINTS}; connect the joints of this arm",
            packet.count
        ));
    }
    Ok(JointVector::from_column_slice(&packet.position_rad[..JOINTS]))
}

/// Makes a packet of joint angles (rad) and speeds (rad/s).
pub fn packet(position_rad: &JointVector, velocity_rad_s: &JointVector) -> Joints {
    let mut out = Joints {
        position_rad: [0.0; MAX_JOINTS],
        velocity_rad_s: [0.0; MAX_JOINTS],
        count: JOINTS as u32,
        reserved: 0,
    };
    out.position_rad[..JOINTS].copy_from_slice(position_rad.as_slice());
    out.velocity_rad_s[..JOINTS].copy_from_slice(velocity_rad_s.as_slice());
    out
}

/// Pose of the left camera in the frame `scene`, the camera's pose at joint angles of 0.
pub fn camera_pose(scene_from_camera: &Isometry3<f64>) -> Pose {
    let (q, at) = (scene_from_camera.rotation, scene_from_camera.translation.vector);
    Pose {
        a_from_b_wxyz: [q.w, q.i, q.j, q.k],
        a_from_b_mm: [at.x, at.y, at.z],
        a: name16("scene"),
        b: name16("left_camera"),
    }
}

/// Sets the positions of the joints, mm, in the frame of [`camera_pose`].
///
/// # Errors
/// The host has no frame memory left.
pub fn set_links(slot: &mut Slot<'_, TableData>, stance: &Stance, base_from_scene: &Isometry3<f64>) -> Result<()> {
    let mut values = [0.0; LINK_POINTS * LINK_COLUMNS.len()];
    for (row, place) in values.chunks_exact_mut(LINK_COLUMNS.len()).zip(stance.links()) {
        row.copy_from_slice(base_from_scene.inverse_transform_point(&place).coords.as_slice());
    }
    slot.set_table(&LINK_COLUMNS, &values)
}

/// Requested velocities of a packet, rad/s, as many as it states. The interlock refuses a packet with a wrong count.
pub fn requested(packet: &Joints) -> &[f64] {
    &packet.velocity_rad_s[..(packet.count as usize).min(MAX_JOINTS)]
}
