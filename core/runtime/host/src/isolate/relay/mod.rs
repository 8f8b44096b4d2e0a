//! Both ends of a connection between the host of a graph and a process of isolated nodes on another machine.
//!
//! To the host, a [`Link`] is the process of the group: it is started, receives pools, plugins, lanes and requests like
//! the process of any group. To the process on the other machine, [`Served`] is the host. The code in between carries
//! each message of a lane to the other side, together with the bytes of frames that the other side lacks; [`Request`]
//! and [`outputs`] name them. Pools have the same numbers and offsets on both sides.

mod link;
mod message;
pub mod messages;
mod served;

pub use self::link::{Given, Link, LinkLane, LinkNumbers};
pub use self::message::{Bytes, Open, Request, answered, arrived, made_copy, outputs, succeeded};
pub use self::served::{ServeError, Served, ServedLane};
pub use super::wire::lane::Settings;

/// Kinds of messages that the code in between interprets; others pass unchanged.
pub mod kind {
    use crate::isolate::wire::lane::Kind;

    /// The request of a tick.
    pub const PROCESS: u32 = Kind::Process as u32;
    /// The request to open an instance.
    pub const OPEN: u32 = Kind::Open as u32;
    /// The request to close an instance.
    pub const CLOSE: u32 = Kind::Close as u32;
    /// The result of a function of the host.
    pub const ANSWER: u32 = Kind::Answer as u32;
    /// The result of a request.
    pub const DONE: u32 = Kind::Done as u32;
    /// The node wants a buffer.
    pub const ALLOC: u32 = Kind::Alloc as u32;
    /// The node wants a copy of an output that it can write.
    pub const MAKE_MUT: u32 = Kind::MakeMut as u32;
    /// The node asks for the host's clock.
    pub const CLOCK: u32 = Kind::Clock as u32;
}

/// A message of the other side is malformed, or the other side has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RelayError {
    /// The process has ended.
    #[error("the process has ended")]
    Gone,
    /// The other side is of another build or broken.
    #[error("a message between the processes is malformed")]
    Bad,
}

impl From<crate::isolate::wire::BadMessage> for RelayError {
    fn from(_: crate::isolate::wire::BadMessage) -> Self {
        Self::Bad
    }
}

impl From<crate::isolate::lane::Lost> for RelayError {
    fn from(lost: crate::isolate::lane::Lost) -> Self {
        if lost == crate::isolate::lane::Lost::Bad { Self::Bad } else { Self::Gone }
    }
}
