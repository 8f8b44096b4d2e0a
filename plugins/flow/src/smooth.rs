//! `smooth`: averages over time; the past is an input of the graph.

use panoscope_node::{Bgr8, Context, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot};

/// Input ports of `smooth`.
#[derive(Ports)]
pub struct In<'f> {
    /// The newest image.
    image: Image<'f, Bgr8>,
    /// Output of this node at the previous tick: wire its own output here with `delay = 1`.
    past: Option<Image<'f, Bgr8>>,
}

/// Output ports of `smooth`.
#[derive(Ports)]
pub struct Out<'f> {
    /// Weighted mean of `image` and `past`.
    image: Slot<'f, Bgr8>,
}

/// How strongly the past counts.
#[derive(Params)]
pub struct Memory {
    /// Weight of the past, in 1/256.
    #[param(default = 192, range = 0..=255)]
    past_weight: u32,
}

/// Averages images over time. It has no state, so it can be replaced while it runs.
pub struct Smooth;

impl Node for Smooth {
    const INFO: NodeInfo = NodeInfo::compute("smooth", "filter", "Averages images over time.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Memory;

    fn open(_: &Open<'_>, _: &Memory) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Memory) -> Result<()> {
        let image = input.image.view();
        let past = input.past.map(|p| p.view()).filter(|p| (p.width, p.height) == (image.width, image.height));
        let Some(past) = past else { return out.image.forward(input.image.frame()) };
        let mut mean = out.image.alloc(image.width, image.height)?;
        for y in 0..image.height {
            for ((to, &now), &then) in mean.row_mut(y).iter_mut().zip(image.row(y)).zip(past.row(y)) {
                let sum = u32::from(then) * params.past_weight + u32::from(now) * (256 - params.past_weight);
                *to = ((sum + 128) >> 8) as u8;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_node::harness::{Harness, HarnessError};

    #[test]
    fn the_past_weighs_as_told() -> std::result::Result<(), HarnessError> {
        let mut node = Harness::<Smooth>::from_toml("params = { past_weight = 128 }")?;
        let first = node.input_image::<Bgr8>("image", 1, 1, &[10, 20, 30]).process()?;
        assert_eq!(first.plane::<Bgr8>("image")?.data, [10, 20, 30], "no past on the first tick");
        node.input_image::<Bgr8>("image", 1, 1, &[100, 100, 100]).input_image::<Bgr8>("past", 1, 1, &[0, 50, 200]);
        assert_eq!(node.process()?.plane::<Bgr8>("image")?.data, [50, 75, 150]);
        Ok(())
    }
}
