//! `chaos_pose`: a small packet that may contain NaN.

use panoscope_node::abi::Pose;
use panoscope_node::{Context, Gray8, Image, Node, NodeInfo, Open, Ports, Result, Slot, name16};

use crate::harm::{Harm, Plan};

/// Any input; it provides the ticks.
#[derive(Ports)]
pub struct In<'f> {
    /// Provides the ticks.
    image: Image<'f, Gray8>,
}

/// A pose.
#[derive(Ports)]
pub struct Out<'f> {
    /// No rotation, no translation.
    pose: Slot<'f, Pose>,
}

/// Makes poses.
pub struct ChaosPose;

impl Node for ChaosPose {
    const INFO: NodeInfo = NodeInfo::compute("chaos_pose", "flow", "Makes poses and misbehaves on request.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Plan;

    fn open(open: &Open<'_>, plan: &Plan) -> Result<Self> {
        plan.open(open);
        Ok(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, plan: &Plan) -> Result<()> {
        let harm = plan.at(cx.tick().seq);
        plan.suffer(cx, harm)?;
        if harm == Harm::Leak {
            std::mem::forget(input.image.retain());
        }
        if harm == Harm::Nothing {
            return Ok(());
        }
        let x_mm = if harm == Harm::Nan { f64::NAN } else { 0.0 };
        let (a, b) = (name16("world"), name16("scope"));
        out.pose.set(Pose { a_from_b_wxyz: [1.0, 0.0, 0.0, 0.0], a_from_b_mm: [x_mm, 0.0, 0.0], a, b })
    }
}
