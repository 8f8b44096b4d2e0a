//! Errors of edits of a graph file.

use thiserror::Error;

/// Why a file could not be changed. The text is as before then.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EditError {
    /// The text is no TOML.
    #[error("the graph file is not TOML: {message}")]
    Syntax {
        /// What the parser says.
        message: String,
    },
    /// No node of that name.
    #[error("there is no node `{id}`")]
    NoNode {
        /// The name looked for.
        id: String,
    },
    /// No argument of that name.
    #[error("there is no argument `{name}`")]
    NoArg {
        /// The name looked for.
        name: String,
    },
    /// The node belongs to a part and is changed in the part's file.
    #[error("`{id}` belongs to a part: open the part's file to change more than its parameters")]
    InPart {
        /// The node.
        id: String,
    },
    /// The value comes from the command line.
    #[error(transparent)]
    NoHome(#[from] NoHome),
    /// A node of that name exists already.
    #[error("there is already a node `{id}`")]
    NodeExists {
        /// The name.
        id: String,
    },
    /// A name that no node may have.
    #[error("`{id}` cannot name a node: letters, digits, _ and - only, a letter or _ first")]
    BadId {
        /// The name.
        id: String,
    },
    /// A part of the file is of another TOML type than it must be.
    #[error("{place} is not {expected}")]
    Shape {
        /// Which part, such as `nodes.wide.params`.
        place: String,
        /// What it must be.
        expected: &'static str,
    },
}

/// Why a parameter has no entry in a file.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NoHome {
    /// No node of that name.
    #[error("there is no node `{0}`")]
    NoNode(String),
    /// The value comes from the command line.
    #[error("`{param}` has the value of argument `{arg}`, which was given on the command line; change it there")]
    CommandLine {
        /// `node.param`.
        param: String,
        /// The argument.
        arg: String,
    },
}
