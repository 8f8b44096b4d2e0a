//! A child process: its start, its resources and its end.

use std::ffi::OsString;
use std::fs::File;
use std::io;
use std::os::fd::{AsFd, AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::fs::FileExt;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_abi::BufferId;
use panoscope_base as base;
use panoscope_engine::isolation::{GroupSettings, LinkReport, Machine};
use panoscope_engine::memory::{MAX_POOLS, Memory, PoolFile, memory};

use super::{PluginImage, Totals, lock};
use crate::isolate::lane::Lane;
use crate::isolate::socket;
use crate::isolate::wire::lane::{Settings, ToChild};
use crate::isolate::wire::{encoded, plain_words, whole};
use crate::isolate::{COMMAND, EXIT_CONFINED, EXIT_LINK, LINK_COMMAND, MACHINE_PROGRAM, PROTOCOL};

/// Time limit for a process to end after its last instance closed, or after it was killed.
const MAX_LEAVE: Duration = Duration::from_secs(1);
/// Bytes of standard error that are kept.
const STDERR_BYTES: u64 = 16 << 10;
/// Maximum number of characters of standard error in a message.
const MAX_SAID: usize = 300;
const MAX_SAID_BY_LINK: usize = 1200;
/// Name of the program whose processes run isolated nodes.
const PROGRAM: &str = "panoscope";

/// The program whose processes run isolated nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Launch {
    /// Its file.
    pub program: PathBuf,
    /// Arguments before the name of the group.
    pub arguments: Vec<OsString>,
    /// Environment variables besides those of this process.
    pub environment: Vec<(OsString, OsString)>,
}

/// The program for a process of nodes is missing.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// The system does not name the file of the running program.
    #[error("the path of this program is unknown")]
    OwnFile,
    /// The installation lacks a program.
    #[error("the program {} is missing, {purpose}", program.display())]
    Missing {
        /// Expected location.
        program: PathBuf,
        /// Purpose of the program.
        purpose: &'static str,
    },
}

impl Launch {
    /// This program, the one installed next to it, or the one that this process belongs to ([`base::program`]).
    pub(crate) fn own() -> Result<Self, LaunchError> {
        Ok(Self { program: program()?, arguments: vec![COMMAND.into()], environment: Vec::new() })
    }

    /// As [`Self::own`], for the link to another machine.
    pub(super) fn link(machine: &Machine) -> Result<Self, LaunchError> {
        let Machine { address, pixels, timeout_ms, plaintext, .. } = machine;
        let settings = [address.clone(), pixels.word().to_owned(), timeout_ms.to_string(), plaintext.to_string()];
        let arguments = [LINK_COMMAND.to_owned()].into_iter().chain(settings).map(OsString::from).collect();
        let program = installed(MACHINE_PROGRAM, "which links machines")?;
        Ok(Self { program, arguments, environment: Vec::new() })
    }

    /// Starts the program; its standard error goes to `stderr`, if that is given.
    fn start(&self, group: &str, socket: OwnedFd, stderr: Option<&File>) -> io::Result<Child> {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).arg(group).envs(self.environment.iter().map(|(name, value)| (name, value)));
        if let Some(stderr) = stderr {
            command.stderr(stderr.try_clone()?);
        }
        command.stdin(Stdio::from(socket)).spawn()
    }
}

fn program() -> Result<PathBuf, LaunchError> {
    let me = base::program::file().ok_or(LaunchError::OwnFile)?;
    if me.file_name().is_some_and(|name| name == PROGRAM) {
        let is_running = std::env::current_exe().is_ok_and(|running| running == me);
        // The running version, even if its file was replaced meanwhile.
        return Ok(if is_running { PathBuf::from("/proc/self/exe") } else { me });
    }
    installed(PROGRAM, "whose processes run isolated nodes")
}

/// A program of the installation; `purpose` is for the error.
fn installed(name: &str, purpose: &'static str) -> Result<PathBuf, LaunchError> {
    let me = base::program::file().ok_or(LaunchError::OwnFile)?;
    let beside = me.with_file_name(name);
    // Test programs lie in a folder below.
    let above = me.parent().and_then(Path::parent).map(|folder| folder.join(name));
    let found = [Some(beside.clone()), above].into_iter().flatten().find(|file| file.is_file());
    found.ok_or(LaunchError::Missing { program: beside, purpose })
}

