//! Every file operation of every sink fails in turn: a full disk, an I/O error, a device that is gone, a kill. What was acknowledged before is
//! readable afterwards, and every loss is reported.
//!
//! The faults come from `tests/c/disk_faults.c`, preloaded into a child process of this test. `PANOSCOPE_DISK_TICKS` sets how many ticks each case
//! has (3 without it): each tick brings more operations, each of which fails in a separate case.

use std::collections::BTreeSet;
use std::ffi::CString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use opencv::prelude::*;
use opencv::{imgcodecs, videoio};
use panoscope_node::abi::{CloudPoint, Detection, STATUS_STOPPED};
use panoscope_node::harness::{Harness, HarnessError, Setup};
use panoscope_node::{Bgr8, Disparity, Node};
use panoscope_sinks::write_cloud::WriteCloud;
use panoscope_sinks::write_images::WriteImages;
use panoscope_sinks::write_raw::WriteRaw;
use panoscope_sinks::write_table::WriteTable;
use panoscope_sinks::write_video::WriteVideo;

const CHILD: &str = "PANOSCOPE_TEST_DISK_CHILD";
/// Name of the campaign for files that GStreamer writes.
const INDEXED: &str = "indexed";

/// Faults, numbered as in `disk_faults.c`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    Full = 1,
    EioOnce = 2,
    EioTorn = 3,
    Gone = 4,
    Kill = 5,
    KillTorn = 6,
}

const FAULTS: [Fault; 6] = [Fault::Full, Fault::EioOnce, Fault::EioTorn, Fault::Gone, Fault::Kill, Fault::KillTorn];

type Arm = unsafe extern "C" fn(*const libc::c_char, libc::c_int, libc::c_int);
type Disarm = unsafe extern "C" fn() -> libc::c_int;

/// The preloaded library.
struct Disk {
    arm: Arm,
    disarm: Disarm,
}

impl Disk {
    fn find() -> Self {
        let symbol = |name: &str| {
            let name = CString::new(name).unwrap();
            // SAFETY: a plain look-up.
            let found = unsafe { libc::dlsym(libc::RTLD_DEFAULT, name.as_ptr()) };
            assert!(!found.is_null(), "the library is not preloaded");
            found
        };
        // SAFETY: functions of `disk_faults.c` with these signatures.
        let (arm, disarm) = unsafe {
            (
                std::mem::transmute::<*mut libc::c_void, Arm>(symbol("disk_arm")),
                std::mem::transmute::<*mut libc::c_void, Disarm>(symbol("disk_disarm")),
            )
        };
        Self { arm, disarm }
    }

    fn arm(&self, folder: &Path, fault: Fault, number: i32) {
        let folder = CString::new(folder.to_str().unwrap()).unwrap();
        // SAFETY: the function copies the text.
        unsafe { (self.arm)(folder.as_ptr(), fault as i32, number) }
    }

    fn disarm(&self) -> bool {
        // SAFETY: no arguments.
        unsafe { (self.disarm)() != 0 }
    }
}

/// A sink, and how its output is read by others.
struct Sink {
    name: &'static str,
    run: fn(&Path, u64, &mut dyn FnMut(u64)) -> Reported,
    /// Ticks that are read back complete.
    read: fn(&Path) -> BTreeSet<u64>,
}

/// Failures that a run reported.
#[derive(Default, Debug)]
struct Reported {
    errors: Vec<String>,
    stopped: bool,
}

