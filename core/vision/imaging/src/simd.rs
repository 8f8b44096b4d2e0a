//! Code shared by kernels: two instruction sets, growing buffers.

pub(crate) use panoscope_base::dispatch;

/// Makes `buffer` at least `len` long without changing existing elements.
pub(crate) fn grow<T: Clone + Default>(buffer: &mut Vec<T>, len: usize) {
    if buffer.len() < len {
        buffer.resize(len, T::default());
    }
}
