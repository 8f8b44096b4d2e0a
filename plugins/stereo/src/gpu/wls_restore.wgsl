// Gives pixels of objects back their disparities.

struct Kept {
    count: u32,
    // Rows of the map times its columns, and columns.
    list: array<u32>,
}
@group(0) @binding(1) var<storage, read> kept: Kept;
@group(0) @binding(2) var<storage, read> disparities: array<u32>;
@group(0) @binding(3) var<storage, read_write> smooth_map: array<u32>;
@group(0) @binding(4) var<storage, read_write> confidences: array<f32>;

// Pixels of a row of threads.
const ROW = 4096u;

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let number = id.y * ROW + id.x;
    if (id.x >= ROW || number >= kept.count) {
        return;
    }
    let x = kept.list[number] % call.width;
    let y = kept.list[number] / call.width;
    smooth_map[y * call.stride_out + x] = disparities[y * call.stride + x];
    let at = y * call.stride_confidence + x;
    confidences[at] = max(confidences[at], KEPT_CONFIDENCE);
}
