// Which depths are unknown: one bit for each, in whole words for each row.

struct Call {
    width: u32,
    height: u32,
    // Words of a row of the depths.
    stride: u32,
}

@group(0) @binding(0) var<storage, read> call: Call;
// Bits of f32, because WGSL has no NaN.
@group(0) @binding(1) var<storage, read> depths: array<u32>;
@group(0) @binding(2) var<storage, read_write> unknown: array<u32>;

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let words = (call.width + 31u) / 32u;
    if (id.x >= words || id.y >= call.height) {
        return;
    }
    let first = 32u * id.x;
    var word = 0u;
    for (var i = 0u; i < min(32u, call.width - first); i++) {
        let is_unknown = (depths[id.y * call.stride + first + i] & 0x7fffffffu) > 0x7f800000u;
        word |= select(0u, 1u << i, is_unknown);
    }
    unknown[id.y * words + id.x] = word;
}
