//! The host's side: groups, their processes, and the instances that live there.

mod answer;
mod describer;
mod kept;
#[doc(hidden)]
pub mod played;
mod process;
mod remote;
mod stock;

use std::collections::HashMap;
use std::ffi::c_void;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError, Weak};

use panoscope_abi::{self as abi, NodeType, Status};
use panoscope_engine::isolation::{Group, GroupError, GroupReport, GroupSettings, Isolator, LinkReport};
use panoscope_engine::memory::{Domain, SharedFrames};

pub use self::describer::{DescribeError, Describer, Description, describe};
pub use self::process::{Launch, LaunchError};
pub(crate) use self::process::{NodeLane, Process};

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Cost of the calls of a group in all its processes.
#[derive(Default)]
pub(crate) struct Totals {
    processes: AtomicU64,
    calls: AtomicU64,
    round_trips: AtomicU64,
    sleeps: AtomicU64,
    /// Last known state of the connection to another machine.
    last_link: Mutex<Option<LinkReport>>,
}

impl Totals {
    /// Keeps the state of a connection for reports after its end.
    fn keep_link(&self, link: LinkReport) {
        *lock(&self.last_link) = Some(link);
    }

    /// Counts one tick.
    fn add(&self, round_trips: u64, sleeps: u64) {
        self.calls.fetch_add(1, Ordering::Relaxed);
        self.round_trips.fetch_add(round_trips, Ordering::Relaxed);
        self.sleeps.fetch_add(sleeps, Ordering::Relaxed);
    }
}

/// The code of a plugin, as verified and mapped by the host.
#[derive(Debug)]
pub struct PluginImage {
    /// Number in this process; each version of a plugin's file has its own.
    id: u32,
    /// The bytes that were mapped: a path below `/proc/self/fd` that stays valid until the process ends.
    image: PathBuf,
    /// The plugin's file, for messages.
    file: PathBuf,
    /// The program that can run it, if not this one.
    launch: Option<Launch>,
}

type Images = HashMap<usize, (Arc<PluginImage>, u32)>;

/// A node type's image and its position there, by the address of the type.
static IMAGES: LazyLock<Mutex<Images>> = LazyLock::new(Mutex::default);
/// The functions of isolated node types, by the address of the type.
static PROXIES: LazyLock<Mutex<HashMap<usize, &'static NodeType>>> = LazyLock::new(Mutex::default);

impl PluginImage {
    fn new(image: &Path, file: &Path, launch: Option<Launch>) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(1);
        let id = NEXT.fetch_add(1, Ordering::Relaxed);
        Self { id, image: image.to_owned(), file: file.to_owned(), launch }
    }
}

