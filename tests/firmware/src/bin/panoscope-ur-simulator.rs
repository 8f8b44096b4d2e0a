//! A simulated Universal Robots arm for trying `arm_ur`: prints the node's parameters, then runs until it is terminated.
//!
//! usage: panoscope-ur-simulator [SERIAL_NUMBER [RTDE_PORT DASHBOARD_PORT]]

use std::process::ExitCode;

use panoscope_arm_core::JointVector;
use panoscope_firmware::ur::{UrBehaviour, UrSimulator};

const PROGRAM: &str = include_str!("../../../../core/robot/arm_guard/ur/panoscope_arm.script");

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let serial = args.first().map_or("20240000001", String::as_str);
    let port = |index: usize| args.get(index).and_then(|text| text.parse().ok()).unwrap_or(0);
    let (angles, behaviour) = (JointVector::zeros(), UrBehaviour::default());
    match UrSimulator::plug_in_at(serial, PROGRAM, angles, behaviour, (port(1), port(2))) {
        Ok(simulator) => {
            let (rtde, dashboard) = simulator.ports();
            println!("host = \"127.0.0.1\", port = {rtde}, dashboard_port = {dashboard}");
            loop {
                std::thread::park();
            }
        }
        Err(error) => {
            eprintln!("no simulated arm: {error}");
            ExitCode::FAILURE
        }
    }
}
