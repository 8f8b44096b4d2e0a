//! The child's side: receives memory and plugins from the host and runs the calls of each instance on a separate
//! thread.

mod crash;
mod describe;
mod instance;
mod on_device;
mod pools;
mod table;

use std::collections::HashMap;
use std::ffi::OsString;
use std::fs::File;
use std::os::fd::{AsFd, AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use panoscope_abi::{Host, NodeType};
use panoscope_engine::loading;
use panoscope_engine::pool::{Pool, Task};

pub use self::instance::opening;
use self::table::ChildLane;
use crate::isolate::EXIT_CONFINED;
use crate::isolate::confine::confine;
use crate::isolate::lane::Lane;
use crate::isolate::socket;
use crate::isolate::wire::lane::{Settings, ToChild, hello};
use crate::isolate::wire::{BadMessage, whole};

/// A plugin cannot be loaded in the process of a group.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{message}")]
pub struct LoadError {
    /// The loader's message.
    pub message: String,
}

/// Loads a plugin: a path to its bytes, and its file for messages. Returns its node types in order.
pub type LoadFn = fn(image: &Path, file: &Path) -> Result<Vec<&'static NodeType>, LoadError>;

/// A node type that is not available.
#[derive(Clone, Debug, thiserror::Error)]
pub(super) enum NoNodeType {
    /// The host has not sent its plugin.
    #[error("the host has not sent its plugin to this process")]
    NoPlugin,
    /// Its plugin cannot be loaded.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// Its index is beyond the plugin's node types.
    #[error("its plugin has no such node type")]
    NoType,
}

/// Exit status when messages of the host are malformed, because it is of another build.
pub(super) const EXIT_PROTOCOL: i32 = 86;
/// Maximum wait for a plugin. Its message is sent before its first node opens, but the main thread may not have read it
/// yet.
const MAX_WAIT: Duration = Duration::from_secs(10);
/// Maximum single wait in [`wait_while`].
const MAX_SLICE: Duration = Duration::from_millis(10);
/// Stack size of the main thread, which some libraries need when they open.
const STACK_BYTES: usize = 8 << 20;

/// Ends the process without running anything else.
pub(super) fn leave(code: i32) -> ! {
    loop {
        // SAFETY: ends the process.
        unsafe { libc::syscall(libc::SYS_exit_group, code) };
    }
}

/// Waits while `missing` is true, for about `limit` in which this process runs. Time in which the machine stalls or
/// sleeps does not count, because the awaited thread does not run either.
pub(super) fn wait_while<'g, T>(
    changed: &Condvar,
    mut guard: MutexGuard<'g, T>,
    limit: Duration,
    mut missing: impl FnMut(&mut T) -> bool,
) -> MutexGuard<'g, T> {
    for _ in 0..limit.as_millis() / MAX_SLICE.as_millis() {
        let waited = changed.wait_timeout_while(guard, MAX_SLICE, &mut missing);
        let (now, over) = waited.unwrap_or_else(PoisonError::into_inner);
        guard = now;
        if !over.timed_out() {
            break;
        }
    }
    guard
}

/// A plugin that the host sent.
struct Plugin {
    image: File,
    file: PathBuf,
    loaded: Option<Result<Vec<&'static NodeType>, LoadError>>,
}

/// State shared by all lanes.
pub(super) struct Child {
    load: LoadFn,
    plugins: Mutex<HashMap<u32, Plugin>>,
    arrived: Condvar,
    pool: Pool,
    host: &'static Host,
}

impl Child {
    /// A node type of a plugin, which is loaded when its first node opens.
    fn node_type(&self, plugin: u32, index: u32) -> Result<&'static NodeType, NoNodeType> {
        let types = self.node_types(plugin)?;
        types.get(index as usize).copied().ok_or(NoNodeType::NoType)
    }

    /// The node types of a plugin, which is loaded on first use.
    fn node_types(&self, plugin: u32) -> Result<Vec<&'static NodeType>, NoNodeType> {
        let plugins = self.plugins.lock().unwrap_or_else(PoisonError::into_inner);
        let missing = |plugins: &mut HashMap<u32, Plugin>| !plugins.contains_key(&plugin);
        let mut plugins = wait_while(&self.arrived, plugins, MAX_WAIT, missing);
        let Some(Plugin { image, file, loaded }) = plugins.get_mut(&plugin) else {
            return Err(NoNodeType::NoPlugin);
        };
        let path = PathBuf::from(format!("/proc/self/fd/{}", image.as_raw_fd()));
        Ok(loaded.get_or_insert_with(|| (self.load)(&path, file)).clone()?)
    }
}

