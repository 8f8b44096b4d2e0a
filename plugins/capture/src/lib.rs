//! Sources: cameras, video files, images, pipelines.

pub mod capture;
pub mod crop;
pub mod devices;
pub mod source;

use panoscope_node::export_plugin;

export_plugin![capture::Capture];
