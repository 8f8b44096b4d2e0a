//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

mod calibration_files;
mod calibrations_of_data_sets;
mod find;
mod samples;
