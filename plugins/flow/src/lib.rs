//! Small nodes that need no library: test frames, pass-through, gates, sinks that count, and nodes that misbehave on
//! demand. They are meant to be read: each is a whole node in one short file.

pub mod allocate;
pub mod device;
pub mod drain;
pub mod every_nth;
pub mod failing;
pub mod frames;
pub mod gate;
pub mod ledger;
pub mod level;
pub mod pass;
pub mod ports;
pub mod smooth;

use panoscope_node::export_plugin;

export_plugin![
    frames::Frames,
    pass::Pass,
    pass::PassBlocking,
    drain::Drain,
    drain::DrainBlocking,
    gate::Gate,
    every_nth::EveryNth,
    ledger::Ledger,
    level::Level,
    failing::Failing,
    allocate::Allocate,
    smooth::Smooth,
    device::Device,
];
