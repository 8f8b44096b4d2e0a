//! All tests of the package as one program: `cargo nextest` runs each test in its own process.

mod content;
mod found;
mod graphs;
mod simulation;
