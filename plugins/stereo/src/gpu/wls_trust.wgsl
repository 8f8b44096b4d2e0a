// Confidence of the disparities, given or as `Confidence` of the processor, and disparity times confidence.

@group(0) @binding(1) var<storage, read> disparities: array<u32>;
// The given confidence, or the right view's disparities; else anything.
@group(0) @binding(2) var<storage, read> others: array<u32>;
@group(0) @binding(3) var<storage, read> guide: array<u32>;
@group(0) @binding(4) var<storage, read_write> product: array<f32>;
@group(0) @binding(5) var<storage, read_write> support: array<f32>;

const STEPS_PER_PX = 4.0;
const MAX_STEPS = 2047.0;

// Confidence by the scatter around a pixel.
fn scatter(x: u32, y: u32) -> f32 {
    let r = call.radius;
    var count = 0u;
    var sum = 0u;
    var squares = 0u;
    for (var row = max(y, call.y + r) - r; row < min(y + r + 1u, call.y + call.rows); row++) {
        for (var column = max(x, call.x + r) - r; column < min(x + r + 1u, call.x + call.columns); column++) {
            let bits = disparities[row * call.stride + column];
            if (is_finite(bits)) {
                let steps = u32(clamp(bitcast<f32>(bits) * STEPS_PER_PX, 0.0, MAX_STEPS));
                count++;
                sum += steps;
                squares += steps * steps;
            }
        }
    }
    let share = 1.0 / f32(max(count, 1u));
    let mean = f32(sum) * share;
    let variance = f32(squares >> 1u) * 2.0 * share - mean * mean;
    let matched = min(f32(count) * call.full, 1.0);
    return clamp(1.0 - call.loss * max(variance, 0.0), 0.0, 1.0) * (matched * matched);
}

fn trust(x: u32, y: u32, bits: u32) -> f32 {
    if (!is_finite(bits)) {
        return 0.0;
    }
    if (call.stride_given > 0u) {
        let given = others[y * call.stride_given + x];
        return select(0.0, clamp(bitcast<f32>(given), 0.0, 1.0), is_finite(given));
    }
    if (call.stride_right > 0u) {
        let there = f32(x) - bitcast<f32>(bits) + 0.5;
        if (there < 0.0 || there >= f32(call.width)) {
            return 0.0;
        }
        if (!is_near(bits, others[y * call.stride_right + u32(there)], call.left_right_px)) {
            return 0.0;
        }
    }
    if (!is_exposed(x, y)) {
        return 0.0;
    }
    if (call.radius == 0u) {
        return 1.0;
    }
    return scatter(x, y);
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= call.columns || id.y >= call.rows) {
        return;
    }
    let x = call.x + id.x;
    let y = call.y + id.y;
    let bits = disparities[y * call.stride + x];
    let confidence = trust(x, y, bits);
    let at = id.y * call.columns + id.x;
    support[at] = confidence;
    product[at] = 0.0;
    if (confidence > 0.0) {
        product[at] = bitcast<f32>(bits) * confidence;
    }
}