const SINKS: [Sink; 9] = [
    Sink { name: "video", run: |f, n, ack| run::<WriteVideo>(f, "path = \"v.mkv\"", n, ack, picture), read: videos },
    Sink {
        name: "h264",
        run: |f, n, ack| run::<WriteVideo>(f, "path = \"v.mkv\", codec = \"h264\"", n, ack, picture),
        read: videos,
    },
    Sink {
        name: "images",
        run: |f, n, ack| run::<WriteImages>(f, "path = \"{seq}.png\"", n, ack, picture),
        read: |f| stills(f, "png"),
    },
    Sink {
        name: "raw",
        run: |f, n, ack| run::<WriteRaw>(f, "path = \"{seq}.pfm\"", n, ack, plane),
        read: |f| stills(f, "pfm"),
    },
    Sink { name: "cloud", run: |f, n, ack| run::<WriteCloud>(f, "path = \"{seq}.ply\"", n, ack, cloud), read: clouds },
    Sink { name: "jsonl", run: |f, n, ack| run::<WriteTable>(f, "path = \"t.jsonl\"", n, ack, table), read: lines },
    Sink { name: "csv", run: |f, n, ack| run::<WriteTable>(f, "path = \"t.csv\"", n, ack, table), read: csv },
    Sink { name: "coco", run: |f, n, ack| run::<WriteTable>(f, "path = \"t.json\"", n, ack, boxes), read: coco },
    Sink {
        name: "last",
        // Nothing is acknowledged before the end.
        run: |f, n, _| run::<WriteImages>(f, "path = \"last.png\", at_end = true", n, &mut |_| {}, picture),
        read: |_| BTreeSet::new(),
    },
];

/// Runs a node for this many ticks as the runtime does: reopened after an error, left closed after a lasting one, finished at the end.
fn run<N: Node>(
    folder: &Path,
    params: &str,
    ticks: u64,
    acknowledge: &mut dyn FnMut(u64),
    give: fn(&mut Harness<N>, u64),
) -> Reported {
    let mut reported = Reported::default();
    let setup = Setup::new(&format!("params = {{ {params} }}")).graph_dir(folder);
    let mut node = match Harness::<N>::open(setup) {
        Ok(node) => node,
        Err(error) => {
            reported.errors.push(error.to_string());
            return reported;
        }
    };
    let mut open = true;
    for tick in 0..ticks {
        if !open {
            open = node.reopen().map_err(|error| reported.note(&error)).is_ok();
            if reported.stopped {
                break;
            }
        }
        if !open {
            continue;
        }
        node.at_tick(tick, tick as i64 * 40_000_000);
        give(&mut node, tick);
        match node.process() {
            Ok(_) => acknowledge(tick),
            Err(error) => {
                reported.note(&error);
                open = false;
                if let Err(error) = node.finish() {
                    reported.note(&error);
                }
                if reported.stopped {
                    break;
                }
            }
        }
    }
    if open && let Err(error) = node.finish() {
        reported.note(&error);
    }
    reported
}

impl Reported {
    fn note(&mut self, error: &HarnessError) {
        self.stopped |= error.status() == Some(STATUS_STOPPED);
        self.errors.push(error.to_string());
    }
}

/// A gray level that identifies the tick.
fn level(tick: u64) -> u8 {
    (10 + tick % 12 * 20) as u8
}

fn picture<N: Node>(node: &mut Harness<N>, tick: u64) {
    node.input_image::<Bgr8>("image", 64, 48, &vec![level(tick); 64 * 48 * 3]);
}

fn plane<N: Node>(node: &mut Harness<N>, tick: u64) {
    node.input_image::<Disparity>("disparity", 40, 30, &vec![f32::from(level(tick)); 40 * 30]);
}

fn cloud<N: Node>(node: &mut Harness<N>, tick: u64) {
    let point = CloudPoint { x_mm: f32::from(level(tick)), y_mm: 1.0, z_mm: 50.0, bgr: [1, 2, 3], filled: 0 };
    node.input_cloud("cloud", 20, 10, &[point; 200]);
}

fn table<N: Node>(node: &mut Harness<N>, tick: u64) {
    node.input_table("table", &["level", "b"], &[f64::from(level(tick)), 2.5]);
}

fn boxes<N: Node>(node: &mut Harness<N>, tick: u64) {
    let item = Detection {
        x_px: f32::from(level(tick)),
        y_px: 1.0,
        width_px: 4.0,
        height_px: 2.0,
        score: 0.9,
        class_index: 0,
        track_id: -1,
    };
    node.input_detections("detections", &[item], "hook", (640, 480));
}

fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let found = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut found: Vec<PathBuf> = found.filter(|path| path.extension().is_some_and(|e| e == ending)).collect();
    found.sort();
    found
}