/// A lane and the node that uses it.
pub(crate) struct NodeLane {
    pub lane: Lane,
    /// Its name in the graph.
    pub node: String,
    /// For messages: "node `scope`".
    about: String,
    /// Whether the child works on a request.
    pub in_call: AtomicBool,
}

/// State shared by a process's owner and the thread that waits for its end.
struct Life {
    /// For messages: "the process of group `readers`".
    what: String,
    /// Process number, which may be reused after the end; 0 for a played process.
    id: u32,
    /// `None` for a process that is played by a thread in tests.
    pidfd: Option<OwnedFd>,
    /// Whether it is the link to another machine.
    is_link: bool,
    /// Standard error of the process, if it is kept.
    stderr: Option<File>,
    state: Mutex<LifeState>,
    ended: Condvar,
    /// Set before the lanes are closed at the end of the process.
    is_dead: AtomicBool,
    is_killed: AtomicBool,
}

#[derive(Default)]
struct LifeState {
    lanes: Vec<Arc<NodeLane>>,
    /// Function of [`Process::at_end`].
    at_end: Option<Box<dyn FnOnce() + Send>>,
    /// Reason, if the host ended it.
    reason: Option<String>,
    /// Description of its end.
    words: Option<String>,
}

impl LifeState {
    /// State of the link; see [`Process::link_report`].
    fn link_report(&self) -> Option<LinkReport> {
        let counts = self.lanes.first()?.lane.link();
        let clock_uncertainty_ns = counts.clock_uncertainty_ns.load(Ordering::Relaxed);
        let offset_ns = counts.clock_offset_ns.load(Ordering::Relaxed);
        Some(LinkReport {
            address: String::new(),
            clock_offset_ns: (clock_uncertainty_ns > 0).then_some(offset_ns),
            clock_uncertainty_ns,
            round_trip_ns: counts.round_trip_ns.load(Ordering::Relaxed),
            sent_bytes: counts.sent_bytes.load(Ordering::Relaxed),
            received_bytes: counts.received_bytes.load(Ordering::Relaxed),
        })
    }
}

impl Life {
    /// Records the end and wakes all threads that wait for an answer.
    fn end(&self, status: io::Result<ExitStatus>) {
        let mut state = lock(&self.state);
        if state.words.is_some() {
            return;
        }
        // A link has lost its machine with whole sentences.
        let most = if self.is_link { MAX_SAID_BY_LINK } else { MAX_SAID };
        let said = self.stderr.as_ref().and_then(|stderr| said(stderr, most));
        state.words = Some(words(&self.what, &state, status, said));
        self.is_dead.store(true, Ordering::SeqCst);
        state.lanes.iter().for_each(|lane| lane.lane.close());
        let at_end = state.at_end.take();
        drop(state);
        self.ended.notify_all();
        if let Some(at_end) = at_end {
            at_end();
        }
    }

    fn kill(&self, reason: &str) {
        lock(&self.state).reason.get_or_insert_with(|| reason.to_owned());
        self.is_killed.store(true, Ordering::Release);
        match &self.pidfd {
            // SAFETY: a plain system call; the file descriptor names this process even after its end.
            Some(pidfd) => unsafe {
                libc::syscall(libc::SYS_pidfd_send_signal, pidfd.as_raw_fd(), libc::SIGKILL, 0, 0);
            },
            None => self.end(Ok(ExitStatus::from_raw(libc::SIGKILL))),
        }
    }

