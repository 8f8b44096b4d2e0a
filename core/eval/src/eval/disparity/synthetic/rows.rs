//! Rows of a picture from several threads.

use std::sync::{Mutex, PoisonError};

use panoscope_base::Parallel;

/// Calls `fill(row, its values)` once for each row of `data`, rows of `len` values, from the threads of `pool`.
pub fn fill_rows<T: Send>(data: &mut [T], len: usize, pool: &dyn Parallel, fill: impl Fn(usize, &mut [T]) + Sync) {
    // Each lock is taken once: it hands the row to whichever thread comes.
    let rows: Vec<Mutex<&mut [T]>> = data.chunks_exact_mut(len).map(Mutex::new).collect();
    pool.run(rows.len(), &|row| fill(row, &mut rows[row].lock().unwrap_or_else(PoisonError::into_inner)));
}
