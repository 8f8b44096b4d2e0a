//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

mod allocation;
mod campaign;
mod guard;
mod ur;
