//! The process that runs the graph for the window: plugins, models and everything foreign live here. It shows nothing.
//!
//! The main thread takes the window's commands; a second one sends pictures and states. Whatever takes long has a thread of its own, so that
//! an emergency stop never waits. The process ends with its socket, after all files are finished.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::fs::OpenOptions;
use std::io::{self, BufReader, Write};
use std::net::Shutdown;
use std::os::fd::{AsFd, AsRawFd, RawFd};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use panoscope_editor_model::arguments::Form;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::picture::RenderedPacket;
use panoscope_editor_model::pixels::Pixels;
use panoscope_editor_model::session::Session;
use panoscope_editor_model::texts::phrase;
use panoscope_engine::clock;
use panoscope_engine::ending::signals;
use panoscope_engine::sync::lock;
use panoscope_graph::{GraphOptions, GraphText};
use panoscope_host::audit::LockFacts;
use panoscope_host::loader::verify::Seal;
use panoscope_host::loader::{self as loader, Loader};

use super::link::{self, Block, Command, CounterState, Message, Picture, Region, RigState, RunState, SLOTS};
use super::page::Page;
use super::runner::{Local, Runner};
use super::{Opened, Options, Ready, Refusal, open};

/// First argument of the process; the file descriptor of the shared memory follows, then the arguments of the window.
pub const COMMAND: &str = "theatre-worker";

/// Time between two signs of life.
pub(crate) const BEAT: Duration = Duration::from_millis(50);
/// Longest wait for something to send.
const ROUND: Duration = Duration::from_millis(20);
/// How long files may take to be finished after the window is gone.
const MAX_END: Duration = Duration::from_secs(40);
/// Makes the system end this process before others when memory runs out: the window outlives it.
const OOM_SCORE: &str = "500";

/// What was prepared and can be run.
struct Prepared {
    loader: Arc<Loader>,
    seal: Option<Arc<Seal>>,
    /// Nodes whose parameters the window shows.
    watched: Vec<String>,
}

struct Worker {
    path: PathBuf,
    options: Options,
    region: Region,
    /// To the window.
    out: Mutex<UnixStream>,
    local: Mutex<Option<Local>>,
    prepared: Mutex<Option<Prepared>>,
    watched: Mutex<Vec<String>>,
    free: Mutex<Vec<u32>>,
    /// Something is there to be sent.
    has_changes: Mutex<bool>,
    changed: Condvar,
    /// Number of the last text that was requested.
    asked: AtomicU64,
}

/// Runs the graph file at `path` for the window that started this process; returns when the window is gone or ends it. `memory` is the file
/// descriptor of the shared memory.
///
/// # Errors
/// The window handed over no socket or no memory.
pub fn serve(memory: &OsStr, path: PathBuf, options: Options) -> io::Result<()> {
    let socket = UnixStream::from(io::stdin().as_fd().try_clone_to_owned()?);
    socket.peer_addr()?;
    // No program that a plugin starts may keep the socket open.
    become_nothing(libc::STDIN_FILENO)?;
    let memory: RawFd = memory.to_str().and_then(|text| text.parse().ok()).unwrap_or(-1);
    let region = Region::inherited(memory)?;
    // Best effort: the file is missing in some containers.
    let _ = OpenOptions::new()
        .write(true)
        .open("/proc/self/oom_score_adj")
        .and_then(|mut file| file.write_all(OOM_SCORE.as_bytes()));
    let worker = Arc::new(Worker {
        path,
        options,
        region,
        out: Mutex::new(socket.try_clone()?),
        local: Mutex::default(),
        prepared: Mutex::default(),
        watched: Mutex::default(),
        free: Mutex::new((0..SLOTS).collect()),
        has_changes: Mutex::default(),
        changed: Condvar::new(),
        asked: AtomicU64::new(0),
    });
    let reporting = Arc::clone(&worker);
    std::thread::Builder::new().name("reports".to_owned()).spawn(move || reporting.report())?;
    let from = socket.try_clone()?;
    // A signal ends the wait for commands, as the window's end does.
    std::mem::forget(signals::telling(move || drop(socket.shutdown(Shutdown::Read))));
    if !worker.take_commands(from) {
        // Nobody reads it any more, and writing would be an error.
        let _ = become_nothing(libc::STDERR_FILENO);
    }
    signals::notice();
    worker.end();
    Ok(())
}

