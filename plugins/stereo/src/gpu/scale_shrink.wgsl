// Means of blocks in gray, rounded: the same bytes as `shrink_gray` of the processor.

fn byte(at: u32) -> u32 {
    return (source[at >> 2u] >> ((at & 3u) * 8u)) & 255u;
}

// BT.601 in 15-bit fixed point, rounded.
fn gray(at: u32) -> u32 {
    if (sizes.pixel_bytes == 1u) {
        return byte(at);
    }
    return (byte(at) * 3735u + byte(at + 1u) * 19235u + byte(at + 2u) * 9798u + 16384u) >> 15u;
}

fn mean(x: u32, y: u32) -> u32 {
    let area = sizes.factor * sizes.factor;
    var sum = area / 2u;
    for (var row = y * sizes.factor; row < (y + 1u) * sizes.factor; row++) {
        let first = row * sizes.source_stride;
        for (var column = x * sizes.factor; column < (x + 1u) * sizes.factor; column++) {
            sum += gray(first + column * sizes.pixel_bytes);
        }
    }
    return sum / area;
}

// A thread makes four pixels, one word.
@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = id.x * 4u;
    if (first >= sizes.width || id.y >= sizes.height) {
        return;
    }
    var word = 0u;
    for (var i = 0u; i < min(sizes.width - first, 4u); i++) {
        word |= mean(first + i, id.y) << (8u * i);
    }
    target_words[id.y * (sizes.stride >> 2u) + id.x] = word;
}
