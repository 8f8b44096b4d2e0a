//! The bytes of each file format, apart from nodes and file names.

pub mod array;
pub mod coco;
pub mod fields;
pub mod json;
pub mod mkv;
pub mod ply;
pub mod still;
