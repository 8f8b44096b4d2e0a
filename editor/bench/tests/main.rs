//! All tests of the package as one program: `cargo nextest` runs each test in a process of its own.

mod arguments;
mod arrange;
#[path = "../../../tests/support/attachable.rs"]
mod attachable;
mod attached;
mod begin;
mod build;
mod common;
mod comparing;
mod corpus;
mod docks;
mod document;
mod find;
mod german;
mod guide;
mod kill;
mod looks;
#[path = "../../theatre/tests/common/looks.rs"]
mod looks_graph;
mod parts;
mod playing;
mod probes;
mod sizes;
mod source;
mod states;
mod still;
mod tasks;
mod timeline;
mod values;
mod why;
mod window;
