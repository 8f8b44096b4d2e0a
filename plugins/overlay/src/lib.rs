//! Drawing on images.
