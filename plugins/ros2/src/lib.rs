//! Sends and receives topics of ROS 2 without a ROS installation, and plays bags.
//!
//! The nodes speak DDS, as `rmw_fastrtps` and `rmw_cyclonedds` do: every ROS 2 program on the network sees their topics without a bridge. `rustdds`
//! implements it in Rust alone. Alternatives: `ros2-client` is `rustdds` with nodes, services and actions, which topics do not need; zenoh's bridge
//! for ROS 2 is another process that must run next to every ROS program, and `rmw_zenoh` reaches only programs that use it.
//!
//! Unless `networks` says otherwise, sockets are bound to the loopback device, so that the kernel passes them no packet of another machine. Messages
//! with pixels are encoded and decoded without a copy per byte; see [`panoscope_ros`].

pub mod bag;
mod dds;
mod incoming;
pub mod publish;
pub mod subscribe;
mod times;

use panoscope_node::{Choice, export_plugin};

export_plugin![publish::Publish, subscribe::Subscribe, bag::Bag];

/// Which machines can be reached.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Networks {
    /// Only programs of this machine.
    Loopback,
    /// All machines on the networks of this machine. DDS has no password: whoever reaches it can read the topics and send to them.
    All,
}
