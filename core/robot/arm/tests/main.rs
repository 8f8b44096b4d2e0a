//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

mod chain;
mod closed_loop;
mod interlock;
mod skill;
mod tuning;
