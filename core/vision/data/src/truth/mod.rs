//! Ground truth in files: maps of disparity, depth and points, boxes of objects, images of classes.
//!
//! `maps` reads one number per pixel from the formats that stereo data sets use, `points` three of them, which it moves
//! into the rectified view. `labels` reads the boxes of one image as VOC and YOLO write them, `masks` finds the
//! connected parts of a class. This module does not know graphs: nodes and evaluations interpret the numbers and boxes.

pub mod labels;
pub mod maps;
pub mod masks;
pub mod points;
