//! A plugin's `validate` function as the [`Validator`] of its node type.

use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use panoscope_abi as abi;
use panoscope_base::secret::redact;

use super::ParamSnapshot;
use crate::diagnostic::Severity;
use crate::validate::{NodeSetup, ParamProblem, Validator};

type Validate = unsafe extern "C" fn(*mut abi::ValidateCall) -> abi::Status;

/// Problems of one node that are kept: a plugin that reports without end must not fill the memory.
const MAX_PROBLEMS: usize = 64;

/// Asks `validate`, whose plugin stays mapped.
pub(super) fn of(validate: Validate) -> Validator {
    // SAFETY: a function of the contract; `problems_of` passes a call that outlives it.
    Validator::new(move |setup| problems_of(setup, |call| unsafe { validate(call) }))
}

/// Report of the plugin, as [`abi::ValidateCall::invalid`] takes it.
struct Sink {
    params: usize,
    problems: Vec<ParamProblem>,
}

unsafe extern "C" fn invalid(call: *mut c_void, severity: u32, param: u32, message: abi::Str, help: abi::Str) {
    // A panic (of the allocator) must not cross into the plugin.
    let _ = catch_unwind(AssertUnwindSafe(|| {
        // SAFETY: `call` is the sink that `problems` lends for the length of the call and touches only after it.
        let sink = unsafe { &mut *call.cast::<Sink>() };
        if sink.problems.len() == MAX_PROBLEMS {
            return;
        }
        // SAFETY: the plugin's texts are readable for the length of this function.
        let (message, help) = unsafe { (message.bytes(), help.bytes()) };
        // They may quote an address.
        let words = |bytes: &[u8]| redact(&String::from_utf8_lossy(bytes)).into_owned();
        sink.problems.push(ParamProblem {
            severity: if severity == abi::PROBLEM_WARNING { Severity::Warning } else { Severity::Error },
            param: usize::try_from(param).ok().filter(|p| *p < sink.params),
            message: words(message),
            help: words(help),
        });
    }));
}

/// Reports of `ask` about a node to its call, which lives until `ask` returns. It may ask a plugin elsewhere.
pub fn problems_of(
    setup: &NodeSetup<'_>,
    ask: impl FnOnce(*mut abi::ValidateCall) -> abi::Status,
) -> Vec<ParamProblem> {
    let snapshot = ParamSnapshot::new(setup.params);
    let dir = if setup.graph_dir.as_os_str().is_empty() { Path::new(".") } else { setup.graph_dir };
    let graph_dir = std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned());
    let graph_dir = graph_dir.to_string_lossy();
    let mut sink = Sink { params: setup.params.len(), problems: Vec::new() };
    let (connections, outputs_read) = setup.wiring.map_or((&[][..], 0), |w| (&w.connections[..], w.outputs_read));
    let mut call = abi::ValidateCall {
        struct_size: size_of::<abi::ValidateCall>() as u32,
        flags: if setup.batch { abi::CALL_BATCH } else { 0 } | if setup.wiring.is_some() { abi::CALL_WIRED } else { 0 },
        call: (&raw mut sink).cast(),
        node_id: abi::Str::borrow(setup.node_id),
        params: snapshot.values().as_ptr(),
        params_len: snapshot.values().len(),
        graph_dir: abi::Str::borrow(&graph_dir),
        connections: connections.as_ptr(),
        connections_len: connections.len(),
        outputs_read,
        invalid: Some(invalid),
    };
    let status = ask(&raw mut call);
    if status < abi::STATUS_OK && !sink.problems.iter().any(|p| p.severity == Severity::Error) {
        sink.problems.push(ParamProblem {
            severity: Severity::Error,
            param: None,
            message: format!("the node refused its parameters without a message (status {status})"),
            help: String::new(),
        });
    }
    sink.problems
}