    /// Waits up to `most` for the end; `false` if the process still runs.
    fn wait(&self, most: Duration) -> bool {
        let until = Instant::now() + most;
        let mut state = lock(&self.state);
        while state.words.is_none() {
            let Some(left) = until.checked_duration_since(Instant::now()) else { return false };
            state = self.ended.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }
}

/// A memory file of fixed size for standard error, so that a process cannot exhaust memory by writing.
fn new_stderr() -> io::Result<File> {
    // SAFETY: the name is a zero-terminated text.
    let fd = unsafe { libc::memfd_create(c"panoscope-stderr".as_ptr(), libc::MFD_CLOEXEC | libc::MFD_ALLOW_SEALING) };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: `memfd_create` returned this file descriptor, and nothing else owns it.
    let file = unsafe { File::from_raw_fd(fd) };
    file.set_len(STDERR_BYTES)?;
    // SAFETY: a plain system call on a file that is open.
    match unsafe { libc::fcntl(fd, libc::F_ADD_SEALS, libc::F_SEAL_SHRINK | libc::F_SEAL_GROW | libc::F_SEAL_SEAL) } {
        0 => Ok(file),
        _ => Err(io::Error::last_os_error()),
    }
}

/// The last two lines in a file of [`new_stderr`], at most `most` characters; `None` without one.
fn said(stderr: &File, most: usize) -> Option<String> {
    let mut bytes = vec![0; STDERR_BYTES as usize];
    let len = stderr.read_at(&mut bytes, 0).ok()?;
    let written = bytes[..len].iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    // The end counts: a line may be longer than what is shown.
    let text = plain_words(&bytes[written.saturating_sub(4 * most)..written]);
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let last = lines[lines.len().saturating_sub(2)..].join("; ");
    let skipped = last.chars().count().saturating_sub(most);
    (!last.is_empty()).then(|| last.chars().skip(skipped).collect())
}

/// Describes how a process ended, and in which node. `said` is its last output.
fn words(what: &str, state: &LifeState, status: io::Result<ExitStatus>, said: Option<String>) -> String {
    if let Some(reason) = &state.reason {
        return format!("{what} was ended: {reason}");
    }
    let crashed = state.lanes.iter().find(|lane| lane.lane.signal() != 0);
    let nodes: Vec<&str> = match crashed {
        Some(lane) => vec![lane.about.as_str()],
        None => {
            let busy = state.lanes.iter().filter(|lane| lane.in_call.load(Ordering::Relaxed));
            busy.map(|lane| lane.about.as_str()).collect()
        }
    };
    let location =
        if nodes.is_empty() { "outside of every call".to_owned() } else { format!("in {}", nodes.join(" or ")) };
    let how = match status {
        Err(cause) => return format!("{what} is lost: {cause}"),
        Ok(status) => match (status.signal(), status.code()) {
            (Some(signal), _) => format!("crashed {location}: {}", signal_words(signal)),
            (None, Some(EXIT_CONFINED)) => {
                "cannot be locked in: the system refuses the restrictions that it says it has".to_owned()
            }
            // It says itself what happened.
            (None, Some(EXIT_LINK)) => {
                return format!("{what} is lost: {}", said.unwrap_or_else(|| "its link gave no reason".to_owned()));
            }
            (None, code) => format!("ended {location}: exit({})", code.unwrap_or(0)),
        },
    };
    let said = said.map(|said| format!("; it wrote: {said}")).unwrap_or_default();
    format!("{what} {how}{said}")
}

fn signal_words(signal: i32) -> String {
    let (name, meaning) = match signal {
        libc::SIGSEGV => ("SIGSEGV", "invalid memory access, or a stack overflow"),
        libc::SIGBUS => ("SIGBUS", "memory that could not be had"),
        libc::SIGFPE => ("SIGFPE", "an impossible division"),
        libc::SIGILL => ("SIGILL", "an instruction that this processor does not know"),
        libc::SIGABRT => ("SIGABRT", "abort, or out of memory"),
        libc::SIGKILL => ("SIGKILL", "killed from outside, possibly because the system ran out of memory"),
        libc::SIGTERM => ("SIGTERM", "ended from outside"),
        libc::SIGSYS => ("SIGSYS", "a system call that is not allowed"),
        other => return format!("signal {other}"),
    };
    format!("{name} ({meaning})")
}

/// The process of a group. It ends when this is dropped.
pub(crate) struct Process {
    life: Arc<Life>,
    socket: Mutex<Option<OwnedFd>>,
    /// Pools that the child was given, one bit each.
    known_pools: [AtomicU64; MAX_POOLS / 64 + 1],
    /// Files of these pools: while they are kept, their numbers are not reused.
    files: Mutex<Vec<PoolFile>>,
    /// Plugins that the child was given.
    plugins: Mutex<Vec<u32>>,
    domain: u32,
    is_link: bool,
    totals: Arc<Totals>,
    watcher: Mutex<Option<JoinHandle<()>>>,
}

impl Process {
    /// Starts a process. `what` names it in messages, `domain` is that of its own pools, `totals` counts what its calls
    /// cost.
    pub fn start(
        launch: &Launch,
        settings: &GroupSettings,
        what: String,
        domain: u32,
        totals: &Arc<Totals>,
    ) -> io::Result<Arc<Self>> {
        let (ours, theirs) = socket::pair()?;
        let is_link = settings.machine.is_some();
        let stderr = if settings.keeps_stderr || is_link { Some(new_stderr()?) } else { None };
        let mut child = launch.start(&settings.name, theirs, stderr.as_ref())?;
        let begun = pidfd(&child).and_then(|pidfd| {
            let GroupSettings { threads, memory_bytes, deny, .. } = *settings;
            let settings = Settings { threads: threads as u32, memory_bytes, deny };
            let hello = ToChild::Hello { protocol: PROTOCOL, settings };
            socket::send(ours.as_fd(), &encoded(&hello), None)?;
            Ok(pidfd)
        });
        let pidfd = begun.inspect_err(|_| end(&mut child))?;
        let life = Arc::new(Life {
            what,
            id: child.id(),
            pidfd: Some(pidfd),
            is_link,
            stderr,
            state: Mutex::default(),
            ended: Condvar::new(),
            is_dead: AtomicBool::new(false),
            is_killed: AtomicBool::new(false),
        });
        let name: String = format!("group {}", settings.name).chars().take(15).collect();
        let watched = Arc::clone(&life);
        totals.processes.fetch_add(1, Ordering::Relaxed);
        // Passed through a mutex, so that the child can be ended if no thread can be started.
        let handed = Arc::new(Mutex::new(Some(child)));
        let theirs = Arc::clone(&handed);
        let watch = move || {
            if let Some(mut child) = lock(&theirs).take() {
                watched.end(child.wait());
            }
        };
        let watcher = std::thread::Builder::new().name(name).spawn(watch).inspect_err(|_| {
            if let Some(mut child) = lock(&handed).take() {
                end(&mut child);
            }
        })?;
        Ok(Self::new(life, ours, domain, is_link, totals, watcher))
    }

