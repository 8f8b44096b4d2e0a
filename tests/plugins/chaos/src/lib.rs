//! Nodes that misbehave on demand: they panic, hang, slow down, leak, make nothing, too much or nonsense. A graph with
//! them shows what the runtime does about a plugin that goes wrong.

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
