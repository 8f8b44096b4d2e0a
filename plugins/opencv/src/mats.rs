//! Images as OpenCV's matrices, and OpenCV's number of threads.

use std::sync::{Mutex, MutexGuard, PoisonError};

use opencv::boxed_ref::BoxedRef;
use opencv::core::{self, CV_8UC1, CV_8UC3, Mat, UMat};
use opencv::prelude::*;
use panoscope_node::{NodeError, Result, View, ViewMut};

/// Converts an OpenCV error to a node error.
pub fn failed(error: opencv::Error) -> NodeError {
    NodeError::new(format!("OpenCV: {}", error.message))
}

/// Wraps an 8-bit image of one or three channels as a matrix over the same bytes: nothing is copied.
pub fn borrowed(view: View<'_, u8>) -> opencv::Result<BoxedRef<'_, Mat>> {
    let kind = if view.channels == 1 { CV_8UC1 } else { CV_8UC3 };
    let (rows, columns) = (view.height as i32, view.width as i32);
    let bytes = view.data.as_ptr().cast_mut().cast();
    // SAFETY: `View` guarantees that its slice holds `height` rows of `width * channels` bytes, `stride` bytes apart. The matrix
    // lives no longer than the slice, and `BoxedRef` hands out shared references only, so that OpenCV does not write to it.
    let mat = unsafe { Mat::new_rows_cols_with_data_unsafe(rows, columns, kind, bytes, view.stride)? };
    Ok(mat.into())
}

/// Copies an 8-bit matrix into a view of the same size and channels.
pub fn write(mat: &Mat, out: &mut ViewMut<'_, u8>) -> Result<()> {
    let row = out.width * out.channels;
    let bytes = mat.data_bytes().map_err(failed)?;
    if bytes.len() != row * out.height {
        return Err(NodeError::new(format!("OpenCV returned {} bytes instead of {}", bytes.len(), row * out.height)));
    }
    for (y, source) in bytes.chunks_exact(row.max(1)).enumerate() {
        out.row_mut(y).copy_from_slice(source);
    }
    Ok(())
}

/// Converts a matrix to a UMat, which OpenCV's stitching classes take.
pub fn umat(mat: &Mat) -> opencv::Result<UMat> {
    let mut out = UMat::new_def();
    mat.copy_to(&mut out)?;
    Ok(out)
}

/// Converts a UMat to a matrix.
pub fn from_umat(umat: &UMat) -> opencv::Result<Mat> {
    let mut out = Mat::default();
    umat.copy_to(&mut out)?;
    Ok(out)
}

/// OpenCV's number of threads, which applies to the whole process.
///
/// Changing it ends OpenCV's threads, and the next loop starts new ones, too late to take a fair share of it. The number is therefore constant from
/// frame to frame, and restored when the last holder is dropped.
pub struct Threads(());

struct Held {
    holders: usize,
    /// The number before the first holder.
    before: i32,
    /// The number set last, if any.
    set: Option<u32>,
}

static HELD: Mutex<Held> = Mutex::new(Held { holders: 0, before: 0, set: None });

fn held() -> MutexGuard<'static, Held> {
    // Each update is one assignment: a panic leaves nothing half done.
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Threads {
    /// Registers a holder; the number does not change yet.
    pub fn hold() -> Result<Self> {
        let mut held = held();
        if held.holders == 0 {
            held.before = core::get_num_threads().map_err(failed)?;
            held.set = None;
        }
        held.holders += 1;
        Ok(Self(()))
    }

    /// Sets the number of threads until another holder sets it.
    pub fn set(&self, threads: u32) -> Result<()> {
        let mut held = held();
        if held.set != Some(threads) {
            core::set_num_threads(threads as i32).map_err(failed)?;
            held.set = Some(threads);
        }
        Ok(())
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        let mut held = held();
        held.holders -= 1;
        if held.holders == 0 && held.set.take().is_some() {
            // A failure leaves the number as it is; nothing depends on it but speed.
            let _ = core::set_num_threads(held.before);
        }
    }
}
