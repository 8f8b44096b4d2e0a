// Points and colours of all pixels.

@group(0) @binding(2) var<storage, read> depths: array<u32>;
@group(0) @binding(3) var<storage, read> image: array<u32>;

fn byte(at: u32) -> u32 {
    return (image[at >> 2u] >> ((at & 3u) * 8u)) & 255u;
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= call.width || id.y >= call.height) {
        return;
    }
    place(id.x, id.y, depths[id.y * call.stride + id.x]);
    let pixel = id.y * call.stride_image + id.x * call.channels;
    // The next channel, or the same one of a gray image.
    let next = select(0u, 1u, call.channels == 3u);
    cloud[4u * (id.y * call.width + id.x) + 3u] =
        byte(pixel) | (byte(pixel + next) << 8u) | (byte(pixel + 2u * next) << 16u);
}
