// Paints a map of numbers in colours, and to its right a strip that the processor has drawn.

struct Sizes {
    // Columns of the map, and of the image; rows of both.
    width: u32,
    all: u32,
    height: u32,
    // Numbers from one row of the map to the next; words of a row of the image; bytes of a row of the strip.
    map_stride: u32,
    stride: u32,
    strip_stride: u32,
    // Number of the first colour, and colours per unit, as bits.
    low: u32,
    scale: u32,
}

@group(0) @binding(0) var<storage, read> sizes: Sizes;
@group(0) @binding(1) var<storage, read> map: array<u32>;
// 256 colours of the scale; those below and above it; that of unknown numbers.
@group(0) @binding(2) var<storage, read> colors: array<u32, 259>;
@group(0) @binding(3) var<storage, read> strip: array<u32>;
@group(0) @binding(4) var<storage, read_write> target_words: array<u32>;

fn source_word(at: u32) -> u32 {
    return strip[at];
}

fn color(bits: u32) -> u32 {
    let magnitude = bits & 0x7fffffffu;
    // Shaders need not know numbers that are not finite.
    if (magnitude > 0x7f800000u) {
        return colors[258];
    }
    var value = bitcast<f32>(bits);
    if (magnitude == 0x7f800000u) {
        value = select(1e30, -1e30, magnitude != bits);
    }
    let place = (value - bitcast<f32>(sizes.low)) * bitcast<f32>(sizes.scale);
    if (place < -0.5) {
        return colors[256];
    }
    if (place > 255.5) {
        return colors[257];
    }
    return colors[min(u32(place + 0.5), 255u)];
}

@compute @workgroup_size(32, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = id.x * 4u;
    if (first >= sizes.all || id.y >= sizes.height) {
        return;
    }
    var pixels: array<u32, 4>;
    for (var i = 0u; i < 4u; i++) {
        let x = first + i;
        pixels[i] = 0u;
        if (x < sizes.width) {
            pixels[i] = color(map[id.y * sizes.map_stride + x]);
        } else if (x < sizes.all) {
            pixels[i] = joined(left_pixel(two_pixels(id.y * sizes.strip_stride + 3u * (x - sizes.width))));
        }
    }
    store_four(id.y * sizes.stride + id.x * 3u, pixels);
}
