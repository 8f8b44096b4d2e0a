//! Stereo: rectification, matching, filtering, reprojection.
