//! Evaluation: what a change of a parameter, an algorithm or a machine does to the results.

pub mod sweep;
