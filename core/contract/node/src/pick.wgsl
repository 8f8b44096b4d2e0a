// Chosen rows and columns of an image.

struct Call {
    // Words of a row of the result, and its rows.
    width: u32,
    height: u32,
    // Bytes of a row of the image, and of a pixel.
    stride: u32,
    pixel_bytes: u32,
    // Pixels of a row of the result.
    columns: u32,
    // Index of the first column in `chosen`; rows follow.
    first: u32,
    // First word of the result.
    start: u32,
}

@group(0) @binding(0) var<storage, read> call: Call;
@group(0) @binding(1) var<storage, read> chosen: array<u32>;
@group(0) @binding(2) var<storage, read> image: array<u32>;
@group(0) @binding(3) var<storage, read_write> picked: array<u32>;

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= call.width || id.y >= call.height) {
        return;
    }
    let at = call.start + id.y * call.width + id.x;
    let row = chosen[call.first + call.columns + id.y] * call.stride;
    if (call.pixel_bytes % 4u == 0u) {
        let words = call.pixel_bytes / 4u;
        picked[at] = image[row / 4u + chosen[call.first + id.x / words] * words + id.x % words];
        return;
    }
    var word = 0u;
    for (var i = 0u; i < 4u; i++) {
        let pixel = (4u * id.x + i) / call.pixel_bytes;
        if (pixel < call.columns) {
            let byte = row + chosen[call.first + pixel] * call.pixel_bytes + (4u * id.x + i) % call.pixel_bytes;
            word |= ((image[byte / 4u] >> (8u * (byte % 4u))) & 255u) << (8u * i);
        }
    }
    picked[at] = word;
}
