//! `preview`: holds the newest frame for a viewer.

use panoscope_node::{
    AnyImage, Bgr8, Context, Gray8, Gray16, GrayF32, NoPorts, Node, NodeInfo, Open, Ports, Result, Retained, Rgba8,
};

/// Input ports of `preview`.
#[derive(Ports)]
pub struct In<'f> {
    /// The image to show.
    pub image: AnyImage<'f>,
}

#[derive(Default)]
enum Held {
    #[default]
    Nothing,
    Gray8(Retained<Gray8>),
    Bgr8(Retained<Bgr8>),
    Rgba8(Retained<Rgba8>),
    Gray16(Retained<Gray16>),
    F32(Retained<GrayF32>),
}

/// Holds the newest frame, so that a viewer can show it at its own pace. Holds at most two frames, and two only while one replaces the other.
#[derive(Default)]
pub struct Preview {
    held: Held,
    frames: u64,
}

impl Preview {
    /// Width and height of the held frame, px.
    pub fn held_size(&self) -> Option<(u32, u32)> {
        let frame = match &self.held {
            Held::Nothing => return None,
            Held::Gray8(kept) => kept.frame(),
            Held::Bgr8(kept) => kept.frame(),
            Held::Rgba8(kept) => kept.frame(),
            Held::Gray16(kept) => kept.frame(),
            Held::F32(kept) => kept.frame(),
        };
        Some((frame.width, frame.height))
    }
}

impl Node for Preview {
    const INFO: NodeInfo = NodeInfo::compute("preview", "sink", "Holds the newest frame for a viewer; counts frames.");
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = ();

    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, _: &()) -> Result<()> {
        let image = input.image;
        self.held = if let Some(plane) = image.as_plane::<Bgr8>() {
            Held::Bgr8(plane.retain())
        } else if let Some(plane) = image.as_plane::<Gray8>() {
            Held::Gray8(plane.retain())
        } else if let Some(plane) = image.as_plane::<Rgba8>() {
            Held::Rgba8(plane.retain())
        } else if let Some(plane) = image.as_plane::<Gray16>() {
            Held::Gray16(plane.retain())
        } else if let Some(plane) = image.as_plane::<GrayF32>() {
            Held::F32(plane.retain())
        } else {
            Held::Nothing
        };
        self.frames += 1;
        cx.metric("frames", self.frames as f64);
        Ok(())
    }
}
