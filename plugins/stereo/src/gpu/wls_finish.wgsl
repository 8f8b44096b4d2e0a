// The smoothed map and its confidence, from the smoothed planes.

@group(0) @binding(1) var<storage, read> product: array<f32>;
@group(0) @binding(2) var<storage, read> support: array<f32>;
@group(0) @binding(3) var<storage, read_write> smooth_map: array<u32>;
@group(0) @binding(4) var<storage, read_write> confidences: array<f32>;

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= call.width || id.y >= call.height) {
        return;
    }
    var value = NOT_A_NUMBER;
    var confidence = 0.0;
    let is_inside = id.x >= call.x && id.x < call.x + call.columns && id.y >= call.y && id.y < call.y + call.rows;
    if (is_inside) {
        let at = (id.y - call.y) * call.columns + id.x - call.x;
        confidence = support[at];
        if (confidence >= call.least) {
            let found = product[at] / confidence;
            // A pixel outside the right view is not measured, however smooth the surface beside it.
            if (is_seen_by_both(id.x, found)) {
                value = bitcast<u32>(found);
            }
        }
    }
    smooth_map[id.y * call.stride_out + id.x] = value;
    confidences[id.y * call.stride_confidence + id.x] = confidence;
}
