//! All tests of the package as one program: `cargo nextest` runs each test in its own process.

mod ur_program;
mod urscript;
