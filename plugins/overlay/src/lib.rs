//! Drawing on images.
//!
//! `overlay` draws what other nodes found onto their picture, `colorize` makes a picture of a map of numbers, `side_by_side`
//! puts several pictures into one, `screen` one large picture and smaller ones, `turntable` shows a point cloud from all sides.

#![forbid(unsafe_code)]

pub mod bar;
pub mod colorize;
pub mod fit;
pub mod marks;
pub mod nearness;
pub mod overlay;
pub mod quantity;
pub mod screen;
pub mod side_by_side;
pub mod trajectory;
pub mod turntable;

use panoscope_node::export_plugin;

export_plugin![
    overlay::Overlay,
    colorize::Colorize,
    screen::Screen,
    side_by_side::SideBySide,
    trajectory::Trajectory,
    turntable::Turntable
];
