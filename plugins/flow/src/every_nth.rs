//! `every_nth`: reduces the rate of a stream.

use panoscope_node::{Context, Node, NodeInfo, Open, Params, Result};

use crate::ports::{In, Out};

/// How many frames are skipped.
#[derive(Params)]
pub struct Thinning {
    /// One frame in this many passes; the output is empty for the others.
    #[param(default = 2, range = 1..=1000000)]
    n: u64,
}

/// Forwards every n-th frame, counted by tick number, so that branches with the same `n` stay aligned.
pub struct EveryNth;

impl Node for EveryNth {
    const INFO: NodeInfo = NodeInfo::compute("every_nth", "flow", "Forwards every n-th frame.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Thinning;

    fn open(_: &Open<'_>, _: &Thinning) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Thinning) -> Result<()> {
        if cx.tick().seq.is_multiple_of(params.n) { out.image.forward(input.image.frame()) } else { Ok(()) }
    }
}
