// Picks every n-th number of every n-th row of a map.

struct Sizes {
    // Columns and rows that are picked.
    width: u32,
    height: u32,
    step: u32,
    // Numbers from one row of the map to the next; first number of the result.
    stride: u32,
    start: u32,
}

@group(0) @binding(0) var<storage, read> sizes: Sizes;
@group(0) @binding(1) var<storage, read> map: array<u32>;
@group(0) @binding(2) var<storage, read_write> picked: array<u32>;

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x < sizes.width && id.y < sizes.height) {
        picked[sizes.start + id.y * sizes.width + id.x] = map[id.y * sizes.step * sizes.stride + id.x * sizes.step];
    }
}
