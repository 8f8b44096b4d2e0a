//! A rendered tissue scene seen by two or four cameras, with exact truth.
//!
//! [`render`] holds the renderer: plain structs and functions on slices, no framework type.

pub mod render;
