//! Plugins that this process never loads: another process loads them and sends their descriptions.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use panoscope_abi::{self as abi, NodeType, Plugin, Status, Str};
use panoscope_engine::isolation::{Deny, GroupSettings};

use super::process::{Launch, NodeLane, Process};
use super::{PluginImage, Totals, kept, lock};
use crate::isolate::description::{self, Described};
use crate::isolate::lane::{Lost, Side};
use crate::isolate::wire::lane::{Kind, Problem, Validate, after_deferred};
use crate::isolate::wire::{BadMessage, MAX_PROBLEM_BYTES, MAX_PROBLEMS, Params, Reader, encoded, plain_words};

/// Time limit of a check of parameters.
const MAX_VALIDATE: Duration = Duration::from_secs(10);
/// Limit of the process's private memory, bytes.
const MEMORY_BYTES: u64 = 4 << 30;

/// A plugin that could not be described.
#[derive(Debug, thiserror::Error)]
pub enum DescribeError {
    /// No process could be started.
    #[error("the process that describes it could not be started from {program}: {cause}", program = program.display())]
    Start {
        /// The program.
        program: PathBuf,
        /// The system's error.
        cause: std::io::Error,
    },
    /// The program does not exist or does not answer.
    #[error("{0}")]
    Unreachable(String),
    /// The process crashed or ended.
    #[error("{0}")]
    Died(String),
    /// A constructor or the description did not return in time.
    #[error("it did not describe itself within {} s: one of its constructors may hang", .0.as_secs())]
    Late(Duration),
    /// The answer of the process is malformed.
    #[error("its description is malformed")]
    Nonsense,
    /// The process could not load the plugin.
    #[error("{0}")]
    Refused(String),
}

/// A plugin's own description, made in another process. It must be checked like that of a loaded plugin.
pub struct Description {
    /// The descriptor; its functions are never called.
    pub plugin: &'static Plugin,
    /// Answers further questions.
    pub describer: Arc<Describer>,
}

/// Sends questions to a process that has loaded a plugin. The process starts on demand and ends when idle. Where the
/// system can enforce it, the process cannot open network connections or write files.
pub struct Describer {
    pub(super) image: Arc<PluginImage>,
    plugin: String,
    running: Arc<Mutex<Option<Running>>>,
}

struct Running {
    process: Arc<Process>,
    lane: Arc<NodeLane>,
}

/// Loads a plugin in a separate process and asks what it offers.
///
/// `image` is a path to its bytes that stays valid until this process ends, `file` the plugin's file, `name` the name
/// in its note, `launch` the program that can run it, if not this one, `limit` the time limit. `kept` is a file with an
/// earlier answer: it is read instead of asking, with the same checks, and written if it does not exist.
///
/// # Errors
/// See [`DescribeError`].
pub fn describe(
    image: &Path,
    file: &Path,
    name: &str,
    launch: Option<Launch>,
    limit: Duration,
    kept: Option<&Path>,
) -> Result<Description, DescribeError> {
    let image = Arc::new(PluginImage::new(image, file, launch));
    let describer = Arc::new(Describer { image, plugin: name.to_owned(), running: Arc::default() });
    let node_types = describer.node_types(limit, kept)?;
    let pointers: Vec<*const NodeType> =
        node_types.into_iter().map(|node_type| std::ptr::from_ref(Box::leak(Box::new(node_type)))).collect();
    let pointers: &'static [*const NodeType] = Box::leak(pointers.into_boxed_slice());
    let name: &'static str = Box::leak(name.to_owned().into_boxed_str());
    let plugin = descriptor(name, pointers);
    Ok(Description { plugin: Box::leak(Box::new(plugin)), describer })
}

/// The descriptor of a plugin with this name and these node types, which live as long as it is used.
pub(super) fn descriptor(name: &str, node_types: &[*const NodeType]) -> Plugin {
    Plugin {
        magic: abi::MAGIC,
        abi_major: abi::ABI_MAJOR,
        abi_minor: abi::ABI_MINOR,
        struct_size: size_of::<Plugin>() as u32,
        reserved: 0,
        name: Str::borrow(name),
        version: Str::EMPTY,
        doc: Str::EMPTY,
        node_types: node_types.as_ptr(),
        node_types_len: node_types.len(),
        note: std::ptr::null(),
        attach: None,
    }
}

impl Describer {
    fn node_types(&self, limit: Duration, kept: Option<&Path>) -> Result<Vec<NodeType>, DescribeError> {
        let read = |bytes: &[u8]| description::read(bytes).map(Described::into_static);
        if let Some(node_types) = kept.and_then(kept::read).and_then(|bytes| read(&bytes).ok()) {
            return Ok(node_types);
        }
        let answer = self.ask(Kind::Describe, &encoded(&self.image.id), limit)?;
        let mut reader = Reader(&answer);
        let nonsense = |BadMessage| DescribeError::Nonsense;
        match reader.take().map_err(nonsense)? {
            abi::STATUS_OK => {
                let node_types = read(reader.0).map_err(nonsense)?;
                if let Some(file) = kept {
                    kept::write(file, reader.0);
                }
                Ok(node_types)
            }
            _ => Err(DescribeError::Refused(plain_words(reader.bytes().map_err(nonsense)?))),
        }
    }