fn videos(folder: &Path) -> BTreeSet<u64> {
    let mut ticks = BTreeSet::new();
    for path in files(folder, "mkv") {
        let Ok(mut video) = videoio::VideoCapture::from_file(path.to_str().unwrap(), videoio::CAP_FFMPEG) else {
            continue;
        };
        let mut mat = Mat::default();
        while video.is_opened().unwrap() && video.read(&mut mat).unwrap() {
            let bytes = mat.data_bytes().unwrap();
            // A torn frame is gray in its lower part.
            let tick = (0..12).find(|tick| bytes.iter().all(|b| b.abs_diff(level(*tick)) < 6));
            ticks.extend(tick);
        }
    }
    ticks
}

/// Every file under its final name must be complete.
fn stills(folder: &Path, ending: &str) -> BTreeSet<u64> {
    let of = |path: &PathBuf| {
        let tick: u64 = path.file_stem().unwrap().to_str().unwrap().parse().unwrap();
        let mat = imgcodecs::imread(path.to_str().unwrap(), imgcodecs::IMREAD_UNCHANGED).unwrap();
        assert!(mat.rows() > 0, "{} is not whole", path.display());
        let is_right = match ending {
            "png" => mat.data_bytes().unwrap().iter().all(|b| *b == level(tick)),
            _ => mat.data_typed::<f32>().unwrap().iter().all(|v| *v == f32::from(level(tick))),
        };
        assert!(is_right, "{} shows something else", path.display());
        tick
    };
    files(folder, ending).iter().map(of).collect()
}

fn clouds(folder: &Path) -> BTreeSet<u64> {
    let of = |path: &PathBuf| {
        let tick: u64 = path.file_stem().unwrap().to_str().unwrap().parse().unwrap();
        let bytes = fs::read(path).unwrap();
        let end = b"end_header\n";
        let at = bytes.windows(end.len()).position(|w| w == end).expect("a whole head") + end.len();
        assert_eq!(bytes.len() - at, 200 * 16, "{} is not whole", path.display());
        assert_eq!(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()), f32::from(level(tick)));
        tick
    };
    files(folder, "ply").iter().map(of).collect()
}

/// Only the last line of a file may be incomplete.
fn json_lines(path: &Path) -> Vec<serde_json::Value> {
    let text = fs::read_to_string(path).unwrap();
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    whole.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))).collect()
}

fn lines(folder: &Path) -> BTreeSet<u64> {
    let mut ticks = BTreeSet::new();
    for line in files(folder, "jsonl").iter().flat_map(|path| json_lines(path)) {
        let tick = line["seq"].as_u64().unwrap();
        assert_eq!(line["table"][0]["level"].as_u64(), Some(u64::from(level(tick))));
        ticks.insert(tick);
    }
    ticks
}

fn csv(folder: &Path) -> BTreeSet<u64> {
    let mut ticks = BTreeSet::new();
    for path in files(folder, "csv") {
        let text = fs::read_to_string(&path).unwrap();
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let mut rows = whole.lines();
        if let Some(head) = rows.next() {
            assert_eq!(head, "seq,source,capture_ms,level,b", "{}", path.display());
        }
        for row in rows {
            let cells: Vec<&str> = row.split(',').collect();
            let tick: u64 = cells[0].parse().unwrap();
            assert_eq!((cells.len(), cells[3]), (5, level(tick).to_string().as_str()), "{row}");
            ticks.insert(tick);
        }
    }
    ticks
}

fn coco(folder: &Path) -> BTreeSet<u64> {
    let mut ticks = BTreeSet::new();
    for path in files(folder, "json") {
        let bytes = fs::read(&path).unwrap();
        if bytes.is_empty() {
            // Made to see whether it can be, and the disk did not let go of it.
            continue;
        }
        let json: serde_json::Value = serde_json::from_slice(&bytes).expect("a whole file");
        for image in json["images"].as_array().unwrap() {
            let tick = image["id"].as_u64().unwrap();
            let is_its = |a: &&serde_json::Value| a["image_id"].as_u64() == Some(tick);
            let found = json["annotations"].as_array().unwrap().iter().find(is_its).expect("its box");
            assert_eq!(found["bbox"][0].as_u64(), Some(u64::from(level(tick))));
            ticks.insert(tick);
        }
    }
    for line in files(folder, "journal").iter().flat_map(|path| json_lines(path)) {
        let tick = line["image"]["id"].as_u64().unwrap();
        assert_eq!(line["annotations"][0]["bbox"][0].as_u64(), Some(u64::from(level(tick))), "{line}");
        ticks.insert(tick);
    }
    ticks
}