/// Makes a standard stream an empty one.
fn become_nothing(stream: RawFd) -> io::Result<()> {
    let nothing = OpenOptions::new().read(true).write(true).open("/dev/null")?;
    // SAFETY: a plain system call on two open files; nothing owns the descriptor of a standard stream.
    if unsafe { libc::dup2(nothing.as_raw_fd(), stream) } < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(())
}

impl Worker {
    fn send(&self, message: &Message) {
        // A window that is gone also ends the commands.
        let _ = link::send(&mut *lock(&self.out), message);
    }

    fn wake(&self) {
        *lock(&self.has_changes) = true;
        self.changed.notify_all();
    }

    fn with_local(&self, act: impl FnOnce(&Local)) {
        if let Some(local) = &*lock(&self.local) {
            act(local);
        }
    }

    /// Obeys until the window ends the process; `false` when the window is gone.
    fn take_commands(self: &Arc<Self>, from: UnixStream) -> bool {
        let mut from = BufReader::new(from);
        loop {
            match link::receive(&mut from) {
                Ok(Some(Command::Close)) => return true,
                Ok(None) => return false,
                Ok(Some(command)) => self.obey(command),
                Err(error) => {
                    let _ = writeln!(io::stderr(), "error: the window's command was not understood: {error}");
                    return false;
                }
            }
        }
    }

    fn obey(self: &Arc<Self>, command: Command) {
        match command {
            Command::Prepare { file, given } => self.apart("prepare", move |worker| {
                let parsed = worker.parse(&file, &given);
                let result = Ready::of(&parsed, &worker.options).map_err(|error| Refusal::of(&worker.path, &error));
                let answer = result.map(|Ready { opened, loader, seal }| {
                    let nodes = watched(&opened);
                    *lock(&worker.prepared) = Some(Prepared { loader, seal, watched: nodes });
                    Some(Box::new(opened))
                });
                worker.send(&Message::Prepared(answer));
            }),
            Command::Reload { file, text, given, lock: facts, sealed, watched } => {
                self.apart("prepare", move |worker| {
                    let answer = worker.reload(&file, &text, &given, (facts.as_ref(), sealed), watched);
                    let answer = answer.map(|()| None).map_err(|error| Refusal::of(&worker.path, &error));
                    worker.send(&Message::Prepared(answer));
                })
            }
            Command::Take => self.take(),
            Command::FindOverlays { file, given } => self.apart("overlays", move |worker| {
                let loader = lock(&worker.local).as_ref().and_then(|local| local.session().map(Session::loader));
                let parsed = worker.parse(&file, &given);
                let loader = loader.unwrap_or_else(|| Arc::new(worker.options.loader_for(&parsed)));
                let form = Form::new(&worker.path, parsed.text(), &given, &loader);
                worker.send(&Message::Overlays(form.overlays));
            }),
            Command::Run { id, text, anew } => {
                self.with_local(|local| if anew { local.restart(&text) } else { local.run(&text) });
                // After the request, so that a state with this number takes it into account.
                self.asked.store(id, Ordering::Release);
                self.wake();
            }
            Command::Preview { requests, interval_ms } => self.with_local(|local| {
                local.request_previews(requests.into_iter().collect(), Duration::from_millis(interval_ms));
            }),
            Command::SetAtOnce { id, node, param, on } => {
                let mut ok = false;
                self.with_local(|local| {
                    local.set_at_once(&node, &param, on);
                    ok = local.take_refusals().is_empty();
                });
                self.send(&Message::Set { id, ok });
            }
            Command::Free { slot } => {
                let mut free = lock(&self.free);
                if slot < SLOTS && !free.contains(&slot) {
                    free.push(slot);
                }
            }
            Command::Report => {
                let mut report = None;
                self.with_local(|local| report = local.report());
                self.send(&Message::Report(report));
            }
            Command::Close => {}
        }
    }

