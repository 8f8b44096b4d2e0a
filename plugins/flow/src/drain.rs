//! `drain` and `drain_blocking`: sinks that count frames.

use panoscope_node::abi::{FNV_START, fnv1a};
use panoscope_node::{AnyImage, Context, NoPorts, Node, NodeInfo, Open, Params, Result};

use crate::ports::In;

/// Parameters of both sinks.
#[derive(Params)]
pub struct DrainParams {
    /// Reads all pixels and reports a digest of all frames received, as the metric `digest`.
    #[param(default = false)]
    digest: bool,
}

/// Adds the pixels of a frame and its tick to a digest.
fn fold(hash: u64, image: &AnyImage<'_>) -> u64 {
    let tick = image.frame().tick;
    let len = image.rows().map(<[u8]>::len).sum::<usize>();
    let head = [tick.seq, tick.capture_ns as u64, u64::from(image.format()), len as u64];
    let hash = head.iter().fold(hash, |hash, number| fnv1a(hash, &number.to_le_bytes()));
    image.rows().fold(hash, fnv1a)
}

#[derive(Default)]
struct Count {
    frames: u64,
    digest: u64,
}

impl Count {
    fn take(&mut self, cx: &Context<'_>, image: &AnyImage<'_>, params: &DrainParams) {
        self.frames += 1;
        if params.digest {
            let before = if self.frames == 1 { FNV_START } else { self.digest };
            self.digest = fold(before, image);
            // A metric is an f64: 52 bits of the digest fit.
            cx.metric("digest", (self.digest >> 12) as f64);
        }
        cx.metric("frames", self.frames as f64);
    }
}

/// Receives frames and counts them.
#[derive(Default)]
pub struct Drain(Count);

impl Node for Drain {
    const INFO: NodeInfo = NodeInfo::compute("drain", "sink", "Counts frames and releases them.").side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = DrainParams;

    fn open(_: &Open<'_>, _: &DrainParams) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, params: &DrainParams) -> Result<()> {
        self.0.take(cx, &input.image, params);
        Ok(())
    }
}

/// Receives frames on a separate thread and counts them.
#[derive(Default)]
pub struct DrainBlocking(Count);

impl Node for DrainBlocking {
    const INFO: NodeInfo =
        NodeInfo::blocking("drain_blocking", "sink", "Counts frames and releases them, on its own thread.")
            .side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = DrainParams;

    fn open(_: &Open<'_>, _: &DrainParams) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, params: &DrainParams) -> Result<()> {
        self.0.take(cx, &input.image, params);
        Ok(())
    }
}
