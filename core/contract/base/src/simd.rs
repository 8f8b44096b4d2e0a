//! Which instruction set kernels use: decided at run time, here only.

/// The instruction set a kernel runs with.
///
/// A value that allows AVX2 exists only on machines that have it, so a kernel that was given one may call functions
/// compiled for AVX2. Both paths give bit-identical results: no fused multiply-add, the same order of operations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Simd {
    avx2: bool,
}

impl Simd {
    /// The best instruction set of this machine. The standard library asks the processor once and caches the answer.
    #[inline]
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        let avx2 = std::arch::is_x86_feature_detected!("avx2");
        #[cfg(not(target_arch = "x86_64"))]
        let avx2 = false;
        Self { avx2 }
    }

    /// Plain Rust only, for comparisons.
    #[inline]
    pub fn portable() -> Self {
        Self { avx2: false }
    }

    /// Whether AVX2 may be used.
    #[inline]
    pub fn avx2(self) -> bool {
        self.avx2
    }
}

impl Default for Simd {
    fn default() -> Self {
        Self::detect()
    }
}

/// Calls `$body` compiled for AVX2 where `$simd`, a [`Simd`], allows it, and compiled plainly elsewhere.
///
/// `$body` is an `#[inline(always)]` function, so each instance is vectorised for its own target.
#[macro_export]
macro_rules! dispatch {
    ($simd:expr, $body:ident ( $($name:ident : $ty:ty),* $(,)? ) $(-> $ret:ty)?) => {{
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn with_avx2($($name: $ty),*) $(-> $ret)? {
                $body($($name),*)
            }
            if $simd.avx2() {
                // SAFETY: `Simd` allows AVX2 only where the processor has it.
                unsafe { with_avx2($($name),*) }
            } else {
                $body($($name),*)
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            $body($($name),*)
        }
    }};
}
