//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

mod batch;
mod campaign;
mod common;
mod edit_campaign;
mod edits;
mod endings;
mod exclusive;
mod faults;
mod light;
mod limits;
mod limits_of_calls;
mod live;
