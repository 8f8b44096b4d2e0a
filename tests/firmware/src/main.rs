//! A simulated arm for trying `arm_serial`: prints the device to open, then runs until it is terminated.

use std::process::ExitCode;

use panoscope_firmware::{Behaviour, Firmware};

fn main() -> ExitCode {
    let serial = std::env::args().nth(1).unwrap_or_else(|| "SIMULATED-1".to_owned());
    match Firmware::plug_in(&serial, Behaviour::default()) {
        Ok(firmware) => {
            println!("{}", firmware.path());
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
