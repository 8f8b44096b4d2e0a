//! The arm's interlock as a process of its own.
//!
//! `panoscope-arm` owns the serial line, the limits, the watchdog and the latches. The graph's node (`arm_serial`) starts it and sends requests over a
//! socket pair, stamped on the system's monotonic clock. When the program hangs, crashes, is stopped, or sends garbage, the requests go stale or the
//! socket closes, and this process brakes the arm. When this process dies, the arm's own watchdog stops the arm.
//!
//! - [`message`]: what goes over the socket.
//! - [`client`]: the side of the program.
//! - [`server`]: the loop of the process.
//! - [`link`], [`port`]: the serial line.
//! - [`latch`]: stops that survive restarts, on disk.
//! - [`realtime`]: locked memory and priority; [`check`]: whether they are allowed here.

pub mod check;
pub mod client;
pub mod clock;
pub mod latch;
pub mod link;
pub mod message;
pub mod port;
pub mod realtime;
pub mod server;
