// Depths of a disparity map, as `reproject` of the processor.

struct Call {
    width: u32,
    height: u32,
    // Words of a row: of the disparities, of the confidence, 0 without one, and of the depths.
    stride: u32,
    stride_confidence: u32,
    stride_depth: u32,
    min_neighbours: u32,
    // Depth times disparity, px mm; what is added to a disparity, px.
    scale: f32,
    shift: f32,
    near_mm: f32,
    far_mm: f32,
    min_confidence: f32,
    step_px: f32,
}

@group(0) @binding(0) var<storage, read> call: Call;
// Bits of f32, because WGSL has no NaN.
@group(0) @binding(1) var<storage, read> disparities: array<u32>;
@group(0) @binding(2) var<storage, read> confidences: array<u32>;
@group(0) @binding(3) var<storage, read_write> depths: array<u32>;
// Number of known depths.
@group(0) @binding(4) var<storage, read_write> total: atomic<u32>;

const NOT_A_NUMBER = 0x7fc00000u;

var<workgroup> known: atomic<u32>;

fn is_unknown(bits: u32) -> bool {
    return (bits & 0x7fffffffu) > 0x7f800000u;
}

fn depth(x: u32, y: u32) -> u32 {
    let bits = disparities[y * call.stride + x];
    let d = bitcast<f32>(bits);
    if (is_unknown(bits) || d + call.shift == 0.0) {
        return NOT_A_NUMBER;
    }
    let z = call.scale / (d + call.shift);
    var is_kept = z >= call.near_mm && z <= call.far_mm;
    var same = 0u;
    var there = 0u;
    for (var row = max(y, 1u) - 1u; row <= min(y + 1u, call.height - 1u); row++) {
        for (var column = max(x, 1u) - 1u; column <= min(x + 1u, call.width - 1u); column++) {
            if (row != y || column != x) {
                let other = disparities[row * call.stride + column];
                there++;
                same += select(0u, 1u, !is_unknown(other) && abs(bitcast<f32>(other) - d) <= call.step_px);
            }
        }
    }
    // At the border fewer neighbours exist; the share that must agree is the same.
    is_kept = is_kept && same * 8u >= min(call.min_neighbours, 8u) * there;
    if (call.stride_confidence > 0u) {
        let confidence = confidences[y * call.stride_confidence + x];
        is_kept = is_kept && !is_unknown(confidence) && bitcast<f32>(confidence) >= call.min_confidence;
    }
    return select(NOT_A_NUMBER, bitcast<u32>(z), is_kept);
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    if (thread == 0u) {
        atomicStore(&known, 0u);
    }
    workgroupBarrier();
    if (id.x < call.width && id.y < call.height) {
        let z = depth(id.x, id.y);
        depths[id.y * call.stride_depth + id.x] = z;
        if (z != NOT_A_NUMBER) {
            atomicAdd(&known, 1u);
        }
    }
    workgroupBarrier();
    if (thread == 0u) {
        atomicAdd(&total, atomicLoad(&known));
    }
}
