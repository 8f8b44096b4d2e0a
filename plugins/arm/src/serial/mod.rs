//! `arm_serial`: a real arm on a serial line ([`panoscope_arm_core::line`] is the protocol), behind the interlock.

mod driver;
mod port;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use panoscope_node::{Context, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData, TextPacket, Validation};

use crate::declared::{In, MotionOut, StopParams};
use crate::guard::{self, age_ns};
use crate::joints::{arm_of, check_arm, requested};
use driver::{Connection, Demand, Driver, Light};

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    #[ports(flatten)]
    motion: MotionOut<'f>,
    /// One row per tick: whether the arm follows, number of the stop's cause (0 for none), stops so far, largest joint speed, distance of the tube from
    /// the trocar, its depth, age of the arm's last answer.
    table: Slot<'f, TableData>,
    /// State of the arm in words.
    text: Slot<'f, TextPacket>,
}

/// Parameters.
#[derive(Params)]
pub struct SerialParams {
    /// Device of the serial line, such as /dev/ttyUSB0.
    #[param(default = "/dev/ttyUSB0", reopen)]
    port: String,
    /// Bits per second.
    #[param(default = 921600, range = 9600..=4_000_000, reopen)]
    baud: u32,
    /// Longest time without an answer of the arm; after it the arm is stopped.
    #[param(default = 30.0, range = 10.0..=250.0, step = 5.0, unit = "ms", reopen)]
    answer_ms: f64,
    /// URDF file of the arm; empty takes the arm that comes with the plugin.
    #[param(default = "", reopen)]
    arm: PathBuf,
    /// Lets the arm move. Off: requested velocities are ignored.
    #[param(default = false)]
    enabled: bool,
    #[param(flatten)]
    stop: StopParams,
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
        "A six-axis arm on a serial line behind the interlock; its own thread stops the arm when the graph stalls.",
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
        let connection = Connection { path: params.port.clone().into(), baud: params.baud, answer_within };
        let home = chain.stance(&panoscope_arm_core::JointVector::zeros()).base_from_camera;
        let driver = Driver::start(&connection, chain.clone())?;
        Ok(Self { driver, chain, home, reset: None, words: String::new() })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &SerialParams) -> Result<()> {
        let release = self.reset.replace(params.stop.reset).is_some_and(|old| old != params.stop.reset);
        // The age of the light when it got here; from here on the driver's own clock counts.
        let posted = Instant::now();
        let tip = input.tip.as_ref().map(|tip| (guard::evidence(tip), Light { posted, age_ns: age_ns(cx, tip) }));
        let demand = input.joints.as_ref().filter(|_| params.enabled).map(|joints| {
            let (values, mut velocity) = (requested(joints), [0.0; 8]);
            velocity[..values.len()].copy_from_slice(values);
            Demand { velocity, count: values.len(), light: Light { posted, age_ns: age_ns(cx, joints) } }
        });
        self.driver.post(|inbox| {
            inbox.settings = Some(params.stop.settings());
            inbox.emergency_stop = params.stop.emergency_stop;
            inbox.release |= release;
            inbox.tip = tip.or(inbox.tip);
            inbox.demand = demand.or(inbox.demand);
        });
        let known = self.driver.read(|event| {
            if event.stop.is_some() { cx.warn(&event.to_string()) } else { cx.info(&event.to_string()) }
        })?;
        let stance = self.chain.stance(&known.encoders);
        let (position_rad, velocity_rad_s) = &known.set_point;
        out.motion.set(&stance, &self.home, (&known.encoders, velocity_rad_s), (position_rad, velocity_rad_s))?;
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
