//! Inputs and outputs of a model, read from its file without ONNX Runtime.

use std::collections::HashSet;
use std::fmt;
use std::ops::Range;

use super::{Field, Malformed, Reader};

/// An input or output of a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Declared {
    /// Name in the model.
    pub name: String,
    /// Type of its elements, as in `f32`; `None` where it is not a tensor.
    pub element: Option<&'static str>,
    /// Size per axis; `None` for an axis of any length.
    pub dims: Vec<Option<u64>>,
}

impl fmt::Display for Declared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(element) = self.element else { return write!(f, "not a tensor") };
        let dims: Vec<String> = self.dims.iter().map(|dim| dim.map_or("?".to_owned(), |n| n.to_string())).collect();
        write!(f, "{element} {}", if dims.is_empty() { "number".to_owned() } else { dims.join("x") })
    }
}

/// Inputs, outputs and metadata of a model.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Signature {
    /// Inputs without those that hold weights.
    pub inputs: Vec<Declared>,
    /// Outputs.
    pub outputs: Vec<Declared>,
    /// Keys and texts that the exporter wrote.
    pub metadata: Vec<(String, String)>,
    /// Version of ONNX's own operators.
    pub opset: Option<u64>,
}

/// Name of an element type by its number in `TensorProto.DataType`.
fn element_name(number: u64) -> &'static str {
    const NAMES: [&str; 17] = [
        "undefined",
        "f32",
        "u8",
        "i8",
        "u16",
        "i16",
        "i32",
        "i64",
        "text",
        "bool",
        "f16",
        "f64",
        "u32",
        "u64",
        "complex64",
        "complex128",
        "bf16",
    ];
    usize::try_from(number).ok().and_then(|index| NAMES.get(index)).unwrap_or(&"unknown")
}

impl Reader<'_> {
    /// The fields of a message, up to the first malformed one.
    fn fields(&self, range: Range<usize>) -> impl Iterator<Item = Result<Field, Malformed>> {
        let mut at = range.start;
        std::iter::from_fn(move || {
            let field = (at < range.end).then(|| self.field(&mut at, range.end))?;
            if field.is_err() {
                at = range.end;
            }
            Some(field)
        })
    }

    fn text(&self, range: Range<usize>) -> String {
        String::from_utf8_lossy(&self.data[range]).into_owned()
    }

    /// The bytes of the first field `number` in `range`.
    fn part(&self, range: Range<usize>, number: u64) -> Result<Option<Range<usize>>, Malformed> {
        for field in self.fields(range) {
            match field? {
                Field { number: found, bytes: Some(bytes), .. } if found == number => return Ok(Some(bytes)),
                _ => {}
            }
        }
        Ok(None)
    }

    /// The first field `number` in `range` that is a number.
    fn number(&self, range: Range<usize>, number: u64) -> Result<Option<u64>, Malformed> {
        for field in self.fields(range) {
            match field? {
                Field { number: found, bytes: None, value } if found == number => return Ok(Some(value)),
                _ => {}
            }
        }
        Ok(None)
    }

    fn declared(&self, range: Range<usize>) -> Result<Declared, Malformed> {
        let name = self.part(range.clone(), 1)?.map(|name| self.text(name)).unwrap_or_default();
        let mut declared = Declared { name, element: None, dims: Vec::new() };
        let Some(kind) = self.part(range, 2)? else { return Ok(declared) };
        let Some(tensor) = self.part(kind, 1)? else { return Ok(declared) };
        declared.element = Some(element_name(self.number(tensor.clone(), 1)?.unwrap_or(0)));
        let Some(shape) = self.part(tensor, 2)? else { return Ok(declared) };
        for dim in self.fields(shape) {
            if let Field { number: 1, bytes: Some(bytes), .. } = dim? {
                // Negative lengths stand for any in some exports.
                declared.dims.push(self.number(bytes, 1)?.filter(|n| i64::try_from(*n).is_ok()));
            }
        }
        Ok(declared)
    }
}

/// Reads inputs, outputs and metadata of a model.
///
/// # Errors
/// The bytes are not a complete ONNX file.
pub fn signature(model: &[u8]) -> Result<Signature, Malformed> {
    let reader = Reader::new(model);
    let mut out = Signature::default();
    let mut graph = None;
    for field in reader.fields(0..model.len()) {
        let Field { number, bytes: Some(bytes), .. } = field? else { continue };
        match number {
            7 => graph = Some(bytes),
            // Operators of ONNX itself have no domain.
            8 if reader.part(bytes.clone(), 1)?.is_none_or(|domain| domain.is_empty()) => {
                out.opset = reader.number(bytes, 2)?;
            }
            14 => {
                let text = |number| Ok(reader.part(bytes.clone(), number)?.map(|text| reader.text(text)));
                out.metadata.push((text(1)?.unwrap_or_default(), text(2)?.unwrap_or_default()));
            }
            _ => {}
        }
    }
    let Some(graph) = graph else { return Err(Malformed { reason: "it has no graph", offset: model.len() }) };
    let mut weights = HashSet::new();
    for field in reader.fields(graph) {
        let Field { number, bytes: Some(bytes), .. } = field? else { continue };
        match number {
            5 => weights.extend(reader.part(bytes, 8)?.map(|name| reader.text(name))),
            11 => out.inputs.push(reader.declared(bytes)?),
            12 => out.outputs.push(reader.declared(bytes)?),
            _ => {}
        }
    }
    out.inputs.retain(|input| !weights.contains(&input.name));
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::super::tests::field;
    use super::*;

    fn varint_field(number: u64, value: u64) -> Vec<u8> {
        assert!(number < 16 && value < 128);
        vec![(number << 3) as u8, value as u8]
    }

    /// Name, element type and shape; 0 for an axis of any length.
    fn value(name: &str, element: u64, dims: &[u64]) -> Vec<u8> {
        let dim = |&n: &u64| if n == 0 { field(1, &field(2, b"any")) } else { field(1, &varint_field(1, n)) };
        let shape: Vec<u8> = dims.iter().flat_map(dim).collect();
        let tensor = [varint_field(1, element), field(2, &shape)].concat();
        [field(1, name.as_bytes()), field(2, &field(1, &tensor))].concat()
    }

    #[test]
    fn inputs_outputs_and_metadata_are_read() {
        let graph = [
            field(5, &field(8, b"weights")),
            field(11, &value("image", 10, &[1, 3, 0, 0])),
            field(11, &value("weights", 1, &[7])),
            field(12, &value("map", 1, &[1, 1, 96, 64])),
            field(12, &[field(1, b"list"), field(2, &field(4, b""))].concat()),
        ]
        .concat();
        let entry = [field(1, b"task"), field(2, b"detect")].concat();
        let opset = varint_field(2, 17);
        let model = [field(7, &graph), field(8, &opset), field(14, &entry)].concat();
        let read = signature(&model).unwrap();
        let texts: Vec<String> = read.inputs.iter().chain(&read.outputs).map(|d| format!("{} {d}", d.name)).collect();
        assert_eq!(texts, ["image f16 1x3x?x?", "map f32 1x1x96x64", "list not a tensor"]);
        assert_eq!(read.metadata, [("task".to_owned(), "detect".to_owned())]);
        assert_eq!(read.opset, Some(17));
        for cut in 0..model.len() {
            // No part of a model panics.
            let _ = signature(&model[..cut]);
        }
        assert_eq!(signature(b"").unwrap_err().reason, "it has no graph");
    }
}
