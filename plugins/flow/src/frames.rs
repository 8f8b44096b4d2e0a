//! `frames`: a source of test frames.

use panoscope_node::{
    AnyFormat, Bgr8, Choice, Context, Gray8, Gray16, GrayF32, NoPorts, Node, NodeInfo, Open, Params, Ports, Result,
    Rgba8, Slot, ViewMut, random,
};

/// The output.
#[derive(Ports)]
pub struct Out<'f> {
    /// The test frame.
    image: Slot<'f, AnyFormat>,
}

/// Pixel format of the test frames.
#[derive(Choice, Clone, Copy)]
pub enum Format {
    /// 8-bit gray.
    Gray8,
    /// 8-bit blue, green, red.
    Bgr8,
    /// 8-bit red, green, blue, opacity.
    Rgba8,
    /// 16-bit gray.
    Gray16,
    /// 32-bit floating point, 0..1.
    F32,
}

/// Content of the test frames.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Pattern {
    /// A diagonal ramp that moves by one pixel per frame; the first pixel is the tick number modulo 256.
    Ramp,
    /// Noise that differs from frame to frame and is the same in every run.
    Noise,
    /// Nothing: pixels keep what the buffer held before. Only for timing the nodes that follow.
    None,
}

/// Size, format, pattern and rate of the frames.
#[derive(Params)]
pub struct FramesParams {
    /// Width of the frames.
    #[param(default = 640, range = 1..=16384, unit = "px")]
    width_px: usize,
    /// Height of the frames.
    #[param(default = 480, range = 1..=16384, unit = "px")]
    height_px: usize,
    /// Pixel format of the frames.
    #[param(default = "bgr8")]
    format: Format,
    /// Content of the frames.
    #[param(default = "ramp")]
    pattern: Pattern,
    /// Frames per second of media time; a live graph runs at this rate.
    #[param(default = 30.0, range = 0.001..=1000000.0, unit = "Hz")]
    rate_hz: f64,
    /// Number of frames; 0 for no end.
    #[param(default = 0, range = 0..=1000000000)]
    count: u64,
    /// Media time of the first frame.
    #[param(default = 0.0, range = -1000000.0..=1000000.0, unit = "ms")]
    start_ms: f64,
}

/// Makes test frames.
pub struct Frames;

/// Draws values 0..256 and converts each to an element.
fn draw<E: Copy>(mut view: ViewMut<'_, E>, pattern: Pattern, seq: u64, element: impl Fn(u8) -> E) {
    let (channels, height) = (view.channels, view.height);
    for y in 0..height {
        for (i, pixel) in view.row_mut(y).chunks_exact_mut(channels).enumerate() {
            let value = match pattern {
                Pattern::Ramp => (i as u64).wrapping_add(y as u64).wrapping_add(seq) as u8,
                Pattern::Noise => random::nth(seq + 1, (y as u64) << 32 | i as u64) as u8,
                Pattern::None => return,
            };
            pixel.fill(element(value));
        }
    }
}

impl Node for Frames {
    const INFO: NodeInfo = NodeInfo::compute("frames", "source", "Makes test frames.").source();
    type In<'f> = NoPorts;
    type Out<'f> = Out<'f>;
    type Params = FramesParams;

    fn open(_: &Open<'_>, _: &FramesParams) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Out<'f>, params: &FramesParams) -> Result<()> {
        let seq = cx.tick().seq;
        if params.count > 0 && seq >= params.count {
            cx.end();
            return Ok(());
        }
        cx.set_capture_ns((params.start_ms * 1e6 + seq as f64 * 1e9 / params.rate_hz) as i64);
        let (width, height, pattern) = (params.width_px, params.height_px, params.pattern);
        match params.format {
            Format::Gray8 => draw(out.image.alloc_as::<Gray8>(width, height)?, pattern, seq, |v| v),
            Format::Bgr8 => draw(out.image.alloc_as::<Bgr8>(width, height)?, pattern, seq, |v| v),
            Format::Rgba8 => draw(out.image.alloc_as::<Rgba8>(width, height)?, pattern, seq, |v| v),
            Format::Gray16 => draw(out.image.alloc_as::<Gray16>(width, height)?, pattern, seq, |v| u16::from(v) * 257),
            Format::F32 => draw(out.image.alloc_as::<GrayF32>(width, height)?, pattern, seq, |v| f32::from(v) / 255.0),
        }
        Ok(())
    }
}
