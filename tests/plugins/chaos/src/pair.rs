//! `chaos_pair`: a well-behaved node that requires two frames of one size.

use panoscope_node::{AnyFormat, Context, Gray8, Image, Node, NodeInfo, Open, Ports, Result, Slot, error};

/// Two frames of the same instant.
#[derive(Ports)]
pub struct In<'f> {
    /// The frame to forward.
    left: Image<'f, Gray8>,
    /// The frame to compare with.
    right: Image<'f, Gray8>,
}

/// The left frame.
#[derive(Ports)]
pub struct Out<'f> {
    /// The same buffer as the left input.
    image: Slot<'f, AnyFormat>,
}

/// Forwards the left frame.
pub struct ChaosPair;

impl Node for ChaosPair {
    const INFO: NodeInfo = NodeInfo::compute("chaos_pair", "flow", "Hands a picture on if another has the same size.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ();

    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, _: &()) -> Result<()> {
        let (left, right) = (&input.left, &input.right);
        if (left.width(), left.height()) != (right.width(), right.height()) {
            let (lw, lh, rw, rh) = (left.width(), left.height(), right.width(), right.height());
            return Err(error!("left is {lw}x{lh}, right is {rw}x{rh}"));
        }
        out.image.forward(left.frame())
    }
}
