//! Sources: cameras, video files, images, network streams, pipelines.

pub mod capture;
pub mod crop;
mod depth;
pub mod devices;
mod live;
mod pairing;
mod position;
pub mod settings;
pub mod source;
mod timing;
mod views;

use panoscope_node::export_plugin;

export_plugin![capture::Capture];
