//! A model in ONNX Runtime: opened with care, run on one picture.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ort::environment::Environment;
use ort::session::Session;
use ort::session::builder::SessionBuilder;
use ort::value::{Outlet, TensorElementType, TensorRef};

use crate::onnx_file::{self, OnnxFile, OnnxFileError};
use crate::provider::Provider;
use crate::runtime_library::{self, LibraryError};

/// Why a model does not serve.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// No ONNX Runtime.
    #[error(transparent)]
    Library(#[from] LibraryError),
    /// The file itself.
    #[error(transparent)]
    File(#[from] OnnxFileError),
    /// ONNX Runtime refused it.
    #[error("ONNX Runtime cannot open {path}: {reason}", path = path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Its message.
        reason: String,
    },
    /// Its input is no picture.
    #[error("{path} wants {found}, expected one picture: f32 1x3xHxW", path = path.display())]
    Input {
        /// The file.
        path: PathBuf,
        /// Its inputs.
        found: String,
    },
    /// It has no fixed input size and none was given.
    #[error("{path} takes pictures of any size ({found}): say which with `input_width` and `input_height`", path = path.display())]
    Size {
        /// The file.
        path: PathBuf,
        /// Its inputs.
        found: String,
    },
    /// A run failed.
    #[error("{path} failed: {reason}", path = path.display())]
    Run {
        /// The file.
        path: PathBuf,
        /// ONNX Runtime's message.
        reason: String,
    },
}

/// One output of one run.
pub struct Tensor<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its values.
    pub data: Values<'a>,
}

/// Numbers of an output.
#[derive(Clone, Copy)]
pub enum Values<'a> {
    /// Most outputs.
    Float(&'a [f32]),
    /// Class numbers.
    Int(&'a [i64]),
    /// Anything else.
    Other,
}

impl<'a> Values<'a> {
    /// The numbers, where they are f32.
    pub fn floats(self) -> Option<&'a [f32]> {
        if let Self::Float(values) = self { Some(values) } else { None }
    }
}

/// An opened model.
pub struct Model {
    session: Session,
    path: PathBuf,
    input_name: String,
    /// Rank of the input: 3 (torchvision's detectors) or 4 (all others).
    rank: usize,
    width: usize,
    height: usize,
    metadata: BTreeMap<String, String>,
    refused: Option<String>,
}

fn describe(outlets: &[Outlet]) -> String {
    let one = |o: &Outlet| match o.dtype().tensor_shape() {
        Some(shape) => {
            let dims: Vec<String> = shape.iter().map(|&d| if d < 0 { "?".into() } else { d.to_string() }).collect();
            let kind = o.dtype().tensor_type().map_or("?".into(), |t| t.to_string());
            format!("`{}` {kind} {}", o.name(), dims.join("x"))
        }
        None => format!("`{}`, no tensor", o.name()),
    };
    if outlets.is_empty() { "nothing".into() } else { outlets.iter().map(one).collect::<Vec<_>>().join(", ") }
}

/// A session on `provider`; else ONNX Runtime's message.
fn session_of(
    environment: &Environment,
    path: &Path,
    file: &OnnxFile,
    threads: usize,
    provider: Provider,
) -> Result<Session, String> {
    let text = |e: ort::Error<SessionBuilder>| e.to_string();
    let mut builder = Session::builder(environment).map_err(|e| e.to_string())?;
    provider.register(&mut builder)?;
    let builder = builder.with_intra_threads(threads.max(1)).map_err(text)?;
    let builder = builder.with_inter_threads(1).map_err(text)?;
    // What went wrong comes back as an error; a second line on the terminal would only cover the progress.
    let builder = builder.with_log_level(ort::logging::LogLevel::Fatal).map_err(text)?;
    // Threads spin while the network runs (waking them between its hundred steps would cost as much as the steps) and stop with its end: a
    // waiting thread that keeps spinning takes the core from the next node.
    let builder = builder.with_intra_op_spinning(true).map_err(text)?;
    let builder = builder.with_config_entry("session.force_spinning_stop", "1").map_err(text)?;
    let mut builder = builder.with_inter_op_spinning(false).map_err(text)?;
    for (name, bytes) in &file.weights {
        builder = builder.with_external_initializer_file_in_memory(name, bytes.clone()).map_err(text)?;
    }
    // From what was looked through; only weights beside the model need its path.
    let session =
        if file.has_weights_beside { builder.commit_from_file(path) } else { builder.commit_from_memory(&file.bytes) };
    session.map_err(|e| e.to_string())
}

