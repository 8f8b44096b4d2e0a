//! Registration and compositing of overlapping views.
