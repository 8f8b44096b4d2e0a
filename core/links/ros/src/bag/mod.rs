//! Bags: folders with MCAP files and `metadata.yaml`, in the format of `ros2 bag`.

mod error;
mod fields;
mod reader;
mod scan;
mod writer;

pub use error::BagError;
pub use reader::{BagReader, BagTopic, RawMessage, survey};
pub use writer::BagWriter;
