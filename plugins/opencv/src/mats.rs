//! Pictures as OpenCV's matrices, and its number of threads.

use opencv::boxed_ref::BoxedRef;
use opencv::core::{self, CV_8UC1, CV_8UC3, Mat, UMat};
use opencv::prelude::*;
use panoscope_node::{NodeError, Result, View, ViewMut};

/// What OpenCV says, as a node's error.
pub fn failed(error: opencv::Error) -> NodeError {
    NodeError::new(format!("OpenCV: {}", error.message))
}

/// An 8-bit picture of one or three channels as a matrix over the same bytes: nothing is copied.
pub fn borrowed(view: View<'_, u8>) -> opencv::Result<BoxedRef<'_, Mat>> {
    let kind = if view.channels == 1 { CV_8UC1 } else { CV_8UC3 };
    let (rows, columns) = (view.height as i32, view.width as i32);
    let bytes = view.data.as_ptr().cast_mut().cast();
    // SAFETY: `View` guarantees that its slice holds `height` rows of `width * channels` bytes, `stride` bytes apart. The matrix
    // lives no longer than the slice, and `BoxedRef` hands out shared references only, so that OpenCV does not write to it.
    let mat = unsafe { Mat::new_rows_cols_with_data_unsafe(rows, columns, kind, bytes, view.stride)? };
    Ok(mat.into())
}

/// Writes an 8-bit matrix of the same size and channels.
pub fn write(mat: &Mat, out: &mut ViewMut<'_, u8>) -> Result<()> {
    let row = out.width * out.channels;
    let bytes = mat.data_bytes().map_err(failed)?;
    if bytes.len() != row * out.height {
        return Err(NodeError::new(format!("OpenCV made {} bytes, {} were expected", bytes.len(), row * out.height)));
    }
    for (y, source) in bytes.chunks_exact(row.max(1)).enumerate() {
        out.row_mut(y).copy_from_slice(source);
    }
    Ok(())
}

/// The matrix where OpenCV's stitching classes want it.
pub fn umat(mat: &Mat) -> opencv::Result<UMat> {
    let mut out = UMat::new_def();
    mat.copy_to(&mut out)?;
    Ok(out)
}

/// Back from there.
pub fn from_umat(umat: &UMat) -> opencv::Result<Mat> {
    let mut out = Mat::default();
    umat.copy_to(&mut out)?;
    Ok(out)
}

/// Sets OpenCV's number of threads, which holds for the whole process, and puts it back at the end of the scope.
pub struct Threads(i32);

impl Threads {
    /// `threads` from now on.
    pub fn set(threads: u32) -> opencv::Result<Self> {
        let before = core::get_num_threads()?;
        core::set_num_threads(threads as i32)?;
        Ok(Self(before))
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        // A failure leaves the number as it is; nothing depends on it but speed.
        let _ = core::set_num_threads(self.0);
    }
}
