//! Exchanges images, poses, points and surfaces with navigation programs that speak OpenIGTLink, such as 3D Slicer, PLUS and MITK. `igtl_send` sends,
//! `igtl_receive` receives, each as server or as client.
//!
//! [`link`] has the connections. Nodes with the same role, address and port share one, so that a program that is connected to `igtl_send` can send to
//! `igtl_receive` on the same connection. Nothing listens or connects unless a graph has such a node.
//!
//! Units: mm, in the coordinates of the packet that is sent; those of the left camera are x right, y down, z forward. Names of devices and of
//! coordinate frames are parameters; see the documentation of each node.

#![forbid(unsafe_code)]

pub mod connection;
pub mod link;
pub mod receive;
pub mod send;

use panoscope_node::export_plugin;

export_plugin![send::Send, receive::Receive];
