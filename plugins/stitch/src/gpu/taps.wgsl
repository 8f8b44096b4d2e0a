// Samples one or two views at positions that the processor has found.

struct Head {
    // Samples of the first view, and of both.
    first: u32,
    all: u32,
    // Bytes of a row of each view.
    strides: vec2<u32>,
}

@group(0) @binding(0) var<storage, read> head: Head;
@group(0) @binding(1) var<storage, read> first_view: array<u32>;
@group(0) @binding(2) var<storage, read> second_view: array<u32>;
// Byte offset of each sample, and its weights: of the left and of the right column, one byte each, and of the lower row, two bytes.
@group(0) @binding(3) var<storage, read> positions: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> target_words: array<u32>;

// The view that this thread reads.
var<private> shown_view: u32;

fn source_word(at: u32) -> u32 {
    if (shown_view == 0u) {
        return first_view[at];
    }
    return second_view[at];
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let index = id.y * 1024u + id.x;
    if (index >= head.all) {
        return;
    }
    shown_view = select(0u, 1u, index >= head.first);
    let position = positions[index];
    let weights = vec3<i32>(vec3<u32>(position.y & 255u, (position.y >> 8u) & 255u, position.y >> 16u));
    let stride = select(head.strides.x, head.strides.y, shown_view == 1u);
    target_words[index] = between(position.x, stride, weights.x, weights.y, weights.z, vec3<i32>(16384));
}
