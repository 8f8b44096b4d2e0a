//! Node classes as descriptors of the plugin interface. They live until the process ends, as those of a library do.

use panoscope_abi::{self as abi, NodeType, Param, Port, Str};
use panoscope_node::Packet;
use pyo3::prelude::*;
use pyo3::types::PyAny;

use crate::{classes, instance};

fn leak(text: String) -> Str {
    Str::new(Box::leak(text.into_boxed_str()))
}

fn text(of: &Bound<'_, PyAny>, name: &str) -> PyResult<Str> {
    Ok(leak(of.getattr(name)?.extract()?))
}

fn list<T>(
    of: &Bound<'_, PyAny>,
    name: &str,
    read: impl Fn(&Bound<'_, PyAny>) -> PyResult<T>,
) -> PyResult<&'static [T]> {
    let values: Vec<T> = of.getattr(name)?.try_iter()?.map(|value| read(&value?)).collect::<PyResult<_>>()?;
    Ok(Box::leak(values.into_boxed_slice()))
}

/// The descriptor of a `panoscope.nodes.NodeType`.
pub fn node_type(of: &Bound<'_, PyAny>) -> PyResult<&'static NodeType> {
    let flag = |name: &str, bit: u32| -> PyResult<u32> { Ok(if of.getattr(name)?.is_truthy()? { bit } else { 0 }) };
    let inputs = list(of, "inputs", port)?;
    let outputs = list(of, "outputs", port)?;
    let params = list(of, "params", param)?;
    let class = of.getattr("cls")?;
    let has_state = class.hasattr("save_state")? && class.hasattr("load_state")?;
    let descriptor: &'static NodeType = Box::leak(Box::new(NodeType {
        struct_size: size_of::<NodeType>() as u32,
        kind: of.getattr("kind")?.extract()?,
        flags: flag("is_source", abi::NODE_SOURCE)? | flag("has_side_effects", abi::NODE_SIDE_EFFECTS)?,
        reserved: 0,
        name: text(of, "name")?,
        family: text(of, "family")?,
        doc: text(of, "doc")?,
        inputs: inputs.as_ptr(),
        inputs_len: inputs.len(),
        outputs: outputs.as_ptr(),
        outputs_len: outputs.len(),
        params: params.as_ptr(),
        params_len: params.len(),
        open: Some(instance::open),
        process: Some(instance::process),
        close: Some(instance::close),
        save_state: has_state.then_some(instance::save_state),
        load_state: has_state.then_some(instance::load_state),
        validate: None,
        finish: None,
    }));
    classes::remember(descriptor, of);
    Ok(descriptor)
}

fn port(of: &Bound<'_, PyAny>) -> PyResult<Port> {
    let kind = of.getattr("kind")?;
    let packet: String = kind.getattr("packet")?.extract()?;
    Ok(Port {
        name: text(of, "name")?,
        doc: text(of, "doc")?,
        layout_hash: layout_hash(&packet),
        packet: leak(packet),
        formats: kind.getattr("formats")?.extract()?,
        flags: of.getattr("flags")?.extract()?,
    })
}

/// Hash of the layout of a packet type; 0 for those without a fixed one.
fn layout_hash(packet: &str) -> u64 {
    fn of<P: Packet>() -> (&'static str, u64) {
        (P::NAME, P::LAYOUT_HASH)
    }
    let known = [
        of::<abi::Homography>(),
        of::<abi::Roi>(),
        of::<abi::Calibration>(),
        of::<abi::Tip>(),
        of::<abi::Pose>(),
        of::<abi::Joints>(),
        of::<abi::Scalar>(),
    ];
    known.into_iter().find(|(name, _)| *name == packet).map_or(0, |(_, hash)| hash)
}

fn param(of: &Bound<'_, PyAny>) -> PyResult<Param> {
    let number = |name: &str| -> PyResult<f64> { of.getattr(name)?.extract() };
    let choices = list(of, "choices", |choice| Ok(leak(choice.extract()?)))?;
    let floats: &'static [f64] = list(of, "default_floats", |value| value.extract())?;
    Ok(Param {
        name: text(of, "name")?,
        doc: text(of, "doc")?,
        unit: text(of, "unit")?,
        kind: of.getattr("kind")?.extract()?,
        flags: of.getattr("flags")?.extract()?,
        default_number: number("default_number")?,
        min: number("min")?,
        max: number("max")?,
        step: number("step")?,
        default_text: text(of, "default_text")?,
        choices: choices.as_ptr(),
        choices_len: choices.len(),
        default_floats: floats.as_ptr(),
        default_floats_len: floats.len(),
    })
}
