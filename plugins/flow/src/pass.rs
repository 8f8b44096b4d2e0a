//! `pass` and `pass_blocking`: forward a frame.

use std::time::Duration;

use panoscope_node::{Context, Node, NodeInfo, Open, Params, Result};

use crate::ports::{In, Out};

/// Forwards frames, inline after their producer.
pub struct Pass;

impl Node for Pass {
    const INFO: NodeInfo = NodeInfo::compute("pass", "flow", "Forwards frames without a copy.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ();

    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, _: &()) -> Result<()> {
        out.image.forward(input.image.frame())
    }
}

/// How long to hold a frame.
#[derive(Params)]
pub struct Wait {
    /// Time that the node sleeps per frame, as a slow device would.
    #[param(default = 0.0, range = 0.0..=10000.0, unit = "ms")]
    wait_ms: f64,
}

/// Forwards frames from a separate thread, after a pause.
pub struct PassBlocking;

impl Node for PassBlocking {
    const INFO: NodeInfo =
        NodeInfo::blocking("pass_blocking", "flow", "Forwards frames from its own thread, after an optional pause.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Wait;

    fn open(_: &Open<'_>, _: &Wait) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Wait) -> Result<()> {
        if params.wait_ms > 0.0 {
            std::thread::sleep(Duration::from_secs_f64(params.wait_ms / 1e3));
        }
        out.image.forward(input.image.frame())
    }
}
