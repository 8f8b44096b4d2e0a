//! All tests of the package as one program: `cargo nextest` runs each test in a process of its own.

mod chain;
mod closed_loop;
mod interlock;
mod tuning;
