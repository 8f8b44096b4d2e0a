// The middle of every block of a map.

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= sizes.width || id.y >= sizes.height) {
        return;
    }
    let middle = id.xy * sizes.factor + sizes.factor / 2u;
    target_words[id.y * (sizes.stride >> 2u) + id.x] = scaled(source[middle.y * (sizes.source_stride >> 2u) + middle.x]);
}
