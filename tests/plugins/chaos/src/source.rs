//! `chaos_source`: a source of test frames that misbehaves on request.

use panoscope_node::{AnyFormat, AnyImage, Context, Gray8, Node, NodeInfo, Open, Ports, Result, Slot};

use crate::harm::{Harm, Plan};

const WIDTH: usize = 32;
const HEIGHT: usize = 24;
/// 5 ms of media time per frame.
const FRAME_NS: i64 = 5_000_000;

/// Result of an earlier tick.
#[derive(Ports)]
pub struct In<'f> {
    /// Ignored: for graphs in which a source waits for the results of its ticks.
    #[allow(dead_code, reason = "only that it is there matters")]
    before: Option<AnyImage<'f>>,
}

/// The frame that is made.
#[derive(Ports)]
pub struct Out<'f> {
    /// A gray8 frame of one value: the tick number modulo 256.
    image: Slot<'f, AnyFormat>,
}

/// Makes test frames, 200 per second.
pub struct ChaosSource;

impl Node for ChaosSource {
    const INFO: NodeInfo =
        NodeInfo::compute("chaos_source", "source", "Makes test frames and misbehaves on request.").source();
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Plan;

    fn open(open: &Open<'_>, plan: &Plan) -> Result<Self> {
        plan.open(open);
        Ok(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: In<'f>, mut out: Out<'f>, plan: &Plan) -> Result<()> {
        let seq = cx.tick().seq;
        let harm = plan.at(seq);
        plan.suffer(cx, harm)?;
        let late_ns = match harm {
            Harm::Repeat => FRAME_NS,
            Harm::Reorder => 2 * FRAME_NS + FRAME_NS / 2,
            _ => 0,
        };
        match harm {
            Harm::Extreme if seq.is_multiple_of(2) => cx.set_capture_ns(i64::MIN),
            Harm::Extreme => cx.set_capture_ns(i64::MAX),
            _ => cx.set_capture_ns(seq as i64 * FRAME_NS - late_ns),
        }
        if plan.spoil(harm, &mut out.image, WIDTH, HEIGHT)? {
            return Ok(());
        }
        let mut plane = out.image.alloc_as::<Gray8>(WIDTH, HEIGHT)?;
        for y in 0..HEIGHT {
            plane.row_mut(y).fill(seq as u8);
        }
        Ok(())
    }
}
