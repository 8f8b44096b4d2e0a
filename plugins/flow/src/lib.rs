//! Small nodes that need no library: test frames, pass-through, gates, averages, and sinks that count. Each is a complete
//! node in one short file and a good first example to read.

pub mod drain;
pub mod every_nth;
pub mod frames;
pub mod gate;
pub mod level;
pub mod pass;
pub mod ports;
pub mod smooth;
pub mod transpose;

use panoscope_node::export_plugin;

export_plugin![
    frames::Frames,
    pass::Pass,
    pass::PassBlocking,
    drain::Drain,
    drain::DrainBlocking,
    gate::Gate,
    every_nth::EveryNth,
    level::Level,
    smooth::Smooth,
    transpose::Transpose,
];
