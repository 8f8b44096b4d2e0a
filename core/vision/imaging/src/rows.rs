//! Work on the rows of an image, on several threads.

use std::sync::{Mutex, PoisonError};

use crate::{Parallel, ViewMut};

/// Rows that a thread takes at a time.
const ROWS: usize = 64;

/// Calls `row` with each row of an image and its number, on several threads.
pub fn each_row<T: Send>(out: &mut ViewMut<'_, T>, pool: &dyn Parallel, row: impl Fn(usize, &mut [T]) + Sync) {
    let (stride, width, height) = (out.stride, out.width * out.channels, out.height);
    let bands: Vec<_> = out.data.chunks_mut((stride * ROWS).max(1)).map(Mutex::new).collect();
    pool.run(bands.len(), &|index| {
        let mut band = bands[index].lock().unwrap_or_else(PoisonError::into_inner);
        for (at, values) in band.chunks_mut(stride).enumerate().take(height.saturating_sub(index * ROWS)) {
            row(index * ROWS + at, &mut values[..width]);
        }
    });
}
