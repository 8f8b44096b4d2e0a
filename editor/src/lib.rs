//! The editor: a window over a running graph.
//!
//! The graph file's text is the truth ([`document`]); the canvas is derived from it; a session ([`session`]) makes the running graph what
//! the text says, one transaction after the other. An observer ([`observe`]) takes pictures and counters off the window's thread. These
//! parts know nothing of egui; the rest draws.

pub mod actions;
pub mod app;
pub mod canvas;
pub mod content;
pub mod disk;
pub mod document;
pub mod history;
mod layout;
pub mod observe;
pub mod ops;
pub mod palette;
pub mod panels;
pub mod picker;
pub mod picture;
mod search;
pub mod session;
pub mod space;
pub mod surface;
pub mod sweeping;
pub mod theatre;
pub mod theme;
pub mod viewer;
