//! Local features: integral image, SURF, matching.
