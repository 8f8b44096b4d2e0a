//! Formats that only sinks write; the others are in `panoscope_data::formats`.

pub mod coco;
pub mod mkv;
