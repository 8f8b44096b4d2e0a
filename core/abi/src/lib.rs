//! The binary contract between the Panoscope host and its plugins.
