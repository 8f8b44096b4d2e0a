//! What kernels share: code for two instruction sets, growing buffers.

pub(crate) use panoscope_base::dispatch;

/// Makes `buffer` at least `len` long without touching what is already there.
pub(crate) fn grow<T: Clone + Default>(buffer: &mut Vec<T>, len: usize) {
    if buffer.len() < len {
        buffer.resize(len, T::default());
    }
}
