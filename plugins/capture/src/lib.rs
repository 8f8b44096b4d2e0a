//! Sources: cameras, video files, images, network streams, pipelines, and the ground truth that belongs to their frames.

mod boxes;
pub mod capture;
pub mod crop;
pub mod data_set;
pub mod devices;
mod exchanged;
mod kept_frames;
mod live;
mod pairing;
mod playing;
mod position;
pub mod read_labels;
pub mod read_maps;
mod series;
pub mod settings;
pub mod source;
mod timing;
mod views;

use panoscope_node::export_plugin;

export_plugin![capture::Capture, data_set::DataSet, read_maps::ReadMaps, read_labels::ReadLabels];
