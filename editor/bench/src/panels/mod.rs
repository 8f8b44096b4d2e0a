//! The panels around the canvas, and dialogs.

pub mod below;
pub mod cutout;
mod distribution;
pub mod files;
pub mod history;
pub mod inspector;
pub mod node_help;
pub mod overview;
pub mod params;
pub mod plots;
pub mod plugins;
mod prose;
pub mod source;
pub mod states;
pub mod sweep;
pub mod timeline;
pub mod top;
pub mod trace;
