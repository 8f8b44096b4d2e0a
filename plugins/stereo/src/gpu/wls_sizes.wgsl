// What the kernels of the weighted-least-squares filter read about a call.

struct Sizes {
    // The rectangle that is filtered, px: its size, and its place in the guide.
    width: u32,
    height: u32,
    x: u32,
    y: u32,
    // Bytes of a row of the guide, and of a pixel: 1 or 3.
    stride: u32,
    channels: u32,
    // A colour distance times this is the binary logarithm of a weight.
    factor: f32,
    // Strength of the smoothing in this round.
    strength: f32,
}

@group(0) @binding(0) var<storage, read> sizes: Sizes;
