// Fills in points of small holes and marks them.

// Index of the pixel and bits of its depth.
@group(0) @binding(2) var<storage, read> filled: array<vec2<u32>>;

// Points of a row of threads.
const ROW = 4096u;

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let number = id.y * ROW + id.x;
    if (id.x >= ROW || number >= call.count) {
        return;
    }
    let point = filled[number];
    place(point.x % call.width, point.x / call.width, point.y);
    cloud[4u * point.x + 3u] |= 1u << 24u;
}
