//! Runs one node in a unit test, with parameters from TOML text and a complete host in the same process.
//!
//! ```ignore
//! let mut node = Harness::<StereoBm>::from_toml("params = { search_px = 64 }")?;
//! let out = node.input_image::<Gray8>("left", 640, 480, &left).input_image::<Gray8>("right", 640, 480, &right).process()?;
//! let disparity = out.plane::<Disparity>("disparity")?;
//! ```
//!
//! Parameters are checked as in a graph file, with the same messages. Fresh memory is filled with `0xA5`, so that
//! unwritten pixels are visible. When the harness is dropped, the node must have released every buffer, or the test
//! fails.

mod call;
mod error;
mod files;
mod host;
mod inputs;
mod memory;
mod on_device;
mod outputs;
mod params;

use std::ffi::c_void;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use panoscope_graph::from_abi::{ParamSnapshot, node_types};
use panoscope_graph::{NodeSetup, NodeType, ParamProblem, ParamValue, Wiring};

pub use error::HarnessError;
pub use files::Files;
pub use on_device::lend_device;
pub use outputs::Outputs;

use crate::Node;
use crate::abi::{self, Str};
use crate::export::NodeTypeOf;

/// Severity of a log line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// The node cannot go on.
    Error,
    /// The user should know.
    Warn,
    /// Progress.
    Info,
    /// For debugging the node.
    Debug,
}

/// A line that the node logged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// Severity.
    pub level: Level,
    /// The line's text.
    pub message: String,
}

/// A number that the node reported.
#[derive(Clone, Debug, PartialEq)]
pub struct Metric {
    /// Name, such as `inliers`.
    pub name: String,
    /// Value, in the unit that the name ends with.
    pub value: f64,
}

/// Placeholder for a node type that is known only by its descriptor, such as one written in C.
pub enum Foreign {}

/// Options for opening a node.
#[derive(Clone, Debug)]
pub struct Setup {
    toml: String,
    node_id: String,
    graph_dir: PathBuf,
    threads: usize,
    batch: bool,
    read: Option<Vec<String>>,
    files: Files,
}

impl Default for Setup {
    fn default() -> Self {
        let (toml, node_id) = (String::new(), "node".to_owned());
        Self {
            toml,
            node_id,
            graph_dir: PathBuf::from("."),
            threads: 1,
            batch: false,
            read: None,
            files: Files::default(),
        }
    }
}

impl From<&str> for Setup {
    fn from(toml: &str) -> Self {
        Self { toml: toml.to_owned(), ..Self::default() }
    }
}

impl Setup {
    /// `toml`: the text under `[nodes.NAME]` of a graph file, such as `params = { ... }`.
    pub fn new(toml: &str) -> Self {
        toml.into()
    }

    /// Sets the node's name in the graph; default `node`.
    pub fn node_id(self, node_id: &str) -> Self {
        Self { node_id: node_id.to_owned(), ..self }
    }

    /// Sets the folder of the graph file, to which paths are relative; default is the current folder.
    pub fn graph_dir(self, graph_dir: impl AsRef<Path>) -> Self {
        Self { graph_dir: graph_dir.as_ref().to_owned(), ..self }
    }

    /// Sets the number of threads that run loops; default 1.
    pub fn threads(self, threads: usize) -> Self {
        Self { threads: threads.max(1), ..self }
    }

    /// Runs the node as in a graph with `mode = "batch"`.
    pub fn batch(self) -> Self {
        Self { batch: true, ..self }
    }

    /// Sets the run that the node belongs to; default is a separate run.
    pub fn files(self, files: &Files) -> Self {
        Self { files: files.clone(), ..self }
    }

    /// Gives a reader to these outputs only; by default all outputs have one.
    pub fn read_only(self, outputs: &[&str]) -> Self {
        Self { read: Some(outputs.iter().map(|o| (*o).to_owned()).collect()), ..self }
    }
}

/// One open node and its host.
pub struct Harness<N = Foreign> {
    descriptor: *const abi::NodeType,
    node_type: NodeType,
    setup: Setup,
    host: Box<abi::Host>,
    pool: u32,
    instance: Option<*mut c_void>,
    values: Vec<ParamValue>,
    snapshot: ParamSnapshot,
    params_version: u64,
    outputs_read: u64,
    next_tick: abi::Tick,
    pending: Vec<inputs::Pending>,
    /// Age of the light of input ports in the next call, ns, and the host's clock.
    ages_ns: Vec<(usize, i64)>,
    now_ns: Option<i64>,
    tick_age_ns: i64,
    problem: Option<HarnessError>,
    reported: host::Reported,
    node: PhantomData<fn() -> N>,
}

impl<N: Node> Harness<N> {
    /// Opens the node with the text under `[nodes.NAME]` of a graph file; empty for the defaults.
    ///
    /// # Errors
    /// Mistakes in the text, with the messages of a graph file; an error or panic of the node's `open`.
    pub fn from_toml(toml: &str) -> Result<Self, HarnessError> {
        Self::open(Setup::new(toml))
    }

