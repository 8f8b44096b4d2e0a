// Patches of a gray image for the processor, one after the other, each from a whole word on.

struct Patches {
    // Bytes of a row of the image; columns of a patch, and its bytes; number of patches.
    stride: u32,
    width: u32,
    bytes: u32,
    count: u32,
    // Byte of the image where each patch begins.
    first: array<u32>,
}

@group(0) @binding(0) var<storage, read> call: Patches;
@group(0) @binding(1) var<storage, read> source: array<u32>;
@group(0) @binding(2) var<storage, read_write> patches: array<u32>;

// A thread makes a word of a patch.
@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let words = (call.bytes + 3u) / 4u;
    if (id.x >= words || id.y >= call.count) {
        return;
    }
    var word = 0u;
    for (var i = 0u; i < min(call.bytes - 4u * id.x, 4u); i++) {
        let pixel = 4u * id.x + i;
        let at = call.first[id.y] + pixel / call.width * call.stride + pixel % call.width;
        word |= ((source[at >> 2u] >> ((at & 3u) * 8u)) & 255u) << (8u * i);
    }
    patches[id.y * words + id.x] = word;
}
