//! The editor: a window over a running graph.
//!
//! What it knows of the graph stands in `panoscope-editor-model`; this crate draws and edits.

#![forbid(unsafe_code)]

pub mod actions;
pub mod app;
pub mod canvas;
pub mod palette;
pub mod panels;
pub mod picker;
mod search;
pub mod space;
pub mod viewer;