    fn new(
        life: Arc<Life>,
        socket: OwnedFd,
        domain: u32,
        is_link: bool,
        totals: &Arc<Totals>,
        watcher: JoinHandle<()>,
    ) -> Arc<Self> {
        Arc::new(Self {
            life,
            socket: Mutex::new(Some(socket)),
            known_pools: [const { AtomicU64::new(0) }; MAX_POOLS / 64 + 1],
            files: Mutex::default(),
            plugins: Mutex::default(),
            domain,
            is_link,
            totals: Arc::clone(totals),
            watcher: Mutex::new(Some(watcher)),
        })
    }

    /// A process that is played by a thread: `play` receives each lane of the process and ends the process when it
    /// returns.
    pub fn played(
        domain: u32,
        totals: &Arc<Totals>,
        play: impl Fn(&Lane) + Clone + Send + 'static,
    ) -> io::Result<Arc<Self>> {
        let (ours, theirs) = socket::pair()?;
        let life = Arc::new(Life {
            what: "the process".to_owned(),
            id: 0,
            pidfd: None,
            is_link: false,
            stderr: None,
            state: Mutex::default(),
            ended: Condvar::new(),
            is_dead: AtomicBool::new(false),
            is_killed: AtomicBool::new(false),
        });
        let lived = Arc::clone(&life);
        let watcher = std::thread::Builder::new().name("played".to_owned()).spawn(move || {
            let mut lanes = Vec::new();
            while let Ok((message, file)) = socket::receive(theirs.as_fd())
                && let Ok(message) = whole(&message)
            {
                if let ToChild::Lane = message
                    && let Some(lane) = file.and_then(|file| Lane::map(&File::from(file)).ok())
                {
                    let (life, play, lane) = (Arc::clone(&lived), play.clone(), Arc::new(lane));
                    let served = Arc::clone(&lane);
                    let thread = std::thread::spawn(move || {
                        play(&served);
                        life.kill("it has no more to say");
                    });
                    lanes.push((lane, thread));
                }
            }
            lived.end(Ok(ExitStatus::from_raw(0)));
            for (lane, thread) in lanes {
                // One that is no longer used is closed by nobody else.
                lane.close();
                let _ = thread.join();
            }
        })?;
        Ok(Self::new(life, ours, domain, false, totals, watcher))
    }

