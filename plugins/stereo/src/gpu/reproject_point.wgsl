// What the kernels that make points of a cloud share.

struct Call {
    width: u32,
    height: u32,
    // Words of a row of the depths, bytes of one of the image, and bytes of its pixels: 1 or 3.
    stride: u32,
    stride_image: u32,
    channels: u32,
    // Of the points that are filled in.
    count: u32,
    // The left camera: middle, px, and angle of a pixel.
    cx: f32,
    cy: f32,
    per_px: f32,
}

@group(0) @binding(0) var<storage, read> call: Call;
// Four words for each point: position, bits of f32, and colour.
@group(0) @binding(1) var<storage, read_write> cloud: array<u32>;

const NOT_A_NUMBER = 0x7fc00000u;

// Writes the position of a point, by the bits of its depth.
fn place(x: u32, y: u32, bits: u32) {
    let at = 4u * (y * call.width + x);
    let z = bitcast<f32>(bits);
    let is_known = bits != NOT_A_NUMBER;
    cloud[at] = select(NOT_A_NUMBER, bitcast<u32>((f32(x) - call.cx) * call.per_px * z), is_known);
    cloud[at + 1u] = select(NOT_A_NUMBER, bitcast<u32>((f32(y) - call.cy) * call.per_px * z), is_known);
    cloud[at + 2u] = bits;
}
