// Weights between neighbouring pixels of a guide: exp(-colour distance / sigma).

@group(0) @binding(1) var<storage, read> guide: array<u32>;
@group(0) @binding(2) var<storage, read_write> right: array<f32>;
@group(0) @binding(3) var<storage, read_write> down: array<f32>;

fn value(at: u32) -> i32 {
    return i32((guide[at >> 2u] >> ((at & 3u) * 8u)) & 255u);
}

fn weight(a: u32, b: u32) -> f32 {
    var sum = 0;
    for (var c = 0u; c < sizes.channels; c++) {
        let d = value(a + c) - value(b + c);
        sum += d * d;
    }
    return exp2(max(sqrt(f32(sum)) * sizes.factor, -100.0));
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= sizes.width || id.y >= sizes.height) {
        return;
    }
    let pixel = (sizes.y + id.y) * sizes.stride + (sizes.x + id.x) * sizes.channels;
    let at = id.y * sizes.width + id.x;
    right[at] = 0.0;
    down[at] = 0.0;
    if (id.x + 1u < sizes.width) {
        right[at] = weight(pixel, pixel + sizes.channels);
    }
    if (id.y + 1u < sizes.height) {
        down[at] = weight(pixel, pixel + sizes.stride);
    }
}