/// Registers a loaded plugin, whose bytes processes of isolated nodes map.
///
/// `image` is a path to them that stays valid until this process ends, `file` the plugin's file, `entries` its node
/// types in order.
pub fn remember(entries: &[&'static NodeType], image: &Path, file: &Path) {
    put(entries, &Arc::new(PluginImage::new(image, file, None)));
}

/// Registers a described plugin: processes of isolated nodes map the bytes that its describing process mapped.
/// `entries` are its node types in order.
pub fn remember_described(entries: &[&'static NodeType], describer: &Describer) {
    put(entries, &describer.image);
}

fn put(entries: &[&'static NodeType], image: &Arc<PluginImage>) {
    let mut images = lock(&IMAGES);
    for (index, entry) in entries.iter().enumerate() {
        images.insert(std::ptr::from_ref(*entry).addr(), (Arc::clone(image), index as u32));
    }
}

/// Makes processes of this program for isolated nodes. Attaches to the engine.
#[derive(Debug, Default)]
pub struct Processes;

impl Isolator for Processes {
    fn group(&self, settings: &GroupSettings) -> Result<Arc<dyn Group>, GroupError> {
        let frames = SharedFrames::begin()?;
        let domain = Domain::written_elsewhere()?;
        let settings = settings.clone();
        let totals = Arc::default();
        Ok(Arc::new(Isolated { settings, process: Mutex::default(), domain, totals, _frames: frames }))
    }
}

/// A group without a process.
#[derive(Debug, thiserror::Error)]
enum ProcessError {
    /// A plugin of another kind, such as one in Python, on another machine.
    #[error("no other machine runs nodes of its plugin")]
    NoMachine,
    /// The program to start is not known.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The program does not start.
    #[error("the process of group `{group}` could not be started from {}: {cause}", program.display())]
    Start { group: String, program: PathBuf, cause: std::io::Error },
}

/// A group. Its process lives as long as one of its instances is open.
struct Isolated {
    settings: GroupSettings,
    process: Mutex<Weak<Process>>,
    domain: Domain,
    totals: Arc<Totals>,
    _frames: SharedFrames,
}

impl Isolated {
    /// The running process, or a new one that can run the code of `image`.
    fn process(&self, image: &PluginImage) -> Result<Arc<Process>, ProcessError> {
        let mut process = lock(&self.process);
        if let Some(old) = process.upgrade() {
            if !old.is_ending() {
                return Ok(old);
            }
            // Both would write the same pools.
            old.wait_for_end();
        }
        let what = match &self.settings.machine {
            Some(machine) => format!("machine `{}`", machine.name),
            None => format!("the process of group `{}`", self.settings.name),
        };
        let launch = match (&self.settings.machine, &image.launch) {
            (Some(_), Some(_)) => return Err(ProcessError::NoMachine),
            (Some(machine), None) => Launch::link(machine)?,
            (None, Some(launch)) => launch.clone(),
            (None, None) => Launch::own()?,
        };
        let started = Process::start(&launch, &self.settings, what, self.domain.number(), &self.totals);
        let new = started.map_err(|cause| {
            let (group, program) = (self.settings.name.clone(), launch.program.clone());
            ProcessError::Start { group, program, cause }
        })?;
        *process = Arc::downgrade(&new);
        Ok(new)
    }
}

impl Group for Isolated {
    fn proxy(&self, entry: &'static NodeType) -> &'static NodeType {
        let mut proxies = lock(&PROXIES);
        proxies.entry(std::ptr::from_ref(entry).addr()).or_insert_with(|| Box::leak(Box::new(remote::proxy_of(entry))))
    }

    unsafe fn open(&self, entry: &'static NodeType, call: *mut abi::OpenCall, instance: *mut *mut c_void) -> Status {
        let refuse = |words: String| {
            // SAFETY: the caller's promise: the call and its table live.
            unsafe {
                if let Some(fail) = (*(*call).host).fail {
                    fail((*call).call, abi::Str::borrow(&words));
                }
            }
            abi::STATUS_ERROR
        };
        let known = lock(&IMAGES).get(&std::ptr::from_ref(entry).addr()).cloned();
        let Some((image, index)) = known else {
            return refuse("its plugin was not loaded from a file, so no other process can load it".to_owned());
        };
        let process = match self.process(&image) {
            Ok(process) => process,
            Err(error) => return refuse(error.to_string()),
        };
        // SAFETY: the caller's promise.
        unsafe { remote::open(process, &image, Some(entry), index, call, instance) }
    }

    fn max_pause_ms(&self) -> u64 {
        if self.settings.machine.is_some() { 100 } else { u64::MAX }
    }

    fn not_enforced(&self) -> Vec<&'static str> {
        if self.settings.machine.is_some() {
            // The other machine says so itself.
            return Vec::new();
        }
        crate::isolate::kernel().lacks(self.settings.deny)
    }

    fn counts(&self) -> GroupReport {
        let load = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let Totals { processes, calls, round_trips, sleeps, last_link } = &*self.totals;
        // Held while a process starts, which a report does not wait for.
        let process = self.process.try_lock().ok().and_then(|process| process.upgrade());
        let link = self.settings.machine.as_ref().and_then(|machine| {
            let now = process.as_ref().and_then(|process| process.link_report());
            Some(LinkReport { address: machine.address.clone(), ..now.or_else(|| lock(last_link).clone())? })
        });
        GroupReport {
            process_id: process.and_then(|process| process.id()),
            processes: load(processes),
            calls: load(calls),
            round_trips: load(round_trips),
            sleeps: load(sleeps),
            not_enforced: self.not_enforced(),
            link,
        }
    }

    fn domain(&self) -> u32 {
        self.domain.number()
    }

    fn kill(&self, reason: &str) {
        let process = lock(&self.process).upgrade();
        if let Some(process) = process {
            process.kill(reason);
        }
    }
}
