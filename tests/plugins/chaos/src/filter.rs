//! `chaos` and `chaos_blocking`: forward frames, and misbehave on request.

use panoscope_node::{AnyFormat, Context, Gray8, Image, Node, NodeInfo, Open, Ports, Result, Slot};

use crate::harm::{Harm, Plan};

/// One gray frame.
#[derive(Ports)]
pub struct In<'f> {
    /// The frame to forward.
    image: Image<'f, Gray8>,
}

/// The forwarded frame.
#[derive(Ports)]
pub struct Out<'f> {
    /// The same buffer as the input, when nothing goes wrong.
    image: Slot<'f, AnyFormat>,
}

fn process<'f>(cx: &Context<'f>, input: &In<'f>, out: &mut Out<'f>, plan: &Plan) -> Result<()> {
    let harm = plan.at(cx.tick().seq);
    plan.suffer(cx, harm)?;
    let frame = input.image.frame();
    if harm == Harm::WildWrite {
        // SAFETY: none: the pixels are borrowed, and others read them. In a process of its own the node cannot write them.
        unsafe { frame.data.write_bytes(0xEE, frame.len) };
    }
    if harm == Harm::Leak {
        std::mem::forget(input.image.retain());
    }
    if matches!(harm, Harm::ReleaseTwice | Harm::ReleaseTwiceElsewhere) {
        let kept = input.image.retain();
        // SAFETY: none: this is the misuse that the host has to survive.
        let twin = unsafe { std::ptr::read(&raw const kept) };
        if harm == Harm::ReleaseTwice {
            drop((kept, twin));
        } else {
            // The call waits: the host must not depend on the order of things.
            std::thread::scope(|scope| drop(scope.spawn(|| drop((kept, twin))).join()));
        }
    }
    if plan.spoil(harm, &mut out.image, frame.width as usize, frame.height as usize)? {
        return Ok(());
    }
    out.image.forward(frame)
}

/// Misbehaves inline after its producer.
pub struct Chaos;

impl Node for Chaos {
    const INFO: NodeInfo = NodeInfo::compute("chaos", "flow", "Forwards pictures and misbehaves on request.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Plan;

    fn open(open: &Open<'_>, plan: &Plan) -> Result<Self> {
        plan.open(open);
        Ok(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, plan: &Plan) -> Result<()> {
        process(cx, &input, &mut out, plan)
    }
}

/// Misbehaves on a separate thread.
pub struct ChaosBlocking;

impl Node for ChaosBlocking {
    const INFO: NodeInfo = NodeInfo::blocking("chaos_blocking", "flow", "Misbehaves on its own thread on request.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Plan;

    fn open(open: &Open<'_>, plan: &Plan) -> Result<Self> {
        plan.open(open);
        Ok(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, plan: &Plan) -> Result<()> {
        process(cx, &input, &mut out, plan)
    }
}
