//! The theatre's own program on a virtual screen.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use super::{Folder, PATIENCE};

/// A virtual screen; it ends when this is dropped.
pub struct Screen {
    server: Child,
    display: String,
    /// Holds its pixels.
    folder: Folder,
}

impl Screen {
    /// A screen; `None`, with a report that the test is skipped, without Xvfb.
    pub fn start() -> Option<Self> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let folder = Folder::new(&format!("xvfb_{}", NEXT.fetch_add(1, Ordering::Relaxed)));
        let mut command = Command::new("Xvfb");
        command.args(["-displayfd", "1", "-screen", "0", "1440x900x24", "-nolisten", "tcp"]);
        command.arg("-fbdir").arg(&folder.0);
        let Ok(mut server) = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn() else {
            panoscope_testing::skipped!("Xvfb is not installed");
            return None;
        };
        let mut number = String::new();
        let read = server.stdout.take().map(|out| BufReader::new(out).read_line(&mut number));
        assert!(matches!(read, Some(Ok(1..))), "Xvfb names its display");
        Some(Self { server, display: format!(":{}", number.trim()), folder })
    }

    /// Its pixels now, row by row: blue, green, red and a byte without a meaning.
    pub fn pixels(&self) -> Vec<[u8; 4]> {
        // A window dump of X: a header of 32-bit numbers, the first of them its length in bytes, then colours of 12 bytes each.
        let dump = std::fs::read(self.folder.0.join("Xvfb_screen0")).expect("the screen's pixels");
        let number = |index: usize| {
            let bytes = dump[4 * index..4 * index + 4].try_into().expect("four bytes");
            u32::from_be_bytes(bytes) as usize
        };
        let (width, height, byte_order, bits, colors) = (number(4), number(5), number(7), number(11), number(19));
        assert_eq!((byte_order, bits, number(12)), (0, 32, 4 * width), "rows of 32-bit pixels, blue first");
        let begin = number(0) + 12 * colors;
        dump[begin..begin + 4 * width * height].as_chunks().0.to_vec()
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// A running theatre. Its log, keys and files are in the test's folder: there is no other way to start one.
pub struct Running {
    child: Child,
    pub folder: Folder,
}

impl Running {
    /// Opens a graph in a window on a screen.
    pub fn start(screen: &Screen, folder: Folder, text: &str, words: &[&str]) -> Self {
        let path = folder.write("g.toml", text);
        let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope-theatre"));
        command.arg(&path).args(words).arg("--windowed").arg("--into").arg(folder.0.join("kept"));
        panoscope_testing::own_settings(&mut command, &folder.0);
        command.env("DISPLAY", &screen.display).env("LIBGL_ALWAYS_SOFTWARE", "1").env_remove("WAYLAND_DISPLAY");
        let child = command.current_dir(&folder.0).stdin(Stdio::null()).spawn().expect("it starts");
        Self { child, folder }
    }

    /// Folder of its audit log.
    pub fn log(&self) -> PathBuf {
        self.folder.0.join("state/panoscope/audit")
    }

    pub fn pid(&self) -> i32 {
        self.child.id().cast_signed()
    }

    /// Its processes, the oldest first.
    pub fn workers(&self) -> Vec<i32> {
        children(self.pid())
    }

    /// Waits for a number of processes.
    pub fn until_workers(&mut self, count: usize) -> Vec<i32> {
        let until = Instant::now() + PATIENCE;
        loop {
            let workers = self.workers();
            if workers.len() == count {
                return workers;
            }
            assert!(self.end().is_none(), "it has ended");
            assert!(Instant::now() < until, "{count} processes: {workers:?}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// How it ended, if it has.
    pub fn end(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().expect("it can be waited for")
    }

    /// Waits for its end.
    pub fn until_end(&mut self) -> ExitStatus {
        let until = Instant::now() + PATIENCE;
        loop {
            if let Some(status) = self.end() {
                return status;
            }
            assert!(Instant::now() < until, "it does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// State and parent of a process; `None` when there is none.
fn stat(pid: i32) -> Option<(char, i32)> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name before it may have spaces.
    let mut words = text.rsplit_once(") ")?.1.split(' ');
    Some((words.next()?.chars().next()?, words.next()?.parse().ok()?))
}

/// Processes that this one started and that run, the oldest first.
pub fn children(parent: i32) -> Vec<i32> {
    let all = std::fs::read_dir("/proc").expect("the list of processes").flatten();
    let pids = all.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let mut found: Vec<i32> = pids.filter(|pid| stat(*pid).is_some_and(|(s, p)| p == parent && s != 'Z')).collect();
    found.sort_unstable();
    found
}

/// Whether a process is there and not only waited for.
pub fn is_alive(pid: i32) -> bool {
    stat(pid).is_some_and(|(state, _)| state != 'Z')
}

/// Sends a signal.
pub fn signal(pid: i32, name: &str) {
    let sent = Command::new("kill").args([&format!("-{name}"), &pid.to_string()]).status();
    assert!(sent.is_ok_and(|status| status.success()), "kill -{name} {pid}");
}

/// Waits until processes are gone.
pub fn until_gone(pids: &[i32]) {
    let until = Instant::now() + PATIENCE;
    while let Some(pid) = pids.iter().find(|pid| is_alive(**pid)) {
        assert!(Instant::now() < until, "process {pid} is left");
        std::thread::sleep(Duration::from_millis(10));
    }
}
