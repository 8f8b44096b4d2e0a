//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

mod channels;
#[path = "../../engine/tests/common/mod.rs"]
mod common;
mod damage;
mod disk;
mod formats;
mod full_disk;
mod record;