    /// Whether its nodes run on another machine.
    pub fn is_link(&self) -> bool {
        self.is_link
    }

    /// State of the connection as reported by the link, without its address; `None` while no node uses it.
    pub fn link_report(&self) -> Option<LinkReport> {
        lock(&self.life.state).link_report()
    }

    /// The domain of its own pools.
    pub fn domain(&self) -> u32 {
        self.domain
    }

    /// Cost of its calls.
    pub fn totals(&self) -> &Totals {
        &self.totals
    }

    /// Whether the process has ended.
    pub fn is_dead(&self) -> bool {
        self.life.is_dead.load(Ordering::SeqCst)
    }

    /// Whether the process has ended or was killed.
    pub fn is_ending(&self) -> bool {
        self.is_dead() || self.life.is_killed.load(Ordering::Acquire)
    }

    /// Process number while it runs.
    pub fn id(&self) -> Option<u32> {
        (!self.is_ending()).then_some(self.life.id)
    }

    /// Calls `f` once when the process has ended, from another thread; at once if it has. `f` may drop this process.
    pub fn at_end(&self, f: impl FnOnce() + Send + 'static) {
        let mut state = lock(&self.life.state);
        if state.words.is_none() {
            state.at_end = Some(Box::new(f));
            return;
        }
        drop(state);
        f();
    }

    /// Kills the process; its calls return.
    pub fn kill(&self, reason: &str) {
        self.life.kill(reason);
    }

    /// Waits until the process has ended.
    pub fn wait_for_end(&self) {
        self.life.wait(MAX_LEAVE);
    }

    /// Description of how the process ended.
    pub fn death(&self) -> String {
        if !self.life.wait(MAX_LEAVE) {
            self.life.kill("it did not respond");
            self.life.wait(MAX_LEAVE);
        }
        let words = lock(&self.life.state).words.clone();
        words.unwrap_or_else(|| format!("{} does not end", self.life.what))
    }

    fn send(&self, message: &ToChild, file: &impl AsFd) -> io::Result<()> {
        match &*lock(&self.socket) {
            Some(socket) => socket::send(socket.as_fd(), &encoded(message), Some(file.as_fd())),
            None => Err(io::ErrorKind::NotConnected.into()),
        }
    }

    /// A new lane for a node; `about` names the node in messages.
    pub fn lane(&self, node: &str, about: String) -> io::Result<Arc<NodeLane>> {
        let (lane, file) = Lane::create()?;
        let lane = Arc::new(NodeLane { lane, node: node.to_owned(), about, in_call: AtomicBool::new(false) });
        let mut state = lock(&self.life.state);
        if state.words.is_some() {
            lane.lane.close();
        }
        state.lanes.push(Arc::clone(&lane));
        drop(state);
        self.send(&ToChild::Lane, &file).inspect_err(|_| self.drop_lane(&lane))?;
        Ok(lane)
    }

    /// Removes a lane that is no longer used.
    pub fn drop_lane(&self, lane: &Arc<NodeLane>) {
        let mut state = lock(&self.life.state);
        if self.is_link
            && state.lanes.len() == 1
            && let Some(link) = state.link_report()
        {
            self.totals.keep_link(link);
        }
        state.lanes.retain(|known| !Arc::ptr_eq(known, lane));
    }

    /// Sends a plugin's code to the child, once.
    pub fn give_plugin(&self, image: &PluginImage) -> io::Result<()> {
        let mut plugins = lock(&self.plugins);
        if plugins.contains(&image.id) {
            return Ok(());
        }
        self.give_plugin_file(image.id, &File::open(&image.image)?, &image.file)?;
        plugins.push(image.id);
        Ok(())
    }

    /// Sends the bytes of a plugin to the child; `path` is its file, for messages.
    pub fn give_plugin_file(&self, id: u32, image: &File, path: &Path) -> io::Result<()> {
        self.send(&ToChild::Plugin { id, path: path.as_os_str().as_encoded_bytes().to_vec() }, image)
    }

