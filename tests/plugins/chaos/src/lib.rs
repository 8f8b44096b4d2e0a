//! Nodes that misbehave on request: they panic, hang, slow down, leak, output nothing, too much or malformed frames. A graph with them shows how the
//! runtime handles faulty plugins.

pub mod filter;
pub mod harm;
pub mod life;
pub mod pair;
pub mod pose;
pub mod source;

use panoscope_node::export_plugin;

export_plugin![
    filter::Chaos,
    filter::ChaosBlocking,
    source::ChaosSource,
    pair::ChaosPair,
    pose::ChaosPose,
    life::ChaosLife,
    life::ChaosDevice,
    life::ChaosCamera,
];