    /// Opens the node.
    ///
    /// # Errors
    /// As [`Harness::from_toml`].
    pub fn open(setup: Setup) -> Result<Self, HarnessError> {
        let (descriptor, node_type) = Self::described()?;
        Self::with(descriptor, node_type, setup)
    }

    /// Runs the node's own check as for a graph whose only connections go to the inputs `connected`
    /// (a list input may be named several times). Opens nothing.
    ///
    /// # Errors
    /// Mistakes in the text, with the messages of a graph file; an input or output that the node does not have.
    pub fn problems(setup: &Setup, connected: &[&str]) -> Result<Vec<ParamProblem>, HarnessError> {
        let (_, node_type) = Self::described()?;
        let values = params::read(&node_type, &setup.graph_dir, &setup.toml)?;
        let mut connections = vec![0; node_type.inputs.len()];
        for name in connected {
            let Some(index) = node_type.input(name) else {
                let names = node_type.inputs.iter().map(|i| i.name.as_str());
                return Err(HarnessError::port(format!("there is no input `{name}`{}", available(name, names))));
            };
            connections[index] += 1;
        }
        let wiring = Wiring { connections, outputs_read: outputs_read(&node_type, setup)? };
        let node = NodeSetup {
            node_id: &setup.node_id,
            params: &values,
            graph_dir: &setup.graph_dir,
            batch: setup.batch,
            wiring: Some(&wiring),
        };
        Ok(node_type.validator.as_ref().map(|validator| validator.problems(&node)).unwrap_or_default())
    }

    fn described() -> Result<(&'static abi::NodeType, NodeType), HarnessError> {
        // SAFETY: `attached` returns a static table, valid until the process ends.
        unsafe { crate::host::attach(host::attached()) };
        crate::export::install_panic_hook();
        let descriptor: &'static abi::NodeType = &NodeTypeOf::<N>::NODE_TYPE;
        let plugin = abi::Plugin {
            magic: abi::MAGIC,
            abi_major: abi::ABI_MAJOR,
            abi_minor: abi::ABI_MINOR,
            struct_size: size_of::<abi::Plugin>() as u32,
            reserved: 0,
            name: Str::new("test"),
            version: Str::new("0"),
            doc: Str::EMPTY,
            node_types: &raw const descriptor as *const *const abi::NodeType,
            node_types_len: 1,
            note: std::ptr::null(),
            attach: None,
        };
        // SAFETY: the descriptor is made by this crate from statics, and `plugin` lives until `node_types` returns.
        let node_type = unsafe { node_types(&plugin) }?.remove(0);
        Ok((descriptor, node_type))
    }
}

impl Harness<Foreign> {
    /// Opens node type `name` of a plugin's descriptor, such as one that came out of `dlopen`.
    ///
    /// # Errors
    /// A malformed descriptor, an unknown type; else as [`Harness::from_toml`].
    ///
    /// # Safety
    /// `plugin` was returned by a plugin's entry function and is valid until the process ends, and the plugin obeys the
    /// ABI.
    pub unsafe fn of_plugin(plugin: *const abi::Plugin, name: &str, setup: Setup) -> Result<Self, HarnessError> {
        // SAFETY: the caller guarantees a valid descriptor of a plugin.
        let types = unsafe { node_types(plugin) }?;
        let names = || types.iter().map(|t| t.name.as_str());
        let Some(index) = names().position(|n| n == name) else {
            return Err(HarnessError::port(format!(
                "the plugin has no node type `{name}`{}",
                available(name, names())
            )));
        };
        // SAFETY: `node_types` checked these pointers, and the caller guarantees that they stay valid.
        unsafe {
            if let Some(attach) = (*plugin).attach {
                attach(host::attached());
            }
            Self::with(*(*plugin).node_types.add(index), types[index].clone(), setup)
        }
    }
}

impl<N> Harness<N> {
    fn with(descriptor: *const abi::NodeType, node_type: NodeType, setup: Setup) -> Result<Self, HarnessError> {
        let values = params::read(&node_type, &setup.graph_dir, &setup.toml)?;
        let outputs_read = outputs_read(&node_type, &setup)?;
        let mut harness = Self {
            descriptor,
            host: host::table(setup.threads),
            pool: memory::open_pool(),
            instance: None,
            snapshot: ParamSnapshot::new(&values),
            values,
            params_version: 0,
            outputs_read,
            next_tick: abi::Tick::default(),
            pending: (0..node_type.inputs.len()).map(|_| inputs::Pending::Unconnected).collect(),
            ages_ns: Vec::new(),
            now_ns: None,
            tick_age_ns: 0,
            problem: None,
            reported: host::Reported::default(),
            node_type,
            setup,
            node: PhantomData,
        };
        harness.reopen()?;
        Ok(harness)
    }

    /// The node type's entry in the catalogue: ports, parameters, texts.
    pub fn node_type(&self) -> &NodeType {
        &self.node_type
    }

