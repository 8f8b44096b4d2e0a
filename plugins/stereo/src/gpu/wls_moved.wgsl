// Lists the pixels that the filter has moved or removed although both views agree on them, see `MovedPixel` of the
// processor.

@group(0) @binding(1) var<storage, read> disparities: array<u32>;
// The right view's disparities, or the given confidence.
@group(0) @binding(2) var<storage, read> others: array<u32>;
@group(0) @binding(3) var<storage, read> guide: array<u32>;
@group(0) @binding(4) var<storage, read> smooth_map: array<u32>;
struct Moved {
    count: atomic<u32>,
    unused: u32,
    // Index of the pixel in the rectangle; exposed 1, joins left 2, joins above 4, contacts times 8.
    list: array<vec2<u32>>,
}
@group(0) @binding(5) var<storage, read_write> moved: Moved;

fn disparity(x: u32, y: u32) -> u32 {
    return disparities[y * call.stride + x];
}

fn is_agreed(x: u32, y: u32, bits: u32) -> bool {
    let d = bitcast<f32>(bits);
    if (!is_seen_by_both(x, d)) {
        return false;
    }
    if (call.stride_right == 0u) {
        let given = others[y * call.stride_given + x];
        return is_finite(given) && bitcast<f32>(given) >= KEPT_CONFIDENCE;
    }
    let there = min(u32(max(floor(f32(x) - d + 0.5), 0.0)), call.width - 1u);
    return is_near(bits, others[y * call.stride_right + there], call.left_right_px);
}

// Whether a neighbour is of the same surface and where it was.
fn is_kept(bits: u32, x: u32, y: u32) -> bool {
    let other = disparity(x, y);
    return is_near(bits, other, MAX_STEP_PX) && is_near(other, smooth_map[y * call.stride_out + x], call.left_right_px);
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= call.columns || id.y >= call.rows) {
        return;
    }
    let x = call.x + id.x;
    let y = call.y + id.y;
    let bits = disparity(x, y);
    let is_moved = is_finite(bits) && !is_near(bits, smooth_map[y * call.stride_out + x], call.left_right_px);
    if (!is_moved || !is_agreed(x, y, bits)) {
        return;
    }
    var code = select(0u, 1u, is_exposed(x, y));
    if (id.x > 0u) {
        code |= select(0u, 2u, is_near(bits, disparity(x - 1u, y), MAX_STEP_PX));
        code += select(0u, 8u, is_kept(bits, x - 1u, y));
    }
    if (id.y > 0u) {
        code |= select(0u, 4u, is_near(bits, disparity(x, y - 1u), MAX_STEP_PX));
        code += select(0u, 8u, is_kept(bits, x, y - 1u));
    }
    if (id.x + 1u < call.columns) {
        code += select(0u, 8u, is_kept(bits, x + 1u, y));
    }
    if (id.y + 1u < call.rows) {
        code += select(0u, 8u, is_kept(bits, x, y + 1u));
    }
    moved.list[atomicAdd(&moved.count, 1u)] = vec2<u32>(id.y * call.columns + id.x, code);
}
