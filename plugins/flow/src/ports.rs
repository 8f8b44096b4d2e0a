//! Ports that several nodes share: one frame in, one frame out.

use panoscope_node::{AnyFormat, AnyImage, Ports, Slot};

/// One frame of any format.
#[derive(Ports)]
pub struct In<'f> {
    /// The frame to forward.
    pub image: AnyImage<'f>,
}

/// The forwarded frame.
#[derive(Ports)]
pub struct Out<'f> {
    /// The same buffer as the input: nothing is copied.
    pub image: Slot<'f, AnyFormat>,
}
