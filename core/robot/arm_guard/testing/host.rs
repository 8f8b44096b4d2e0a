//! A program that steers an arm through the guard like the node `arm_serial`, for tests that kill, stop and hang it. It
//! is not shipped.
//!
//! `panoscope-arm-host DEVICE FOLDER RAD_S` turns the last joint at RAD_S. It writes `guard PID` when the guard runs,
//! or `failed: REASON`. On standard input, `hang` makes it stop without an end (it writes `hangs` then), `crash` aborts
//! it, and the end of the input ends it.

use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

use panoscope_arm_core::interlock::{Evidence, Settings};
use panoscope_arm_guard::client::Guard;
use panoscope_arm_guard::clock;
use panoscope_arm_guard::link::Connection;
use panoscope_arm_guard::message::Request;

/// Time between two requests, as of a camera with 100 frames per second.
const TICK: Duration = Duration::from_millis(10);
/// Time before a stop is released again while the arm has not moved; longer than a release takes.
const PATIENCE: Duration = Duration::from_millis(1500);
/// Command that hangs the program.
const HANG: u8 = 1;
const CRASH: u8 = 2;

static COMMAND: AtomicU8 = AtomicU8::new(0);

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [device, folder, rad_s] = args.as_slice() else {
        eprintln!("usage: panoscope-arm-host DEVICE FOLDER RAD_S");
        return ExitCode::from(2);
    };
    let Ok(rad_s) = rad_s.parse::<f64>() else {
        eprintln!("`{rad_s}`: a speed in rad/s is needed");
        return ExitCode::from(2);
    };
    let connection =
        Connection { path: PathBuf::from(device), baud: 921_600, answer_within: Duration::from_millis(240) };
    match Guard::start(&connection, Path::new(""), Some(Path::new(folder))) {
        Ok(guard) => {
            report(&format!("guard {}", guard.process_id()));
            std::thread::spawn(obey);
            steer(guard, rad_s);
            ExitCode::SUCCESS
        }
        Err(error) => {
            report(&format!("failed: {error}"));
            ExitCode::FAILURE
        }
    }
}

/// Writes a line; ignores a closed output.
fn report(line: &str) {
    let mut out = std::io::stdout();
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}

/// Reads commands. The end of the input ends the test.
fn obey() {
    for line in std::io::stdin().lock().lines().map_while(Result::ok) {
        match line.as_str() {
            "hang" => COMMAND.store(HANG, Ordering::Relaxed),
            "crash" => COMMAND.store(CRASH, Ordering::Relaxed),
            _ => {}
        }
    }
    #[expect(clippy::disallowed_methods, reason = "a test program without foreign libraries, from a thread")]
    std::process::exit(0);
}

/// Requests the movement until the guard ends.
fn steer(mut guard: Guard, rad_s: f64) {
    let (mut reset, mut has_moved, mut stopped_since) = (0, false, None);
    loop {
        match COMMAND.load(Ordering::Relaxed) {
            HANG => {
                report("hangs");
                loop {
                    std::thread::park();
                }
            }
            CRASH => std::process::abort(),
            _ => {}
        }
        let now_ns = clock::now_ns();
        guard.request(&Request {
            sent_ns: now_ns,
            tip: Some((now_ns, Evidence { score: 0.9, in_space: true })),
            demand: Some((now_ns, [0.0, 0.0, 0.0, 0.0, 0.0, rad_s, 0.0, 0.0], 6)),
            settings: Settings::default(),
            emergency_stop: false,
            reset,
        });
        let Some(status) = guard.status(|_| ()) else { return };
        has_moved |= status.stop.is_none() && status.set_point.1.amax() > 0.99 * rad_s.abs();
        // The person who releases the arm; a loaded machine may stop it before it moves.
        if status.latched && !has_moved {
            let is_due = stopped_since.is_none_or(|since: Instant| since.elapsed() > PATIENCE);
            if is_due {
                reset += 1;
                stopped_since = Some(Instant::now());
            }
        }
        std::thread::sleep(TICK);
    }
}
