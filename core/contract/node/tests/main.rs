//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

mod c_plugins;
mod compile_messages;
mod descriptors;
mod faults;
mod host_functions;
mod nested;
mod nodes;
mod odd_frames;
mod smallest;
mod templates;
mod validation;
