//! Parallel work of kernels, independent of a thread pool.

/// A pool that runs the chunks of a loop.
///
/// Chunk boundaries never depend on [`Parallel::threads`], and the caller reduces partial results in
/// index order, so that the number of threads never changes a result.
pub trait Parallel: Sync {
    /// Maximum number of threads, the caller included.
    fn threads(&self) -> usize;

    /// Calls `body(i)` once for every `i` in `0..chunks`, in any order, and returns when all calls have returned.
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
