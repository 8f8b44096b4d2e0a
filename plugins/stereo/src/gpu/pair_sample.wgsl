// A small part of an image for the processor: each `step`-th pixel of a map, or means of blocks of bytes.

struct Sizes {
    // Columns and rows of the result; first pixel in the image.
    width: u32,
    height: u32,
    x: u32,
    y: u32,
    step: u32,
    // Bytes of a row of the image, and of a pixel: 1 or 4.
    stride: u32,
    pixel_bytes: u32,
    unused: u32,
}

@group(0) @binding(0) var<storage, read> sizes: Sizes;
@group(0) @binding(1) var<storage, read> source: array<u32>;
// One word for each pixel.
@group(0) @binding(2) var<storage, read_write> samples: array<u32>;

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= sizes.width || id.y >= sizes.height) {
        return;
    }
    let first = (sizes.y + id.y * sizes.step) * sizes.stride + (sizes.x + id.x * sizes.step) * sizes.pixel_bytes;
    if (sizes.pixel_bytes == 4u) {
        samples[id.y * sizes.width + id.x] = source[first >> 2u];
        return;
    }
    let area = sizes.step * sizes.step;
    var sum = area / 2u;
    for (var row = 0u; row < sizes.step; row++) {
        for (var column = 0u; column < sizes.step; column++) {
            let at = first + row * sizes.stride + column;
            sum += (source[at >> 2u] >> ((at & 3u) * 8u)) & 255u;
        }
    }
    samples[id.y * sizes.width + id.x] = sum / area;
}
