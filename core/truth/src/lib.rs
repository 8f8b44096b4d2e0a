//! Truth in files: maps of disparity and depth, boxes of objects.
//!
//! `maps` reads one number per pixel from the formats that stereo data sets use. `labels` reads the boxes of one picture as VOC and YOLO write
//! them. Nothing here knows a graph: nodes and evaluations decide what a number or a box means.

pub mod labels;
pub mod maps;
