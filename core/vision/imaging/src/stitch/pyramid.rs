//! Pyramid kernels on rows of four i16 lanes per pixel: difference in B, G, R (1/8 level) and weight (1024 = one). If
//! only weights are blurred, rows have one lane: the weight.
//!
//! With values up to 2040 every intermediate sum fits in 16 bits. Reconstruction is exact: where all weights are one
//! (or zero) the collapsed pyramid gives back the difference (or zero) to the bit.

/// Lanes per pixel.
pub const LANES: usize = 4;
/// Weight of one.
pub const ONE: i16 = 1024;
/// Padding in pixels before and after a scratch row, so that filters need no border case.
pub const PAD: usize = 4;

macro_rules! dispatch {
    ($(#[$doc:meta])* $name:ident, $avx2:ident, $body:ident, manual, ($($arg:ident: $ty:ty),*)) => {
        $(#[$doc])*
        pub fn $name($($arg: $ty,)* use_avx2: bool) {
            #[cfg(target_arch = "x86_64")]
            if use_avx2 {
                // SAFETY: the caller found AVX2 on this CPU.
                unsafe { simd::$avx2($($arg),*) };
                return;
            }
            let _ = use_avx2;
            $body($($arg),*);
        }
    };
    ($(#[$doc:meta])* $name:ident, $avx2:ident, $body:ident, ($($arg:ident: $ty:ty),*)) => {
        $(#[$doc])*
        pub fn $name($($arg: $ty,)* use_avx2: bool) {
            #[cfg(target_arch = "x86_64")]
            if use_avx2 {
                // SAFETY: the caller found AVX2 on this CPU.
                unsafe { $avx2($($arg),*) };
                return;
            }
            let _ = use_avx2;
            $body($($arg),*);
        }

        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2")]
        fn $avx2($($arg: $ty),*) {
            $body($($arg),*);
        }
    };
}

dispatch!(
    /// `out = (a + 4 b + 6 c + 4 d + e) / 16`, element by element.
    vertical_down, vertical_down_avx2, vertical_down_body, (rows: [&[i16]; 5], out: &mut [i16])
);
dispatch!(
    /// Halves a padded row with the same kernel.
    horizontal_down, horizontal_down_avx2, horizontal_down_body, manual, (padded: &[i16], out: &mut [i16])
);
dispatch!(
    /// `out = (a + 6 b + c) / 8`, element by element: an even row between its neighbours.
    vertical_even, vertical_even_avx2, vertical_even_body, (a: &[i16], b: &[i16], c: &[i16], out: &mut [i16])
);
dispatch!(
    /// `out = (a + b) / 2`, element by element: an odd row.
    vertical_odd, vertical_odd_avx2, vertical_odd_body, (a: &[i16], b: &[i16], out: &mut [i16])
);
dispatch!(
    /// Doubles a padded row.
    horizontal_up, horizontal_up_avx2, horizontal_up_body, manual, (padded: &[i16], out: &mut [i16])
);
dispatch!(
    /// Extracts the weights, lane 3, of a row.
    weights_of, weights_of_avx2, weights_of_body, (pixels: &[i16], out: &mut [i16])
);
dispatch!(
    /// Halves a padded row of one lane.
    horizontal_down_one, horizontal_down_one_avx2, horizontal_down_one_body, (padded: &[i16], out: &mut [i16])
);
dispatch!(
    /// Doubles a padded row of one lane.
    horizontal_up_one, horizontal_up_one_avx2, horizontal_up_one_body, (padded: &[i16], out: &mut [i16])
);
dispatch!(
    /// `blended += weight * (fine - coarse)`; the weight is in lane 3 of `fine`.
    add_band, add_band_avx2, add_band_body, manual, (fine: &[i16], coarse: &[i16], blended: &mut [i16])
);
dispatch!(
    /// `out = weight * values`; the weight is in lane 3 of `weights`.
    weigh, weigh_avx2, weigh_body, (values: &[i16], weights: &[i16], out: &mut [i16])
);
dispatch!(
    /// As [`weigh`], with weights of one lane.
    weigh_by_one, weigh_by_one_avx2, weigh_by_one_body, (values: &[i16], weights: &[i16], out: &mut [i16])
);

#[inline(always)]
fn vertical_down_body([a, b, c, d, e]: [&[i16]; 5], out: &mut [i16]) {
    let n = out.len();
    let (a, b, c, d, e) = (&a[..n], &b[..n], &c[..n], &d[..n], &e[..n]);
    for i in 0..n {
        out[i] = fifth([a[i], b[i], c[i], d[i], e[i]]);
    }
}

#[inline(always)]
fn horizontal_down_body(padded: &[i16], out: &mut [i16]) {
    let source = &padded[(PAD - 2) * LANES..];
    for (i, o) in out.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
        let p: &[i16] = &source[2 * i * LANES..2 * i * LANES + 5 * LANES];
        for l in 0..LANES {
            o[l] = fifth([p[l], p[4 + l], p[8 + l], p[12 + l], p[16 + l]]);
        }
    }
}

#[inline(always)]
fn weights_of_body(pixels: &[i16], out: &mut [i16]) {
    for (o, p) in out.iter_mut().zip(pixels.as_chunks::<LANES>().0) {
        *o = p[3];
    }
}

#[inline(always)]
fn horizontal_down_one_body(padded: &[i16], out: &mut [i16]) {
    let source = &padded[PAD - 2..];
    let n = out.len();
    // Pairs of neighbours, one pair later, and the pixel after those.
    let (near, mid) = (source.as_chunks::<2>().0, source[2..].as_chunks::<2>().0);
    let far = source[4..].as_chunks::<2>().0;
    let last = far.len().min(n);
    for ((o, near), (mid, far)) in out[..last].iter_mut().zip(near).zip(mid.iter().zip(far)) {
        *o = fifth([near[0], near[1], mid[0], mid[1], far[0]]);
    }
    for (i, o) in out.iter_mut().enumerate().skip(last) {
        let p = &source[2 * i..2 * i + 5];
        *o = fifth([p[0], p[1], p[2], p[3], p[4]]);
    }
}

/// `(a + 4 b + 6 c + 4 d + e) / 16`.
#[inline(always)]
fn fifth([a, b, c, d, e]: [i16; 5]) -> i16 {
    let inner = b.wrapping_add(d).wrapping_add(c).wrapping_shl(2);
    a.wrapping_add(e).wrapping_add(inner).wrapping_add(c.wrapping_shl(1)).wrapping_add(8) >> 4
}

#[inline(always)]
fn horizontal_up_one_body(padded: &[i16], out: &mut [i16]) {
    let source = &padded[PAD - 1..];
    let (pairs, rest) = out.as_chunks_mut::<2>();
    let n = pairs.len();
    let (a, b, c) = (&source[..n], &source[1..n + 1], &source[2..n + 2]);
    for (i, o) in pairs.iter_mut().enumerate() {
        *o = [even(a[i], b[i], c[i]), odd(b[i], c[i])];
    }
    if let [o] = rest {
        *o = even(source[n], source[n + 1], source[n + 2]);
    }
}

#[inline(always)]
fn even(a: i16, b: i16, c: i16) -> i16 {
    a.wrapping_add(c).wrapping_add(b.wrapping_shl(2)).wrapping_add(b.wrapping_shl(1)).wrapping_add(4) >> 3
}

#[inline(always)]
fn odd(a: i16, b: i16) -> i16 {
    a.wrapping_add(b).wrapping_add(1) >> 1
}

#[inline(always)]
fn vertical_even_body(a: &[i16], b: &[i16], c: &[i16], out: &mut [i16]) {
    let n = out.len();
    let (a, b, c) = (&a[..n], &b[..n], &c[..n]);
    for i in 0..n {
        out[i] = even(a[i], b[i], c[i]);
    }
}

#[inline(always)]
fn vertical_odd_body(a: &[i16], b: &[i16], out: &mut [i16]) {
    let n = out.len();
    let (a, b) = (&a[..n], &b[..n]);
    for i in 0..n {
        out[i] = odd(a[i], b[i]);
    }
}

#[inline(always)]
fn horizontal_up_body(padded: &[i16], out: &mut [i16]) {
    let source = &padded[(PAD - 1) * LANES..];
    let (pairs, rest) = out.as_chunks_mut::<{ 2 * LANES }>();
    let count = pairs.len();
    for (i, o) in pairs.iter_mut().enumerate() {
        let p: &[i16] = &source[i * LANES..i * LANES + 3 * LANES];
        for l in 0..LANES {
            o[l] = even(p[l], p[4 + l], p[8 + l]);
            o[4 + l] = odd(p[4 + l], p[8 + l]);
        }
    }
    let p = &source[count * LANES..];
    for (l, o) in rest.iter_mut().enumerate() {
        *o = even(p[l], p[4 + l], p[8 + l]);
    }
}

#[inline(always)]
fn scale(value: i16, weight: i16) -> i16 {
    let (a, b) = (i32::from(value.wrapping_shl(3)), i32::from(weight.wrapping_shl(2)));
    ((a * b + 0x4000) >> 15) as i16
}

#[inline(always)]
fn add_band_body(fine: &[i16], coarse: &[i16], blended: &mut [i16]) {
    let (fine, coarse) = (fine.as_chunks::<LANES>().0, coarse.as_chunks::<LANES>().0);
    for ((f, c), b) in fine.iter().zip(coarse).zip(blended.as_chunks_mut::<LANES>().0) {
        for l in 0..LANES {
            b[l] = b[l].wrapping_add(scale(f[l].wrapping_sub(c[l]), f[3]));
        }
    }
}

#[inline(always)]
fn weigh_body(values: &[i16], weights: &[i16], out: &mut [i16]) {
    let (values, weights) = (values.as_chunks::<LANES>().0, weights.as_chunks::<LANES>().0);
    for ((v, w), o) in values.iter().zip(weights).zip(out.as_chunks_mut::<LANES>().0) {
        for l in 0..LANES {
            o[l] = scale(v[l], w[3]);
        }
    }
}

#[inline(always)]
fn weigh_by_one_body(values: &[i16], weights: &[i16], out: &mut [i16]) {
    let values = values.as_chunks::<LANES>().0;
    for ((v, w), o) in values.iter().zip(weights).zip(out.as_chunks_mut::<LANES>().0) {
        for l in 0..LANES {
            o[l] = scale(v[l], *w);
        }
    }
}

/// Kernels with explicit shuffles that the compiler does not generate; ends of rows use the portable bodies.
#[cfg(target_arch = "x86_64")]
mod simd {
    use super::*;
    use std::arch::x86_64::*;

    /// Four pixels from pixel `at` on.
    #[target_feature(enable = "avx2")]
    fn load(row: &[i16], at: usize) -> __m256i {
        let four = &row[at * LANES..at * LANES + 4 * LANES];
        // SAFETY: 32 bytes, as sliced.
        unsafe { _mm256_loadu_si256(four.as_ptr().cast()) }
    }

    #[target_feature(enable = "avx2")]
    fn store(row: &mut [i16], at: usize, value: __m256i) {
        let four = &mut row[at * LANES..at * LANES + 4 * LANES];
        // SAFETY: 32 bytes, as sliced.
        unsafe { _mm256_storeu_si256(four.as_mut_ptr().cast(), value) };
    }

    #[target_feature(enable = "avx2")]
    pub fn horizontal_down_avx2(padded: &[i16], out: &mut [i16]) {
        let count = out.len() / LANES;
        let eight = _mm256_set1_epi16(8);
        let mut i = 0;
        while i + 4 <= count {
            let at = 2 * i + PAD;
            let (l0, l1) = (load(padded, at - 2), load(padded, at + 2));
            let (c0, c1) = (load(padded, at), load(padded, at + 4));
            let r1 = load(padded, at + 6);
            let outer = _mm256_add_epi16(_mm256_unpacklo_epi64(l0, l1), _mm256_unpacklo_epi64(l1, r1));
            let centre = _mm256_unpacklo_epi64(c0, c1);
            let inner = _mm256_add_epi16(_mm256_unpackhi_epi64(l0, l1), _mm256_unpackhi_epi64(c0, c1));
            let inner = _mm256_slli_epi16(_mm256_add_epi16(inner, centre), 2);
            let sum = _mm256_add_epi16(_mm256_add_epi16(outer, inner), _mm256_slli_epi16(centre, 1));
            let value = _mm256_srai_epi16(_mm256_add_epi16(sum, eight), 4);
            store(out, i, _mm256_permute4x64_epi64(value, 0xD8));
            i += 4;
        }
        horizontal_down_body(&padded[2 * i * LANES..], &mut out[i * LANES..]);
    }

    #[target_feature(enable = "avx2")]
    pub fn horizontal_up_avx2(padded: &[i16], out: &mut [i16]) {
        let pairs = out.len() / (2 * LANES);
        let (four, one) = (_mm256_set1_epi16(4), _mm256_set1_epi16(1));
        let mut i = 0;
        while i + 4 <= pairs {
            let (a, b, c) = (load(padded, PAD - 1 + i), load(padded, PAD + i), load(padded, PAD + 1 + i));
            let six = _mm256_add_epi16(_mm256_slli_epi16(b, 2), _mm256_slli_epi16(b, 1));
            let sum = _mm256_add_epi16(_mm256_add_epi16(_mm256_add_epi16(a, c), six), four);
            let even = _mm256_srai_epi16(sum, 3);
            let odd = _mm256_srai_epi16(_mm256_add_epi16(_mm256_add_epi16(b, c), one), 1);
            let (low, high) = (_mm256_unpacklo_epi64(even, odd), _mm256_unpackhi_epi64(even, odd));
            store(out, 2 * i, _mm256_permute2x128_si256(low, high, 0x20));
            store(out, 2 * i + 4, _mm256_permute2x128_si256(low, high, 0x31));
            i += 4;
        }
        horizontal_up_body(&padded[i * LANES..], &mut out[2 * i * LANES..]);
    }

    #[target_feature(enable = "avx2")]
    pub fn add_band_avx2(fine: &[i16], coarse: &[i16], blended: &mut [i16]) {
        let count = blended.len().min(fine.len()).min(coarse.len()) / LANES;
        let weight = _mm256_broadcastsi128_si256(_mm_setr_epi8(6, 7, 6, 7, 6, 7, 6, 7, 14, 15, 14, 15, 14, 15, 14, 15));
        let mut i = 0;
        while i + 4 <= count {
            let f = load(fine, i);
            let difference = _mm256_slli_epi16(_mm256_sub_epi16(f, load(coarse, i)), 3);
            let w = _mm256_slli_epi16(_mm256_shuffle_epi8(f, weight), 2);
            let sum = _mm256_add_epi16(load(blended, i), _mm256_mulhrs_epi16(difference, w));
            store(blended, i, sum);
            i += 4;
        }
        add_band_body(&fine[i * LANES..], &coarse[i * LANES..], &mut blended[i * LANES..]);
    }
}

/// Repeats the border pixels of a padded row of `width` pixels into its padding, if `low..high` is filled and reaches
/// the border.
pub fn pad_row<const N: usize>(padded: &mut [i16], low: usize, high: usize, width: usize) {
    let padded = padded.as_chunks_mut::<N>().0;
    if low == 0 {
        let first = padded[PAD];
        padded[..PAD].fill(first);
    }
    if high == width {
        let last = padded[PAD + width - 1];
        padded[PAD + width..2 * PAD + width].fill(last);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_paths_agree_on_all_lengths() {
        let mut seed = 5u32;
        let mut value = || {
            seed = seed.wrapping_mul(1664525).wrapping_add(1013904223);
            (seed >> 16) as i16 % 2041
        };
        for width in 1..40 {
            let mut row: Vec<i16> = (0..(width + 2 * PAD + 2) * LANES).map(|_| value()).collect();
            pad_row::<LANES>(&mut row, 0, width, width);
            let mut fine: Vec<i16> = (0..2 * width * LANES).map(|_| value()).collect();
            fine.as_chunks_mut::<LANES>().0.iter_mut().for_each(|p| p[3] = p[3].abs().min(ONE));
            let run = |avx2: bool| {
                let (mut down, mut up) = (vec![0; width.div_ceil(2) * LANES], vec![0; 2 * width * LANES]);
                horizontal_down(&row, &mut down, avx2);
                horizontal_up(&row, &mut up, avx2);
                let mut band = up.clone();
                add_band(&fine, &up, &mut band, avx2);
                (down, up, band)
            };
            assert_eq!(run(false), run(crate::Simd::detect().avx2()), "width {width}");
        }
    }
    #[test]
    fn weights_alone_are_blurred_as_with_the_differences() {
        let avx2 = crate::Simd::detect().avx2();
        for width in 1..70 {
            let pixels: Vec<i16> = (0..(width + 2 * PAD + 2) * LANES).map(|at| (at * at * 37 % 1025) as i16).collect();
            let mut ones = vec![0; width + 2 * PAD + 2];
            for simd in [false, avx2] {
                weights_of(&pixels, &mut ones, simd);
                let (mut down, mut up) = (vec![0; width.div_ceil(2) * LANES], vec![0; (2 * width - 1) * LANES]);
                horizontal_down(&pixels, &mut down, simd);
                horizontal_up(&pixels, &mut up, simd);
                let (mut down_one, mut up_one) = (vec![0; width.div_ceil(2)], vec![0; 2 * width - 1]);
                horizontal_down_one(&ones, &mut down_one, simd);
                horizontal_up_one(&ones, &mut up_one, simd);
                let weights = |of: &[i16]| of.as_chunks::<LANES>().0.iter().map(|p| p[3]).collect::<Vec<i16>>();
                assert_eq!((weights(&down), weights(&up)), (down_one, up_one.clone()), "width {width}");
                let (mut weighed, mut by_one) = (vec![0; up.len()], vec![0; up.len()]);
                weigh(&up, &up, &mut weighed, simd);
                weigh_by_one(&up, &up_one, &mut by_one, simd);
                assert_eq!(weighed, by_one, "width {width}");
            }
        }
    }
}
