//! A look into an ONNX file before ONNX Runtime sees it: what it would read outside itself, how deep it nests.
//!
//! An ONNX file may name other files for its weights. Only files in the model's own folder are accepted. Field numbers are those of
//! `onnx.proto3`.

use std::path::{Component, Path, PathBuf};

/// Depth of nested graphs; deeper files are attacks on the reader.
const MAX_DEPTH: usize = 16;
/// Kinds of protobuf messages in an ONNX file.
const MAX_BYTES: u64 = 2 << 30;

/// Why a model file is refused.
#[derive(Debug, thiserror::Error)]
pub enum OnnxFileError {
    /// The file cannot be read.
    #[error("cannot read the model {path}: {source}; name an .onnx file with `model`", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Too large for the format.
    #[error("{path} has {bytes} bytes, an ONNX file has at most {MAX_BYTES}", path = path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its length, bytes.
        bytes: u64,
    },
    /// Not an ONNX file, or cut off.
    #[error("{path} is no whole ONNX file: {reason} at byte {offset}; copy or export it again", path = path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: &'static str,
        /// Position in the file, bytes.
        offset: usize,
    },
    /// Weights outside the model's folder.
    #[error("{path} reads its weights from `{location}`, which is not in its own folder: refused", path = path.display())]
    Outside {
        /// The file.
        path: PathBuf,
        /// The file that it names.
        location: String,
    },
    /// A missing file of weights.
    #[error("{path} keeps its weights in `{location}`, which is not beside it: copy both files", path = path.display())]
    MissingWeights {
        /// The file.
        path: PathBuf,
        /// The file that it names.
        location: String,
    },
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
    /// Kind of the message in a length-delimited field, where it matters.
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

type Fault = (&'static str, usize);

struct MessageReader<'a> {
    data: &'a [u8],
    locations: Vec<String>,
    has_graph: bool,
}

impl MessageReader<'_> {
    fn varint(&self, at: &mut usize, end: usize) -> Result<u64, Fault> {
        let (mut value, mut shift) = (0u64, 0);
        loop {
            if *at >= end {
                return Err(("it ends inside a number", *at));
            }
            let byte = self.data[*at];
            *at += 1;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
            shift += 7;
            if shift > 63 {
                return Err(("a number has too many bytes", *at));
            }
        }
    }

    fn message(&mut self, kind: Message, start: usize, end: usize, depth: usize) -> Result<(), Fault> {
        if depth > 4 * MAX_DEPTH {
            return Err(("graphs stand in graphs more than 16 deep", start));
        }
        let mut at = start;
        let (mut key, mut value) = (0..0, 0..0);
        while at < end {
            let tag = self.varint(&mut at, end)?;
            let field = tag >> 3;
            match tag & 7 {
                0 => drop(self.varint(&mut at, end)?),
                1 => at += 8,
                5 => at += 4,
                2 => {
                    let length = usize::try_from(self.varint(&mut at, end)?).unwrap_or(usize::MAX);
                    let Some(stop) = at.checked_add(length).filter(|&s| s <= end) else {
                        return Err(("a part reaches past the end", at));
                    };
                    self.has_graph |= kind == Message::Model && field == 7;
                    if let Some(child) = kind.child(field) {
                        self.message(child, at, stop, depth + 1)?;
                    }
                    if kind == Message::Entry {
                        match field {
                            1 => key = at..stop,
                            2 => value = at..stop,
                            _ => {}
                        }
                    }
                    at = stop;
                }
                _ => return Err(("an unknown kind of field", at)),
            }
            if at > end {
                return Err(("a number reaches past the end", at));
            }
        }
        if kind == Message::Entry && &self.data[key] == b"location" {
            self.locations.push(String::from_utf8_lossy(&self.data[value]).into_owned());
        }
        Ok(())
    }
}

/// A checked model file.
#[derive(Debug)]
pub struct OnnxFile {
    /// The whole file.
    pub bytes: Vec<u8>,
    /// Whether part of its weights is in files beside it.
    pub has_weights_beside: bool,
}

/// Reads and checks the file. Refuses it when it names files outside its folder.
pub fn read(path: &Path) -> Result<OnnxFile, OnnxFileError> {
    let failed = |source| OnnxFileError::Read { path: path.to_owned(), source };
    let about = std::fs::metadata(path).map_err(failed)?;
    // A device or a pipe has no length, and reading it need not end.
    if !about.is_file() {
        return Err(failed(std::io::Error::other("it is not a regular file")));
    }
    let bytes = about.len();
    if bytes > MAX_BYTES {
        return Err(OnnxFileError::TooLarge { path: path.to_owned(), bytes });
    }
    let data = std::fs::read(path).map_err(failed)?;
    let mut walk = MessageReader { data: &data, locations: Vec::new(), has_graph: false };
    let malformed = |reason, offset| OnnxFileError::Malformed { path: path.to_owned(), reason, offset };
    walk.message(Message::Model, 0, data.len(), 0).map_err(|(reason, offset)| malformed(reason, offset))?;
    if !walk.has_graph {
        return Err(malformed("it holds no graph", data.len()));
    }
    walk.locations.sort();
    walk.locations.dedup();
    let has_weights_beside = !walk.locations.is_empty();
    for location in walk.locations {
        let folder = path.parent().unwrap_or(Path::new(""));
        let inside =
            !location.is_empty() && Path::new(&location).components().all(|c| matches!(c, Component::Normal(_)));
        if !inside {
            return Err(OnnxFileError::Outside { path: path.to_owned(), location });
        }
        // Links count by where they lead.
        let (Ok(real), Ok(home)) = (folder.join(&location).canonicalize(), path.canonicalize()) else {
            return Err(OnnxFileError::MissingWeights { path: path.to_owned(), location });
        };
        if !home.parent().is_some_and(|home| real.starts_with(home)) {
            return Err(OnnxFileError::Outside { path: path.to_owned(), location });
        }
    }
    Ok(OnnxFile { bytes: data, has_weights_beside })
}
