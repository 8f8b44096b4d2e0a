//! A process that runs the graph, as the window sees it: its start, its messages, its end.

use std::ffi::OsString;
use std::io::{self, BufRead, BufReader, Write};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::PathBuf;
use std::process::{Child, ChildStderr, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use panoscope_abi::Tick;
use panoscope_editor_model::content::Content;
use panoscope_editor_model::picture::RenderedPacket;
use panoscope_editor_model::pixels::Pixels;
use panoscope_editor_model::surface::Cloud;
use panoscope_editor_model::texts::{Phrase, phrase};
use panoscope_engine::clock;
use panoscope_engine::sync::lock;

use crate::link::{self, Block, Command, Message, Picture, Region, RigState};
use crate::worker;

/// Signals that a crash report goes with.
const CRASHES: [i32; 5] = [libc::SIGSEGV, libc::SIGBUS, libc::SIGFPE, libc::SIGILL, libc::SIGABRT];
/// How long the report of a crash may take after the end.
const REPORT: Duration = Duration::from_millis(50);

/// How to start the program.
#[derive(Clone, Debug)]
pub struct Program {
    /// Its file.
    pub file: PathBuf,
    /// The arguments of the window, which the process reads as the window did.
    pub arguments: Vec<OsString>,
}

/// Receives what a process sends, on its thread, and its end.
pub(super) type Inbox = dyn Fn(u64, Incoming) + Send + Sync;

/// What comes from a process.
pub(super) enum Incoming {
    Message(Message),
    Picture(panoscope_editor_model::observe::Output, RenderedPacket),
    /// It has ended.
    End,
}

/// Time without a sign of life, measured in the window's own looks at it: time in which the window did not run either does not count.
#[derive(Default)]
struct Silence {
    /// Since the last sign of life, ms.
    beat_ms: AtomicU32,
    /// Since the observer last looked at the run, ms.
    round_ms: AtomicU32,
    rounds: AtomicU64,
    has_begun: AtomicBool,
}

/// What its threads share.
struct Life {
    pid: libc::pid_t,
    /// Names this process even after its end.
    pidfd: OwnedFd,
    silence: Silence,
    /// Why the window ended it.
    reason: Mutex<Option<Phrase>>,
    /// The node where it crashed, as its report says; `Some(None)` outside of all nodes.
    crash: Mutex<Option<Option<String>>>,
    reported: Condvar,
    /// How it ended.
    end: Mutex<Option<Phrase>>,
}

/// A process that runs the graph. It is killed when this is dropped, which does not wait.
pub(super) struct Process {
    pub id: u64,
    life: Arc<Life>,
    out: Sender<Command>,
}

impl Process {
    /// Starts a process. The calling thread must live as long as the window.
    ///
    /// # Errors
    /// The program cannot be started, or the system has no memory, sockets or threads.
    pub fn start(id: u64, program: &Program, inbox: Arc<Inbox>) -> io::Result<Self> {
        let region = Arc::new(Region::create()?);
        let (ours, theirs) = UnixStream::pair()?;
        let fd = region.fd();
        let mut command = std::process::Command::new(&program.file);
        command.arg(worker::COMMAND).arg(fd.to_string()).args(&program.arguments);
        // A group of its own, so that Ctrl-C reaches the window alone, which then ends the process in good order.
        command.stdin(Stdio::from(OwnedFd::from(theirs))).stderr(Stdio::piped()).process_group(0);
        // SAFETY: the closure makes system calls only, which are allowed between `fork` and `exec`.
        unsafe {
            command.pre_exec(move || {
                // A stopped process whose window is gone goes on, so that it sees the end of its socket and finishes its files.
                if libc::fcntl(fd, libc::F_SETFD, 0) != 0 || libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGCONT) != 0 {
                    return Err(io::Error::last_os_error());
                }
                Ok(())
            });
        }
        let mut child = command.spawn()?;
        let begun = Self::begin(id, &mut child, ours, region, &inbox);
        let (process, life) = begun.inspect_err(|_| {
            let _ = child.kill();
            let _ = child.wait();
        })?;
        let wait = move || {
            let status = child.wait();
            life.finish(status);
            inbox(id, Incoming::End);
        };
        std::thread::Builder::new().name("worker end".to_owned()).spawn(wait)?;
        Ok(process)
    }

    fn begin(
        id: u64,
        child: &mut Child,
        socket: UnixStream,
        region: Arc<Region>,
        inbox: &Arc<Inbox>,
    ) -> io::Result<(Self, Arc<Life>)> {
        let life = Arc::new(Life {
            pid: child.id().cast_signed(),
            pidfd: pidfd(child)?,
            silence: Silence::default(),
            reason: Mutex::default(),
            crash: Mutex::default(),
            reported: Condvar::new(),
            end: Mutex::default(),
        });
        let (out, commands) = channel();
        let to = socket.try_clone()?;
        std::thread::Builder::new().name("worker out".to_owned()).spawn(move || write(to, &commands))?;
        let reader = Reader { id, life: Arc::clone(&life), region, out: out.clone(), inbox: Arc::clone(inbox) };
        std::thread::Builder::new().name("worker in".to_owned()).spawn(move || reader.run(socket))?;
        if let Some(errors) = child.stderr.take() {
            let life = Arc::clone(&life);
            std::thread::Builder::new().name("worker errors".to_owned()).spawn(move || relay(&life, errors))?;
        }
        Ok((Self { id, life: Arc::clone(&life), out }, life))
    }

    /// Sends a command; never waits.
    pub fn send(&self, command: Command) {
        let _ = self.out.send(command);
    }

    /// Number of the process.
    pub fn pid(&self) -> libc::pid_t {
        self.life.pid
    }

    /// Ends it at once. `reason` continues a sentence about the image processing.
    pub fn kill(&self, reason: Phrase) {
        self.life.kill(reason);
    }

    /// How it ended, if it has.
    pub fn end(&self) -> Option<Phrase> {
        lock(&self.life.end).clone()
    }

    /// Whether it has ended, also while the thread that finds out how has not run yet.
    pub fn has_ended(&self) -> bool {
        let mut ended = libc::pollfd { fd: self.life.pidfd.as_raw_fd(), events: libc::POLLIN, revents: 0 };
        // SAFETY: a plain system call with one entry, which does not wait.
        unsafe { libc::poll(&raw mut ended, 1, 0) == 1 }
    }

    /// Counts time without a sign of life: `passed` since the last call. Returns the time since the last sign, and since its observer last looked
    /// at the run; `None` before the first sign.
    pub fn silence(&self, passed: Duration) -> (Option<Duration>, Duration) {
        let ms = u32::try_from(passed.as_millis()).unwrap_or(u32::MAX);
        let add =
            |to: &AtomicU32| Duration::from_millis((to.fetch_add(ms, Ordering::Relaxed).saturating_add(ms)).into());
        let silence = &self.life.silence;
        let (beat, round) = (add(&silence.beat_ms), add(&silence.round_ms));
        match silence.has_begun.load(Ordering::Relaxed) {
            true => (Some(beat), round),
            false => (None, beat),
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.end().is_none() {
            self.kill(phrase!("worker-not-needed"));
        }
    }
}

impl Life {
    fn kill(&self, reason: Phrase) {
        let end = lock(&self.end);
        if end.is_none() {
            lock(&self.reason).get_or_insert(reason);
            // SAFETY: a plain system call on a file descriptor that is open.
            unsafe { libc::syscall(libc::SYS_pidfd_send_signal, self.pidfd.as_raw_fd(), libc::SIGKILL, 0, 0) };
        }
    }

    /// The node where it crashed; `None` where none is known.
    fn crash_node(&self, signal: i32) -> Option<String> {
        if !CRASHES.contains(&signal) {
            return None;
        }
        // The report was written before the end, and is read by another thread.
        let crash = lock(&self.crash);
        let wait = self.reported.wait_timeout_while(crash, REPORT, |crash| crash.is_none());
        wait.unwrap_or_else(PoisonError::into_inner).0.clone().flatten()
    }

    fn finish(&self, status: io::Result<ExitStatus>) {
        let reason = lock(&self.reason).clone();
        let words = reason.unwrap_or_else(|| match status {
            Err(error) => phrase!("worker-lost", reason = error.to_string()),
            Ok(status) => match (status.signal(), status.code()) {
                (Some(signal), _) => signal_phrase(signal, self.crash_node(signal)),
                (None, code) => phrase!("worker-exited", code = code.unwrap_or(0)),
            },
        });
        *lock(&self.end) = Some(words);
    }
}

/// Passes on what a process writes to its standard error, and looks for the node that crashed.
fn relay(life: &Life, from: ChildStderr) {
    let mut from = BufReader::new(from);
    let mut line = Vec::new();
    while matches!(from.read_until(b'\n', &mut line), Ok(1..)) {
        // Nobody may read it.
        let _ = io::stderr().write_all(&line);
        if let Some(node) = crash_node(&String::from_utf8_lossy(&line)) {
            lock(&life.crash).get_or_insert(node);
            life.reported.notify_all();
        }
        line.clear();
    }
}

/// The node of a crash that a line of the engine's report names; `Some(None)` where no node ran.
fn crash_node(line: &str) -> Option<Option<String>> {
    let rest = line.strip_prefix("error: ")?;
    if rest.starts_with("the program crashed outside of every node") {
        return Some(None);
    }
    let (node, rest) = rest.strip_prefix("node `")?.split_once('`')?;
    rest.contains(" crashed while it ").then(|| Some(node.to_owned()))
}

/// Names a child process that has not been waited for.
fn pidfd(child: &Child) -> io::Result<OwnedFd> {
    // SAFETY: a plain system call.
    let fd = unsafe { libc::syscall(libc::SYS_pidfd_open, child.id(), 0) };
    match RawFd::try_from(fd) {
        // SAFETY: `pidfd_open` returned this file descriptor, and nothing else owns it.
        Ok(fd) if fd >= 0 => Ok(unsafe { OwnedFd::from_raw_fd(fd) }),
        _ => Err(io::Error::last_os_error()),
    }
}

/// How a signal ended a process: continues a sentence about it.
fn signal_phrase(signal: i32, node: Option<String>) -> Phrase {
    let name = match signal {
        libc::SIGSEGV => "SIGSEGV",
        libc::SIGBUS => "SIGBUS",
        libc::SIGFPE => "SIGFPE",
        libc::SIGILL => "SIGILL",
        libc::SIGABRT => "SIGABRT",
        libc::SIGKILL => return phrase!("worker-killed"),
        libc::SIGTERM => return phrase!("worker-terminated"),
        other => return phrase!("worker-signal", signal = other),
    };
    match node {
        Some(node) => phrase!("worker-crashed-in", node = node, signal = name),
        None => phrase!("worker-crashed", signal = name),
    }
}

fn write(mut to: UnixStream, commands: &Receiver<Command>) {
    // A process that is gone also ends what is read from it.
    while let Ok(command) = commands.recv() {
        if link::send(&mut to, &command).is_err() {
            return;
        }
    }
}

/// Reads what a process sends.
struct Reader {
    id: u64,
    life: Arc<Life>,
    region: Arc<Region>,
    out: Sender<Command>,
    inbox: Arc<Inbox>,
}

impl Reader {
    fn run(self, socket: UnixStream) {
        let mut from = BufReader::new(socket);
        loop {
            match link::receive::<Message>(&mut from) {
                Ok(Some(message)) => {
                    if !self.pass_on(message) {
                        return self.life.kill(phrase!("worker-bad-picture"));
                    }
                }
                // Its end has its own thread.
                Ok(None) => return,
                Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                    return self.life.kill(phrase!("worker-bad-message"));
                }
                Err(_) => return,
            }
        }
    }

    fn pass_on(&self, message: Message) -> bool {
        match message {
            Message::Beat { rounds } => {
                let silence = &self.life.silence;
                silence.beat_ms.store(0, Ordering::Relaxed);
                if silence.rounds.swap(rounds, Ordering::Relaxed) != rounds {
                    silence.round_ms.store(0, Ordering::Relaxed);
                }
                silence.has_begun.store(true, Ordering::Relaxed);
            }
            Message::Picture(picture) => {
                let Some(packet) = self.packet(&picture) else { return false };
                let slots = [picture.pixels, picture.cloud].into_iter().flatten();
                slots.for_each(|block| _ = self.out.send(Command::Free { slot: block.slot }));
                (self.inbox)(self.id, Incoming::Picture(picture.output, packet));
            }
            message => (self.inbox)(self.id, Incoming::Message(message)),
        }
        true
    }

    /// The bytes of a block with so many bytes for each of its elements.
    fn block(&self, block: Block, element_bytes: usize) -> Option<(usize, usize, Vec<u8>)> {
        let (width, height) = (block.width as usize, block.height as usize);
        let len = width.checked_mul(height)?.checked_mul(element_bytes)?;
        Some((width, height, self.region.read(block.slot, len)?))
    }

    /// The preview with its pixels, on this process's clock; `None` when it is malformed.
    fn packet(&self, picture: &Picture) -> Option<RenderedPacket> {
        let pixels = match picture.pixels {
            Some(block) => {
                let (width, height, rgba) = self.block(block, 4)?;
                Some(Pixels { width, height, rgba })
            }
            None => None,
        };
        let cloud = match picture.cloud {
            Some(block) => {
                let (width, height, bytes) = self.block(block, 16)?;
                let points = bytes.as_chunks::<4>().0.as_chunks::<4>().0;
                let points = points.iter().map(|point| point.map(f32::from_le_bytes));
                let (xyz_mm, confidence) = points.map(|[x, y, z, confidence]| ([x, y, z], confidence)).unzip();
                Some(Arc::new(Cloud { width, height, xyz_mm, confidence }))
            }
            None => None,
        };
        // A picture can only be older than the other process says: the way here takes time, too.
        let way_ns = i64::try_from(link::monotonic_ns().saturating_sub(picture.made_ns)).unwrap_or(i64::MAX);
        let now_ns = i64::try_from(clock::now_ns()).unwrap_or(i64::MAX);
        let arrived_ns = picture.age_ns.map(|age_ns| now_ns.saturating_sub(age_ns.max(0).saturating_add(way_ns)));
        Some(RenderedPacket {
            pixels,
            size: picture.size_px,
            text: picture.text.clone(),
            seq: picture.seq,
            tick: Tick { source: picture.source, seq: picture.seq, ..Tick::default() },
            arrived_ns,
            content: picture.rig.map_or(Content::Nothing, RigState::content),
            cloud,
            ..RenderedPacket::default()
        })
    }
}
