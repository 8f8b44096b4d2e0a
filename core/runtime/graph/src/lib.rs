//! Graph files: TOML text and a plain [`Catalog`] of node types become a checked [`Graph`], or [`Diagnostics`] that
//! name every mistake of the file at once. Knows nothing of plugins, threads or frames.
//!
//! ```
//! use panoscope_graph::{Catalog, GraphText, check};
//!
//! let text = GraphText::parse("wide.toml".as_ref(), "plugins = [\"phantom\"]\n[nodes.scope]\ntype = \"fantom\"\n");
//! assert_eq!(text.plugins(), ["phantom"]); // load these, and fill the catalog with what they offer
//! let mistakes = check(&text, &Catalog::default()).into_result().unwrap_err();
//! assert!(mistakes.render(false).contains("wide.toml:1:12")); // no such plugin
//! ```

pub mod args;
pub mod catalog;
mod check;
pub mod checked;
pub mod command_line;
mod diagnostic;
mod dot;
pub mod edit;
mod edit_error;
mod file;
mod fit;
mod flatten;
#[cfg(feature = "abi")]
pub mod from_abi;
pub mod installed;
mod listening;
mod nearest;
mod options;
mod outline;
pub mod packet;
pub mod param;
mod parse;
mod parts;
mod read;
mod reduce;
mod schema;
mod shape;
mod source;
mod text;
pub mod validate;
pub mod value;

pub use args::{Arg, ArgKind};
pub use catalog::{Catalog, NodeKind, NodeType, Offer, PluginProblem, Port};
pub use check::{Checked, check};
pub use checked::{Align, Deny, Edge, Graph, Machine, Mode, Node, OnFault, Pin, Pixels, Preset, PresetView};
pub use diagnostic::{Diagnostic, Diagnostics, Note, Severity};
pub use dot::to_dot;
pub use flatten::{HomeEntry, ParamHome};
pub use listening::{Listener, Listening, can_listen, listening};
pub use options::GraphOptions;
pub use outline::{InputOutline, NodeHome, NodeOutline, PartOutline, PartPort, Reference};
pub use packet::{PacketMismatch, PacketType};
pub use param::{Param, ParamKind, ParamValue, Pick, ValueError};
pub use schema::json_schema;
pub use source::tidy;
pub use text::{FileKind, GraphFile, GraphText};
pub use validate::{NodeSetup, ParamProblem, Validator, Wiring};
