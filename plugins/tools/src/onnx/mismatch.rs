//! A model that does not fit its table, or an image that does not fit the model.

use std::path::PathBuf;

use crate::finite::BrokenNetwork;

/// Where model, table and images disagree.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Mismatch {
    /// A name of the table that the model does not have.
    #[error("{path} has no {side} `{name}`, which the table names; it has {found}", path = path.display())]
    NoSuch {
        /// File of the model.
        path: PathBuf,
        /// `input` or `output`.
        side: &'static str,
        /// Name in the table.
        name: String,
        /// What the model has.
        found: String,
    },
    /// An input of the model that the table does not have.
    #[error("{path} wants {found}, the table names no port for it; add [inputs.{name}]", path = path.display())]
    Unnamed {
        /// File of the model.
        path: PathBuf,
        /// Name of the input.
        name: String,
        /// Its declaration.
        found: String,
    },
    /// An input of another shape or type.
    #[error("{path} wants {found}, the table says {expected}", path = path.display())]
    Input {
        /// File of the model.
        path: PathBuf,
        /// Declaration of the input.
        found: String,
        /// What the table makes of it, with its shape.
        expected: String,
    },
    /// An output of another shape or type.
    #[error("{path} answers {found} to an input of {width}x{height}, the table says {expected}", path = path.display())]
    Output {
        /// File of the model.
        path: PathBuf,
        /// Name and shape of the output.
        found: String,
        /// What the table makes of it, with its shape.
        expected: String,
        /// Columns of the input, px.
        width: usize,
        /// Rows of the input, px.
        height: usize,
    },
    /// Two views of different sizes.
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
    /// A network without usable values.
    #[error(transparent)]
    Broken(#[from] BrokenNetwork),
}

/// Width and height as messages show them.
pub fn size_text((width, height): (usize, usize)) -> String {
    format!("{width}x{height}")
}
