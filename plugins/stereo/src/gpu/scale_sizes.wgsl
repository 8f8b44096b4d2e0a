// What the kernels that shrink and enlarge images read about a call. Maps are bits of f32, because WGSL has no NaN.

struct Sizes {
    // Columns, rows and bytes of a row of the result, and of the image that it is made of.
    width: u32,
    height: u32,
    stride: u32,
    source_width: u32,
    source_height: u32,
    source_stride: u32,
    // Pixels of the larger one per pixel of the smaller one, each way.
    factor: u32,
    // Bytes of a pixel that is shrunk: 1 or 3.
    pixel_bytes: u32,
    // Values of maps become so many times as large.
    times: f32,
    // Neighbours with a larger difference are two surfaces.
    max_step: f32,
    // 1 where the last block continues over what no block covers, 0 where that is unknown.
    continues: u32,
    unused: u32,
}

@group(0) @binding(0) var<storage, read> sizes: Sizes;
@group(0) @binding(1) var<storage, read> source: array<u32>;
@group(0) @binding(2) var<storage, read_write> target_words: array<u32>;

const NOT_A_NUMBER = 0x7fc00000u;

fn is_finite(bits: u32) -> bool {
    return (bits & 0x7f800000u) != 0x7f800000u;
}

// A value of a map, as large as it is in the result.
fn scaled(bits: u32) -> u32 {
    return select(NOT_A_NUMBER, bitcast<u32>(bitcast<f32>(bits) * sizes.times), is_finite(bits));
}
