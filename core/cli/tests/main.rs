//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

#[path = "../../../tests/support/chromium.rs"]
mod chromium;
mod command;
mod common;
mod endings;
mod eval_disparity;
mod field_of_view;
mod graph_args;
mod lock;
mod models;
mod mosaic;
mod no_plugins;
mod secrets;
mod skill;
mod stitch_sweeps;
mod studies;
mod tune;
mod versions;
mod watch;
mod web;
