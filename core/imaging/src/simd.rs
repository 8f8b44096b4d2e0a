//! Kernels compiled twice: once for AVX2, once without.

/// Calls `$body` compiled for AVX2 where `$simd` allows it, and compiled plainly elsewhere.
///
/// `$body` is an `#[inline(always)]` function, so each instance is vectorised for its own target.
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
pub(crate) use dispatch;

/// Makes `buffer` at least `len` long without touching what is already there.
pub(crate) fn grow<T: Clone + Default>(buffer: &mut Vec<T>, len: usize) {
    if buffer.len() < len {
        buffer.resize(len, T::default());
    }
}
