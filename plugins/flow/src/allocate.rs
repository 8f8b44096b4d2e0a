//! `allocate`: uses the heap on demand, to see that a report counts it.

use panoscope_node::{Context, Node, NodeInfo, Open, Params, Result};

use crate::ports::{In, Out};

/// How much is allocated.
#[derive(Params)]
pub struct Heap {
    /// Heap allocations per picture.
    #[param(default = 1, range = 0..=1000000)]
    count: u32,
    /// Size of each.
    #[param(default = 64, range = 1..=1073741824, unit = "bytes")]
    size_bytes: usize,
}

/// Hands pictures on after some heap allocations.
#[derive(Default)]
pub struct Allocate {
    /// Allocations so far.
    total: u64,
}

impl Node for Allocate {
    const INFO: NodeInfo = NodeInfo::compute("allocate", "flow", "Hands pictures on after some heap allocations.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Heap;

    fn open(_: &Open<'_>, _: &Heap) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Heap) -> Result<()> {
        for _ in 0..params.count {
            // The compiler may not leave out what it cannot see through.
            std::hint::black_box(Vec::<u8>::with_capacity(params.size_bytes));
        }
        self.total += u64::from(params.count);
        cx.metric("allocated", self.total as f64);
        out.image.forward(input.image.frame())
    }
}
