//! The arm's interlock as a separate process.
//!
//! `panoscope-arm` owns the connection to the arm, the limits, the watchdog and the latches. The graph's node
//! (`arm_serial`, `arm_ur`) starts it and sends requests over a socket pair, stamped on the system's monotonic clock.
//! When the program hangs, crashes, is stopped, or sends garbage, the requests go stale or the socket closes, and this
//! process brakes the arm. When this process dies, the arm's own watchdog stops the arm.
//!
//! - [`message`]: records on the socket.
//! - [`client`]: the program's side.
//! - [`server`]: the loop of the process.
//! - [`arm_port`]: the loop's interface to an arm.
//! - [`target`]: which arm, and how to open it.
//! - [`link`], [`port`]: a serial line.
//! - [`ur`], [`rtde`], [`tcp`]: a Universal Robots arm over RTDE.
//! - [`latch`]: stops that survive restarts, on disk.
//! - [`realtime`]: locked memory and priority; [`check`]: whether they are allowed here.

pub mod arm_port;
pub mod check;
pub mod client;
pub mod clock;
mod dashboard;
pub mod latch;
pub mod link;
pub mod message;
pub mod port;
pub mod realtime;
pub mod rtde;
pub mod server;
pub mod target;
pub mod tcp;
pub mod ur;
