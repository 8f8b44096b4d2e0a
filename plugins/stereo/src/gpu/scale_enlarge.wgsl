// A map enlarged linearly within surfaces, or each of its values over its block.

// Between two values, `share` of the way; the nearer of them where they are too far apart or one is unknown.
fn between(a: u32, b: u32, share: f32, max_step: f32) -> u32 {
    let first = bitcast<f32>(a);
    let way = bitcast<f32>(b) - first;
    if (is_finite(a) && is_finite(b) && abs(way) <= max_step) {
        return bitcast<u32>(first + way * share);
    }
    return select(b, a, share < 0.5);
}

// Blocks before and after a pixel of a line of `count` blocks, and, in pairs of their sides, the way from the first one's middle.
fn blocks(at: u32, count: u32) -> vec3<u32> {
    // No block is before the first one's middle, and none after the last one's.
    let way = max(2u * at + 1u, sizes.factor) - sizes.factor;
    let first = way / (2u * sizes.factor);
    if (first + 1u >= count) {
        return vec3<u32>(count - 1u, count - 1u, 0u);
    }
    return vec3<u32>(first, first + 1u, way % (2u * sizes.factor));
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= sizes.width || id.y >= sizes.height) {
        return;
    }
    let source_size = vec2<u32>(sizes.source_width, sizes.source_height);
    let target_at = id.y * (sizes.stride >> 2u) + id.x;
    if (sizes.continues == 0u && any(id.xy >= source_size * sizes.factor)) {
        target_words[target_at] = NOT_A_NUMBER;
        return;
    }
    let across = blocks(id.x, source_size.x);
    let down = blocks(id.y, source_size.y);
    let shares = vec2<f32>(f32(across.z), f32(down.z)) / f32(2u * sizes.factor);
    let rows = down.xy * (sizes.source_stride >> 2u);
    let left = scaled(between(source[rows.x + across.x], source[rows.y + across.x], shares.y, sizes.max_step));
    let right = scaled(between(source[rows.x + across.y], source[rows.y + across.y], shares.y, sizes.max_step));
    target_words[target_at] = between(left, right, shares.x, sizes.max_step * sizes.times);
}
