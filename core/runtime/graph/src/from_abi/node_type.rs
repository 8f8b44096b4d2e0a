//! One node type's descriptor. The struct has grown: a plugin built for an older minor version has a shorter one.

use std::path::PathBuf;

use panoscope_abi as abi;

use super::{
    FromAbiError, MAX_PARAMS, MAX_PORTS, Result, check_name, known_bits, params, ports, slice, struct_size, text,
    validator,
};
use crate::catalog::{NodeKind, NodeType};

/// Size of the struct in the first version of the contract: all before `validate`, bytes.
const MIN_SIZE: usize = abi::NodeType::FIRST_SIZE;

/// Flags of a node type.
const NODE_FLAGS: u32 = abi::NODE_SOURCE | abi::NODE_EXCLUSIVE | abi::NODE_SIDE_EFFECTS | abi::NODE_FETCHES;

/// A copy of a descriptor in which fields that its plugin does not have are null.
///
/// # Safety
/// `node` is aligned and points to `(*node).struct_size` readable bytes, at least [`MIN_SIZE`].
unsafe fn copied(node: *const abi::NodeType) -> abi::NodeType {
    let mut copy = std::mem::MaybeUninit::<abi::NodeType>::zeroed();
    // SAFETY: the caller's promise; both sides hold at least the smaller of the two sizes.
    unsafe {
        let len = ((*node).struct_size as usize).min(size_of::<abi::NodeType>());
        std::ptr::copy_nonoverlapping(node.cast::<u8>(), copy.as_mut_ptr().cast::<u8>(), len);
        // All-zero bytes are a value of every field: null pointers, no function, 0.
        copy.assume_init()
    }
}

/// The descriptor with every field of this version: itself, or a copy that lives as long as the process when its plugin
/// is older.
///
/// # Safety
/// `node` was accepted by [`super::node_types`] and stays valid until the process ends.
pub unsafe fn whole(node: *const abi::NodeType) -> &'static abi::NodeType {
    // SAFETY: the caller's promise.
    unsafe {
        if (*node).struct_size as usize >= size_of::<abi::NodeType>() {
            return &*node;
        }
        Box::leak(Box::new(copied(node)))
    }
}

pub(super) unsafe fn node_type(
    plugin_place: &str,
    place: String,
    plugin: &str,
    node: *const abi::NodeType,
) -> Result<NodeType> {
    if node.is_null() || !node.is_aligned() {
        let fault = if node.is_null() { "null" } else { "misaligned" };
        return Err(FromAbiError::Pointer { place, field: "the entry of node_types", fault, len: 1 });
    }
    // SAFETY: the caller's promise; the size is the first field of every version.
    struct_size(&place, unsafe { (*node).struct_size }, MIN_SIZE)?;
    // SAFETY: the caller's promise, and the struct has the fields of the first version.
    let node = &unsafe { copied(node) };
    // SAFETY: the caller's promise.
    let name = unsafe { text(&place, "name", node.name)? };
    check_name(&place, &name, false)?;
    let place = format!("{plugin_place}, node type `{name}`");
    let kind = match node.kind {
        abi::KIND_COMPUTE => NodeKind::Compute,
        abi::KIND_BLOCKING => NodeKind::Blocking,
        abi::KIND_REALTIME => NodeKind::Realtime,
        found => return Err(FromAbiError::Unknown { place, field: "kind", found }),
    };
    known_bits(&place, "flags", node.flags, NODE_FLAGS)?;
    let functions =
        [("open", node.open.is_some()), ("process", node.process.is_some()), ("close", node.close.is_some())];
    if let Some((function, _)) = functions.into_iter().find(|(_, there)| !there) {
        return Err(FromAbiError::NoFunction { place, function });
    }
    // SAFETY: the caller's promise.
    unsafe {
        let found = NodeType {
            plugin: plugin.to_owned(),
            family: text(&place, "family", node.family)?,
            doc: text(&place, "doc", node.doc)?,
            kind,
            source: node.flags & abi::NODE_SOURCE != 0,
            exclusive: node.flags & abi::NODE_EXCLUSIVE != 0,
            side_effects: node.flags & abi::NODE_SIDE_EFFECTS != 0,
            inputs: ports(&place, "input", slice(&place, "inputs", node.inputs, node.inputs_len, MAX_PORTS)?)?,
            outputs: ports(&place, "output", slice(&place, "outputs", node.outputs, node.outputs_len, MAX_PORTS)?)?,
            params: params(&place, slice(&place, "params", node.params, node.params_len, MAX_PARAMS)?)?,
            shipped_dir: PathBuf::new(),
            interpreter: None,
            validator: node.validate.map(validator::of),
            name,
        };
        if found.inputs.is_empty() && !found.source {
            let problem = "it has no inputs and is not marked as a source (NODE_SOURCE), so it would never run";
            return Err(FromAbiError::Contradiction { place, problem: problem.to_owned() });
        }
        Ok(found)
    }
}