    /// Runs `work` on a thread of its own.
    fn apart(self: &Arc<Self>, name: &str, work: impl FnOnce(&Self) + Send + 'static) {
        let worker = Arc::clone(self);
        let started = std::thread::Builder::new().name(name.to_owned()).spawn(move || work(&worker));
        if let Err(error) = started {
            // Without threads nothing runs here; the window starts another process.
            eprintln!("error: a thread could not be started: {error}");
            let _ = lock(&self.out).shutdown(Shutdown::Both);
        }
    }

    fn parse(&self, file: &str, given: &GraphOptions) -> GraphText {
        GraphText::parse_with(&self.path, file, given)
    }

    /// Loads what a text needs that an earlier process ran. Under a lock the code must be as that process found it.
    fn reload(
        &self,
        file: &str,
        text: &str,
        given: &GraphOptions,
        (facts, sealed): (Option<&LockFacts>, bool),
        watched: Vec<String>,
    ) -> Result<(), super::OpenError> {
        let prepared = if sealed {
            let reopened = open::reopen(&self.parse(file, given), &self.options.trust, facts)?;
            let Some((loader, seal)) = reopened else {
                return Err(super::OpenError::Worker(phrase!("worker-locked-anew")));
            };
            Prepared { loader: Arc::new(loader), seal: Some(seal), watched }
        } else {
            let parsed = GraphText::parse(&self.path, text);
            let loader = Loader::search(&loader::search_path(&parsed.plugin_paths()));
            // Loads the plugins now, so that a start needs no time for it.
            let _ = loader.catalog(&parsed.plugins());
            Prepared { loader: Arc::new(loader), seal: None, watched }
        };
        *lock(&self.prepared) = Some(prepared);
        Ok(())
    }

    fn take(self: &Arc<Self>) {
        let Some(Prepared { loader, seal, watched }) = lock(&self.prepared).take() else { return };
        *lock(&self.watched) = watched;
        let mut local = lock(&self.local);
        match &*local {
            Some(local) => local.seal(seal),
            None => {
                let waking = Arc::downgrade(self);
                let wake = Arc::new(move || {
                    if let Some(worker) = waking.upgrade() {
                        worker.wake();
                    }
                });
                match Local::new(&self.path, loader, seal, self.options.frames, wake) {
                    Ok(new) => *local = Some(new),
                    Err(error) => {
                        eprintln!("error: a thread could not be started: {error}");
                        let _ = lock(&self.out).shutdown(Shutdown::Both);
                    }
                }
            }
        }
    }

    /// Sends pictures, states and signs of life, for as long as the process lives.
    fn report(&self) -> ! {
        let mut beat_at = Instant::now();
        let mut state = None;
        let mut counters = Arc::default();
        let mut values = Vec::new();
        let mut pictures: HashMap<Output, RenderedPacket> = HashMap::new();
        let mut beats = 0;
        let mut page = self.options.web.map(Page::new);
        loop {
            let mut messages = Vec::new();
            let mut running = None;
            if let Some(local) = &*lock(&self.local) {
                beats = local.rounds();
                let asked = self.asked.load(Ordering::Acquire);
                let new = RunState::of(&local.status(), asked);
                if state.as_ref() != Some(&new) {
                    messages.push(Message::Status(new.clone()));
                    state = Some(new);
                }
                let new = local.counters();
                if !Arc::ptr_eq(&new, &counters) {
                    messages.push(Message::Counters(CounterState::of(&new)));
                    counters = new;
                }
                let known = |node: &String| Some((node.clone(), local.values(node)?));
                let new: Vec<_> = lock(&self.watched).iter().filter_map(known).collect();
                if new != values {
                    messages.push(Message::Values(new.clone()));
                    values = new;
                }
                pictures.extend(local.take_previews());
                if page.is_some() {
                    running = local.session().and_then(|session| Some((session.handle().engine()?, session.loader())));
                }
            } else {
                beats += 1;
            }
            messages.iter().for_each(|message| self.send(message));
            // After the graph was let go: a command never waits for the page.
            if let (Some(page), Some((engine, loader))) = (&mut page, running) {
                page.update(&engine, &loader);
            }
            pictures.retain(|output, packet| !self.send_picture(output, packet));
            if Instant::now() >= beat_at {
                beat_at = Instant::now() + BEAT;
                self.send(&Message::Beat { rounds: beats });
            }
            let has_changes = lock(&self.has_changes);
            let (mut has_changes, _) = self
                .changed
                .wait_timeout_while(has_changes, ROUND, |has_changes| !*has_changes)
                .unwrap_or_else(PoisonError::into_inner);
            *has_changes = false;
        }
    }

