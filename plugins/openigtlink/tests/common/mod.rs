//! Nodes in one-node hosts, and peer programs.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use panoscope_node::abi::{CloudPoint, Detection, Pose, Tip};
use panoscope_node::harness::{Harness, Outputs, Setup};
use panoscope_node::{Bgr8, name16};
use panoscope_openigtlink::receive::Receive;
use panoscope_openigtlink::send::Send;

pub const COLUMNS_OF_POINTS: [&str; 4] = ["x_mm", "y_mm", "z_mm", "radius_mm"];
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A port that was free a moment ago.
pub fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").expect("a port").local_addr().expect("bound").port()
}

pub fn sender(params: &str) -> Harness<Send> {
    Harness::open(Setup::new(&format!("params = {{ {params} }}"))).expect("it opens")
}

pub fn receiver(params: &str) -> Harness<Receive> {
    Harness::open(Setup::new(&format!("params = {{ {params} }}"))).expect("it opens")
}

/// The same in a graph with `mode = "batch"`.
pub fn batch_receiver(params: &str) -> Harness<Receive> {
    Harness::open(Setup::new(&format!("params = {{ {params} }}")).batch()).expect("it opens")
}

pub fn batch_sender(params: &str) -> Harness<Send> {
    Harness::open(Setup::new(&format!("params = {{ {params} }}")).batch()).expect("it opens")
}

/// A quarter turn about z and 10, 20, 30 mm.
pub fn pose() -> Pose {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    Pose {
        a_from_b_wxyz: [half, 0.0, 0.0, half],
        a_from_b_mm: [10.0, 20.0, 30.0],
        a: name16("Base"),
        b: name16("Camera"),
    }
}

pub fn tip(x_mm: f64) -> Tip {
    Tip { u_px: 5.0, v_px: 6.0, xyz_mm: [x_mm, -2.5, 66.0], score: 0.9, class_index: 0, xyz_valid: 1, track_id: 3 }
}

/// Blue, green, red of six pixels: 0, 10, 20 and so on.
pub const PIXELS: [u8; 18] = [0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 110, 120, 130, 140, 150, 160, 170];

/// An unknown point, two measured ones and one that was filled in.
pub fn cloud() -> Vec<CloudPoint> {
    let point = |x_mm: f32, bgr| CloudPoint { x_mm, y_mm: 2.0, z_mm: 50.0, bgr, filled: 0 };
    let guess = CloudPoint { filled: 1, ..point(2.0, [0, 0, 255]) };
    vec![point(f32::NAN, [1, 2, 3]), point(1.0, [0, 51, 255]), guess, point(3.0, [255, 0, 0])]
}

pub fn detection() -> Detection {
    Detection { x_px: 10.0, y_px: 20.0, width_px: 6.0, height_px: 8.0, score: 0.8, class_index: 1, track_id: -1 }
}

/// Gives the sender one packet of each kind.
pub fn fill(node: &mut Harness<Send>) {
    node.input_image::<Bgr8>("image", 3, 2, &PIXELS);
    node.input_value("pose", pose()).input_value("tip", tip(1.5));
    node.input_cloud("cloud", 4, 1, &cloud()).input_detections(
        "detections",
        &[detection()],
        "Hook\nGrasper",
        (640, 480),
    );
    node.input_text("text", "a text");
}

/// Sends one packet of each kind at 100 Hz until `done`.
pub fn send_until(node: &mut Harness<Send>, what: &str, mut done: impl FnMut(&Harness<Send>) -> bool) {
    let end = Instant::now() + PATIENCE;
    while !done(node) {
        assert!(Instant::now() < end, "{what}");
        fill(node);
        node.process().expect("it sends");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Receives until `done`.
pub fn receive_until(node: &mut Harness<Receive>, what: &str, mut done: impl FnMut(&Outputs) -> bool) {
    let end = Instant::now() + PATIENCE;
    loop {
        let outputs = node.process().expect("it receives");
        if done(&outputs) {
            return;
        }
        drop(outputs);
        assert!(Instant::now() < end, "{what}: {:?}", node.logs());
    }
}

/// A peer program; killed when dropped.
pub struct Peer {
    child: Child,
    lines: Receiver<String>,
}

impl Peer {
    pub fn start(command: &mut Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().expect("the program starts");
        let stdout = child.stdout.take().expect("piped");
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if sender.send(line.replace("-0.00", "0.00")).is_err() {
                    return;
                }
            }
        });
        Self { child, lines }
    }

    /// What it has printed since the last call.
    pub fn printed(&self) -> Vec<String> {
        self.lines.try_iter().collect()
    }

    /// Waits for a printed line.
    pub fn wait_for(&self, line: &str) {
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            match self.lines.recv_timeout(Duration::from_millis(100)) {
                Ok(found) if found == line => return,
                _ => {}
            }
        }
        panic!("the program never printed `{line}`");
    }

    /// Waits for its end and returns the rest of what it printed.
    pub fn end(mut self) -> Vec<String> {
        let end = Instant::now() + PATIENCE;
        while self.child.try_wait().expect("a child").is_none() {
            assert!(Instant::now() < end, "the program does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
        self.lines.iter().collect()
    }

    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().expect("a child").is_some()
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub fn peers() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers"))
}

/// The peer program built on the OpenIGTLink library; `None` if the library is not installed.
pub fn library_peer() -> Option<PathBuf> {
    if !Path::new("/usr/include/openigtlink/igtlMessageBase.h").is_file() {
        return None;
    }
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("library_peer");
    let source = peers().join("library_peer.cpp");
    panoscope_testing::made_once(&program, &[&source], |program| {
        let mut command = Command::new("c++");
        command.args(["-w", "-I/usr/include/openigtlink", "-o"]).arg(program).arg(&source);
        let built = command.arg("-lOpenIGTLink").output().expect("a C++ compiler");
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    });
    Some(program)
}

/// Python with pyigtl; `None` if it is not installed.
pub fn pyigtl_peer() -> Option<Command> {
    let python = || {
        let mut python = Command::new("python3");
        python.env("PYTHONDONTWRITEBYTECODE", "1").stderr(Stdio::null());
        if let Some(folder) = std::env::var_os("PANOSCOPE_PYTHON_PEERS") {
            python.env("PYTHONPATH", folder);
        }
        python
    };
    let is_there = python().args(["-c", "import pyigtl"]).status().is_ok_and(|status| status.success());
    is_there.then(|| {
        let mut command = python();
        command.arg(peers().join("pyigtl_peer.py"));
        command
    })
}
