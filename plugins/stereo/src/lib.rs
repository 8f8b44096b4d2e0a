//! Rectification, disparity, depth and measurement.
