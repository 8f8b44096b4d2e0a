// Pixels of three bytes in arrays of words. The kernel declares `source_word`, which returns a word of the image that is read, and array
// `target_words`.

// The six bytes of two neighbouring pixels that begin at byte `at`: four in x, two in y.
fn two_pixels(at: u32) -> vec2<u32> {
    let word = at >> 2u;
    let shift = (at & 3u) * 8u;
    let w0 = source_word(word);
    let w1 = source_word(word + 1u);
    if (shift == 0u) {
        return vec2<u32>(w0, w1);
    }
    let w2 = source_word(word + 2u);
    return vec2<u32>((w0 >> shift) | (w1 << (32u - shift)), (w1 >> shift) | (w2 << (32u - shift)));
}

fn left_pixel(six: vec2<u32>) -> vec3<i32> {
    return vec3<i32>(vec3<u32>(six.x & 255u, (six.x >> 8u) & 255u, (six.x >> 16u) & 255u));
}

fn right_pixel(six: vec2<u32>) -> vec3<i32> {
    return vec3<i32>(vec3<u32>(six.x >> 24u, six.y & 255u, (six.y >> 8u) & 255u));
}

fn joined(pixel: vec3<i32>) -> u32 {
    let p = vec3<u32>(pixel);
    return p.x | (p.y << 8u) | (p.z << 16u);
}

// Four pixels as three words of `target_words`.
fn store_four(at: u32, p: array<u32, 4>) {
    target_words[at] = p[0] | (p[1] << 24u);
    target_words[at + 1u] = (p[1] >> 8u) | (p[2] << 16u);
    target_words[at + 2u] = (p[2] >> 16u) | (p[3] << 8u);
}
