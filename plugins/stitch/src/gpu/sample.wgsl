// Samples of a view between its pixels, as on the processor.

fn round_multiply(a: vec3<i32>, b: vec3<i32>) -> vec3<i32> {
    return (a * b + vec3<i32>(0x4000)) >> vec3<u32>(15u);
}

// Mean of the four pixels whose upper left one begins at byte `offset` of a view with `stride` bytes per row, times `gain` in 1/16384.
// Weights: of the left and of the right column in 1/64, of the lower row in 1/16384.
fn between(offset: u32, stride: u32, left: i32, right: i32, lower: i32, gain: vec3<i32>) -> u32 {
    let top = two_pixels(offset);
    let bottom = two_pixels(offset + stride);
    let t = left_pixel(top) * left + right_pixel(top) * right;
    let b = left_pixel(bottom) * left + right_pixel(bottom) * right;
    let value = t + round_multiply((b - t) * 2, vec3<i32>(lower));
    let gained = (round_multiply(value, gain) + vec3<i32>(16)) >> vec3<u32>(5u);
    return joined(clamp(gained, vec3<i32>(0), vec3<i32>(255)));
}
