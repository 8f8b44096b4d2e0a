//! A slice whose disjoint parts are written by the chunks of one loop.

/// A pointer that chunks of one loop may share while they write disjoint parts of a slice.
///
/// Kernels write their output rows from several threads at once; the borrow checker cannot see
/// that chunk `i` touches only its own rows, so the split is stated here, in one place.
#[derive(Clone, Copy)]
pub struct SharedMut<'a, T> {
    base: *mut T,
    len: usize,
    lifetime: std::marker::PhantomData<&'a mut [T]>,
}

// SAFETY: the pointer stands for a `&mut [T]`, which may move to another thread when `T` may.
unsafe impl<T: Send> Send for SharedMut<'_, T> {}
// SAFETY: a shared wrapper gives access to elements only through the unsafe `part`, whose callers promise that no two parts overlap; so
// each element is used by one thread at a time, which `T: Send` allows.
unsafe impl<T: Send> Sync for SharedMut<'_, T> {}

impl<'a, T> SharedMut<'a, T> {
    /// Takes the slice that the chunks of one loop will write.
    pub fn new(slice: &'a mut [T]) -> Self {
        Self { base: slice.as_mut_ptr(), len: slice.len(), lifetime: std::marker::PhantomData }
    }

    /// Address of element `index`, for kernels that advance a pointer. They may touch only elements that no other chunk
    /// touches.
    pub(crate) fn address(&self, index: usize) -> *mut T {
        self.base.wrapping_add(index)
    }

    /// The elements `start..start + len`.
    ///
    /// # Safety
    /// No two parts alive at the same time may overlap.
    ///
    /// # Panics
    /// When the part does not lie inside the slice.
    #[allow(clippy::mut_from_ref)]
    pub unsafe fn part(&self, start: usize, len: usize) -> &'a mut [T] {
        assert!(start <= self.len && len <= self.len - start, "part {start}+{len} outside 0..{}", self.len);
        // SAFETY: inside the slice (checked above); disjointness is the caller's promise.
        unsafe { std::slice::from_raw_parts_mut(self.base.add(start), len) }
    }
}
