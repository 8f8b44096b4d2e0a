//! `gate`: passes or blocks frames.

use panoscope_node::{Context, Node, NodeInfo, Open, Params, Result};

use crate::ports::{In, Out};

/// The gate's state.
#[derive(Params)]
pub struct Switch {
    /// Whether frames pass; when closed, the output is empty.
    #[param(default = true)]
    open: bool,
}

/// Forwards frames while it is open.
pub struct Gate;

impl Node for Gate {
    const INFO: NodeInfo = NodeInfo::compute("gate", "flow", "Forwards frames while it is open.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Switch;

    fn open(_: &Open<'_>, _: &Switch) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Switch) -> Result<()> {
        if params.open { out.image.forward(input.image.frame()) } else { Ok(()) }
    }
}
