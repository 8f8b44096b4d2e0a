//! A plugin's node types as bytes: written in the process that ran its constructors, read in one that does not load it.
//!
//! Functions do not cross. For an optional function of the plugin, the copy has one that fails, so that its existence
//! is known.

use std::any::Any;
use std::ffi::c_void;

use panoscope_abi::{self as abi, Host, NodeType, Param, Port, Status, Str};

use crate::isolate::wire::{BadMessage, Reader, Wire, put_bytes};

const HAS_SAVE: u32 = 1;
const HAS_LOAD: u32 = 2;
const HAS_VALIDATE: u32 = 4;
const HAS_FINISH: u32 = 8;

/// Minimum number of bytes of an encoded port.
const PORT_BYTES: usize = 40;
const PARAM_BYTES: usize = 88;
const TYPE_BYTES: usize = 60;

/// Writes node types of a plugin.
///
/// # Safety
/// They are validated descriptors of a plugin that stays mapped.
pub(crate) unsafe fn write(node_types: &[&NodeType], out: &mut Vec<u8>) {
    (node_types.len() as u64).put(out);
    for node_type in node_types {
        let has = |there: bool, bit: u32| if there { bit } else { 0 };
        let functions = has(node_type.save_state.is_some(), HAS_SAVE)
            | has(node_type.load_state.is_some(), HAS_LOAD)
            | has(node_type.validate.is_some(), HAS_VALIDATE)
            | has(node_type.finish_function().is_some(), HAS_FINISH);
        [node_type.kind, node_type.flags, functions].iter().for_each(|number| number.put(out));
        // SAFETY: the caller's promise, for everything that the descriptor points to.
        unsafe {
            for text in [node_type.name, node_type.family, node_type.doc] {
                put_bytes(text.bytes(), out);
            }
            for (ports, len) in [(node_type.inputs, node_type.inputs_len), (node_type.outputs, node_type.outputs_len)] {
                (len as u64).put(out);
                slice(ports, len).iter().for_each(|port| write_port(port, out));
            }
            (node_type.params_len as u64).put(out);
            slice(node_type.params, node_type.params_len).iter().for_each(|param| write_param(param, out));
        }
    }
}

unsafe fn slice<'a, T>(first: *const T, len: usize) -> &'a [T] {
    // SAFETY: the caller's promise: `len` values from `first` on.
    if len == 0 { &[] } else { unsafe { std::slice::from_raw_parts(first, len) } }
}

unsafe fn write_port(port: &Port, out: &mut Vec<u8>) {
    for text in [port.name, port.doc, port.packet] {
        // SAFETY: the caller's promise.
        put_bytes(unsafe { text.bytes() }, out);
    }
    port.layout_hash.put(out);
    [port.formats, port.flags].iter().for_each(|number| number.put(out));
}

unsafe fn write_param(param: &Param, out: &mut Vec<u8>) {
    // SAFETY: the caller's promise.
    unsafe {
        for text in [param.name, param.doc, param.unit] {
            put_bytes(text.bytes(), out);
        }
        [param.kind, param.flags].iter().for_each(|number| number.put(out));
        [param.default_number, param.min, param.max, param.step].iter().for_each(|number| number.put(out));
        put_bytes(param.default_text.bytes(), out);
        (param.choices_len as u64).put(out);
        slice(param.choices, param.choices_len).iter().for_each(|choice| put_bytes(choice.bytes(), out));
        (param.default_floats_len as u64).put(out);
        f64::put_all(slice(param.default_floats, param.default_floats_len), out);
    }
}

/// Decoded node types and the memory that they point to.
pub(crate) struct Described {
    pub node_types: Vec<NodeType>,
    memory: Memory,
}

impl Described {
    /// Leaks the node types, which then live until the process ends, as those of a plugin.
    pub fn into_static(self) -> Vec<NodeType> {
        std::mem::forget(self.memory);
        self.node_types
    }
}

/// Lists and texts, which do not move.
#[derive(Default)]
struct Memory(Vec<Box<dyn Any>>);

