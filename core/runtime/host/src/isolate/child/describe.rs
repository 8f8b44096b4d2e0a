//! Describes a plugin for a host that does not load it, and runs its checks of parameters.

use std::ffi::c_void;

use panoscope_abi::{self as abi, Str};

use super::Child;
use crate::isolate::description;
use crate::isolate::lane::MAX_MESSAGE_BYTES;
use crate::isolate::wire::lane::{Problem, Validate};
use crate::isolate::wire::{BadMessage, MAX_PROBLEM_BYTES, MAX_PROBLEMS, Wire, put_bytes, whole};

/// Writes whether the plugin could be loaded, followed by its node types or the error.
pub(super) fn describe(child: &Child, message: &[u8], out: &mut Vec<u8>) -> Result<(), BadMessage> {
    let plugin = whole(message)?;
    let node_types = child.node_types(plugin);
    let begin = out.len();
    match &node_types {
        Ok(node_types) => {
            abi::STATUS_OK.put(out);
            // SAFETY: the loader has validated them, and their plugin stays mapped.
            unsafe { description::write(node_types, out) };
        }
        Err(error) => refuse(&error.to_string(), out),
    }
    if out.len() > MAX_MESSAGE_BYTES {
        out.truncate(begin);
        refuse(&format!("its description has more than {} KiB", MAX_MESSAGE_BYTES >> 10), out);
    }
    Ok(())
}

fn refuse(reason: &str, out: &mut Vec<u8>) {
    abi::STATUS_ERROR.put(out);
    put_bytes(reason.as_bytes(), out);
}

unsafe extern "C" fn invalid(call: *mut c_void, severity: u32, param: u32, message: Str, help: Str) {
    // SAFETY: `call` is what `validate` lends for the length of the call.
    let Some(problems) = (unsafe { call.cast::<Vec<Problem>>().as_mut() }) else { return };
    if problems.len() == MAX_PROBLEMS {
        return;
    }
    // SAFETY: the plugin's texts are readable for the length of this function.
    let [message, help] = [message, help].map(|text| unsafe {
        let bytes = text.bytes();
        bytes[..bytes.len().min(MAX_PROBLEM_BYTES)].to_vec()
    });
    problems.push(Problem { severity, param, message, help });
}

/// Runs a node type's check of parameters and wiring; writes its status and problems.
pub(super) fn validate(child: &Child, message: &[u8], out: &mut Vec<u8>) -> Result<(), BadMessage> {
    let Validate { plugin, index, flags, node, graph_dir, params, connections, outputs_read } = whole(message)?;
    let params = (params.lent(), params);
    let mut problems = Vec::<Problem>::new();
    let mut call = abi::ValidateCall {
        struct_size: size_of::<abi::ValidateCall>() as u32,
        flags,
        call: (&raw mut problems).cast(),
        node_id: Str::borrow(&node),
        params: params.0.as_ptr(),
        params_len: params.0.len(),
        graph_dir: Str::borrow(&graph_dir),
        connections: connections.as_ptr(),
        connections_len: connections.len(),
        outputs_read,
        invalid: Some(invalid),
    };
    let status = match child.node_type(plugin, index).map(|node_type| node_type.validate) {
        // SAFETY: the plugin contract; everything that the call points to outlives it.
        Ok(Some(validate)) => unsafe { validate(&raw mut call) },
        Ok(None) => abi::STATUS_OK,
        Err(_) => abi::STATUS_ERROR,
    };
    status.put(out);
    problems.put(out);
    Ok(())
}
