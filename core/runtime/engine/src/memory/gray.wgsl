// Gray from colour, BT.601 in 15-bit fixed point, rounded: the same bytes as on the processor.

struct Sizes {
    width: u32,
    height: u32,
    // Bytes of a row of the colours, and of the gray values.
    source_stride: u32,
    stride: u32,
}

@group(0) @binding(0) var<storage, read> sizes: Sizes;
@group(0) @binding(1) var<storage, read> source: array<u32>;
@group(0) @binding(2) var<storage, read_write> target_words: array<u32>;

fn byte(at: u32) -> u32 {
    return (source[at >> 2u] >> ((at & 3u) * 8u)) & 255u;
}

// A thread makes four pixels, one word.
@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = id.x * 4u;
    if (first >= sizes.width || id.y >= sizes.height) {
        return;
    }
    var word = 0u;
    for (var i = 0u; i < 4u; i++) {
        let x = first + i;
        if (x < sizes.width) {
            let at = id.y * sizes.source_stride + x * 3u;
            let gray = (byte(at) * 3735u + byte(at + 1u) * 19235u + byte(at + 2u) * 9798u + 16384u) >> 15u;
            word |= gray << (8u * i);
        }
    }
    target_words[(id.y * sizes.stride >> 2u) + id.x] = word;
}