impl Memory {
    /// Keeps some values; returns their address and count.
    fn keep<T: 'static>(&mut self, values: Vec<T>) -> (*const T, usize) {
        let values = values.into_boxed_slice();
        let kept = (values.as_ptr(), values.len());
        self.0.push(Box::new(values));
        kept
    }
}

/// Reads node types. Only the lengths are checked.
pub(crate) fn read(bytes: &[u8]) -> Result<Described, BadMessage> {
    let (mut reader, mut memory) = (Reader(bytes), Memory::default());
    let node_types =
        (0..reader.count(TYPE_BYTES)?).map(|_| read_type(&mut reader, &mut memory)).collect::<Result<_, _>>()?;
    if reader.0.is_empty() { Ok(Described { node_types, memory }) } else { Err(BadMessage) }
}

fn text(reader: &mut Reader<'_>, memory: &mut Memory) -> Result<Str, BadMessage> {
    let (ptr, len) = memory.keep(reader.bytes()?.to_vec());
    Ok(Str { ptr, len })
}

/// As many values as the message says, each of at least `least` bytes.
fn list<T: 'static>(
    reader: &mut Reader<'_>,
    memory: &mut Memory,
    least: usize,
    read: impl Fn(&mut Reader<'_>, &mut Memory) -> Result<T, BadMessage>,
) -> Result<(*const T, usize), BadMessage> {
    let values = (0..reader.count(least)?).map(|_| read(reader, memory)).collect::<Result<Vec<T>, _>>()?;
    Ok(memory.keep(values))
}

fn read_type(reader: &mut Reader<'_>, memory: &mut Memory) -> Result<NodeType, BadMessage> {
    let (kind, flags, functions) = (reader.take()?, reader.take()?, reader.take::<u32>()?);
    let has = |bit: u32| functions & bit != 0;
    let (name, family, doc) = (text(reader, memory)?, text(reader, memory)?, text(reader, memory)?);
    let (inputs, inputs_len) = list(reader, memory, PORT_BYTES, read_port)?;
    let (outputs, outputs_len) = list(reader, memory, PORT_BYTES, read_port)?;
    let (params, params_len) = list(reader, memory, PARAM_BYTES, read_param)?;
    Ok(NodeType {
        struct_size: size_of::<NodeType>() as u32,
        kind,
        flags,
        reserved: 0,
        name,
        family,
        doc,
        inputs,
        inputs_len,
        outputs,
        outputs_len,
        params,
        params_len,
        open: Some(open),
        process: Some(process),
        close: Some(close),
        save_state: has(HAS_SAVE).then_some(save_state),
        load_state: has(HAS_LOAD).then_some(load_state),
        validate: has(HAS_VALIDATE).then_some(validate),
        finish: has(HAS_FINISH).then_some(finish),
    })
}

fn read_port(reader: &mut Reader<'_>, memory: &mut Memory) -> Result<Port, BadMessage> {
    let (name, doc, packet) = (text(reader, memory)?, text(reader, memory)?, text(reader, memory)?);
    Ok(Port { name, doc, packet, layout_hash: reader.take()?, formats: reader.take()?, flags: reader.take()? })
}

fn read_param(reader: &mut Reader<'_>, memory: &mut Memory) -> Result<Param, BadMessage> {
    let (name, doc, unit) = (text(reader, memory)?, text(reader, memory)?, text(reader, memory)?);
    let (kind, flags) = (reader.take()?, reader.take()?);
    let (default_number, min, max, step) = (reader.take()?, reader.take()?, reader.take()?, reader.take()?);
    let default_text = text(reader, memory)?;
    let (choices, choices_len) = list(reader, memory, 8, text)?;
    let (default_floats, default_floats_len) = list(reader, memory, 8, |reader, _| reader.take())?;
    Ok(Param {
        name,
        doc,
        unit,
        kind,
        flags,
        default_number,
        min,
        max,
        step,
        default_text,
        choices,
        choices_len,
        default_floats,
        default_floats_len,
    })
}

// The engine opens nodes of these types through their group and calls none of these.

