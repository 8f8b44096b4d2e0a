//! What the author of a Panoscope node uses.
