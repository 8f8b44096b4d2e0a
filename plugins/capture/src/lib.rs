//! Sources: cameras, video files, images, pipelines.

pub mod capture;
pub mod crop;
mod depth;
pub mod devices;
mod position;
pub mod source;
mod views;

use panoscope_node::export_plugin;

export_plugin![capture::Capture];
