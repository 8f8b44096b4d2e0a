//! Describes a plugin for a host that does not load it, and runs its checks of parameters.

use std::ffi::c_void;

use panoscope_abi::{self as abi, Str};

use super::Child;
use crate::isolate::description;
use crate::isolate::lane::MAX_MESSAGE_BYTES;
use crate::isolate::wire::{BadMessage, MAX_PROBLEM_BYTES, MAX_PROBLEMS, Reader, Writer};

/// Writes whether the plugin could be loaded, followed by its node types or the error.
pub(super) fn describe(child: &Child, reader: &mut Reader<'_>, out: &mut Vec<u8>) -> Result<(), BadMessage> {
    let plugin = reader.u32()?;
    let node_types = child.node_types(plugin);
    let begin = out.len();
    let mut writer = Writer(out);
    match &node_types {
        Ok(node_types) => {
            writer.i32(abi::STATUS_OK);
            // SAFETY: the loader has validated them, and their plugin stays mapped.
            unsafe { description::write(node_types, &mut writer) };
        }
        Err(error) => _ = writer.i32(abi::STATUS_ERROR).bytes(error.to_string().as_bytes()),
    }
    if out.len() > MAX_MESSAGE_BYTES {
        out.truncate(begin);
        let reason = format!("its description has more than {} KiB", MAX_MESSAGE_BYTES >> 10);
        Writer(out).i32(abi::STATUS_ERROR).bytes(reason.as_bytes());
    }
    Ok(())
}

/// Encoded problems that a node reports.
#[derive(Default)]
struct Problems {
    count: usize,
    bytes: Vec<u8>,
}

unsafe extern "C" fn invalid(call: *mut c_void, severity: u32, param: u32, message: Str, help: Str) {
    // SAFETY: `call` is what `validate` lends for the length of the call.
    let Some(problems) = (unsafe { call.cast::<Problems>().as_mut() }) else { return };
    if problems.count == MAX_PROBLEMS {
        return;
    }
    problems.count += 1;
    let mut out = Writer(&mut problems.bytes);
    out.u32(severity).u32(param);
    for text in [message, help] {
        // SAFETY: the plugin's texts are readable for the length of this function.
        let bytes = unsafe { text.bytes() };
        out.bytes(&bytes[..bytes.len().min(MAX_PROBLEM_BYTES)]);
    }
}

/// Runs a node type's check of parameters and wiring; writes its status and problems.
pub(super) fn validate(child: &Child, reader: &mut Reader<'_>, out: &mut Vec<u8>) -> Result<(), BadMessage> {
    let (plugin, index, flags) = (reader.u32()?, reader.u32()?, reader.u32()?);
    let (node_id, graph_dir, params) = (reader.bytes()?, reader.bytes()?, reader.params()?);
    let connections = (0..reader.count(4)?).map(|_| reader.u32()).collect::<Result<Vec<u32>, _>>()?;
    let outputs_read = reader.u64()?;
    let text = |bytes: &[u8]| Str { ptr: bytes.as_ptr(), len: bytes.len() };
    let mut problems = Problems::default();
    let mut call = abi::ValidateCall {
        struct_size: size_of::<abi::ValidateCall>() as u32,
        flags,
        call: (&raw mut problems).cast(),
        node_id: text(node_id),
        params: params.values.as_ptr(),
        params_len: params.values.len(),
        graph_dir: text(graph_dir),
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
    Writer(out).i32(status).u64(problems.count as u64);
    out.extend_from_slice(&problems.bytes);
    Ok(())
}
