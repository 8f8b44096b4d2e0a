//! Topics of ROS 2 in and out without a ROS installation, and bags.
//!
//! The nodes speak DDS, which is what `rmw_fastrtps` and `rmw_cyclonedds` speak: every ROS 2 program on the network sees their topics without a
//! bridge. `rustdds` does it in Rust alone. The alternatives were weighed: `ros2-client` is `rustdds` with nodes, services and actions, of which
//! topics need nothing; zenoh's bridge for ROS 2 is another process that has to run beside every ROS program, and `rmw_zenoh` reaches only programs
//! that have it.
//!
//! Unless `networks` says otherwise, sockets are bound to the loopback device, so that the kernel hands them no packet of another machine.
//! Messages with pixels are encoded and decoded without a copy per byte; see [`panoscope_ros`].

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
    /// Programs of this machine only.
    Loopback,
    /// Whoever is on a network of this machine. DDS has no password: whoever reaches it sees the topics and can send to them.
    All,
}
