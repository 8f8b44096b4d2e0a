//! Drawing on images.
//!
//! `overlay` draws the results of other nodes on their image, `colorize` shows a map of numbers as an image, `side_by_side` combines several images
//! into one, `screen` one large image and smaller ones, `turntable` shows a point cloud from all sides.

#![forbid(unsafe_code)]

pub mod bar;
pub mod colorize;
pub mod fit;
pub mod gpu;
pub mod marks;
pub mod nearness;
pub mod overlay;
pub mod quantity;
pub mod screen;
pub mod shapes;
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
