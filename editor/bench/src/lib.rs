//! The editor: a window that shows a running graph and edits it.
//!
//! The model of the graph is in `panoscope-editor-model`; this crate draws it and handles input.

#![forbid(unsafe_code)]

pub mod actions;
pub mod app;
pub mod arrangement;
pub mod canvas;
pub mod docks;
pub mod palette;
pub mod panels;
pub mod picker;
mod probing;
mod search;
pub mod view3d;
pub mod viewer;
