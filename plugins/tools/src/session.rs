//! A session of ONNX Runtime: checks the file, selects a provider, and passes tensors in and out as slices.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use half::f16;
use ort::environment::Environment;
use ort::session::{Session, SessionInputValue};
use ort::value::{DynValue, Outlet, PrimitiveTensorElementType, TensorElementType, TensorRef};

use crate::onnx_file::{self, OnnxFile, OnnxFileError};
use crate::provider::Provider;
use crate::runtime_library::{self, LibraryError};

/// Why a model cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum SessionError {
    /// ONNX Runtime cannot be used.
    #[error(transparent)]
    Library(#[from] LibraryError),
    /// The file cannot be used.
    #[error(transparent)]
    File(#[from] OnnxFileError),
    /// ONNX Runtime cannot open the file.
    #[error("ONNX Runtime cannot open {path}: {reason}", path = path.display(), reason = first_line(source))]
    Open { path: PathBuf, source: ort::Error },
    /// A run of the network failed.
    #[error("{path} failed in ONNX Runtime: {reason}", path = path.display(), reason = first_line(source))]
    Run { path: PathBuf, source: ort::Error },
}

/// An input or output as the model declares it.
#[derive(Clone, Debug, PartialEq)]
pub struct Declared {
    /// Its name.
    pub name: String,
    /// Type of its elements; `None` if it is not a tensor.
    pub element: Option<TensorElementType>,
    /// Its shape; -1 for an axis of any length.
    pub dims: Vec<i64>,
}

impl Declared {
    fn of(outlet: &Outlet) -> Self {
        let dims = outlet.dtype().tensor_shape().map(|shape| shape.iter().copied().collect());
        let element = outlet.dtype().tensor_type();
        Self { name: outlet.name().to_owned(), element, dims: dims.unwrap_or_default() }
    }
}

impl fmt::Display for Declared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.element {
            Some(element) => write!(f, "`{}` {element} {}", self.name, dims_text(&self.dims)),
            None => write!(f, "`{}`, not a tensor", self.name),
        }
    }
}

/// A shape as text for messages, as in `1x3x?x?`.
pub fn dims_text(dims: &[i64]) -> String {
    let one = |&dim: &i64| if dim < 0 { "?".to_owned() } else { dim.to_string() };
    if dims.is_empty() { "number".to_owned() } else { dims.iter().map(one).collect::<Vec<_>>().join("x") }
}

/// Several inputs or outputs as text for messages.
pub fn list_text<T: fmt::Display>(all: &[T]) -> String {
    if all.is_empty() { "nothing".into() } else { all.iter().map(T::to_string).collect::<Vec<_>>().join(", ") }
}

/// One output of one run.
#[derive(Clone)]
pub struct Tensor<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its values.
    pub data: Values<'a>,
}

impl fmt::Display for Tensor<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let dims: Vec<i64> = self.shape.iter().map(|&n| n as i64).collect();
        write!(f, "`{}` {}", self.name, dims_text(&dims))
    }
}

/// Values of an output. Other floats, small integers and booleans are read as f32, i32 as i64.
#[derive(Clone, Copy)]
pub enum Values<'a> {
    /// 32-bit floats.
    Float(&'a [f32]),
    /// Class numbers.
    Int(&'a [i64]),
    /// Anything else.
    Other,
}

impl<'a> Values<'a> {
    /// The values if they are floats.
    pub fn floats(self) -> Option<&'a [f32]> {
        if let Self::Float(values) = self { Some(values) } else { None }
    }
}

