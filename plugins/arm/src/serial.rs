//! `arm_serial`: a real arm on a serial line ([`panoscope_arm_core::line`] is the protocol).

use std::path::{Path, PathBuf};
use std::time::Duration;

use panoscope_arm_guard::link::Connection;
use panoscope_arm_guard::target::Target;
use panoscope_node::{Context, Node, NodeInfo, Open, Params, Result, Validation};

use crate::declared::{In, StopParams};
use crate::joints::check_arm;
use crate::real::{Out, RealArm};

/// Parameters of `arm_serial`.
#[derive(Params)]
pub struct SerialParams {
    /// Device of the serial line, such as /dev/ttyUSB0.
    #[param(default = "/dev/ttyUSB0", reopen)]
    port: String,
    /// Bits per second.
    #[param(default = 921600, range = 9600..=4_000_000, reopen)]
    baud: u32,
    /// Time limit for an answer of the arm. After it the arm is stopped.
    #[param(default = 30.0, range = 10.0..=250.0, step = 5.0, unit = "ms", reopen)]
    answer_ms: f64,
    /// URDF file of the arm; empty takes the arm that comes with the plugin.
    #[param(default = "", reopen)]
    arm: PathBuf,
    /// Lets the arm move after `reset` has released it. Off: requested velocities are ignored.
    #[param(default = false)]
    enabled: bool,
    #[param(flatten)]
    stop: StopParams,
}

/// The `arm_serial` node.
pub struct ArmSerial(RealArm);

impl Node for ArmSerial {
    const INFO: NodeInfo = NodeInfo::realtime(
        "arm_serial",
        "arm",
        "A six-axis arm on a serial line. A separate process guards it and stops it whatever the program does.",
    )
    .exclusive()
    .side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = SerialParams;

    fn validate(params: &SerialParams, check: &mut Validation<'_>) {
        check_arm(check, &params.arm);
        // A line may be plugged in until the graph runs.
        if !Path::new(&params.port).exists() {
            let message = format!("the serial line {} does not exist", params.port);
            check.warning("port", message, "connect the arm before the graph runs, or correct the path");
        }
    }

    fn open(cx: &Open<'_>, params: &SerialParams) -> Result<Self> {
        let answer_within = Duration::from_secs_f64(params.answer_ms * 1e-3);
        let connection = Connection { path: params.port.clone().into(), baud: params.baud, answer_within };
        RealArm::open(cx, Target::Serial(connection), &params.arm).map(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, out: Out<'f>, params: &SerialParams) -> Result<()> {
        self.0.process(cx, &input, out, params.enabled, &params.stop)
    }
}