/// Runs the child until the host closes the socket. Standard input is the socket.
pub fn serve(load: LoadFn) -> ! {
    match start(load) {
        Ok((child, socket)) => match run(&child, &socket) {
            Ok(()) => leave(0),
            Err(BadMessage) => leave(EXIT_PROTOCOL),
        },
        Err(cause) => {
            eprintln!("panoscope: the process of isolated nodes cannot start: {cause}");
            leave(EXIT_PROTOCOL)
        }
    }
}

/// Takes the socket and makes the process ready for plugins.
fn start(load: LoadFn) -> std::io::Result<(Arc<Child>, OwnedFd)> {
    // SAFETY: plain system calls; standard input is the socket that the host gave, and becomes empty for the plugins.
    let socket = unsafe {
        let socket = libc::fcntl(0, libc::F_DUPFD_CLOEXEC, 3);
        if socket < 0 {
            return Err(std::io::Error::last_os_error());
        }
        // Whatever libraries of the host left open, such as a camera.
        libc::close_range(socket as u32 + 1, u32::MAX, 0);
        if socket > 3 {
            libc::close_range(3, socket as u32 - 1, 0);
        }
        let nothing = File::open("/dev/null")?;
        libc::dup2(nothing.as_raw_fd(), 0);
        // A terminal's Ctrl-C goes to all processes of the command; the host ends this one when it is done.
        for signal in [libc::SIGINT, libc::SIGHUP, libc::SIGTERM, libc::SIGPIPE] {
            libc::signal(signal, libc::SIG_IGN);
        }
        OwnedFd::from_raw_fd(socket)
    };
    let (message, _) = socket::receive(socket.as_fd())?;
    let Settings { threads, memory_bytes, deny } = hello(&message)?;
    let limit = |resource, most: u64| {
        let limit = libc::rlimit { rlim_cur: most, rlim_max: most };
        // SAFETY: only reads the struct. Where a limit cannot be set, the system's own holds.
        unsafe { libc::setrlimit(resource, &raw const limit) };
    };
    // Private memory; the pools are shared and do not count.
    limit(libc::RLIMIT_DATA, memory_bytes);
    limit(libc::RLIMIT_CORE, 0);
    crash::install();
    // Before the first thread starts, and before a plugin is mapped.
    if let Err(cause) = confine(deny) {
        eprintln!("panoscope: the process of isolated nodes cannot be locked in: {cause}");
        leave(EXIT_CONFINED);
    }
    let host: &'static Host = Box::leak(Box::new(table::table(threads)));
    loading::use_table(host);
    let pool = Pool::new(threads as usize);
    let nothing: Task = Arc::new(|_, _| ());
    pool.start(&nothing)?;
    let plugins = Mutex::default();
    Ok((Arc::new(Child { load, plugins, arrived: Condvar::new(), pool, host }), socket))
}

/// Receives messages until the host closes the socket.
fn run(child: &Arc<Child>, socket: &OwnedFd) -> Result<(), BadMessage> {
    loop {
        let (message, file) = socket::receive(socket.as_fd()).map_err(|_| BadMessage)?;
        if message.is_empty() {
            return Ok(());
        }
        let (message, file) = (whole(&message)?, File::from(file.ok_or(BadMessage)?));
        match message {
            ToChild::Hello { .. } => return Err(BadMessage),
            ToChild::Pool { number, len, is_own } => {
                pools::map(number, len as usize, is_own, &file).map_err(|_| BadMessage)?;
            }
            ToChild::Plugin { id, path } => {
                let plugin = Plugin { image: file, file: PathBuf::from(OsString::from_vec(path)), loaded: None };
                child.plugins.lock().unwrap_or_else(PoisonError::into_inner).insert(id, plugin);
                child.arrived.notify_all();
            }
            ToChild::Lane => {
                let lane = ChildLane::new(Lane::map(&file).map_err(|_| BadMessage)?);
                let mine = Arc::clone(child);
                let work = move || instance::serve(&mine, &lane);
                let thread = std::thread::Builder::new().stack_size(STACK_BYTES).spawn(work);
                thread.map_err(|_| BadMessage)?;
            }
        }
    }
}
