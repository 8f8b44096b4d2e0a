//! Facts about ONNX that need no ONNX Runtime: which other files hold the weights of a model, and where the runtime's
//! library is.
//!
//! Field numbers are those of `onnx.proto3`.

pub mod signature;
pub mod work;

use std::ffi::OsStr;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Name by which the dynamic linker knows a loaded ONNX Runtime of any 1.x version.
pub const RUNTIME_SONAME: &str = "libonnxruntime.so.1";

/// Environment variable that names ONNX Runtime's library.
pub const RUNTIME_VARIABLE: &str = "ORT_DYLIB_PATH";

/// Maximum depth of nested graphs; deeper files are treated as hostile.
const MAX_DEPTH: usize = 16;

/// Field of a model that holds one file of weights, after all fields of ONNX. Readers of ONNX skip fields that they do
/// not know.
const BUNDLED: u64 = 52_001;

/// Bytes that are not a complete ONNX file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{reason} at byte {offset}")]
pub struct Malformed {
    /// Description of the problem.
    pub reason: &'static str,
    /// Position in the file, bytes.
    pub offset: usize,
}

#[derive(Clone, Copy, PartialEq)]
enum Message {
    Model,
    Graph,
    Node,
    Attribute,
    Tensor,
    SparseTensor,
    Entry,
    Function,
    Training,
}

impl Message {
    /// Message type of a length-delimited field; `None` where its content is not read.
    fn child(self, field: u64) -> Option<Self> {
        Some(match (self, field) {
            (Self::Model, 7) => Self::Graph,
            (Self::Model, 20) => Self::Training,
            (Self::Model, 25) => Self::Function,
            (Self::Training, 1 | 2) => Self::Graph,
            (Self::Graph, 1) | (Self::Function, 7) => Self::Node,
            (Self::Graph, 5) => Self::Tensor,
            (Self::Graph, 15) => Self::SparseTensor,
            (Self::Function, 11) | (Self::Node, 5) => Self::Attribute,
            (Self::Attribute, 5 | 10) => Self::Tensor,
            (Self::Attribute, 6 | 11) => Self::Graph,
            (Self::Attribute, 22 | 23) => Self::SparseTensor,
            (Self::SparseTensor, 1 | 2) => Self::Tensor,
            (Self::Tensor, 13) => Self::Entry,
            _ => return None,
        })
    }
}

/// One field of a message: its number and either its bytes (length-delimited) or its numeric value.
struct Field {
    number: u64,
    bytes: Option<Range<usize>>,
    value: u64,
}

struct Reader<'a> {
    data: &'a [u8],
    locations: Vec<String>,
    has_graph: bool,
}

impl<'a> Reader<'a> {
    fn new(data: &'a [u8]) -> Self {
        Self { data, locations: Vec::new(), has_graph: false }
    }

    fn varint(&self, at: &mut usize, end: usize) -> Result<u64, Malformed> {
        let (mut value, mut shift) = (0u64, 0);
        loop {
            if *at >= end {
                return Err(Malformed { reason: "it ends within a number", offset: *at });
            }
            let byte = self.data[*at];
            *at += 1;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
            shift += 7;
            if shift > 63 {
                return Err(Malformed { reason: "a number has too many bytes", offset: *at });
            }
        }
    }

    /// Reads the field at `at` and moves `at` past it.
    fn field(&self, at: &mut usize, end: usize) -> Result<Field, Malformed> {
        let tag = self.varint(at, end)?;
        let number = tag >> 3;
        let (mut bytes, mut value) = (None, 0);
        match tag & 7 {
            0 => value = self.varint(at, end)?,
            1 => *at += 8,
            5 => *at += 4,
            2 => {
                let length = usize::try_from(self.varint(at, end)?).unwrap_or(usize::MAX);
                let Some(stop) = at.checked_add(length).filter(|&s| s <= end) else {
                    return Err(Malformed { reason: "a part reaches past the end", offset: *at });
                };
                bytes = Some(*at..stop);
                *at = stop;
            }
            _ => return Err(Malformed { reason: "an unknown kind of field", offset: *at }),
        }
        if *at > end {
            return Err(Malformed { reason: "a number reaches past the end", offset: *at });
        }
        Ok(Field { number, bytes, value })
    }

    fn message(&mut self, kind: Message, range: Range<usize>, depth: usize) -> Result<(), Malformed> {
        if depth > 4 * MAX_DEPTH {
            return Err(Malformed { reason: "graphs are nested more than 16 levels deep", offset: range.start });
        }
        let mut at = range.start;
        let (mut key, mut value) = (0..0, 0..0);
        while at < range.end {
            let Field { number, bytes: Some(bytes), .. } = self.field(&mut at, range.end)? else { continue };
            self.has_graph |= kind == Message::Model && number == 7;
            if let Some(child) = kind.child(number) {
                self.message(child, bytes.clone(), depth + 1)?;
            }
            if kind == Message::Entry {
                match number {
                    1 => key = bytes,
                    2 => value = bytes,
                    _ => {}
                }
            }
        }
        if kind == Message::Entry && &self.data[key] == b"location" {
            self.locations.push(String::from_utf8_lossy(&self.data[value]).into_owned());
        }
        Ok(())
    }
}

/// Names of the files that hold weights of a model, as the model gives them: relative to its folder, sorted, each once.
///
/// # Errors
/// The bytes are not a complete ONNX file.
pub fn weight_files(model: &[u8]) -> Result<Vec<String>, Malformed> {
    let mut reader = Reader::new(model);
    reader.message(Message::Model, 0..model.len(), 0)?;
    if !reader.has_graph {
        return Err(Malformed { reason: "it has no graph", offset: model.len() });
    }
    reader.locations.sort();
    reader.locations.dedup();
    Ok(reader.locations)
}

