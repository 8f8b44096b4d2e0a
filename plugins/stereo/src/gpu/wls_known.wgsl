// The rows and grains of columns in which a disparity is known.

@group(0) @binding(1) var<storage, read> disparities: array<u32>;
struct Bounds {
    // First and last grain, first and last row.
    first: atomic<u32>,
    last: atomic<u32>,
    top: atomic<u32>,
    low: atomic<u32>,
}
@group(0) @binding(2) var<storage, read_write> bounds: Bounds;

const GRAIN_PX = 32u;

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x * GRAIN_PX >= call.width || id.y >= call.height) {
        return;
    }
    for (var x = id.x * GRAIN_PX; x < min((id.x + 1u) * GRAIN_PX, call.width); x++) {
        if (is_finite(disparities[id.y * call.stride + x])) {
            atomicMin(&bounds.first, id.x);
            atomicMax(&bounds.last, id.x);
            atomicMin(&bounds.top, id.y);
            atomicMax(&bounds.low, id.y);
            return;
        }
    }
}
