//! All tests of the package as one program: `cargo nextest` runs each test in its own process.

mod calibrate;
mod calibration_files;
mod stereo;
mod stitch;
mod threads;