    /// Sends a preview; `false` while there is no free slot for its pixels.
    fn send_picture(&self, output: &Output, packet: &mut RenderedPacket) -> bool {
        let mut slots = Vec::new();
        let needed = usize::from(packet.pixels.is_some()) + usize::from(packet.cloud.is_some());
        {
            let mut free = lock(&self.free);
            if free.len() < needed {
                return false;
            }
            let kept = free.len() - needed;
            slots.extend(free.drain(kept..));
        }
        let mut block = |width: usize, height: usize, bytes: &[u8]| {
            let slot = slots.pop()?;
            if self.region.write(slot, bytes) {
                return Some(Block { slot, width: width as u32, height: height as u32 });
            }
            lock(&self.free).push(slot);
            None
        };
        let pixels = packet.pixels.take().map(fitted).and_then(|p| block(p.width, p.height, &p.rgba));
        let cloud = packet.cloud.as_ref().and_then(|cloud| {
            let unknown = std::iter::repeat(&f32::NAN);
            let points = cloud.xyz_mm.iter().zip(cloud.confidence.iter().chain(unknown));
            let numbers = points.flat_map(|([x, y, z], confidence)| [*x, *y, *z, *confidence]);
            let bytes: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
            block(cloud.width, cloud.height, &bytes)
        });
        let age_ns = packet
            .arrived_ns
            .map(|arrived_ns| i64::try_from(clock::now_ns()).unwrap_or(i64::MAX).saturating_sub(arrived_ns));
        self.send(&Message::Picture(Box::new(Picture {
            output: output.clone(),
            size_px: packet.size,
            text: std::mem::take(&mut packet.text),
            seq: packet.seq,
            source: packet.tick.source,
            age_ns,
            made_ns: link::monotonic_ns(),
            pixels,
            cloud,
            rig: RigState::of(&packet.content),
        })));
        true
    }

    /// Finishes all files.
    fn end(&self) {
        let limit = std::thread::Builder::new().name("limit".to_owned()).spawn(|| {
            std::thread::sleep(MAX_END);
            eprintln!("error: the graph did not end within {} s", MAX_END.as_secs());
            panoscope_engine::ending::leave(1);
        });
        drop(limit);
        let local = lock(&self.local).take();
        if let Some(mut local) = local {
            local.close();
        }
    }
}

/// Nodes of a graph whose parameters the window shows.
pub(crate) fn watched(opened: &Opened) -> Vec<String> {
    let settings = opened.plan.settings.iter().map(|setting| setting.node.clone());
    let mut nodes: Vec<String> = settings.chain(opened.plan.stops.iter().map(|stop| stop.node.clone())).collect();
    nodes.sort();
    nodes.dedup();
    nodes
}

/// The image, in half its size as often as it takes to fit a slot.
fn fitted(mut pixels: Pixels) -> Pixels {
    while !Region::fits(pixels.rgba.len()) {
        let (width, height) = (pixels.width.div_ceil(2), pixels.height.div_ceil(2));
        let rows = pixels.rgba.chunks_exact(4 * pixels.width).step_by(2);
        let rgba = rows.flat_map(|row| row.chunks_exact(4).step_by(2)).flatten().copied().collect();
        pixels = Pixels { width, height, rgba };
    }
    pixels
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_that_fits_no_slot_is_made_smaller() {
        let pixels = Pixels { width: 8000, height: 4500, rgba: vec![7; 8000 * 4500 * 4] };
        let small = fitted(pixels);
        assert_eq!((small.width, small.height, small.rgba.len()), (4000, 2250, 4000 * 2250 * 4));
        let odd = Pixels { width: 3, height: 1, rgba: vec![1; 12] };
        assert_eq!(fitted(odd.clone()), odd);
    }
}
