//! `arm_sim`: a simulated six-axis arm behind the interlock. It moves in virtual time (the media time of its ticks). Ages are those of the host: in a
//! live run a tip is as old as the light that it comes from.

use std::path::PathBuf;

use nalgebra::Vector3;
use panoscope_arm_core::dynamics::{Quality, SimArm};
use panoscope_arm_core::interlock::{Cause, TubePose};
use panoscope_arm_core::{Chain, Interlock, JOINTS, JointVector};
use panoscope_node::{
    Context, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData, TextPacket, Validation, error,
};

use crate::declared::{In, MotionOut, StopParams};
use crate::guard::{self, Switches, age_ns, duration_ns};
use crate::joints::{arm_of, check_arm, requested};

/// Output ports of `arm_sim`.
#[derive(Ports)]
pub struct Out<'f> {
    #[ports(flatten)]
    motion: MotionOut<'f>,
    /// One row per tick: whether the arm follows, number of the stop's cause (0 for none), stops so far, largest joint speed, speed and acceleration
    /// of the camera, distance of the tube from the trocar, its depth and its tilt.
    table: Slot<'f, TableData>,
    /// State of the arm as text.
    text: Slot<'f, TextPacket>,
}

/// Parameters of `arm_sim`.
#[derive(Params)]
pub struct SimParams {
    /// URDF file of the arm; empty takes the arm that comes with the plugin.
    #[param(default = "", reopen)]
    arm: PathBuf,
    #[param(flatten)]
    stop: StopParams,
    /// Time from a set-point until the motors receive it.
    #[param(default = 50.0, range = 1.0..=500.0, step = 1.0, unit = "ms", reopen)]
    latency_ms: f64,
    /// Time constant of the motors.
    #[param(default = 15.0, range = 1.0..=500.0, step = 1.0, unit = "ms", reopen)]
    lag_ms: f64,
    /// Backlash of each gear, full width.
    #[param(default = 0.0115, range = 0.0..=1.0, step = 0.0005, unit = "deg", reopen)]
    backlash_deg: f64,
    /// Standard deviation of each encoder's noise.
    #[param(default = 0.0012, range = 0.0..=0.1, step = 0.0001, unit = "deg", reopen)]
    encoder_noise_deg: f64,
}

/// Columns of the table, in order.
pub const COLUMNS: [&str; 9] =
    ["following", "cause", "stops", "speed_rad_s", "camera_mm_s", "pivot_mm", "depth_mm", "tilt_deg", "camera_mm_s2"];

/// The `arm_sim` node.
pub struct ArmSim {
    lock: Interlock,
    arm: SimArm,
    quality: Quality,
    home: nalgebra::Isometry3<f64>,
    down: Vector3<f64>,
    switches: Switches,
    started: bool,
    /// When the light of the newest tip arrived, ns of the host's clock.
    tip_light_ns: Option<i64>,
    /// State of the camera at the previous tick: position (mm), velocity (mm/s), time (ns).
    last: Option<(Vector3<f64>, Vector3<f64>, i64)>,
    words: String,
}

impl ArmSim {
    fn at(chain: Chain, angles_rad: JointVector, quality: Quality) -> Self {
        let home = chain.stance(&JointVector::zeros());
        let lock = Interlock::new(chain, angles_rad, 0);
        let angles_rad = lock.set_point().position;
        Self {
            arm: SimArm::new(quality, angles_rad),
            lock,
            quality,
            home: home.base_from_camera,
            down: home.base_from_tip * Vector3::z(),
            switches: Switches::default(),
            started: false,
            tip_light_ns: None,
            last: None,
            words: String::new(),
        }
    }

    fn quality(params: &SimParams) -> Quality {
        Quality {
            latency_ms: params.latency_ms,
            lag_ms: params.lag_ms,
            backlash_rad: params.backlash_deg.to_radians(),
            encoder_noise_rad: params.encoder_noise_deg.to_radians(),
        }
    }
}

