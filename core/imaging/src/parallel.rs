//! How kernels ask for more than one thread, without knowing whose threads they are.

/// A pool that runs the chunks of a loop.
///
/// Chunk boundaries never depend on [`Parallel::threads`], and partial results are reduced in
/// index order by the caller, so that the number of threads never changes a result.
pub trait Parallel: Sync {
    /// How many threads may take part, the caller included.
    fn threads(&self) -> usize;

    /// Calls `body(i)` once for every `i` in `0..chunks`, in any order, and returns when all are done.
    fn run(&self, chunks: usize, body: &(dyn Fn(usize) + Sync));
}

/// Runs every chunk on the calling thread, in order.
#[derive(Clone, Copy, Debug, Default)]
pub struct Serial;

impl Parallel for Serial {
    fn threads(&self) -> usize {
        1
    }

    fn run(&self, chunks: usize, body: &(dyn Fn(usize) + Sync)) {
        for index in 0..chunks {
            body(index);
        }
    }
}

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

// SAFETY: the pointer stands for a `&mut [T]`; each part handed out by `part` is used by one thread.
unsafe impl<T: Send> Send for SharedMut<'_, T> {}
// SAFETY: as above; sharing the wrapper gives no access without the unsafe `part`.
unsafe impl<T: Send> Sync for SharedMut<'_, T> {}

impl<'a, T> SharedMut<'a, T> {
    /// Takes the slice that the chunks of one loop will write.
    pub fn new(slice: &'a mut [T]) -> Self {
        Self { base: slice.as_mut_ptr(), len: slice.len(), lifetime: std::marker::PhantomData }
    }

    /// Where element `index` lies, for kernels that walk by pointer; what they touch must be theirs, as for [`Self::part`].
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
