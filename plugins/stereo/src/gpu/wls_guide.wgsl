
fn guide_byte(at: u32) -> i32 {
    return i32((guide[at >> 2u] >> ((at & 3u) * 8u)) & 255u);
}

// Smallest and largest channel of a pixel of the guide.
fn levels(x: u32, y: u32) -> vec2<i32> {
    let at = y * call.stride_guide + x * call.channels;
    var found = vec2<i32>(guide_byte(at));
    for (var c = 1u; c < call.channels; c++) {
        let value = guide_byte(at + c);
        found = vec2<i32>(min(found.x, value), max(found.y, value));
    }
    return found;
}

fn is_exposed(x: u32, y: u32) -> bool {
    let found = levels(x, y);
    return found.x < call.highlight && found.y > call.dark;
}
