// Clears what is outside the mask and the strip around it that may be filled.

@group(0) @binding(1) var<storage, read> mask: array<u32>;
@group(0) @binding(2) var<storage, read> guide: array<u32>;
// For each row: columns of the strip, from and to before, and of the mask.
@group(0) @binding(3) var<storage, read> rows: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read_write> smooth_map: array<u32>;
@group(0) @binding(5) var<storage, read_write> confidences: array<f32>;

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= call.width || id.y >= call.height) {
        return;
    }
    let at = id.y * call.stride_mask + id.x;
    if (((mask[at >> 2u] >> ((at & 3u) * 8u)) & 255u) != 0u) {
        return;
    }
    let row = rows[id.y];
    let is_near = id.x >= row.x && id.x < row.y && (id.x < row.z || id.x >= row.w);
    if (call.beyond_px > 0u && is_near && levels(id.x, id.y).y > call.dark) {
        return;
    }
    smooth_map[id.y * call.stride_out + id.x] = NOT_A_NUMBER;
    confidences[id.y * call.stride_confidence + id.x] = 0.0;
}
