//! Stitching: warp, exposure, seam, blend, canvas.
