//! Eight-lane arithmetic with identical results on every machine.
//!
//! [`Lanes`] has two implementations: [`Portable`] on arrays and, on x86-64, `Avx2` on vector registers. Both round every operation by IEEE 754 in
//! the same order (no fused multiply-add, no reciprocal estimates), so a kernel generic over `Lanes` gives the same bits with either.

use std::ops::{Add, Div, Mul, Sub};

/// Number of lanes in a packet.
pub const LANES: usize = 8;

/// Eight `f32`, with eight `u32` as [`Lanes::U`].
pub trait Lanes: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> {
    /// Eight unsigned integers.
    type U: Copy;

    /// The same value in each lane.
    fn splat(value: f32) -> Self;
    /// Lanes from an array.
    fn load(values: &[f32; LANES]) -> Self;
    /// Lanes to an array.
    fn store(self) -> [f32; LANES];
    /// Correctly rounded square root.
    fn sqrt(self) -> Self;
    /// Largest whole number not above.
    fn floor(self) -> Self;
    /// `self < other ? self : other`.
    fn min(self, other: Self) -> Self;
    /// `self > other ? self : other`.
    fn max(self, other: Self) -> Self;
    /// `a < b ? yes : no`, lane by lane.
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self;
    /// Bit `i` is set where lane `i` of `self` is less than `other`'s.
    fn less_mask(self, other: Self) -> u32;
    /// Truncates to integers (as two's complement); the magnitude of inputs must be below 2^31.
    fn to_u32(self) -> Self::U;
    /// Reads the lanes as signed integers.
    fn from_i32(values: Self::U) -> Self;
    /// `table[index & (len - 1)]` lane by lane; `table.len()` is a power of two.
    fn gather(table: &[f32], index: Self::U) -> Self;
    /// Eight bytes, lowest first, as eight lanes.
    fn from_bytes(bytes: u64) -> Self;
    /// Transposes an 8x8 matrix.
    fn transpose(rows: [Self; LANES]) -> [Self; LANES];

    /// The same integer in each lane.
    fn u_splat(value: u32) -> Self::U;
    /// `start, start + 1, ..`.
    fn u_ramp(start: u32) -> Self::U;
    /// Integer lanes to an array.
    fn u_store(values: Self::U) -> [u32; LANES];
    /// Wrapping sum.
    fn u_add(a: Self::U, b: Self::U) -> Self::U;
    /// Wrapping product.
    fn u_mul(a: Self::U, b: Self::U) -> Self::U;
    /// Exclusive or.
    fn u_xor(a: Self::U, b: Self::U) -> Self::U;
    /// And.
    fn u_and(a: Self::U, b: Self::U) -> Self::U;
    /// Logical shift right.
    fn u_shr<const N: i32>(a: Self::U) -> Self::U;
    /// Shift left by a count known at run time.
    fn u_shl(a: Self::U, count: u32) -> Self::U;
    /// Writes eight BGR pixels; channels are rounded half up and must lie in 0..=255.
    fn pack_bgr(b: Self, g: Self, r: Self, out: &mut [u8; 24]);

    /// Absolute value.
    #[inline(always)]
    fn abs(self) -> Self {
        self.max(Self::splat(0.0) - self)
    }
    /// Between two bounds.
    #[inline(always)]
    fn clamp(self, low: f32, high: f32) -> Self {
        self.max(Self::splat(low)).min(Self::splat(high))
    }
}

/// Implementation on arrays: for machines without AVX2, and the reference for the other one.
#[derive(Clone, Copy, Debug)]
pub struct Portable([f32; LANES]);

macro_rules! portable_op {
    ($trait:ident, $name:ident, $op:tt) => {
        impl $trait for Portable {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self(std::array::from_fn(|i| self.0[i] $op other.0[i]))
            }
        }
    };
}
portable_op!(Add, add, +);
portable_op!(Sub, sub, -);
portable_op!(Mul, mul, *);
portable_op!(Div, div, /);

