//! Descriptors of plugins: structures in memory, built from the bytes. Pointers are null, misaligned or valid for their length, as the contract demands.

use std::ffi::c_void;

use panoscope_abi as abi;
use panoscope_graph::from_abi;

use crate::draw::Draw;

unsafe extern "C" fn open(_: *mut abi::OpenCall, _: *mut *mut c_void) -> abi::Status {
    abi::STATUS_INVALID
}

unsafe extern "C" fn process(_: *mut c_void, _: *mut abi::Call) -> abi::Status {
    abi::STATUS_INVALID
}

unsafe extern "C" fn close(_: *mut c_void) {}

/// A text of the bytes, now and then a pointer or a length that is none.
fn text(draw: &mut Draw<'_>) -> abi::Str {
    match draw.u8() {
        250 => abi::Str { ptr: std::ptr::null(), len: 3 },
        251 => abi::Str { ptr: draw.0.as_ptr(), len: usize::MAX },
        252 => abi::Str::EMPTY,
        _ => {
            let bytes = draw.bytes(40);
            abi::Str { ptr: bytes.as_ptr(), len: bytes.len() }
        }
    }
}

/// A pointer and a length for a list.
fn list<T>(draw: &mut Draw<'_>, items: &[T]) -> (*const T, usize) {
    match draw.u8() {
        250 => (std::ptr::null(), 2),
        251 => (items.as_ptr(), usize::MAX),
        252 => (items.as_ptr().cast::<u8>().wrapping_add(1).cast(), 1),
        253 => (std::ptr::null(), 0),
        _ => (items.as_ptr(), items.len()),
    }
}

/// A flag set that is often right.
fn flags(draw: &mut Draw<'_>) -> u32 {
    match draw.u8() {
        255 => draw.u32(),
        small => u32::from(small),
    }
}

fn number(draw: &mut Draw<'_>) -> f64 {
    match draw.u8() {
        255 => draw.f64(),
        254 => f64::INFINITY,
        253 => f64::NEG_INFINITY,
        252 => 1e16,
        small => f64::from(small) - 100.0,
    }
}

fn port(draw: &mut Draw<'_>) -> abi::Port {
    const PACKETS: [&str; 8] = ["image", "mask", "disparity", "cloud", "any", "table", "own", "tip"];
    let name = text(draw);
    let packet = match draw.u8() {
        255 => text(draw),
        index => abi::Str::new(PACKETS[usize::from(index) % PACKETS.len()]),
    };
    abi::Port { name, doc: text(draw), packet, layout_hash: draw.u64(), formats: flags(draw), flags: flags(draw) }
}

