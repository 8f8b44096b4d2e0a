//! All tests of the package as one program: `cargo nextest` runs each test in a process of its own.

mod ages;
mod arguments;
#[path = "../../../tests/support/attachable.rs"]
mod attachable;
mod attached;
mod common;
mod display;
mod guarded;
mod legible;
mod looks;
#[path = "common/looks.rs"]
mod looks_graph;
mod procedure;
mod records;
mod screen;
mod stale;
mod theatre;
mod touch;
mod trust;
#[path = "../../../tests/support/video.rs"]
mod video;