    /// Changes the node's parameters, as an editor does while the graph runs: `toml` replaces all earlier text.
    /// A change of a `reopen` parameter closes the node and opens it again.
    ///
    /// # Errors
    /// As [`Harness::from_toml`]; when the text has mistakes, the old parameters stay.
    pub fn set_params(&mut self, toml: &str) -> Result<(), HarnessError> {
        let values = params::read(&self.node_type, &self.setup.graph_dir, toml)?;
        let declared = self.node_type.params.iter().zip(values.iter().zip(&self.values));
        let reopen = declared.into_iter().any(|(param, (new, old))| param.reopen && new != old);
        self.snapshot = ParamSnapshot::new(&values);
        self.values = values;
        self.params_version += 1;
        if reopen { self.reopen() } else { Ok(()) }
    }

    /// Sets the tick of the next call; later calls count on from it. By default ticks begin at 0, with 30 per second of
    /// media time.
    pub fn at_tick(&mut self, seq: u64, capture_ns: i64) -> &mut Self {
        self.next_tick = abi::Tick { seq, capture_ns, ..self.next_tick };
        self
    }

    /// Sets the host's clock for the ages of the next call, ns. By default it shows the tick's capture time.
    pub fn at_clock(&mut self, now_ns: i64) -> &mut Self {
        self.now_ns = Some(now_ns);
        self
    }

    /// Sets the age of the light of the tick for the next call. By default it is 0.
    pub fn tick_age(&mut self, age: std::time::Duration) -> &mut Self {
        self.tick_age_ns = i64::try_from(age.as_nanos()).unwrap_or(i64::MAX);
        self
    }

    /// Sets the age of the light of an input for the next call. By default it is that of the tick.
    pub fn input_age(&mut self, name: &str, age: std::time::Duration) -> &mut Self {
        let Some(index) = self.node_type.input(name) else {
            let names = self.node_type.inputs.iter().map(|p| p.name.as_str());
            let problem = format!("there is no input `{name}`{}", available(name, names));
            self.problem.get_or_insert_with(|| HarnessError::port(problem));
            return self;
        };
        self.ages_ns.push((index, i64::try_from(age.as_nanos()).unwrap_or(i64::MAX)));
        self
    }

    /// Limits the buffers that may be alive at once, inputs included: a further allocation returns `STATUS_EXHAUSTED`.
    pub fn limit_buffers(&mut self, buffers: usize) -> &mut Self {
        memory::limit(self.pool, Some(buffers));
        self
    }

    /// All log lines of the node since the harness was made.
    pub fn logs(&self) -> &[LogLine] {
        &self.reported.logs
    }

    /// All metrics of the node since the harness was made, in order.
    pub fn metrics(&self) -> &[Metric] {
        &self.reported.metrics
    }

    /// The last value of a metric; `None` when it was never reported.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.reported.metrics.iter().rev().find(|m| m.name == name).map(|m| m.value)
    }

    /// Number of frames that the host copied because the node wrote to them while they were shared.
    pub fn copies(&self) -> u64 {
        self.reported.copies
    }

    /// Bytes of all outputs allocated so far.
    pub fn allocated_bytes(&self) -> u64 {
        self.reported.allocated_bytes
    }

    /// Number of buffers that the node retains between calls.
    pub fn kept_buffers(&self) -> usize {
        let pending = self.pending.iter().map(inputs::Pending::buffers).sum::<usize>();
        memory::alive(self.pool).saturating_sub(pending)
    }
}

impl<N> Drop for Harness<N> {
    fn drop(&mut self) {
        // A test that checks the result calls `finish` itself.
        let _ = self.finish();
        self.drop_inputs();
        let violation = memory::take_violation(self.pool);
        let left = memory::close_pool(self.pool);
        if std::thread::panicking() {
            return;
        }
        assert!(left == 0, "the node was closed and still holds {left} frames: every `retain` needs a `release`");
        if let Some(problem) = violation {
            panic!("the node violated the ABI: {problem}");
        }
    }
}

/// Bit set of the outputs that have a reader.
fn outputs_read(node_type: &NodeType, setup: &Setup) -> Result<u64, HarnessError> {
    let Some(read) = &setup.read else { return Ok(u64::MAX) };
    let mut bits = 0;
    for name in read {
        let Some(index) = node_type.output(name) else {
            let names = node_type.outputs.iter().map(|o| o.name.as_str());
            return Err(HarnessError::port(format!("there is no output `{name}`{}", available(name, names))));
        };
        bits |= 1_u64.checked_shl(index as u32).unwrap_or(0);
    }
    Ok(bits)
}

/// The end of a message about an unknown name: lists the names that exist.
fn available<'a>(wanted: &str, names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.collect();
    match names.as_slice() {
        [] => ": it has none".to_owned(),
        names if names.iter().any(|n| n.eq_ignore_ascii_case(wanted)) => format!(": names are lower case ({wanted})"),
        names => format!("; there are: {}", names.join(", ")),
    }
}