/// Acknowledged ticks, in memory that survives a killed child.
struct Board(*mut [u8; 4096]);

impl Board {
    fn new() -> Self {
        let (rights, kind) = (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_SHARED | libc::MAP_ANONYMOUS);
        // SAFETY: fresh memory, of zeros.
        let memory = unsafe { libc::mmap(std::ptr::null_mut(), 4096, rights, kind, -1, 0) };
        assert_ne!(memory, libc::MAP_FAILED);
        Self(memory.cast())
    }

    fn clear(&self) {
        // SAFETY: no child runs.
        unsafe { self.0.write([0; 4096]) }
    }

    fn set(&self, tick: u64) {
        // SAFETY: inside the memory; one process at a time writes.
        unsafe { self.0.cast::<u8>().add(tick as usize % 4096).write_volatile(1) }
    }

    fn ticks(&self) -> BTreeSet<u64> {
        // SAFETY: no child runs.
        let all = unsafe { self.0.read() };
        (0..4096).filter(|tick| all[*tick as usize] == 1).collect()
    }
}

/// Runs one case; returns whether the fault occurred.
fn case(disk: &Disk, board: &Board, folder: &Path, sink: &Sink, fault: Fault, number: i32, ticks: u64) -> bool {
    let _ = fs::remove_dir_all(folder);
    fs::create_dir_all(folder).unwrap();
    board.clear();
    let is_kill = matches!(fault, Fault::Kill | Fault::KillTorn);
    let mut reported = Reported::default();
    let came = if is_kill {
        // SAFETY: the child goes on alone with this thread; other threads of this process rest.
        let child = unsafe { libc::fork() };
        assert!(child >= 0, "no child process");
        if child == 0 {
            disk.arm(folder, fault, number);
            (sink.run)(folder, ticks, &mut |tick| board.set(tick));
            // SAFETY: ends the child without touching what it shares with its parent.
            unsafe { libc::_exit(0) };
        }
        let mut status = 0;
        // SAFETY: a child of this process.
        unsafe { libc::waitpid(child, &raw mut status, 0) };
        let killed = libc::WIFSIGNALED(status) && libc::WTERMSIG(status) == libc::SIGKILL;
        assert!(killed || (libc::WIFEXITED(status) && libc::WEXITSTATUS(status) == 0), "the child ended with {status}");
        killed
    } else {
        disk.arm(folder, fault, number);
        reported = (sink.run)(folder, ticks, &mut |tick| board.set(tick));
        disk.disarm()
    };
    let (acknowledged, found) = (board.ticks(), (sink.read)(folder));
    let lost: Vec<&u64> = acknowledged.difference(&found).collect();
    assert!(
        lost.is_empty(),
        "acknowledged, but not to be found: {lost:?}; found {found:?}; reported {:?}",
        reported.errors
    );
    if !came {
        assert!(reported.errors.is_empty(), "{:?}", reported.errors);
        assert!(sink.name == "last" || acknowledged.len() as u64 == ticks, "{acknowledged:?}");
    } else if !is_kill {
        // An error while a torn end is taken off, or a journal removed, loses nothing.
        let all = sink.name != "last" && acknowledged.len() as u64 == ticks;
        assert!(all || !reported.errors.is_empty(), "lost in silence: {acknowledged:?} of {ticks}");
    }
    if came && fault == Fault::Full {
        assert!(reported.stopped || !reported.errors.is_empty(), "the full disk was not reported");
        assert!(reported.errors.len() <= 2, "reported once in a call, and perhaps at the end: {:?}", reported.errors);
        assert!(reported.errors.iter().all(|e| e.contains("the disk is full")), "{:?}", reported.errors);
        let parts = fs::read_dir(folder)
            .unwrap()
            .filter(|f| f.as_ref().unwrap().file_name().to_string_lossy().ends_with("tmp-part"));
        assert_eq!(parts.count(), 0, "something half-written is left");
    }
    came
}

