//! Ports that several nodes share: one picture in, one picture out.

use panoscope_node::{AnyFormat, AnyImage, Ports, Slot};

/// One picture of any format.
#[derive(Ports)]
pub struct In<'f> {
    /// The picture.
    pub image: AnyImage<'f>,
}

/// The picture handed on.
#[derive(Ports)]
pub struct Out<'f> {
    /// The same buffer as the input: nothing is copied.
    pub image: Slot<'f, AnyFormat>,
}
