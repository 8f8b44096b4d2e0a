//! A model that does not fit its table, or an image that does not fit the model.

use std::path::PathBuf;

use crate::finite::BrokenNetwork;

/// How model, table and images disagree.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Mismatch {
    /// The table has a name that the model does not have.
    #[error("the table names {side} `{name}`, which {path} does not have; it has {found}", path = path.display())]
    NoSuch {
        path: PathBuf,
        /// `input` or `output`.
        side: &'static str,
        name: String,
        found: String,
    },
    /// The model has an input that the table does not have.
    #[error("{path} takes {found}, for which the table names no port; add [inputs.{name}]", path = path.display())]
    Unnamed { path: PathBuf, name: String, found: String },
    /// An input has another shape or type.
    #[error("{path} takes {found}, but the table says {expected}", path = path.display())]
    Input { path: PathBuf, found: String, expected: String },
    /// An output has another shape or type.
    #[error("{path} returns {found} for an input of {width}x{height}, but the table says {expected}", path = path.display())]
    Output { path: PathBuf, found: String, expected: String, width: usize, height: usize },
    /// Two views have different sizes.
    #[error("`{first}` is {first_size}, but `{second}` is {second_size}: connect views of one size")]
    Views { first: &'static str, first_size: String, second: &'static str, second_size: String },
    /// The network outputs no usable values.
    #[error(transparent)]
    Broken(#[from] BrokenNetwork),
}

/// Width and height, as text for messages.
pub fn size_text((width, height): (usize, usize)) -> String {
    format!("{width}x{height}")
}