/// Files of containers that GStreamer writes: a crash may lose them, but every failed write is reported.
fn indexed_files(disk: &Disk, folder: &Path) -> u32 {
    let mut cases = 0;
    for ending in ["mp4", "mov", "avi"] {
        for fault in [Fault::Full, Fault::Gone] {
            for number in 1.. {
                let _ = fs::remove_dir_all(folder);
                fs::create_dir_all(folder).unwrap();
                disk.arm(folder, fault, number);
                let params = format!("path = \"v.{ending}\"");
                let reported = run::<WriteVideo>(folder, &params, 4, &mut |_| {}, picture);
                cases += 1;
                if !disk.disarm() {
                    assert!(reported.errors.is_empty() && number > 3, "{ending}: {:?}", reported.errors);
                    break;
                }
                assert!(!reported.errors.is_empty(), "{ending} with {fault:?} at operation {number}: not reported");
                let is_full = reported.errors.iter().any(|error| error.contains("the disk is full"));
                assert!(fault != Fault::Full || is_full, "{ending}: {:?}", reported.errors);
            }
        }
    }
    cases
}

/// Runs in the child process that the library is preloaded into.
fn campaign(only: &str) {
    let ticks = std::env::var("PANOSCOPE_DISK_TICKS").ok().and_then(|n| n.parse().ok()).unwrap_or(3).clamp(1, 12);
    let (disk, board) = (Disk::find(), Board::new());
    let folder = std::env::temp_dir().join(format!("panoscope_disk_{only}_{}", std::process::id()));
    let mut cases = 0;
    if only == INDEXED {
        cases += indexed_files(&disk, &folder);
    }
    for sink in SINKS.iter().filter(|sink| sink.name == only) {
        for fault in FAULTS {
            let mut number = 1;
            loop {
                let ran = std::panic::catch_unwind(|| case(&disk, &board, &folder, sink, fault, number, ticks));
                cases += 1;
                match ran {
                    Ok(true) => number += 1,
                    Ok(false) => break,
                    Err(_) => panic!("{} with {fault:?} at operation {number}", sink.name),
                }
            }
            // The sinks that open, write and rename do more than that many operations.
            assert!(number > 2, "{} with {fault:?}: no operation was met", sink.name);
        }
    }
    println!("{only}: {cases} cases");
    let _ = fs::remove_dir_all(&folder);
}

// SAFETY-relevant state of `Disk` and `Board` is plain; panics are reported, not recovered from.
impl std::panic::RefUnwindSafe for Board {}

fn library() -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/c/disk_faults.c");
    let library = std::env::temp_dir().join(format!("panoscope_disk_faults_{}.so", std::process::id()));
    let built = Command::new("cc")
        .args(["-O1", "-shared", "-fPIC", "-fvisibility=hidden", "-o"])
        .args([&library, &source])
        .status()
        .expect("a C compiler");
    assert!(built.success(), "{} does not build", source.display());
    library
}

#[test]
fn what_was_acknowledged_is_readable_after_a_fault_at_any_operation() {
    if let Ok(only) = std::env::var(CHILD) {
        return campaign(&only);
    }
    let library = library();
    for name in SINKS.iter().map(|sink| sink.name).chain([INDEXED]) {
        let child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "disk::what_was_acknowledged_is_readable_after_a_fault_at_any_operation", "--nocapture"])
            .env(CHILD, name)
            .env("LD_PRELOAD", &library)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&child.stdout).into_owned() + &String::from_utf8_lossy(&child.stderr);
        assert!(child.status.success(), "{name}: {said}");
        let cases = said.lines().find(|line| line.ends_with(" cases"));
        println!("{}", cases.expect("the child counts its cases"));
    }
    fs::remove_file(library).unwrap();
}
