//! All tests of the package as one program: `cargo nextest` runs each test in its own process.

mod exports;
mod foreign_exports;
mod hidden_jaws;
mod hostile_campaign;
mod hostile_models;
mod moving_tips;
mod odd_models;
mod onnx_node;
mod stereo_net;
mod tiny_onnx;
mod tips;
mod training;
