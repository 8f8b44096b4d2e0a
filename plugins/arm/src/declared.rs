//! Ports and parameters that both arm drivers share: inputs, outputs about the movement, parameters that stop the arm.

use nalgebra::Isometry3;
use panoscope_arm_core::JointVector;
use panoscope_arm_core::chain::Stance;
use panoscope_arm_core::interlock::Settings;
use panoscope_node::abi::{Joints, Pose, Tip};
use panoscope_node::{Params, Ports, Result, Slot, TableData, Value};

use crate::joints::{camera_pose, packet, set_links};

/// Inputs of a driver.
#[derive(Ports)]
pub struct In<'f> {
    /// Requested joint velocities, from `arm_pid`.
    pub joints: Option<Value<'f, Joints>>,
    /// Tip that the arm follows, straight from `tip_track`. The arm moves only while fresh tips arrive.
    pub tip: Option<Value<'f, Tip>>,
}

/// Outputs of a driver about the arm's movement.
#[derive(Ports)]
pub struct MotionOut<'f> {
    /// Joint angles (rad) and velocities (rad/s) as the encoders read them.
    joints: Slot<'f, Joints>,
    /// Newest set-points (rad, rad/s), after the interlock.
    setpoint: Slot<'f, Joints>,
    /// Pose of the left camera in the frame `scene`, which is the camera's pose at joint angles of 0; mm. The true pose for `arm_sim`, by the
    /// encoders for a real arm.
    camera_pose: Slot<'f, Pose>,
    /// Positions of the joints in the frame `scene`, mm: one row per joint, from the base to the camera.
    links: Slot<'f, TableData>,
}

/// Joint angles, rad, and velocities, rad/s.
pub type Motion<'a> = (&'a JointVector, &'a JointVector);

impl MotionOut<'_> {
    /// Sets all outputs. `stance` holds the present angles and velocities, `base_from_scene` the left camera's pose at joint angles of 0.
    ///
    /// # Errors
    /// The host has no frame memory left.
    pub fn set(
        &mut self,
        stance: &Stance,
        base_from_scene: &Isometry3<f64>,
        encoders: Motion<'_>,
        set_point: Motion<'_>,
    ) -> Result<()> {
        self.camera_pose.set(camera_pose(&(base_from_scene.inverse() * stance.base_from_camera)))?;
        if self.links.is_read() {
            set_links(&mut self.links, stance, base_from_scene)?;
        }
        self.joints.set(packet(encoders.0, encoders.1))?;
        self.setpoint.set(packet(set_point.0, set_point.1))
    }
}

/// Parameters that stop an arm.
#[derive(Params)]
pub struct StopParams {
    /// Stops the arm. It stays stopped when this is switched off again, until `reset` changes.
    #[param(default = false)]
    pub emergency_stop: bool,
    /// A change of this number releases a latched stop. The driver of a real arm then also opens a lost connection again.
    #[param(default = 0, range = 0..=1_000_000_000)]
    pub reset: u64,
    /// Maximum age of a tip's light, by the host's clock. The arm stops when no younger tip has arrived. A predicted tip is as old as the image in
    /// which it was last seen.
    #[param(default = 150.0, range = 10.0..=300.0, step = 10.0, unit = "ms")]
    max_age_ms: f64,
    /// Lowest score of a tip that is followed. The score of a predicted tip falls with time.
    #[param(default = 0.3, range = 0.01..=1.0, step = 0.01, unit = "ratio")]
    min_score: f64,
}

impl StopParams {
    /// Settings of the interlock for these parameters.
    pub fn settings(&self) -> Settings {
        Settings { max_age_ms: self.max_age_ms, min_score: self.min_score }
    }
}
