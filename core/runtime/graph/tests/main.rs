//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

mod common;
mod edit;
mod good;
mod graph_messages;
mod installed;
mod isolate;
mod mutation;
mod nodes;
mod outputs;
mod part_edits;
mod parts;