    /// Makes sure that the child can map the pool of a buffer.
    #[inline]
    pub fn give_pool(&self, buffer: BufferId) -> io::Result<()> {
        let (known, bit) = self.known_pool(buffer).ok_or(io::ErrorKind::InvalidInput)?;
        if known.load(Ordering::Acquire) & bit != 0 { Ok(()) } else { self.send_pool(buffer, known, bit) }
    }

    /// Whether the child was given the pool of a buffer.
    #[inline]
    pub fn can_read(&self, buffer: BufferId) -> bool {
        self.known_pool(buffer).is_some_and(|(known, bit)| known.load(Ordering::Acquire) & bit != 0)
    }

    /// The word and bit of a buffer's pool in `known_pools`.
    #[inline]
    fn known_pool(&self, buffer: BufferId) -> Option<(&AtomicU64, u64)> {
        Some((self.known_pools.get(buffer.pool as usize / 64)?, 1_u64 << (buffer.pool % 64)))
    }

    /// Sends the file of a pool to the child, writable if the pool is its own.
    pub fn give_pool_file(&self, number: u32, file: &File, len: usize, is_own: bool) -> io::Result<()> {
        let message = ToChild::Pool { number, len: len as u64, is_own };
        if is_own {
            return self.send(&message, file);
        }
        // The pools of another group's process can be written; this process gets them for reading.
        self.send(&message, &File::open(format!("/proc/self/fd/{}", file.as_raw_fd()))?)
    }

    #[cold]
    fn send_pool(&self, buffer: BufferId, known: &AtomicU64, bit: u64) -> io::Result<()> {
        let mut files = lock(&self.files);
        if known.load(Ordering::Acquire) & bit != 0 {
            return Ok(());
        }
        let pool = memory().pool_file(buffer.pool).ok_or(io::ErrorKind::NotFound)?;
        self.give_pool_file(buffer.pool, &pool.file, pool.len, Memory::domain_of(buffer) == self.domain)?;
        files.push(pool);
        known.fetch_or(bit, Ordering::Release);
        Ok(())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The child leaves when its socket ends.
        drop(lock(&self.socket).take());
        if !self.life.wait(MAX_LEAVE) {
            self.life.kill("it did not leave");
        }
        // The watcher itself drops the process where that is done at its end.
        let is_other = |watcher: &JoinHandle<()>| watcher.thread().id() != std::thread::current().id();
        if let Some(watcher) = lock(&self.watcher).take().filter(is_other) {
            let _ = watcher.join();
        }
    }
}

fn end(child: &mut Child) {
    let _ = child.kill();
    let _ = child.wait();
}

fn pidfd(child: &Child) -> io::Result<OwnedFd> {
    // SAFETY: a plain system call; the process has not been waited for, so its number is its own.
    let fd = unsafe { libc::syscall(libc::SYS_pidfd_open, child.id(), 0) };
    match i32::try_from(fd) {
        // SAFETY: the system returned this file descriptor, and nothing else owns it.
        Ok(fd) if fd >= 0 => Ok(unsafe { OwnedFd::from_raw_fd(fd) }),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn the_last_lines_of_standard_error_are_kept() {
        let mut file = new_stderr().expect("memory");
        assert_eq!(said(&file, MAX_SAID), None);
        file.write_all(b"first\n\n\x1b[31mterminate called\n  what():  bad\xff\n").expect("room");
        assert_eq!(said(&file, MAX_SAID).as_deref(), Some("[31mterminate called; what():  bad\u{fffd}"));
        let mut written = 0;
        while let Ok(len) = file.write(&[b'x'; 1000]) {
            written += len;
        }
        assert!(written < STDERR_BYTES as usize, "nobody makes it larger");
        assert_eq!(said(&file, MAX_SAID).map(|said| said.len()), Some(MAX_SAID));
        let state = LifeState::default();
        let aborted = || Ok(ExitStatus::from_raw(libc::SIGABRT));
        let plain = words("the process", &state, aborted(), None);
        assert_eq!(words("the process", &state, aborted(), Some("bad".to_owned())), format!("{plain}; it wrote: bad"));
    }
}
