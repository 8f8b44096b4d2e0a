// Resamples a view through a map, bilinear in 1/32 px: the same bytes as on the processor.

struct Sizes {
    width: u32,
    height: u32,
    // Words of a row of the result.
    stride: u32,
    // Bytes of a row of the view, and of its start.
    source_stride: u32,
    source_start: u32,
    // First word of the result.
    target_start: u32,
    // Side of the blocks whose mean is taken; with 1 the map is followed.
    block: u32,
    unused: u32,
}

@group(0) @binding(0) var<storage, read> sizes: Sizes;
@group(0) @binding(1) var<storage, read> source: array<u32>;
// For each pixel: row and column of the upper left neighbour; then fractions of two pixels in a word.
@group(0) @binding(2) var<storage, read> corners: array<u32>;
@group(0) @binding(3) var<storage, read> fractions: array<u32>;
@group(0) @binding(4) var<storage, read_write> target_words: array<u32>;

fn source_word(at: u32) -> u32 {
    return source[at];
}

fn turned(x: u32, y: u32) -> u32 {
    let at = y * sizes.width + x;
    let fraction = (fractions[at >> 1u] >> ((at & 1u) * 16u)) & 0xffffu;
    if (fraction == 0xffffu) {
        return 0u;
    }
    let corner = corners[at];
    let offset = sizes.source_start + (corner >> 16u) * sizes.source_stride + (corner & 0xffffu) * 3u;
    let right = i32(fraction & 255u);
    let down = i32(fraction >> 8u);
    let upper = two_pixels(offset);
    let lower = two_pixels(offset + sizes.source_stride);
    let u = left_pixel(upper) * (32 - right) + right_pixel(upper) * right;
    let l = left_pixel(lower) * (32 - right) + right_pixel(lower) * right;
    return joined((u * (32 - down) + l * down + vec3<i32>(512)) >> vec3<u32>(10u));
}

fn mean(x: u32, y: u32) -> u32 {
    var sum = vec3<i32>(0);
    for (var dy = 0u; dy < sizes.block; dy++) {
        let row = sizes.source_start + (y * sizes.block + dy) * sizes.source_stride + x * sizes.block * 3u;
        for (var dx = 0u; dx < sizes.block; dx++) {
            sum += left_pixel(two_pixels(row + dx * 3u));
        }
    }
    let area = i32(sizes.block * sizes.block);
    return joined((sum + vec3<i32>(area / 2)) / vec3<i32>(area));
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = id.x * 4u;
    if (first >= sizes.width || id.y >= sizes.height) {
        return;
    }
    var pixels: array<u32, 4>;
    for (var i = 0u; i < 4u; i++) {
        let x = first + i;
        pixels[i] = 0u;
        if (x < sizes.width) {
            if (sizes.block > 1u) {
                pixels[i] = mean(x, id.y);
            } else {
                pixels[i] = turned(x, id.y);
            }
        }
    }
    store_four(sizes.target_start + id.y * sizes.stride + id.x * 3u, pixels);
}
