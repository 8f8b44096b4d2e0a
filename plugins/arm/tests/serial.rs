//! The serial driver against a simulated arm on a pseudo-terminal: it moves, and every way in which the line can fail stops it and is said.

use std::fs::File;
use std::io::{Read, Write};
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_arm::serial::ArmSerial;
use panoscope_arm_core::line::{Line, Reader};
use panoscope_arm_core::{Cause, JointVector};
use panoscope_node::abi::{Joints, MAX_JOINTS, Tip};
use panoscope_node::harness::{Harness, HarnessError, Level};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

const WELL: u8 = 0;
const SILENT: u8 = 1;
const GARBAGE: u8 = 2;
const UNPLUGGED: u8 = 3;
const STUCK: u8 = 4;

/// What the arm saw.
#[derive(Default)]
struct Seen {
    set_points: Vec<(Instant, JointVector)>,
    watchdog: u32,
}

/// An arm that goes at once where it is sent, with the watchdog that the protocol asks for.
struct Device {
    path: String,
    mode: Arc<AtomicU8>,
    seen: Arc<Mutex<Seen>>,
    thread: Option<JoinHandle<()>>,
}

impl Device {
    fn plug_in() -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo-terminal");
        grantpt(&master).expect("granted");
        unlockpt(&master).expect("unlocked");
        let path = ptsname(&master, Vec::new()).expect("named").into_string().expect("text");
        rustix::fs::fcntl_setfl(&master, rustix::fs::OFlags::NONBLOCK).expect("no waiting");
        let (mode, seen) = (Arc::new(AtomicU8::new(WELL)), Arc::new(Mutex::new(Seen::default())));
        let (its_mode, its_seen) = (Arc::clone(&mode), Arc::clone(&seen));
        let thread = std::thread::spawn(move || serve(File::from(master), &its_mode, &its_seen));
        Self { path, mode, seen, thread: Some(thread) }
    }

    fn turn(&self, mode: u8) {
        self.mode.store(mode, Ordering::SeqCst);
    }

    fn last(&self) -> JointVector {
        let seen = self.seen.lock().expect("whole");
        seen.set_points.last().map_or(JointVector::zeros(), |(_, position)| *position)
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.turn(UNPLUGGED);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn serve(mut line: File, mode: &AtomicU8, seen: &Mutex<Seen>) {
    let mut reader = Reader::default();
    let (mut position, mut ready, mut moving) = (JointVector::zeros(), true, false);
    let mut heard = Instant::now();
    loop {
        let now_mode = mode.load(Ordering::SeqCst);
        if now_mode == UNPLUGGED {
            return;
        }
        let mut buffer = [0; 1024];
        // Nobody has opened the other end yet, or nothing was sent.
        let count = line.read(&mut buffer).unwrap_or(0);
        let mut answers = Vec::new();
        reader.take(&buffer[..count], |line| {
            let seq = match line {
                Some(Line::Hello { seq }) => seq,
                Some(Line::Clear { seq }) => {
                    (ready, moving) = (true, false);
                    seq
                }
                Some(Line::Set { seq, position: wanted, velocity }) => {
                    heard = Instant::now();
                    if ready {
                        if now_mode != STUCK {
                            position = wanted;
                        }
                        moving = velocity != JointVector::zeros();
                        seen.lock().expect("whole").set_points.push((heard, wanted));
                    }
                    seq
                }
                _ => return,
            };
            Line::Answer { seq, ready, position }.write(&mut answers);
        });
        // A loaded machine may hold the driver up: only a long silence is taken for its death here.
        if moving && heard.elapsed() > Duration::from_millis(400) {
            (ready, moving) = (false, false);
            seen.lock().expect("whole").watchdog += 1;
        }
        match now_mode {
            SILENT => {}
            GARBAGE if !answers.is_empty() => {
                let _ = line.write_all(b"\x00\xffA 12 R 5*00\n~~~\n\nA\n*\n");
            }
            _ => {
                let _ = line.write_all(&answers);
            }
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn params(path: &str, more: &str) -> String {
    format!("params = {{ port = \"{path}\", baud = 115200, enabled = true, answer_ms = 250{more} }}")
}

fn tip() -> Tip {
    Tip { u_px: 400.0, v_px: 240.0, xyz_mm: [7.5, 0.0, 65.0], score: 0.9, class_index: 0, xyz_valid: 1, track_id: 1 }
}

fn demand() -> Joints {
    let mut velocity_rad_s = [0.0; MAX_JOINTS];
    velocity_rad_s[5] = 0.1;
    Joints { position_rad: [0.0; MAX_JOINTS], velocity_rad_s, count: 6, reserved: 0 }
}

/// Ticks every 10 ms until `done` says so of the node's words; false when that takes longer than some seconds.
fn drive(
    node: &mut Harness<ArmSerial>,
    ask: bool,
    seconds: f64,
    mut done: impl FnMut(&str) -> bool,
) -> Result<bool, HarnessError> {
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < seconds {
        if ask {
            node.input_value("tip", tip()).input_value("joints", demand());
        }
        if done(node.process()?.text("text")?) {
            return Ok(true);
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(false)
}

/// Gets the arm moving. On a loaded machine a real answer may come late: that latches, as it should, and is let go here.
fn moving(device: &Device, node: &mut Harness<ArmSerial>, reset: &mut u64) -> Result<(), HarnessError> {
    for _ in 0..8 {
        let before = device.last()[5];
        let mut follows = 0;
        let fine = drive(node, true, 6.0, |words| {
            follows += u32::from(words == "arm follows" && (device.last()[5] - before).abs() > 0.01);
            follows > 3 || words.contains("STOPPED")
        })?;
        if fine && follows > 3 {
            return Ok(());
        }
        *reset += 1;
        node.set_params(&params(&device.path, &format!(", reset = {reset}")))?;
        drive(node, false, 2.0, |words| !words.contains("STOPPED"))?;
    }
    panic!("the arm never moved: {:?}", node.logs());
}

fn is_logged(node: &Harness<ArmSerial>, words: &str) -> bool {
    node.logs().iter().any(|line| line.level == Level::Warn && line.message.contains(words))
}

#[test]
fn set_points_come_and_end_when_the_graph_stalls() -> Result<(), HarnessError> {
    let device = Device::plug_in();
    let mut node = Harness::<ArmSerial>::from_toml(&params(&device.path, ""))?;
    moving(&device, &mut node, &mut 0)?;
    // The graph does not call any more: the driver's thread alone has to see it.
    std::thread::sleep(Duration::from_millis(700));
    let count = device.seen.lock().expect("whole").set_points.len();
    let at = device.last();
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(device.seen.lock().expect("whole").set_points.len(), count, "no set-point any more");
    drive(&mut node, false, 1.0, |_| true)?;
    let causes = [Cause::LoopStalled, Cause::OldTip, Cause::Stalled];
    assert!(causes.iter().any(|cause| is_logged(&node, cause.words())), "{:?}", node.logs());
    assert!(at[5] > 0.01 && at.iter().enumerate().all(|(k, v)| k == 5 || v.abs() < 1e-9), "{at}");
    // No step of the set-points was larger than the speed allows.
    let seen = device.seen.lock().expect("whole");
    for two in seen.set_points.windows(2) {
        let seconds = (two[1].0 - two[0].0).as_secs_f64();
        assert!((two[1].1 - two[0].1).amax() <= 0.4 * (seconds + 0.25), "{:?}", two);
    }
    Ok(())
}

#[test]
fn every_fault_of_the_line_stops_the_arm_and_is_said() -> Result<(), HarnessError> {
    for (mode, cause) in [
        (SILENT, Cause::Stalled),
        (GARBAGE, Cause::Garbage),
        (UNPLUGGED, Cause::Unplugged),
        (STUCK, Cause::NotFollowing),
    ] {
        // A late answer of a loaded machine may come first: then once more.
        let mut said = false;
        for _ in 0..4 {
            let device = Device::plug_in();
            let mut node = Harness::<ArmSerial>::from_toml(&params(&device.path, ""))?;
            moving(&device, &mut node, &mut 0)?;
            device.turn(mode);
            assert!(drive(&mut node, true, 6.0, |words| words.contains("STOPPED"))?, "{cause:?}: {:?}", node.logs());
            let still = drive(&mut node, true, 0.5, |words| !words.contains("STOPPED"))?;
            // Latched: asking on does not help.
            assert!(!still, "{cause:?} does not latch");
            said = is_logged(&node, cause.words());
            if said {
                break;
            }
        }
        assert!(said, "{cause:?}");
    }
    Ok(())
}

#[test]
fn an_emergency_stop_outlives_the_node_and_ends_with_reset() -> Result<(), HarnessError> {
    let device = Device::plug_in();
    let mut node = Harness::<ArmSerial>::from_toml(&params(&device.path, ""))?;
    let mut reset = 0;
    moving(&device, &mut node, &mut reset)?;
    node.set_params(&params(&device.path, &format!(", reset = {reset}, emergency_stop = true")))?;
    assert!(drive(&mut node, true, 6.0, |words| words.contains("emergency stop"))?);
    drop(node);
    // As after a fault or an edit of the graph.
    let mut node = Harness::<ArmSerial>::from_toml(&params(&device.path, ""))?;
    assert!(drive(&mut node, true, 6.0, |words| words.contains("emergency stop"))?);
    let before = device.last();
    drive(&mut node, true, 0.5, |_| false)?;
    assert_eq!(device.last(), before);
    node.set_params(&params(&device.path, ", reset = 1"))?;
    moving(&device, &mut node, &mut 1)
}

#[test]
fn a_line_without_an_arm_is_refused_with_its_name() {
    let refused = |port: &str| {
        let made = Harness::<ArmSerial>::from_toml(&params(port, ""));
        made.err().map(|error| error.to_string()).unwrap_or_default()
    };
    assert!(refused("/dev/no_such_line").contains("/dev/no_such_line cannot be opened"));
    assert!(refused("/dev/null").contains("/dev/null is no serial line"), "{}", refused("/dev/null"));
    let device = Device::plug_in();
    device.turn(SILENT);
    assert!(refused(&device.path).contains("no arm answered"), "{}", refused(&device.path));
}
