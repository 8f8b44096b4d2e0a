//! `panoscope-arm`: the arm's interlock, started by the nodes `arm_serial` and `arm_ur` with a socket as standard
//! input.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use panoscope_arm_core::Chain;
use panoscope_arm_guard::check::Check;
use panoscope_arm_guard::link::Connection;
use panoscope_arm_guard::server::{self, Options};
use panoscope_arm_guard::target::Target;
use panoscope_arm_guard::ur::{self, UrConnection};
use panoscope_arm_guard::{client, latch};

const USAGE: &str = "panoscope-arm guards an arm. The nodes `arm_serial` and `arm_ur` of a graph start it.

usage: panoscope-arm --port DEVICE --baud BITS_PER_SECOND --answer-ms MS [--arm FILE.urdf] [--latches FOLDER]
       panoscope-arm --ur HOST --home RAD,RAD,RAD,RAD,RAD,RAD --answer-ms MS --arm FILE.urdf [--latches FOLDER]
                     [--rtde-port PORT] [--dashboard-port PORT]
       standard input must be the socket to the program that steers the arm
       panoscope-arm --check [FOLDER]
       tries locked memory, real-time priority and the folder of latched stops, and writes the result";

fn main() -> ExitCode {
    match run(std::env::args().skip(1).collect()) {
        Ok(()) => ExitCode::SUCCESS,
        Err((code, message)) => {
            eprintln!("panoscope-arm: {message}");
            ExitCode::from(code)
        }
    }
}

/// Runs the program with its arguments. Errors are an exit code and a message.
fn run(args: Vec<String>) -> Result<(), (u8, String)> {
    let wrong = |message: String| (2, format!("{message}\n\n{USAGE}"));
    if let [first, folder @ ..] = args.as_slice()
        && first == "--check"
    {
        let check = Check::run(folder.first().map(Path::new));
        return check.write(&mut std::io::stdout()).map_err(|error| (1, error.to_string()));
    }
    let (mut port, mut baud, mut answer_ms, mut arm, mut latches) = (None, None, None, PathBuf::new(), None);
    let (mut host, mut home, mut rtde_port, mut dashboard_port) = (None, None, ur::RTDE_PORT, ur::DASHBOARD_PORT);
    let mut args = args.into_iter();
    while let Some(option) = args.next() {
        let value = args.next().ok_or_else(|| wrong(format!("`{option}` needs a value")))?;
        let number =
            |text: &str| text.parse::<u32>().map_err(|_| wrong(format!("`{option} {text}`: expected a whole number")));
        let tcp_port = |text: &str| {
            text.parse::<u16>().map_err(|_| wrong(format!("`{option} {text}`: expected a port from 1 to 65535")))
        };
        match option.as_str() {
            "--port" => port = Some(PathBuf::from(value)),
            "--baud" => baud = Some(number(&value)?),
            "--answer-ms" => answer_ms = Some(number(&value)?),
            "--ur" => host = Some(value),
            "--home" => {
                let angles = ur::home_of(&value);
                home = Some(angles.ok_or_else(|| wrong(format!("`--home {value}`: expected six angles in rad")))?);
            }
            "--rtde-port" => rtde_port = tcp_port(&value)?,
            "--dashboard-port" => dashboard_port = tcp_port(&value)?,
            "--arm" => arm = PathBuf::from(value),
            "--latches" => latches = Some(PathBuf::from(value)),
            _ => return Err(wrong(format!("unknown option `{option}`"))),
        }
    }
    let Some(answer_ms) = answer_ms else { return Err(wrong("`--answer-ms` is missing".to_owned())) };
    let answer_within = Duration::from_millis(u64::from(answer_ms));
    let target = match (port, baud, host, home) {
        (Some(path), Some(baud), None, None) => Target::Serial(Connection { path, baud, answer_within }),
        // The limits of another arm than the robot would not be its limits.
        (None, None, Some(_), Some(_)) if arm.as_os_str().is_empty() => {
            return Err(wrong("`--ur` needs `--arm`: the file that describes this robot".to_owned()));
        }
        (None, None, Some(host), Some(home)) => {
            Target::Ur(UrConnection { host, rtde_port, dashboard_port, home, answer_within })
        }
        _ => return Err(wrong("give either `--port` and `--baud`, or `--ur` and `--home`".to_owned())),
    };
    let failed = |message: String| (1, message);
    let socket = client::inherited_socket().map_err(|error| wrong(error.to_string()))?;
    let chain = if arm.as_os_str().is_empty() {
        Chain::shipped().map_err(|e| failed(e.to_string()))?
    } else {
        let text = std::fs::read_to_string(&arm).map_err(|e| failed(format!("{}: {e}", arm.display())))?;
        Chain::from_urdf(&text).map_err(|e| failed(format!("{}: {e}", arm.display())))?
    };
    let latches = latches.map_or_else(latch::folder, Ok).map_err(|e| failed(e.to_string()))?;
    server::serve(socket, Options { target, chain, latches }).map_err(|e| failed(e.to_string()))
}