impl Lanes for Portable {
    type U = [u32; LANES];

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; LANES])
    }
    #[inline(always)]
    fn load(values: &[f32; LANES]) -> Self {
        Self(*values)
    }
    #[inline(always)]
    fn store(self) -> [f32; LANES] {
        self.0
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }
    #[inline(always)]
    fn floor(self) -> Self {
        Self(self.0.map(f32::floor))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| if self.0[i] < other.0[i] { self.0[i] } else { other.0[i] }))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| if self.0[i] > other.0[i] { self.0[i] } else { other.0[i] }))
    }
    #[inline(always)]
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        Self(std::array::from_fn(|i| if a.0[i] < b.0[i] { yes.0[i] } else { no.0[i] }))
    }
    #[inline(always)]
    fn less_mask(self, other: Self) -> u32 {
        (0..LANES).fold(0, |mask, i| mask | (u32::from(self.0[i] < other.0[i]) << i))
    }
    #[inline(always)]
    fn to_u32(self) -> Self::U {
        self.0.map(|v| v as i32 as u32)
    }
    #[inline(always)]
    fn from_i32(values: Self::U) -> Self {
        Self(values.map(|v| v as i32 as f32))
    }
    #[inline(always)]
    fn gather(table: &[f32], index: Self::U) -> Self {
        Self(index.map(|i| table[i as usize & (table.len() - 1)]))
    }
    #[inline(always)]
    fn from_bytes(bytes: u64) -> Self {
        Self(bytes.to_le_bytes().map(f32::from))
    }
    #[inline(always)]
    fn transpose(rows: [Self; LANES]) -> [Self; LANES] {
        std::array::from_fn(|column| Self(std::array::from_fn(|row| rows[row].0[column])))
    }
    #[inline(always)]
    fn u_splat(value: u32) -> Self::U {
        [value; LANES]
    }
    #[inline(always)]
    fn u_ramp(start: u32) -> Self::U {
        std::array::from_fn(|i| start.wrapping_add(i as u32))
    }
    #[inline(always)]
    fn u_store(values: Self::U) -> [u32; LANES] {
        values
    }
    #[inline(always)]
    fn u_add(a: Self::U, b: Self::U) -> Self::U {
        std::array::from_fn(|i| a[i].wrapping_add(b[i]))
    }
    #[inline(always)]
    fn u_mul(a: Self::U, b: Self::U) -> Self::U {
        std::array::from_fn(|i| a[i].wrapping_mul(b[i]))
    }
    #[inline(always)]
    fn u_xor(a: Self::U, b: Self::U) -> Self::U {
        std::array::from_fn(|i| a[i] ^ b[i])
    }
    #[inline(always)]
    fn u_and(a: Self::U, b: Self::U) -> Self::U {
        std::array::from_fn(|i| a[i] & b[i])
    }
    #[inline(always)]
    fn u_shr<const N: i32>(a: Self::U) -> Self::U {
        a.map(|v| v >> N)
    }
    #[inline(always)]
    fn u_shl(a: Self::U, count: u32) -> Self::U {
        a.map(|v| v << count)
    }
    #[inline(always)]
    fn pack_bgr(b: Self, g: Self, r: Self, out: &mut [u8; 24]) {
        for i in 0..LANES {
            out[3 * i] = (b.0[i] + 0.5) as i32 as u8;
            out[3 * i + 1] = (g.0[i] + 0.5) as i32 as u8;
            out[3 * i + 2] = (r.0[i] + 0.5) as i32 as u8;
        }
    }
}

