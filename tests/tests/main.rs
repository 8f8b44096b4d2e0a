//! All tests of the package as one program: `cargo nextest` runs each test in its own process.

mod ages;
mod attach;
mod batches;
mod c_plugins;
mod checks;
mod data_sets;
mod deaths;
mod described;
mod determinism;
mod dicom;
mod documents;
mod export;
mod files;
mod foreign_models;
mod golden;
mod gpu;
mod graphs;
mod hostile_models;
mod isolated_runs;
mod isolation;
mod live;
mod lock;
mod losses;
mod machines;
mod mosaic;
mod panorama_of_cameras;
mod proximity;
mod python;
mod python_host;
mod readme;
mod real_sources;
mod record;
mod recovery;
mod reported_files;
#[path = "../../core/vision/data/tests/samples/mod.rs"]
mod samples;
mod service;
mod shipped;
mod soak;
mod sources;
#[path = "../support/video.rs"]
mod video;
