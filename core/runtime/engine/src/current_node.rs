//! Which node each thread runs, readable in a signal handler.

use std::cell::Cell as Slot;
use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock};

use panoscope_abi::{self as abi, Tick};
use panoscope_graph::Validator;

use crate::busy::CallKind;
use crate::sync::lock;

/// The calling thread's number.
pub(crate) fn thread_id() -> i32 {
    // SAFETY: a plain question to the system.
    unsafe { libc::gettid() }
}

/// The names of a node for a crash report. Plain strings: reading them in a signal handler needs no lock and no heap.
#[derive(Debug, Default)]
pub(crate) struct NodeNames {
    pub node: String,
    pub node_type: String,
    /// The plugin's file; empty when it is not known.
    pub file: String,
}

impl NodeNames {
    /// The node `id` of this type.
    pub fn of(id: &str, node_type: &'static abi::NodeType) -> Arc<Self> {
        // SAFETY: a validated descriptor of a plugin that stays mapped.
        let name = unsafe { node_type.name.text() }.unwrap_or("?").to_owned();
        let file = lock(files()).get(&address(node_type)).cloned().unwrap_or_default();
        Arc::new(Self { node: id.to_owned(), node_type: name, file })
    }
}

/// A node whose `process` runs.
pub(crate) trait Running {
    /// Its name for a crash report.
    fn who(&self) -> &NodeNames;

    /// The tick that it processes.
    fn tick(&self) -> Tick;

    /// Counts a copy of a frame that its call made necessary.
    fn count_copy(&self, bytes: usize);
}

/// Work of the calling thread for a node. Copied into threads that help it with a loop.
#[derive(Clone, Copy)]
pub(crate) struct CurrentWork {
    /// The node whose `process` runs.
    call: Option<*const dyn Running>,
    /// Another kind of call; takes precedence over `call`.
    other: *const NodeNames,
    kind: CallKind,
}

thread_local! {
    // Constants without destructors: no lazy initialisation, so that a signal handler may read them.
    static CALL: Slot<Option<*const (dyn Running + 'static)>> = const { Slot::new(None) };
    static OTHER: Slot<(*const NodeNames, CallKind)> = const { Slot::new((std::ptr::null(), CallKind::Process)) };
}

/// The calling thread runs `process` of `node` until [`end_call`]. Costs two stores: the node's name is looked up only
/// after a crash.
#[inline]
pub(crate) fn begin_call(node: &(dyn Running + 'static)) {
    CALL.with(|call| call.set(Some(node)));
}

/// See [`begin_call`].
#[inline]
pub(crate) fn end_call() {
    CALL.with(|call| call.set(None));
}

/// Counts a copy of a frame of `bytes` for the node whose `process` the calling thread runs, if there is one.
pub(crate) fn count_copy(bytes: usize) {
    if let Some(node) = CALL.with(Slot::get) {
        // SAFETY: set by `begin_call` or `help`: the call is under way below on this thread, or on one that waits for this one, and borrows it.
        unsafe { &*node }.count_copy(bytes);
    }
}

/// Source slot and number of a tick.
pub(crate) type TickName = (u32, u64);

/// Ends what [`with`] or [`help`] began.
pub(crate) struct Guard {
    before: CurrentWork,
}

impl Drop for Guard {
    fn drop(&mut self) {
        set(self.before);
    }
}

fn set(work_now: CurrentWork) {
    CALL.with(|call| call.set(work_now.call));
    OTHER.with(|other| other.set((work_now.other, work_now.kind)));
}

/// The work that the calling thread does now.
pub(crate) fn current_work() -> CurrentWork {
    let (other, kind) = OTHER.with(Slot::get);
    CurrentWork { call: CALL.with(Slot::get), other, kind }
}

/// Runs `work`, which makes another kind of call for a node, on the calling thread.
pub(crate) fn with<T>(who: &Arc<NodeNames>, kind: CallKind, work: impl FnOnce() -> T) -> T {
    let before = current_work();
    set(CurrentWork { other: Arc::as_ptr(who), kind, ..before });
    // `who` is borrowed until the guard is gone, also when `work` panics.
    let _guard = Guard { before };
    work()
}

/// Runs `work`, which helps another thread with a loop of its node, while that thread waits.
pub(crate) fn help<T>(doing_there: CurrentWork, work: impl FnOnce() -> T) -> T {
    let before = current_work();
    set(doing_there);
    let _guard = Guard { before };
    work()
}

/// The node that the calling thread works for, the kind of call, and in `process` the tick: source and number.
///
/// Reads thread-locals and memory that the calls below on this thread keep alive: a signal handler may call this.
pub(crate) fn current<'a>() -> Option<(&'a NodeNames, CallKind, Option<TickName>)> {
    let CurrentWork { call, other, kind } = current_work();
    // SAFETY: set by `with` or `help`, which are under way below on this thread and keep it borrowed.
    if let Some(who) = unsafe { other.as_ref() } {
        return Some((who, kind, None));
    }
    // SAFETY: set by `begin_call` or `help`: the call is under way below on this thread, or on one that waits for this one, and borrows it.
    let node = unsafe { &*call? };
    let tick = node.tick();
    Some((node.who(), CallKind::Process, Some((tick.source, tick.seq))))
}

fn address(node_type: &'static abi::NodeType) -> usize {
    std::ptr::from_ref(node_type).addr()
}

fn files() -> &'static Mutex<HashMap<usize, String>> {
    static FILES: OnceLock<Mutex<HashMap<usize, String>>> = OnceLock::new();
    FILES.get_or_init(Mutex::default)
}