pub fn run(bytes: &[u8]) {
    let mut draw = Draw(bytes);
    let draw = &mut draw;
    let choices: Vec<abi::Str> = (0..draw.u8() % 5).map(|_| text(draw)).collect();
    let floats: Vec<f64> = (0..draw.u8() % 5).map(|_| number(draw)).collect();
    let inputs: Vec<abi::Port> = (0..draw.u8() % 4).map(|_| port(draw)).collect();
    let outputs: Vec<abi::Port> = (0..draw.u8() % 4).map(|_| port(draw)).collect();
    let params: Vec<abi::Param> = (0..draw.u8() % 5)
        .map(|_| {
            let (choices, choices_len) = list(draw, &choices);
            let (default_floats, default_floats_len) = list(draw, &floats);
            abi::Param {
                name: text(draw),
                doc: text(draw),
                unit: text(draw),
                kind: flags(draw) % 10,
                flags: flags(draw),
                default_number: number(draw),
                min: number(draw),
                max: number(draw),
                step: number(draw),
                default_text: text(draw),
                choices,
                choices_len,
                default_floats,
                default_floats_len,
            }
        })
        .collect();
    let nodes: Vec<abi::NodeType> = (0..draw.u8() % 3)
        .map(|_| {
            let has = draw.u8();
            let (inputs, inputs_len) = list(draw, &inputs);
            let (outputs, outputs_len) = list(draw, &outputs);
            let (params, params_len) = list(draw, &params);
            // SAFETY: null pointers, absent functions and zeros are values of all fields.
            let blank: abi::NodeType = unsafe { std::mem::zeroed() };
            abi::NodeType {
                // A smaller size is that of an older plugin; a larger one would promise memory that is not there.
                struct_size: match draw.u8() {
                    255 => draw.u32() % (size_of::<abi::NodeType>() as u32 + 1),
                    254 => abi::NodeType::FIRST_SIZE as u32,
                    _ => size_of::<abi::NodeType>() as u32,
                },
                kind: flags(draw) % 5,
                flags: flags(draw),
                name: text(draw),
                family: text(draw),
                doc: text(draw),
                inputs,
                inputs_len,
                outputs,
                outputs_len,
                params,
                params_len,
                open: (has & 1 == 0).then_some(open),
                process: (has & 2 == 0).then_some(process),
                close: (has & 4 == 0).then_some(close),
                ..blank
            }
        })
        .collect();
    let mut pointers: Vec<*const abi::NodeType> = nodes.iter().map(std::ptr::from_ref).collect();
    if draw.u8() == 255 {
        pointers.push(std::ptr::null());
    }
    let (node_types, node_types_len) = list(draw, &pointers);
    // SAFETY: as for the node types.
    let blank: abi::Plugin = unsafe { std::mem::zeroed() };
    let plugin = abi::Plugin {
        magic: if draw.u8() == 255 { draw.u64() } else { abi::MAGIC },
        abi_major: if draw.u8() == 255 { draw.u32() } else { abi::ABI_MAJOR },
        abi_minor: abi::ABI_MINOR,
        struct_size: if draw.u8() == 255 { draw.u32() } else { size_of::<abi::Plugin>() as u32 },
        name: text(draw),
        version: text(draw),
        doc: text(draw),
        node_types,
        node_types_len,
        ..blank
    };
    // SAFETY: every pointer is null, misaligned, or points to memory above that lives until the end of this function. Lengths beyond that memory are
    // beyond the limits of the reader, which refuses them before it follows the pointer.
    let found = unsafe { from_abi::node_types(&raw const plugin) };
    match found {
        Ok(types) => {
            assert_eq!(types.len(), node_types_len);
            for found in &types {
                assert!(!found.name.is_empty() && (found.source || !found.inputs.is_empty()));
                let mut names: Vec<&str> = found.params.iter().map(|param| param.name.as_str()).collect();
                names.sort_unstable();
                assert!(names.windows(2).all(|pair| pair[0] != pair[1]), "{names:?}");
                let json = serde_json::to_string(found).expect("a node type is JSON");
                let back: panoscope_graph::NodeType = serde_json::from_str(&json).expect("its own JSON");
                assert_eq!(serde_json::to_string(&back).expect("a node type is JSON"), json);
            }
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

pub fn seeds() -> Vec<Vec<u8>> {
    // No choices and floats; one input `in`, one output `out`, no parameter; one node.
    let text = |text: &str| [&[0, text.len() as u8], text.as_bytes()].concat();
    let port = |name: &str| [text(name), text("a port"), vec![0], vec![0; 8], vec![2, 0]].concat();
    let node = [vec![0, 0, 0, 0, 0, 0, 0], text("blur"), text("filter"), text("Blurs.")].concat();
    let tail = [vec![0, 0, 0, 0, 0], text("filters"), text("0.1"), text("Filters.")].concat();
    let plain = [vec![0, 0, 1], port("input"), vec![1], port("output"), vec![0, 1], node, tail].concat();
    let mut many = plain.clone();
    many.extend((0..200u8).map(|n| n.wrapping_mul(37)));
    vec![plain, many, vec![0; 40], vec![255; 60], (0..=255).collect()]
}