/// Values of an input.
#[derive(Clone, Copy, Debug)]
pub enum InputValues<'a> {
    /// 32-bit floats.
    F32(&'a [f32]),
    /// 16-bit floats.
    F16(&'a [f16]),
    /// Bytes.
    U8(&'a [u8]),
    /// Signed bytes.
    I8(&'a [i8]),
}

/// An input of one run.
pub struct RunInput<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its shape.
    pub dims: Vec<i64>,
    /// Values; as many as the shape has.
    pub values: InputValues<'a>,
}

/// Converted values of an output of another type than f32 and i64.
#[derive(Default)]
struct Widened {
    floats: Vec<f32>,
    ints: Vec<i64>,
}

/// An opened model.
pub struct ModelSession {
    session: Session,
    path: PathBuf,
    inputs: Vec<Declared>,
    outputs: Vec<Declared>,
    metadata: BTreeMap<String, String>,
    refused: Option<String>,
    widened: Vec<Widened>,
}

/// Builds a session on `provider`.
fn session_of(
    environment: &Environment,
    path: &Path,
    file: &OnnxFile,
    threads: usize,
    provider: Provider,
) -> ort::Result<Session> {
    let mut builder = Session::builder(environment)?;
    provider.register(&mut builder)?;
    let builder = builder.with_intra_threads(threads.max(1))?;
    let builder = builder.with_inter_threads(1)?;
    // What went wrong comes back as an error; a second line on the terminal would only cover the progress.
    let builder = builder.with_log_level(ort::logging::LogLevel::Fatal)?;
    // Threads spin while the network runs (waking them between its hundred steps would cost as much as the steps) and stop with its end: a
    // waiting thread that keeps spinning takes the core from the next node.
    let builder = builder.with_intra_op_spinning(true)?;
    let builder = builder.with_config_entry("session.force_spinning_stop", "1")?;
    let mut builder = builder.with_inter_op_spinning(false)?;
    for (name, bytes) in &file.weights {
        builder = builder.with_external_initializer_file_in_memory(name, bytes.clone())?;
    }
    // From what was looked through; only weights beside the model need its path.
    if file.has_weights_beside { builder.commit_from_file(path) } else { builder.commit_from_memory(&file.bytes) }
}

fn metadata_of(session: &Session) -> BTreeMap<String, String> {
    let mut metadata = BTreeMap::new();
    if let Ok(held) = session.metadata() {
        for key in held.custom_keys().unwrap_or_default() {
            if let Some(value) = held.custom(&key) {
                metadata.insert(key, value);
            }
        }
    }
    metadata
}

impl ModelSession {
    /// Opens a file. If `provider` cannot run it, the processor does; see [`Self::refused`].
    ///
    /// # Errors
    /// No ONNX Runtime, or a file that cannot be used.
    pub fn open(path: &Path, threads: usize, provider: Provider) -> Result<Self, SessionError> {
        let environment = runtime_library::environment()?;
        let file = onnx_file::read(path)?;
        let session_on = |provider| session_of(environment, path, &file, threads, provider);
        let (session, refused) = match session_on(provider) {
            Err(reason) if provider != Provider::Cpu => (session_on(Provider::Cpu), Some(first_line(&reason))),
            opened => (opened, None),
        };
        let session = session.map_err(|source| SessionError::Open { path: path.to_owned(), source })?;
        let (inputs, outputs) = (session.inputs(), session.outputs());
        Ok(Self {
            inputs: inputs.iter().map(Declared::of).collect(),
            outputs: outputs.iter().map(Declared::of).collect(),
            metadata: metadata_of(&session),
            path: path.to_owned(),
            session,
            refused,
            widened: Vec::new(),
        })
    }

    /// Why the requested provider does not run the network, if the processor runs it instead.
    pub fn refused(&self) -> Option<&str> {
        self.refused.as_deref()
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Inputs in the order of the file.
    pub fn inputs(&self) -> &[Declared] {
        &self.inputs
    }

    /// Outputs in the order of the file.
    pub fn outputs(&self) -> &[Declared] {
        &self.outputs
    }

    /// Value of a custom metadata key of the file.
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.metadata.get(key).map(String::as_str)
    }

    /// Runs the network and passes its outputs, in the order of the file, to `read`.
    ///
    /// # Errors
    /// ONNX Runtime's message.
    pub fn run<T>(
        &mut self,
        inputs: &[RunInput<'_>],
        read: impl FnOnce(&[Tensor<'_>]) -> T,
    ) -> Result<T, SessionError> {
        let Self { session, path, widened, .. } = self;
        let failed = |source| SessionError::Run { path: path.clone(), source };
        let mut values = Vec::with_capacity(inputs.len());
        for input in inputs {
            values.push((input.name, input.value().map_err(failed)?));
        }
        let outputs = session.run(values).map_err(failed)?;
        widened.resize_with(outputs.len(), Widened::default);
        widened.iter_mut().enumerate().for_each(|(index, widened)| widened.fill(&outputs[index]));
        let tensors: Vec<Tensor<'_>> = outputs
            .keys()
            .zip(&*widened)
            .enumerate()
            .map(|(index, (name, widened))| {
                let value = &outputs[index];
                let shape = value.dtype().tensor_shape();
                let shape = shape.map(|shape| shape.iter().map(|&d| d.max(0) as usize).collect()).unwrap_or_default();
                Tensor { name, shape, data: widened.values(value) }
            })
            .collect();
        Ok(read(&tensors))
    }
}

impl RunInput<'_> {
    fn value(&self) -> Result<SessionInputValue<'_>, ort::Error> {
        let dims = self.dims.clone();
        Ok(match self.values {
            InputValues::F32(values) => TensorRef::from_array_view((dims, values))?.into(),
            InputValues::F16(values) => TensorRef::from_array_view((dims, values))?.into(),
            InputValues::U8(values) => TensorRef::from_array_view((dims, values))?.into(),
            InputValues::I8(values) => TensorRef::from_array_view((dims, values))?.into(),
        })
    }
}

impl Widened {
    /// Converts an output of another type than f32 and i64.
    fn fill(&mut self, value: &DynValue) {
        fn convert<T: PrimitiveTensorElementType + Copy, N>(value: &DynValue, to: impl Fn(T) -> N, out: &mut Vec<N>) {
            if let Ok((_, data)) = value.try_extract_tensor::<T>() {
                out.extend(data.iter().map(|&v| to(v)));
            }
        }
        self.floats.clear();
        self.ints.clear();
        let floats = &mut self.floats;
        match value.dtype().tensor_type() {
            Some(TensorElementType::Float16) => convert(value, f16::to_f32, floats),
            Some(TensorElementType::Float64) => convert(value, |v: f64| v as f32, floats),
            Some(TensorElementType::Uint8) => convert(value, |v: u8| f32::from(v), floats),
            Some(TensorElementType::Int8) => convert(value, |v: i8| f32::from(v), floats),
            Some(TensorElementType::Bool) => convert(value, |v: bool| f32::from(u8::from(v)), floats),
            Some(TensorElementType::Int32) => convert(value, |v: i32| i64::from(v), &mut self.ints),
            _ => {}
        }
    }

    fn values<'a>(&'a self, value: &'a DynValue) -> Values<'a> {
        match value.dtype().tensor_type() {
            Some(TensorElementType::Float32) => {
                value.try_extract_tensor().map_or(Values::Other, |(_, data)| Values::Float(data))
            }
            Some(TensorElementType::Int64) => {
                value.try_extract_tensor().map_or(Values::Other, |(_, data)| Values::Int(data))
            }
            Some(TensorElementType::Int32) => Values::Int(&self.ints),
            Some(
                TensorElementType::Float16
                | TensorElementType::Float64
                | TensorElementType::Uint8
                | TensorElementType::Int8
                | TensorElementType::Bool,
            ) => Values::Float(&self.floats),
            _ => Values::Other,
        }
    }
}

fn first_line(error: &ort::Error) -> String {
    error.to_string().lines().next().unwrap_or("").chars().take(300).collect()
}