impl Model {
    /// Opens a file. `size` is used where the model accepts any size; 0 takes the model's. Where `provider` cannot run it the processor does:
    /// see [`Model::refused`].
    pub fn open(path: &Path, threads: usize, size: (usize, usize), provider: Provider) -> Result<Self, ModelError> {
        let environment = runtime_library::environment()?;
        let file = onnx_file::read(path)?;
        let session_on = |provider| session_of(environment, path, &file, threads, provider);
        let (session, refused) = match session_on(provider) {
            Err(reason) if provider != Provider::Cpu => (session_on(Provider::Cpu), Some(first_line(&reason))),
            opened => (opened, None),
        };
        let session = session.map_err(|e| ModelError::Open { path: path.to_owned(), reason: first_line(&e) })?;
        let found = describe(session.inputs());
        let input_error = || ModelError::Input { path: path.to_owned(), found: found.clone() };
        let [input] = session.inputs() else { return Err(input_error()) };
        let (Some(shape), Some(TensorElementType::Float32)) =
            (input.dtype().tensor_shape(), input.dtype().tensor_type())
        else {
            return Err(input_error());
        };
        let dims: Vec<i64> = shape.iter().copied().collect();
        let (channels, h, w) = match dims[..] {
            [n, c, h, w] if n == 1 || n < 0 => (c, h, w),
            [c, h, w] => (c, h, w),
            _ => return Err(input_error()),
        };
        if channels != 3 && channels >= 0 {
            return Err(input_error());
        }
        let pick = |model: i64, asked: usize| if model > 0 { model as usize } else { asked };
        let (width, height) = (pick(w, size.0), pick(h, size.1));
        if width == 0 || height == 0 {
            return Err(ModelError::Size { path: path.to_owned(), found });
        }
        if width.max(height) > 8192 {
            return Err(input_error());
        }
        let (rank, input_name) = (dims.len(), input.name().to_owned());
        let mut metadata = BTreeMap::new();
        if let Ok(held) = session.metadata() {
            for key in held.custom_keys().unwrap_or_default() {
                if let Some(value) = held.custom(&key) {
                    metadata.insert(key, value);
                }
            }
        }
        Ok(Self { session, path: path.to_owned(), input_name, rank, width, height, metadata, refused })
    }

    /// Why the provider that was asked for does not run the network, where the processor runs it instead.
    pub fn refused(&self) -> Option<&str> {
        self.refused.as_deref()
    }

    /// Width and height in px of the network's picture.
    pub fn input_size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Whether the input has no batch dimension, as torchvision exports detectors.
    pub fn without_batch(&self) -> bool {
        self.rank == 3
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A custom key of the file.
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.metadata.get(key).map(String::as_str)
    }

    /// Runs the network on a planar picture of `input_size` and hands its outputs to `read`.
    pub fn run<T>(&mut self, picture: &[f32], read: impl FnOnce(&[Tensor<'_>]) -> T) -> Result<T, ModelError> {
        let (path, failed) = (&self.path, |e: ort::Error, path: &Path| ModelError::Run {
            path: path.to_owned(),
            reason: first_line(&e.to_string()),
        });
        let (h, w) = (self.height as i64, self.width as i64);
        let shape = if self.rank == 3 { vec![3, h, w] } else { vec![1, 3, h, w] };
        let input = TensorRef::from_array_view((shape, picture)).map_err(|e| failed(e, path))?;
        let outputs = self.session.run(ort::inputs![self.input_name.as_str() => input]).map_err(|e| failed(e, path))?;
        let tensors: Vec<Tensor<'_>> = outputs
            .keys()
            .filter_map(|name| {
                let value = outputs.get(name)?;
                let dims = |shape: &ort::value::Shape| shape.iter().map(|&d| d.max(0) as usize).collect::<Vec<_>>();
                Some(if let Ok((shape, data)) = value.try_extract_tensor::<f32>() {
                    Tensor { name, shape: dims(shape), data: Values::Float(data) }
                } else if let Ok((shape, data)) = value.try_extract_tensor::<i64>() {
                    Tensor { name, shape: dims(shape), data: Values::Int(data) }
                } else {
                    Tensor { name, shape: Vec::new(), data: Values::Other }
                })
            })
            .collect();
        Ok(read(&tensors))
    }
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or("").chars().take(300).collect()
}
