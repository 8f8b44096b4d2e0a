// Brings an image to a smaller size: each pixel is the mean of the pixels under it, with the roundings of the processor. At its own size the image is
// copied.

struct Sizes {
    // Columns and rows of the result, and of the image.
    width: u32,
    height: u32,
    source_width: u32,
    source_height: u32,
    // Bytes of a row of the image; words of a row of the result, and its first word; first byte of the image.
    source_stride: u32,
    stride: u32,
    start: u32,
    source_start: u32,
}

@group(0) @binding(0) var<storage, read> sizes: Sizes;
@group(0) @binding(1) var<storage, read> source: array<u32>;
@group(0) @binding(2) var<storage, read_write> target_words: array<u32>;

fn source_word(at: u32) -> u32 {
    return source[at];
}

// First pixel under pixel `at` of `all`, and the one after the last.
fn span(at: u32, all: u32, source_all: u32) -> vec2<u32> {
    let first = at * source_all / all;
    return vec2<u32>(first, max((at + 1u) * source_all / all, first + 1u));
}

fn pixel(x: u32, y: u32) -> vec3<u32> {
    return vec3<u32>(left_pixel(two_pixels(sizes.source_start + y * sizes.source_stride + 3u * x)));
}

fn mean_of_two(a: vec3<u32>, b: vec3<u32>) -> vec3<u32> {
    return (a + b + vec3<u32>(1u)) >> vec3<u32>(1u);
}

fn mean(columns: vec2<u32>, rows: vec2<u32>) -> vec3<u32> {
    if (sizes.source_width <= 2u * sizes.width && sizes.source_height <= 2u * sizes.height) {
        let right = columns.y - 1u;
        let bottom = rows.y - 1u;
        return mean_of_two(
            mean_of_two(pixel(columns.x, rows.x), pixel(columns.x, bottom)),
            mean_of_two(pixel(right, rows.x), pixel(right, bottom)),
        );
    }
    var sum = vec3<u32>(0u);
    for (var y = rows.x; y < rows.y; y++) {
        for (var x = columns.x; x < columns.y; x++) {
            sum += pixel(x, y);
        }
    }
    let count = (columns.y - columns.x) * (rows.y - rows.x);
    // The processor adds up to 257 pixels in 16 bits and multiplies by the reciprocal.
    if (count <= 257u) {
        let share = ((1u << 20u) + count / 2u) / count;
        return (sum * share + vec3<u32>(1u << 19u)) >> vec3<u32>(20u);
    }
    return (sum + vec3<u32>(count / 2u)) / vec3<u32>(count);
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = id.x * 4u;
    if (first >= sizes.width || id.y >= sizes.height) {
        return;
    }
    let rows = span(id.y, sizes.height, sizes.source_height);
    var pixels: array<u32, 4>;
    for (var i = 0u; i < 4u; i++) {
        pixels[i] = 0u;
        if (first + i < sizes.width) {
            pixels[i] = joined(vec3<i32>(mean(span(first + i, sizes.width, sizes.source_width), rows)));
        }
    }
    store_four(sizes.start + id.y * sizes.stride + id.x * 3u, pixels);
}
