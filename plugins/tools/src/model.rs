//! A network that takes one image.

use std::path::{Path, PathBuf};

use crate::image_input::{Element, ImageInput, Packed};
use crate::provider::Provider;
use crate::session::{ModelSession, SessionError, Tensor, list_text};

/// Why a model cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum ModelError {
    /// The file, ONNX Runtime, or a run of the network.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The model's input is not an image.
    #[error("{path} takes {found}; expected one image: f32 or f16, 1x3xHxW or 1xHxWx3", path = path.display())]
    Input { path: PathBuf, found: String },
    /// The model has no fixed input size, and none was given.
    #[error("{path} takes images of any size ({found}): set `input_width` and `input_height`", path = path.display())]
    Size { path: PathBuf, found: String },
    /// The model solves another task than the node expects.
    #[error("{path} is exported for the task `{task}`: {help}", path = path.display())]
    Task {
        path: PathBuf,
        task: String,
        /// What the node reads, and what to use instead.
        help: &'static str,
    },
}

/// An opened model with one image as input.
pub struct Model {
    session: ModelSession,
    input: ImageInput,
    packed: Packed,
    width: usize,
    height: usize,
}

impl Model {
    /// Opens a file. `size` is used if the model accepts any size; 0 takes the model's. If `provider` cannot run it, the processor does; see
    /// [`Model::refused`].
    ///
    /// # Errors
    /// No ONNX Runtime, a file that cannot be used, or an input that is not one image.
    pub fn open(path: &Path, threads: usize, size: (usize, usize), provider: Provider) -> Result<Self, ModelError> {
        let session = ModelSession::open(path, threads, provider)?;
        let found = list_text(session.inputs());
        let input = match session.inputs() {
            [input] => ImageInput::of(input, None, Some(3)),
            _ => None,
        };
        let input = input.filter(|input| matches!(input.element, Element::F32 | Element::F16));
        let Some(input) = input else { return Err(ModelError::Input { path: path.to_owned(), found }) };
        let (width, height) = (input.width.unwrap_or(size.0), input.height.unwrap_or(size.1));
        if width == 0 || height == 0 {
            return Err(ModelError::Size { path: path.to_owned(), found });
        }
        Ok(Self { session, input, packed: Packed::default(), width, height })
    }

    /// Checks the task in the model's metadata, if there is one.
    ///
    /// # Errors
    /// The task is one of `tasks`; `help` says what the node reads.
    pub fn refuse_tasks(&self, tasks: &[&str], help: &'static str) -> Result<(), ModelError> {
        match self.metadata("task") {
            Some(task) if tasks.contains(&task) => {
                Err(ModelError::Task { path: self.path().to_owned(), task: task.to_owned(), help })
            }
            _ => Ok(()),
        }
    }

    /// Why the requested provider does not run the network, if the processor runs it instead.
    pub fn refused(&self) -> Option<&str> {
        self.session.refused()
    }

    /// Width and height of the network's image, px.
    pub fn input_size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        self.session.path()
    }

    /// Value of a custom metadata key of the file.
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.session.metadata(key)
    }

    /// Runs the network on the three planes of an image of `input_size` and passes its outputs to `read`.
    ///
    /// # Errors
    /// ONNX Runtime's message.
    pub fn run<T>(&mut self, planar: &[f32], read: impl FnOnce(&[Tensor<'_>]) -> T) -> Result<T, ModelError> {
        let input = self.input.run_input(planar, (self.width, self.height), &mut self.packed);
        Ok(self.session.run(&[input], read)?)
    }
}
