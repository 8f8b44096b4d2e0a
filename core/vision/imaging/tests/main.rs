//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

mod stereo_aloe;
mod stereo_common;
mod stereo_filters;
mod stereo_formats;
mod stereo_geometry;
mod stereo_matching;
mod stereo_order;
