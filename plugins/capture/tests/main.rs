//! All tests of the package as one program: `cargo nextest` runs each test in its own process.

mod common;
mod damage;
mod damaged_streams;
mod data_sets;
mod lost_view;
mod missing_decoder;
mod opening;
mod orientation;
mod pairs;
mod playing;
mod rtsp;
#[path = "../../../core/vision/data/tests/samples/mod.rs"]
mod samples;
mod streams;
mod truth;
mod views;
