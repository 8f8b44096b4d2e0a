//! Evaluation: what a change of a parameter, an algorithm or a machine does to the results.

#![forbid(unsafe_code)]

pub mod sweep;
