//! Bags: folders with MCAP files and `metadata.yaml`, as `ros2 bag` writes them.

mod error;
mod fields;
mod reader;
mod scan;
mod writer;

pub use error::BagError;
pub use reader::{BagReader, BagTopic, RawMessage, survey};
pub use writer::BagWriter;