    /// Calls `validate` of node type `index`; its problems are passed to `call`.
    ///
    /// # Errors
    /// The plugin could not be asked.
    ///
    /// # Safety
    /// The call and everything that it points to stay valid until this returns.
    pub unsafe fn validate(&self, index: u32, call: *mut abi::ValidateCall) -> Result<Status, DescribeError> {
        // SAFETY: the caller's promise.
        let call = unsafe { &*call };
        // SAFETY: the caller's promise.
        let request = unsafe {
            Validate {
                plugin: self.image.id,
                index,
                flags: call.flags,
                node: call.node_id.text().unwrap_or_default().to_owned(),
                graph_dir: call.graph_dir.text().unwrap_or_default().to_owned(),
                params: Params::copy(call.params, call.params_len),
                connections: (0..call.connections_len).map(|at| *call.connections.add(at)).collect(),
                outputs_read: call.outputs_read,
            }
        };
        let answer = self.ask(Kind::Validate, &encoded(&request), MAX_VALIDATE)?;
        // SAFETY: the caller's promise.
        unsafe { report(&answer, call) }.map_err(|BadMessage| DescribeError::Nonsense)
    }

    /// Sends a request to the process; returns its answer.
    fn ask(&self, kind: Kind, request: &[u8], limit: Duration) -> Result<Vec<u8>, DescribeError> {
        let mut running = lock(&self.running);
        let was_running = running.as_ref().is_some_and(|running| !running.process.is_ending());
        if !was_running {
            *running = Some(self.start()?);
        }
        let answer = exchange(running.as_ref(), kind, request, limit);
        if !(was_running && matches!(answer, Err(DescribeError::Died(_)))) {
            return answer;
        }
        // It may just have left because it was not needed.
        *running = Some(self.start()?);
        exchange(running.as_ref(), kind, request, limit)
    }

    fn start(&self) -> Result<Running, DescribeError> {
        let own = || Launch::own().map_err(|error| DescribeError::Unreachable(error.to_string()));
        let launch = self.image.launch.clone().map_or_else(own, Ok)?;
        let settings = GroupSettings {
            name: format!("describes {}", self.plugin),
            threads: 1,
            memory_bytes: MEMORY_BYTES,
            deny: Deny { network: true, new_files: true },
            // An interpreter says there why it does not start.
            keeps_stderr: self.image.launch.is_some(),
            machine: None,
        };
        let what = "the process that describes it".to_owned();
        let process = Process::start(&launch, &settings, what, 0, &Arc::new(Totals::default()))
            .map_err(|cause| DescribeError::Start { program: launch.program, cause })?;
        let lane = process.give_plugin(&self.image).and_then(|()| process.lane("", "its code".to_owned()));
        match lane {
            Ok(lane) => {
                // It leaves when it is not needed for a while; nothing of it stays then. Whoever asks it meanwhile starts another one.
                let running = Arc::downgrade(&self.running);
                process.at_end(move || {
                    let Some(running) = running.upgrade() else { return };
                    let ended =
                        running.try_lock().ok().and_then(|mut running| running.take_if(|r| r.process.is_dead()));
                    drop(ended);
                });
                Ok(Running { process, lane })
            }
            Err(_) if process.is_ending() => Err(DescribeError::Died(process.death())),
            Err(cause) => Err(DescribeError::Unreachable(format!("the process that describes it: {cause}"))),
        }
    }
}

/// Passes the problems in the answer of a process on to `call`; returns the status.
///
/// # Safety
/// The handle of the call stays valid until this returns.
pub(super) unsafe fn report(answer: &[u8], call: &abi::ValidateCall) -> Result<Status, BadMessage> {
    let mut reader = Reader(answer);
    let (status, problems) = (reader.take()?, reader.take::<Vec<Problem>>()?);
    if problems.len() > MAX_PROBLEMS {
        return Err(BadMessage);
    }
    for Problem { severity, param, message, help } in &problems {
        let text = |bytes: &[u8]| Str { ptr: bytes.as_ptr(), len: bytes.len().min(MAX_PROBLEM_BYTES) };
        if let Some(invalid) = call.invalid {
            // SAFETY: the caller's promise; the texts live until the function returns.
            unsafe { invalid(call.call, *severity, *param, text(message), text(help)) };
        }
    }
    Ok(status)
}

fn exchange(running: Option<&Running>, kind: Kind, request: &[u8], limit: Duration) -> Result<Vec<u8>, DescribeError> {
    let Some(Running { process, lane }) = running else { return Err(DescribeError::Nonsense) };
    if request.len() > crate::isolate::lane::MAX_MESSAGE_BYTES {
        return Err(DescribeError::Unreachable("its parameters do not fit a message to its process".to_owned()));
    }
    lane.in_call.store(true, Ordering::Relaxed);
    lane.lane.post(Side::Host, kind, request);
    // The end of the process closes lanes after it is recorded: a later post sees it here.
    if process.is_dead() {
        return Err(DescribeError::Died(process.death()));
    }
    let mut message = Vec::new();
    let answered = lane.lane.receive_until(Side::Host, &mut message, Some(Instant::now() + limit));
    let outcome = match answered {
        Ok(Kind::Done) => {
            // What it wrote down belongs to no call.
            after_deferred(&message).map(|reader| reader.0.to_vec()).map_err(|BadMessage| DescribeError::Nonsense)
        }
        // Functions of the host belong to calls, and here is none.
        Ok(_) | Err(Lost::Bad) => Err(DescribeError::Nonsense),
        Err(Lost::Late) => Err(DescribeError::Late(limit)),
        Err(Lost::Gone) => Err(DescribeError::Died(process.death())),
    };
    lane.in_call.store(false, Ordering::Relaxed);
    if outcome.is_err() && !process.is_dead() {
        process.kill("it did not describe its plugin");
    }
    outcome
}
