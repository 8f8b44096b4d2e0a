//! `arm_serial`: a real arm on a serial line ([`panoscope_arm_core::line`] is the protocol), behind the interlock.

mod driver;
mod port;

use std::path::PathBuf;
use std::time::Duration;

use panoscope_node::abi::{Joints, Pose, Tip};
use panoscope_node::{
    Context, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData, TextPacket, Validation, Value,
};

use crate::guard;
use crate::joints::{arm_of, asked, camera_pose, check_arm, packet, tell_links};
use driver::{Driver, Place};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Joint velocities that are asked for.
    joints: Option<Value<'f, Joints>>,
    /// The tip that they follow, straight from the tracker: without a fresh one nothing moves.
    tip: Option<Value<'f, Tip>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// What the arm's encoders read last.
    joints: Slot<'f, Joints>,
    /// The newest set-points: what the interlock let through.
    setpoint: Slot<'f, Joints>,
    /// Where the left camera stands by the encoders, in the frame `scene`: where it is at home.
    camera_pose: Slot<'f, Pose>,
    /// Where the links join by the encoders, one row per joint from the base to the camera, in the frame of `camera_pose`.
    links: Slot<'f, TableData>,
    /// One row per tick: state, cause of a stop, age of the arm's last answer.
    table: Slot<'f, TableData>,
    /// The state in words.
    text: Slot<'f, TextPacket>,
}

/// Parameters.
#[derive(Params)]
pub struct SerialParams {
    /// The serial line's device, such as /dev/ttyUSB0.
    #[param(default = "/dev/ttyUSB0", reopen)]
    port: String,
    /// Bits per second.
    #[param(default = 921600, range = 9600..=4_000_000, reopen)]
    baud: u32,
    /// Longest time that the arm may take to answer a line; then it is stopped.
    #[param(default = 30.0, range = 10.0..=250.0, step = 5.0, unit = "ms", reopen)]
    answer_ms: f64,
    /// The arm, a URDF file; empty takes the one that ships.
    #[param(default = "", reopen)]
    arm: PathBuf,
    /// Whether the arm may move at all.
    #[param(default = false)]
    enabled: bool,
    /// Stops the arm; it stays stopped when this is let go, until `reset` changes.
    #[param(default = false)]
    emergency_stop: bool,
    /// Another number than before lets a latched stop go; a line that broke off is opened again.
    #[param(default = 0, range = 0..=1_000_000_000)]
    reset: u64,
    /// Oldest tip that is followed.
    #[param(default = 150.0, range = 10.0..=300.0, step = 10.0, unit = "ms")]
    max_age_ms: f64,
    /// Lowest score of a tip that is followed; a tip that is only predicted loses score with time.
    #[param(default = 0.3, range = 0.01..=1.0, step = 0.01, unit = "ratio")]
    min_score: f64,
}

/// Columns of the table.
pub const COLUMNS: [&str; 7] = ["following", "cause", "stops", "speed_rad_s", "pivot_mm", "depth_mm", "answer_age_ms"];

/// See the module.
pub struct ArmSerial {
    driver: Driver,
    chain: panoscope_arm_core::Chain,
    home: nalgebra::Isometry3<f64>,
    reset: Option<u64>,
    words: String,
}

impl Node for ArmSerial {
    const INFO: NodeInfo = NodeInfo::realtime(
        "arm_serial",
        "arm",
        "A six-axis arm on a serial line behind the interlock; its own thread stops it when the graph does not go on.",
    )
    .exclusive()
    .side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = SerialParams;

    fn validate(params: &SerialParams, check: &mut Validation<'_>) {
        check_arm(check, &params.arm);
        // A line may be plugged in until the graph runs.
        if !std::path::Path::new(&params.port).exists() {
            let message = format!("there is no serial line {}", params.port);
            check.warning("port", message, "plug the arm in before the graph runs, or name its line");
        }
    }

    fn open(_: &Open<'_>, params: &SerialParams) -> Result<Self> {
        let chain = arm_of(&params.arm)?;
        let answer_within = Duration::from_secs_f64(params.answer_ms * 1e-3);
        let place = Place { path: params.port.clone().into(), baud: params.baud, answer_within };
        let home = chain.stance(&panoscope_arm_core::JointVector::zeros()).base_from_camera;
        let driver = Driver::start(&place, chain.clone())?;
        Ok(Self { driver, chain, home, reset: None, words: String::new() })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &SerialParams) -> Result<()> {
        let release = self.reset.replace(params.reset).is_some_and(|old| old != params.reset);
        // The tip's age in media time when it got here; from here on the driver's own clock counts.
        let now_ns = cx.tick().capture_ns;
        let age = |tip: &Value<'_, Tip>| {
            let ns = now_ns.saturating_sub(tip.tick().capture_ns);
            Duration::from_nanos(ns.unsigned_abs())
        };
        self.driver.tell(|inbox| {
            inbox.settings = Some(guard::settings(params.max_age_ms, params.min_score));
            inbox.emergency_stop = params.emergency_stop;
            inbox.release |= release;
            if let Some(tip) = &input.tip {
                inbox.tip = Some((guard::evidence(tip), age(tip)));
            }
            if let Some(joints) = input.joints.as_ref().filter(|_| params.enabled) {
                let (values, mut kept) = (asked(joints), [0.0; 8]);
                kept[..values.len()].copy_from_slice(values);
                inbox.demand = Some((kept, values.len()));
            }
        });
        let known = self
            .driver
            .look(|event| if event.stop.is_some() { cx.warn(&event.to_string()) } else { cx.info(&event.to_string()) });
        let stance = self.chain.stance(&known.encoders);
        out.camera_pose.set(camera_pose(&(self.home.inverse() * stance.base_from_camera)))?;
        if out.links.is_read() {
            tell_links(&mut out.links, &stance, &self.home)?;
        }
        out.joints.set(packet(&known.encoders, &known.set_point.1))?;
        out.setpoint.set(packet(&known.set_point.0, &known.set_point.1))?;
        cx.metric("stops", known.stops as f64);
        if out.text.is_read() {
            guard::words(known.stop, known.latched, &mut self.words);
            out.text.set_text(if params.enabled { &self.words } else { "arm off" })?;
        }
        let row: [f64; COLUMNS.len()] = [
            f64::from(u8::from(known.stop.is_none())),
            known.stop.map_or(0.0, |cause| cause.number() as f64),
            known.stops as f64,
            known.set_point.1.amax(),
            known.pivot_mm,
            known.depth_mm,
            known.answer_age_ms,
        ];
        out.table.set_table(&COLUMNS, &row)
    }
}
