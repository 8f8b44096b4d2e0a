//! Errors of edits of a graph file.

use std::path::PathBuf;
use thiserror::Error;

/// An edit that was refused; the text is unchanged.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EditError {
    /// The text is not TOML.
    #[error("the graph file is not TOML: {message}")]
    Syntax {
        /// Message of the parser.
        message: String,
    },
    /// No node of that name.
    #[error("there is no node `{id}`")]
    NoNode {
        /// The requested name.
        id: String,
    },
    /// No argument of that name.
    #[error("there is no argument `{name}`")]
    NoArg {
        /// The requested name.
        name: String,
    },
    /// The node belongs to a part; its entry is in the part's file.
    #[error("`{id}` belongs to a part: this file has no entry of it, the part's file has")]
    InPart {
        /// The node.
        id: String,
    },
    /// The node is an overlay's.
    #[error("`{id}` comes from the overlay {file}: change it there, or open the graph without the overlay")]
    FromOverlay {
        /// The node.
        id: String,
        /// The overlay.
        file: String,
    },
    /// The node is not a part, or the part's file cannot be used.
    #[error("`{id}` is not a part with a file that can be read")]
    NoPart {
        /// The node.
        id: String,
    },
    /// Several parts use the file, and a change of all of them was not confirmed.
    #[error("{} is used {} times in this graph ({}): the change would apply to each", .file.display(), .users.len(), .users.join(", "))]
    SharedPart {
        /// The part's file.
        file: PathBuf,
        /// The nodes that use it.
        users: Vec<String>,
    },
    /// Nodes for a new part that are not all in one file and part.
    #[error("a part is made of nodes of one level: `{id}` is in another part than the others")]
    SeveralLevels {
        /// One of the nodes.
        id: String,
    },
    /// No node was named.
    #[error("select at least one node to make a part of")]
    NothingSelected,
    /// An input that would be connected inside a part and from outside at once.
    #[error(
        "input `{input}` of `{id}` would be connected both inside the part and from outside: a part supplies all of a list or none of it"
    )]
    MixedInput {
        /// The node.
        id: String,
        /// Its input.
        input: String,
    },
    /// A part has no arguments, and only parameters and inputs can be handed to it.
    #[error("`{key}` of `{id}` is the value of an argument, which a part cannot take: write a value there first")]
    ArgInPart {
        /// The node.
        id: String,
        /// The entry.
        key: String,
    },
    /// The file of a new part exists.
    #[error("{file} exists already: choose another name for the part")]
    FileExists {
        /// The file.
        file: String,
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
    /// An invalid node name.
    #[error("`{id}` cannot name a node: letters, digits, _ and - only, a letter or _ first")]
    BadId {
        /// The name.
        id: String,
    },
    /// An entry of the file has the wrong TOML type.
    #[error("{place} is not {expected}")]
    Shape {
        /// Path of the entry, such as `nodes.wide.params`.
        place: String,
        /// Required value.
        expected: &'static str,
    },
}

/// A parameter without an entry in a file.
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