fn push_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Header in front of the `len` bytes of the weight file `name` that is appended to its model. [`unbundle`] reads the
/// result.
pub fn bundle_header(name: &str, len: u64) -> Vec<u8> {
    let mut inner = Vec::new();
    push_varint(&mut inner, 1 << 3 | 2);
    push_varint(&mut inner, name.len() as u64);
    inner.extend_from_slice(name.as_bytes());
    push_varint(&mut inner, 2 << 3 | 2);
    push_varint(&mut inner, len);
    let mut out = Vec::new();
    push_varint(&mut out, BUNDLED << 3 | 2);
    push_varint(&mut out, inner.len() as u64 + len);
    out.extend_from_slice(&inner);
    out
}

/// A model with the files of its weights in one file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bundle {
    /// Length of the model itself; the weights follow it.
    pub model_len: usize,
    /// Name and bytes of each file of weights, in the order of the file.
    pub weights: Vec<(String, Range<usize>)>,
}

/// Finds the weight files that were appended to a model. A plain model has none.
///
/// # Errors
/// The bytes are not a complete sequence of fields.
pub fn unbundle(bytes: &[u8]) -> Result<Bundle, Malformed> {
    let reader = Reader::new(bytes);
    let mut bundle = Bundle { model_len: bytes.len(), weights: Vec::new() };
    let mut at = 0;
    while at < bytes.len() {
        let before = at;
        let field = reader.field(&mut at, bytes.len())?;
        let Some(inner) = field.bytes.filter(|_| field.number == BUNDLED) else {
            if !bundle.weights.is_empty() {
                return Err(Malformed { reason: "the model has fields after its weights", offset: before });
            }
            continue;
        };
        if bundle.weights.is_empty() {
            bundle.model_len = before;
        }
        let (mut name, mut content, mut inside) = (None, None, inner.start);
        while inside < inner.end {
            match reader.field(&mut inside, inner.end)? {
                Field { number: 1, bytes: Some(range), .. } => name = std::str::from_utf8(&bytes[range]).ok(),
                Field { number: 2, bytes: Some(range), .. } => content = Some(range),
                _ => {}
            }
        }
        let (Some(name), Some(content)) = (name, content) else {
            return Err(Malformed { reason: "a file of weights has no name or no bytes", offset: before });
        };
        bundle.weights.push((name.to_owned(), content));
    }
    Ok(bundle)
}

/// Files in `folder` that are named like ONNX Runtime's library, sorted, without symbolic links.
fn runtimes_in(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let named = |name: &OsStr| name.to_string_lossy().starts_with("libonnxruntime.so");
    let is_library = |p: &PathBuf| p.file_name().is_some_and(named) && !p.is_symlink();
    let mut found: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(is_library).collect();
    found.sort();
    found
}

/// Files to try as ONNX Runtime, in order: the variable's, or those next to the program and then the system's.
pub fn runtime_candidates() -> Vec<PathBuf> {
    if let Some(named) = std::env::var_os(RUNTIME_VARIABLE).filter(|p| !p.is_empty()) {
        return vec![named.into()];
    }
    let mut files = Vec::new();
    if let Some(program) = crate::program::file() {
        for folder in program.ancestors().skip(1).take(4) {
            files.extend(runtimes_in(&folder.join("onnxruntime")));
        }
    }
    files.push("libonnxruntime.so".into());
    files
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field with bytes.
    pub(super) fn field(number: u64, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        push_varint(&mut out, number << 3 | 2);
        push_varint(&mut out, bytes.len() as u64);
        out.extend_from_slice(bytes);
        out
    }

    /// A model with one tensor whose weights are in `location`.
    fn model(location: &str) -> Vec<u8> {
        let entry = [field(1, b"location"), field(2, location.as_bytes())].concat();
        field(7, &field(5, &field(13, &entry)))
    }

    #[test]
    fn files_of_weights_are_found() {
        assert_eq!(weight_files(&model("w.bin")).unwrap(), ["w.bin"]);
        assert_eq!(weight_files(&field(7, b"")).unwrap(), Vec::<String>::new());
        assert_eq!(weight_files(b"").unwrap_err().reason, "it has no graph");
        assert!(weight_files(&model("w.bin")[..5]).is_err());
    }

    #[test]
    fn a_bundle_gives_model_and_weights_back() {
        let plain = model("w.bin");
        let whole = unbundle(&plain).unwrap();
        assert_eq!((whole.model_len, whole.weights.len()), (plain.len(), 0));
        let mut bytes = plain.clone();
        for (name, content) in [("w.bin", &b"weights"[..]), ("empty.bin", b"")] {
            bytes.extend(bundle_header(name, content.len() as u64));
            bytes.extend_from_slice(content);
        }
        let bundle = unbundle(&bytes).unwrap();
        assert_eq!(bytes[..bundle.model_len], plain);
        let weights: Vec<(&str, &[u8])> =
            bundle.weights.iter().map(|(name, range)| (name.as_str(), &bytes[range.clone()])).collect();
        assert_eq!(weights, [("w.bin", &b"weights"[..]), ("empty.bin", b"")]);
        // Readers of ONNX skip the field.
        assert_eq!(weight_files(&bytes).unwrap(), ["w.bin"]);
        for cut in bundle.model_len + 1..bytes.len() {
            assert!(unbundle(&bytes[..cut]).is_err() || unbundle(&bytes[..cut]).unwrap().weights.len() < 2, "{cut}");
        }
        bytes.extend(field(7, b""));
        assert!(unbundle(&bytes).unwrap_err().reason.contains("after its weights"));
    }
}
