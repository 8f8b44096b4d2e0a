//! Formats that only sinks write; `panoscope_formats` has the others.

pub mod coco;
pub mod mkv;