unsafe extern "C" fn open(call: *mut abi::OpenCall, _: *mut *mut c_void) -> Status {
    // SAFETY: the contract: the call and its table live.
    unsafe {
        if let Some(fail) = (*(*call).host).fail {
            fail(
                (*call).call,
                Str::new(
                    "its plugin is loaded in a process of its own only; isolate the node, or no node of the plugin",
                ),
            );
        }
    }
    abi::STATUS_ERROR
}

unsafe extern "C" fn process(_: *mut c_void, _: *mut abi::Call) -> Status {
    abi::STATUS_INVALID
}

unsafe extern "C" fn close(_: *mut c_void) {}

unsafe extern "C" fn save_state(_: *mut c_void, _: *const Host, _: *mut c_void) -> Status {
    abi::STATUS_INVALID
}

unsafe extern "C" fn load_state(_: *mut c_void, _: *const u8, _: usize) -> Status {
    abi::STATUS_INVALID
}

unsafe extern "C" fn validate(_: *mut abi::ValidateCall) -> Status {
    abi::STATUS_OK
}

unsafe extern "C" fn finish(_: *mut c_void, _: *const Host, _: *mut c_void) -> Status {
    abi::STATUS_INVALID
}

#[cfg(test)]
mod tests {
    use super::*;

    fn described() -> NodeType {
        let port = Port {
            name: Str::new("image"),
            doc: Str::new("What comes in."),
            packet: Str::new("image"),
            layout_hash: 0,
            formats: 6,
            flags: 1,
        };
        let choices: &'static [Str] = Box::leak(Box::new([Str::new("near"), Str::new("far")]));
        let floats: &'static [f64] = Box::leak(Box::new([1.0, f64::NAN]));
        let param = Param {
            name: Str::new("side"),
            doc: Str::EMPTY,
            unit: Str::new("px"),
            kind: abi::PARAM_CHOICE,
            flags: abi::PARAM_REOPEN,
            default_number: 1.0,
            min: f64::NEG_INFINITY,
            max: 4.0,
            step: 0.5,
            default_text: Str::EMPTY,
            choices: choices.as_ptr(),
            choices_len: choices.len(),
            default_floats: floats.as_ptr(),
            default_floats_len: floats.len(),
        };
        let (ports, params): (&'static [Port], &'static [Param]) =
            (Box::leak(Box::new([port])), Box::leak(Box::new([param])));
        NodeType {
            struct_size: size_of::<NodeType>() as u32,
            kind: abi::KIND_BLOCKING,
            flags: abi::NODE_SIDE_EFFECTS,
            reserved: 0,
            name: Str::new("look"),
            family: Str::new("sink"),
            doc: Str::new("Looks."),
            inputs: ports.as_ptr(),
            inputs_len: 1,
            outputs: std::ptr::null(),
            outputs_len: 0,
            params: params.as_ptr(),
            params_len: 1,
            open: Some(open),
            process: Some(process),
            close: Some(close),
            save_state: Some(save_state),
            load_state: None,
            validate: Some(validate),
            finish: None,
        }
    }

    #[test]
    fn a_description_comes_back_as_it_was() {
        let node_type = described();
        let (mut first, mut second) = (Vec::new(), Vec::new());
        // SAFETY: a descriptor whose parts live until the process ends.
        unsafe { write(&[&node_type], &mut first) };
        let read = read(&first).expect("what was written");
        let copy = &read.node_types[0];
        // SAFETY: `read` holds what the copy points to.
        unsafe { write(&[copy], &mut second) };
        assert_eq!(first, second);
        assert!(copy.save_state.is_some() && copy.validate.is_some());
        assert!(copy.load_state.is_none() && copy.finish.is_none());
    }

    #[test]
    fn a_cut_or_lengthened_description_is_refused() {
        let node_type = described();
        let mut whole = Vec::new();
        // SAFETY: a descriptor whose parts live until the process ends.
        unsafe { write(&[&node_type], &mut whole) };
        for len in 0..whole.len() {
            assert!(read(&whole[..len]).is_err(), "{len} of {} bytes", whole.len());
        }
        whole.push(0);
        assert!(read(&whole).is_err());
        assert!(read(&(u64::MAX / 2).to_le_bytes()).is_err(), "a count beyond the bytes");
    }
}