/// Records that a plugin was loaded: its node types come from this file.
pub(crate) fn loaded(entries: &[&'static abi::NodeType], file: &Path) {
    let mut files = lock(files());
    for entry in entries {
        files.insert(address(entry), file.display().to_string());
    }
}

/// Runs code of a plugin's file that belongs to no node yet: constructors, its description.
pub(crate) fn loading<T>(file: &Path, work: impl FnOnce() -> T) -> T {
    let who = Arc::new(NodeNames { node: String::new(), node_type: String::new(), file: file.display().to_string() });
    with(&who, CallKind::Open, work)
}

/// A plugin's validator for which a crash report names the node.
pub(crate) fn checking(node_type: &str, file: &Path, validator: Validator) -> Validator {
    let (node_type, file) = (node_type.to_owned(), file.display().to_string());
    Validator::new(move |setup| {
        let who = NodeNames { node: setup.node_id.to_owned(), node_type: node_type.clone(), file: file.clone() };
        with(&Arc::new(who), CallKind::Check, || validator.problems(setup))
    })
}

/// Nodes that are opening now.
static OPENING: Mutex<Vec<Arc<NodeNames>>> = Mutex::new(Vec::new());

/// Runs a node's `open`.
pub(crate) fn opening<T>(who: &Arc<NodeNames>, work: impl FnOnce() -> T) -> T {
    struct Listed(*const NodeNames);
    impl Drop for Listed {
        fn drop(&mut self) {
            let mut list = lock(&OPENING);
            if let Some(at) = list.iter().position(|who| Arc::as_ptr(who) == self.0) {
                list.swap_remove(at);
            }
        }
    }
    lock(&OPENING).push(Arc::clone(who));
    let _listed = Listed(Arc::as_ptr(who));
    with(who, CallKind::Open, work)
}

/// Nodes that are opening now, by name and type.
pub(crate) fn being_opened() -> Vec<String> {
    lock(&OPENING).iter().map(|who| format!("`{}` ({})", who.node, who.node_type)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_graph::NodeSetup;

    #[test]
    fn a_thread_knows_what_it_does_and_forgets_it_after_a_panic() {
        let who = Arc::new(NodeNames { node: "a".to_owned(), node_type: "t".to_owned(), file: "f".to_owned() });
        assert!(current().is_none());
        let there = with(&who, CallKind::Close, || {
            let (now, kind, tick) = current().expect("set");
            assert_eq!((now.node.as_str(), kind, tick), ("a", CallKind::Close, None));
            current_work()
        });
        assert!(current().is_none());
        let seen = help(there, || current().map(|(who, kind, _)| (who.node.clone(), kind)));
        assert_eq!(seen, Some(("a".to_owned(), CallKind::Close)));
        let caught = std::panic::catch_unwind(|| with(&who, CallKind::Open, || panic!("told to")));
        assert!(caught.is_err() && current().is_none());
        assert_eq!(opening(&who, being_opened), ["`a` (t)"]);
        assert!(being_opened().is_empty());
    }

    #[test]
    fn a_validator_runs_in_the_name_of_the_node_that_it_checks() {
        let seen = Arc::new(Mutex::new(None));
        let saw = Arc::clone(&seen);
        let validator = checking(
            "t",
            Path::new("p.so"),
            Validator::new(move |_| {
                let (who, kind, _) = current().expect("set");
                *lock(&saw) = Some((who.node.clone(), who.node_type.clone(), who.file.clone(), kind));
                Vec::new()
            }),
        );
        let setup = NodeSetup { node_id: "a", params: &[], graph_dir: Path::new(""), batch: true, wiring: None };
        assert!(validator.problems(&setup).is_empty() && current().is_none());
        let [node, node_type, file] = ["a", "t", "p.so"].map(str::to_owned);
        assert_eq!(*lock(&seen), Some((node, node_type, file, CallKind::Check)));
    }
}
