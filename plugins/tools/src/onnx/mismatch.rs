//! A model that does not fit its table, or an image that does not fit the model.

use std::path::PathBuf;

use crate::finite::BrokenNetwork;

/// How model, table and images disagree.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Mismatch {
    /// The table has a name that the model does not have.
    #[error("{path} has no {side} `{name}`, which the table names; it has {found}", path = path.display())]
    NoSuch {
        /// File of the model.
        path: PathBuf,
        /// `input` or `output`.
        side: &'static str,
        /// Name in the table.
        name: String,
        /// The names that the model has.
        found: String,
    },
    /// The model has an input that the table does not have.
    #[error("{path} wants {found}, the table names no port for it; add [inputs.{name}]", path = path.display())]
    Unnamed {
        /// File of the model.
        path: PathBuf,
        /// Name of the input.
        name: String,
        /// Its declaration.
        found: String,
    },
    /// An input has another shape or type.
    #[error("{path} wants {found}, the table says {expected}", path = path.display())]
    Input {
        /// File of the model.
        path: PathBuf,
        /// Declaration of the input.
        found: String,
        /// Shape that the table requires.
        expected: String,
    },
    /// An output has another shape or type.
    #[error("{path} answers {found} to an input of {width}x{height}, the table says {expected}", path = path.display())]
    Output {
        /// File of the model.
        path: PathBuf,
        /// Name and shape of the output.
        found: String,
        /// Shape that the table requires.
        expected: String,
        /// Columns of the input, px.
        width: usize,
        /// Rows of the input, px.
        height: usize,
    },
    /// Two views have different sizes.
    #[error("`{first}` is {first_size}, `{second}` is {second_size}: wire views of one size")]
    Views {
        /// A port.
        first: &'static str,
        /// Its width and height, px.
        first_size: String,
        /// Another port.
        second: &'static str,
        /// Its width and height, px.
        second_size: String,
    },
    /// The network outputs no usable values.
    #[error(transparent)]
    Broken(#[from] BrokenNetwork),
}

/// Width and height, as text for messages.
pub fn size_text((width, height): (usize, usize)) -> String {
    format!("{width}x{height}")
}