#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{LANES, Lanes};
    use std::arch::x86_64::*;
    use std::ops::{Add, Div, Mul, Sub};

    /// Vector registers. Used only inside functions entered after AVX2 was detected.
    #[derive(Clone, Copy, Debug)]
    pub struct Avx2(__m256);

    macro_rules! avx2_op {
        ($trait:ident, $name:ident, $intrinsic:ident) => {
            impl $trait for Avx2 {
                type Output = Self;
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    // SAFETY: see `Avx2`: the feature was detected before any value was made.
                    Self(unsafe { $intrinsic(self.0, other.0) })
                }
            }
        };
    }
    avx2_op!(Add, add, _mm256_add_ps);
    avx2_op!(Sub, sub, _mm256_sub_ps);
    avx2_op!(Mul, mul, _mm256_mul_ps);
    avx2_op!(Div, div, _mm256_div_ps);

    // SAFETY of every block below: see `Avx2`: the feature was detected before any value was made;
    // memory is read and written only through whole arrays or indices masked to the table.
    #[allow(clippy::undocumented_unsafe_blocks)]
    impl Lanes for Avx2 {
        type U = __m256i;

        #[inline(always)]
        fn splat(value: f32) -> Self {
            Self(unsafe { _mm256_set1_ps(value) })
        }
        #[inline(always)]
        fn load(values: &[f32; LANES]) -> Self {
            Self(unsafe { _mm256_loadu_ps(values.as_ptr()) })
        }
        #[inline(always)]
        fn store(self) -> [f32; LANES] {
            let mut out = [0.0; LANES];
            unsafe { _mm256_storeu_ps(out.as_mut_ptr(), self.0) };
            out
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            Self(unsafe { _mm256_sqrt_ps(self.0) })
        }
        #[inline(always)]
        fn floor(self) -> Self {
            Self(unsafe { _mm256_floor_ps(self.0) })
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            Self(unsafe { _mm256_min_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            Self(unsafe { _mm256_max_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
            Self(unsafe { _mm256_blendv_ps(no.0, yes.0, _mm256_cmp_ps::<_CMP_LT_OQ>(a.0, b.0)) })
        }
        #[inline(always)]
        fn less_mask(self, other: Self) -> u32 {
            unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0)) as u32 }
        }
        #[inline(always)]
        fn to_u32(self) -> Self::U {
            unsafe { _mm256_cvttps_epi32(self.0) }
        }
        #[inline(always)]
        fn from_i32(values: Self::U) -> Self {
            Self(unsafe { _mm256_cvtepi32_ps(values) })
        }
        #[inline(always)]
        fn gather(table: &[f32], index: Self::U) -> Self {
            debug_assert!(table.len().is_power_of_two());
            unsafe {
                let index = _mm256_and_si256(index, _mm256_set1_epi32((table.len() - 1) as i32));
                Self(_mm256_i32gather_ps::<4>(table.as_ptr(), index))
            }
        }
        #[inline(always)]
        fn from_bytes(bytes: u64) -> Self {
            Self(unsafe { _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_cvtsi64_si128(bytes as i64))) })
        }
        #[inline(always)]
        fn transpose(rows: [Self; LANES]) -> [Self; LANES] {
            unsafe {
                // Macros, not closures: a closure is a function of its own without the AVX2 feature.
                macro_rules! pairs {
                    ($i:expr) => {
                        (_mm256_unpacklo_ps(rows[$i].0, rows[$i + 1].0), _mm256_unpackhi_ps(rows[$i].0, rows[$i + 1].0))
                    };
                }
                macro_rules! quads {
                    ($a:expr, $b:expr) => {
                        (_mm256_shuffle_ps::<0x44>($a, $b), _mm256_shuffle_ps::<0xEE>($a, $b))
                    };
                }
                let ((a0, a1), (a2, a3), (b0, b1), (b2, b3)) = (pairs!(0), pairs!(2), pairs!(4), pairs!(6));
                let ((u0, u1), (u2, u3)) = (quads!(a0, a2), quads!(a1, a3));
                let ((l0, l1), (l2, l3)) = (quads!(b0, b2), quads!(b1, b3));
                [
                    Self(_mm256_permute2f128_ps::<0x20>(u0, l0)),
                    Self(_mm256_permute2f128_ps::<0x20>(u1, l1)),
                    Self(_mm256_permute2f128_ps::<0x20>(u2, l2)),
                    Self(_mm256_permute2f128_ps::<0x20>(u3, l3)),
                    Self(_mm256_permute2f128_ps::<0x31>(u0, l0)),
                    Self(_mm256_permute2f128_ps::<0x31>(u1, l1)),
                    Self(_mm256_permute2f128_ps::<0x31>(u2, l2)),
                    Self(_mm256_permute2f128_ps::<0x31>(u3, l3)),
                ]
            }
        }
        #[inline(always)]
        fn u_splat(value: u32) -> Self::U {
            unsafe { _mm256_set1_epi32(value as i32) }
        }
        #[inline(always)]
        fn u_ramp(start: u32) -> Self::U {
            unsafe { _mm256_add_epi32(_mm256_set1_epi32(start as i32), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7)) }
        }
        #[inline(always)]
        fn u_store(values: Self::U) -> [u32; LANES] {
            let mut out = [0; LANES];
            unsafe { _mm256_storeu_si256(out.as_mut_ptr().cast(), values) };
            out
        }
        #[inline(always)]
        fn u_add(a: Self::U, b: Self::U) -> Self::U {
            unsafe { _mm256_add_epi32(a, b) }
        }
        #[inline(always)]
        fn u_mul(a: Self::U, b: Self::U) -> Self::U {
            unsafe { _mm256_mullo_epi32(a, b) }
        }
        #[inline(always)]
        fn u_xor(a: Self::U, b: Self::U) -> Self::U {
            unsafe { _mm256_xor_si256(a, b) }
        }
        #[inline(always)]
        fn u_and(a: Self::U, b: Self::U) -> Self::U {
            unsafe { _mm256_and_si256(a, b) }
        }
        #[inline(always)]
        fn u_shr<const N: i32>(a: Self::U) -> Self::U {
            unsafe { _mm256_srli_epi32::<N>(a) }
        }
        #[inline(always)]
        fn u_shl(a: Self::U, count: u32) -> Self::U {
            unsafe { _mm256_sll_epi32(a, _mm_cvtsi32_si128(count as i32)) }
        }
        #[inline(always)]
        fn pack_bgr(b: Self, g: Self, r: Self, out: &mut [u8; 24]) {
            let mut bytes = [0u8; 28];
            unsafe {
                let half = _mm256_set1_ps(0.5);
                let blue = _mm256_cvttps_epi32(_mm256_add_ps(b.0, half));
                let green = _mm256_slli_epi32::<8>(_mm256_cvttps_epi32(_mm256_add_ps(g.0, half)));
                let red = _mm256_slli_epi32::<16>(_mm256_cvttps_epi32(_mm256_add_ps(r.0, half)));
                let bgr = _mm256_or_si256(blue, _mm256_or_si256(green, red));
                let order = _mm256_setr_epi8(
                    0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1, 0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1,
                    -1, -1, -1,
                );
                let packed = _mm256_shuffle_epi8(bgr, order);
                _mm_storeu_si128(bytes.as_mut_ptr().cast(), _mm256_castsi256_si128(packed));
                _mm_storeu_si128(bytes.as_mut_ptr().add(12).cast(), _mm256_extracti128_si256::<1>(packed));
            }
            out.copy_from_slice(&bytes[..24]);
        }
    }
}
