//! The panels around the canvas, and dialogs.

pub mod below;
pub mod cutout;
pub mod files;
pub mod history;
pub mod inspector;
pub mod overview;
pub mod params;
pub mod plots;
pub mod plugins;
pub mod sweep;
pub mod top;
