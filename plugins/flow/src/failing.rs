//! `failing`: goes wrong on demand, to see what a graph does then.

use panoscope_node::{Choice, Context, Node, NodeInfo, Open, Params, Result, error};

use crate::ports::{In, Out};

/// What goes wrong.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum How {
    /// The node answers with an error.
    Error,
    /// The node panics.
    Panic,
    /// The node does not open.
    Open,
}

/// When it goes wrong.
#[derive(Params)]
pub struct Plan {
    /// What goes wrong.
    #[param(default = "error", reopen)]
    how: How,
    /// First tick that goes wrong.
    #[param(default = 10, range = 0..=1000000000)]
    first: u64,
    /// How many ticks in a row go wrong.
    #[param(default = 1, range = 0..=1000000000)]
    ticks: u64,
}

/// Hands pictures on, except for some ticks, where it fails.
pub struct Failing;

impl Node for Failing {
    const INFO: NodeInfo = NodeInfo::compute("failing", "flow", "Hands pictures on and fails at the ticks it is told.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Plan;

    fn open(_: &Open<'_>, params: &Plan) -> Result<Self> {
        if params.how == How::Open { Err(error!("told not to open")) } else { Ok(Self) }
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Plan) -> Result<()> {
        let seq = cx.tick().seq;
        if seq >= params.first && seq - params.first < params.ticks {
            assert!(params.how != How::Panic, "told to panic at tick {seq}");
            return Err(error!("told to fail at tick {seq}"));
        }
        out.image.forward(input.image.frame())
    }
}
