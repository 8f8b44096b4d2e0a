//! `arm_ur`: a Universal Robots arm over RTDE ([`panoscope_arm_guard::ur`] is the connection). The robot runs `panoscope_arm.script`, which stops it
//! when the heartbeat stops.

use std::path::PathBuf;
use std::time::Duration;

use panoscope_arm_core::{JOINTS, JointVector};
use panoscope_arm_guard::target::Target;
use panoscope_arm_guard::ur::{UrConnection, home_of};
use panoscope_node::{Context, Node, NodeInfo, Open, Params, Result, Validation, error};

use crate::declared::{In, StopParams};
use crate::joints::check_arm;
use crate::real::{Out, RealArm};

/// Parameters of `arm_ur`.
#[derive(Params)]
pub struct UrParams {
    /// Name or address of the robot's controller.
    #[param(default = "192.168.0.10", reopen)]
    host: String,
    /// TCP port of the controller's RTDE interface.
    #[param(default = 30004, range = 1..=65535, reopen)]
    port: u32,
    /// TCP port of the controller's dashboard server, from which the serial number is read.
    #[param(default = 29999, range = 1..=65535, reopen)]
    dashboard_port: u32,
    /// Time limit for an answer of the arm. After it the arm is stopped.
    #[param(default = 30.0, range = 10.0..=250.0, step = 5.0, unit = "ms", reopen)]
    answer_ms: f64,
    /// URDF file of the robot as mounted, with scope and trocar. There is no default: the limits of another arm would not hold for this one.
    #[param(default = "", reopen)]
    arm: PathBuf,
    /// The robot's six joint angles at which the angles of the URDF file are 0: in degrees as the pendant shows them, separated by commas.
    #[param(default = "0, 0, 0, 0, 0, 0", reopen)]
    home_deg: String,
    /// Lets the arm move after `reset` has released it. Off: requested velocities are ignored.
    #[param(default = false)]
    enabled: bool,
    #[param(flatten)]
    stop: StopParams,
}

/// Joint angles of `home_deg`, rad.
fn home(params: &UrParams) -> Option<JointVector> {
    let degrees = home_of(&params.home_deg)?;
    degrees.iter().all(|angle| angle.abs() <= 360.0).then(|| degrees.map(f64::to_radians))
}

fn bad_home(text: &str) -> String {
    format!("`home_deg = \"{text}\"` is not {JOINTS} angles from -360 to 360 degrees, separated by commas")
}

/// The `arm_ur` node.
pub struct ArmUr(RealArm);

impl Node for ArmUr {
    const INFO: NodeInfo = NodeInfo::realtime(
        "arm_ur",
        "arm",
        "A Universal Robots arm over RTDE. A separate process guards it and stops it whatever the program does.",
    )
    .exclusive()
    .side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = UrParams;

    fn validate(params: &UrParams, check: &mut Validation<'_>) {
        if params.arm.as_os_str().is_empty() {
            let message = "no description of the robot is given";
            check.error(
                "arm",
                message,
                "name a URDF file of this robot with its scope and trocar; core/robot/arm/README.md says how",
            );
        } else {
            check_arm(check, &params.arm);
        }
        if home(params).is_none() {
            let help = "copy the angles that the pendant shows where the robot holds the scope at its home";
            check.error("home_deg", bad_home(&params.home_deg), help);
        }
        if params.host.trim().is_empty() {
            check.error(
                "host",
                "no address of the robot is given",
                "name the address that the pendant shows under About",
            );
        }
    }

    fn open(cx: &Open<'_>, params: &UrParams) -> Result<Self> {
        let port = |number: u32| u16::try_from(number).map_err(|_| error!("port {number} is not valid"));
        let connection = UrConnection {
            host: params.host.trim().to_owned(),
            rtde_port: port(params.port)?,
            dashboard_port: port(params.dashboard_port)?,
            home: home(params).ok_or_else(|| error!("{}", bad_home(&params.home_deg)))?,
            answer_within: Duration::from_secs_f64(params.answer_ms * 1e-3),
        };
        if params.arm.as_os_str().is_empty() {
            return Err(error!("`arm` is empty: give the URDF file of this robot"));
        }
        RealArm::open(cx, Target::Ur(connection), &params.arm).map(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, out: Out<'f>, params: &UrParams) -> Result<()> {
        self.0.process(cx, &input, out, params.enabled, &params.stop)
    }
}