impl Node for ArmSim {
    const INFO: NodeInfo = NodeInfo::compute(
        "arm_sim",
        "arm",
        "A simulated six-axis arm behind the interlock, with latency, motor lag, gear backlash and encoder noise.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = SimParams;

    fn validate(params: &SimParams, check: &mut Validation<'_>) {
        check_arm(check, &params.arm);
    }

    fn open(_: &Open<'_>, params: &SimParams) -> Result<Self> {
        Ok(Self::at(arm_of(&params.arm)?, JointVector::zeros(), Self::quality(params)))
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &SimParams) -> Result<()> {
        let now_ns = cx.tick().capture_ns;
        if !self.started {
            self.started = true;
            self.lock.start_clock(now_ns);
        }
        self.lock.set(params.stop.settings());
        self.switches.obey(&mut self.lock, params.stop.emergency_stop, params.stop.reset);
        let (lock, arm) = (&mut self.lock, &mut self.arm);
        // The arm moves in media time, the light of the newest tip ages by the clock of the host.
        let host_ns = cx.tick_arrived_ns().map(|ns| ns.saturating_add(duration_ns(cx.tick_age())));
        if let (Some(host_ns), Some(light_ns)) = (host_ns, self.tip_light_ns) {
            lock.correct_tip(now_ns.saturating_sub(host_ns.saturating_sub(light_ns).max(0)));
        }
        lock.advance(now_ns, &mut |point| arm.step(point));
        if let Some(tip) = &input.tip {
            self.tip_light_ns = cx.arrived_ns(tip);
            lock.tip(now_ns.saturating_sub(age_ns(cx, tip)), guard::evidence(tip));
        }
        if let Some(joints) = &input.joints {
            lock.demand_of_light(now_ns, now_ns.saturating_sub(age_ns(cx, joints)), requested(joints));
        }
        guard::log_events(cx, lock);

        let stance = lock.chain().stance(arm.links());
        let tube = TubePose::of(lock.chain(), &stance, &self.down);
        let pose = self.home.inverse() * stance.base_from_camera;
        let at = pose.translation.vector;
        let (velocity, acceleration) = match self.last {
            Some((before, was, then)) if now_ns > then => {
                let dt_s = (now_ns - then) as f64 * 1e-9;
                let velocity = (at - before) / dt_s;
                (velocity, (velocity - was) / dt_s)
            }
            _ => (Vector3::zeros(), Vector3::zeros()),
        };
        self.last = Some((at, velocity, now_ns));
        let (encoders, point) = (arm.encoders(|| cx.random()), lock.set_point());
        out.motion.set(&stance, &self.home, (&encoders, arm.velocities()), (&point.position, &point.velocity))?;
        let stop = lock.stopped();
        cx.metric("pivot_mm", tube.pivot_mm);
        cx.metric("stops", lock.stops() as f64);
        if out.text.is_read() {
            guard::words(stop, lock.latched().is_some(), &mut self.words);
            out.text.set_text(&self.words)?;
        }
        let row: [f64; COLUMNS.len()] = [
            f64::from(u8::from(stop.is_none())),
            stop.map_or(0.0, |cause| cause.number() as f64),
            lock.stops() as f64,
            arm.velocities().amax(),
            velocity.norm(),
            tube.pivot_mm,
            tube.depth_mm,
            tube.tilt_rad.to_degrees(),
            acceleration.norm(),
        ];
        out.table.set_table(&COLUMNS, &row)
    }

    /// Saves the joint angles and the cause of a latched stop: a replacement must not release a stop that a person latched.
    fn save_state(&self) -> Option<Vec<u8>> {
        let latched = self.lock.latched().map_or(0, |cause| cause.number() as u64);
        let words = self.lock.set_point().position.iter().map(|v| v.to_bits()).chain([latched]);
        Some(words.flat_map(u64::to_le_bytes).collect())
    }

    fn load_state(&mut self, state: &[u8]) -> Result<()> {
        let words: Vec<u64> = state.chunks_exact(8).map(|b| b.try_into().map_or(0, u64::from_le_bytes)).collect();
        if words.len() != JOINTS + 1 {
            return Err(error!("the saved state has {} numbers, which do not fit this arm", words.len()));
        }
        let angles = JointVector::from_fn(|k, _| f64::from_bits(words[k]));
        *self = Self::at(self.lock.chain().clone(), angles, self.quality);
        if let Some(cause) = (words[JOINTS] as usize).checked_sub(1).and_then(|index| Cause::ALL.get(index)) {
            self.lock.latch(*cause);
        }
        Ok(())
    }
}
