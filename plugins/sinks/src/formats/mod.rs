//! Formats that only sinks write; `panoscope_data::formats` has the others.

pub mod coco;
pub mod mkv;
