//! Writers of images, videos, tables and raw data, and live video on the network.
//!
//! Every writer is a node in a separate file. [`formats`] has the bytes of each format; [`target`] turns a path parameter into a file: folders,
//! `{seq}`, part files, errors with help.

#![forbid(unsafe_code)]

pub mod formats;
pub mod picture;
pub mod preview;
pub mod serving;
pub mod stream;
pub mod target;
pub mod webrtc;
pub mod write_cloud;
pub mod write_images;
pub mod write_raw;
pub mod write_table;
pub mod write_video;

use panoscope_node::export_plugin;

export_plugin![
    write_images::WriteImages,
    write_video::WriteVideo,
    write_raw::WriteRaw,
    write_table::WriteTable,
    write_cloud::WriteCloud,
    preview::Preview,
    stream::Stream,
    webrtc::WebRtc,
];
