//! Every operation on the file of a recording fails in turn; all ticks that were reported as recorded must be readable
//! afterwards.
//!
//! The faults come from `tests/c/disk_faults.c`, preloaded into child processes of this test, each of which runs one
//! case. `PANOSCOPE_DISK_TICKS` sets how many ticks are recorded (5 without it).

use std::ffi::CString;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;

use crate::common::{PATIENCE, ready, scratch};
use panoscope_engine::Options;
use panoscope_record::{RecordOptions, Recorder, Recording, RecordingError, head};

const CHILD: &str = "PANOSCOPE_TEST_RECORD_CHILD";
const NAME: &str = "disk::reported_ticks_are_readable_after_a_fault_at_any_operation";
/// Fault number as in `disk_faults.c`, name, and whether the process survives.
const FAULTS: [(i32, &str, bool); 6] = [
    (1, "disk full", true),
    (2, "I/O error once", true),
    (3, "half a write", true),
    (4, "device gone", true),
    (5, "kill", false),
    (6, "kill in a write", false),
];

/// Records a run while operation `number` on files of the folder fails; prints the recorder's report.
fn record(folder: &Path, fault: i32, number: i32, ticks: u64) {
    // SAFETY: `dlsym` gets zero-terminated names; `disk_faults.c` defines the functions with these signatures.
    let (arm, disarm) = unsafe {
        let arm = libc::dlsym(libc::RTLD_DEFAULT, c"disk_arm".as_ptr());
        let disarm = libc::dlsym(libc::RTLD_DEFAULT, c"disk_disarm".as_ptr());
        assert!(!arm.is_null() && !disarm.is_null(), "the library is not preloaded");
        (
            std::mem::transmute::<*mut libc::c_void, extern "C" fn(*const libc::c_char, libc::c_int, libc::c_int)>(arm),
            std::mem::transmute::<*mut libc::c_void, extern "C" fn() -> libc::c_int>(disarm),
        )
    };
    let text = "mode = \"batch\"\nplugins = [\"flow\"]\n[nodes.a]\ntype = \"frames\"\n\
        params = { width_px = 64, height_px = 48, rate_hz = 200.0 }\n\
        [nodes.end]\ntype = \"drain\"\ninputs = { image = \"a.image\" }\n";
    let ready = ready("disk.toml", text);
    let file = folder.join("r.mcap");
    // Not the lock next to it, without which a recording goes on.
    let watched = CString::new(file.to_str().expect("UTF-8")).expect("no zeros");
    arm(watched.as_ptr(), fault, number);
    let record = RecordOptions { file: Some(file), ..RecordOptions::default() };
    let recorder = match Recorder::start(record, head(&ready)) {
        Ok(recorder) => recorder,
        Err(error) => {
            println!("reported: 0 ticks, fault {}, failed true: {error}", disarm());
            return;
        }
    };
    let options = Options { observer: Some(Arc::clone(&recorder) as _), frames: Some(ticks), ..Options::default() };
    let live = ready.start(options).expect("it starts");
    assert!(live.engine().wait(Some(PATIENCE)), "it does not end");
    live.engine().close(PATIENCE);
    let recorded = recorder.finish();
    let (fired, failed) = (disarm(), recorded.failed.is_some());
    println!("reported: {} ticks, fault {fired}, failed {failed}: {:?}", recorded.ticks, recorded.failed);
}

fn library() -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/c/disk_faults.c");
    let library = scratch("disk_faults.so");
    let mut cc = Command::new("cc");
    cc.args(["-O1", "-shared", "-fPIC", "-fvisibility=hidden", "-o"]).args([&library, &source]);
    assert!(cc.status().expect("a C compiler").success(), "{} does not build", source.display());
    library
}

#[test]
fn reported_ticks_are_readable_after_a_fault_at_any_operation() {
    let ticks = std::env::var("PANOSCOPE_DISK_TICKS").ok().and_then(|n| n.parse().ok()).unwrap_or(5);
    if let Ok(case) = std::env::var(CHILD) {
        let mut parts = case.splitn(3, ' ');
        let mut number = || parts.next().and_then(|n| n.parse().ok()).expect("a number");
        let (fault, operation) = (number(), number());
        return record(Path::new(parts.next().expect("a folder")), fault, operation, ticks);
    }
    let library = library();
    let mut cases = 0;
    for (fault, name, goes_on) in FAULTS {
        for operation in 1.. {
            let folder = scratch("recorded");
            let _ = std::fs::remove_dir_all(&folder);
            std::fs::create_dir_all(&folder).expect("a folder");
            let case = format!("{name} at operation {operation}");
            let Output { status, stdout, stderr } = Command::new(std::env::current_exe().expect("a test has a file"))
                .args(["--exact", NAME, "--nocapture"])
                .env(CHILD, format!("{fault} {operation} {}", folder.display()))
                .env("LD_PRELOAD", &library)
                .output()
                .expect("it starts");
            let output = String::from_utf8_lossy(&stdout).into_owned() + &String::from_utf8_lossy(&stderr);
            cases += 1;
            let line = output.lines().find_map(|line| line.split("reported: ").nth(1)).unwrap_or_default().to_owned();
            assert!(status.success() && !line.is_empty() || !goes_on, "{case}: {output}");
            let found = match Recording::open(&folder.join("r.mcap")) {
                Ok(recording) => {
                    for packet in recording.ports.values().flatten() {
                        recording.bytes("a.image", packet).unwrap_or_else(|error| panic!("{case}: {error}"));
                    }
                    let ticks = recording.sources.get("a").map_or(&[][..], |t| t);
                    assert!((0..).zip(ticks).all(|(seq, tick)| tick.seq == seq), "{case}: a tick is missing inside");
                    ticks.len() as u64
                }
                // The recording was not started, so no tick may have been reported.
                Err(
                    RecordingError::Empty { .. } | RecordingError::Unreadable { .. } | RecordingError::Foreign { .. },
                ) => 0,
                Err(error) => panic!("{case}: {error}"),
            };
            if line.is_empty() {
                // The process was killed, so it reported nothing; the file was read above.
                continue;
            }
            let reported: u64 = line.split(' ').next().and_then(|n| n.parse().ok()).expect("a number");
            assert!(found >= reported, "{case}: {reported} ticks were reported, {found} are in the file");
            if line.contains("fault 0") {
                assert!(line.contains("failed false") && reported == ticks, "{case}: {line}");
                break;
            }
            assert!(line.contains("failed true"), "{case}: the loss was not reported: {line}");
        }
    }
    println!("{cases} cases");
    let _ = std::fs::remove_file(library);
}
