//! Distances from tips to tissue and between tips, with warnings.
//!
//! [`Surface`] is the tissue in a depth image, filled in where instruments hide it; [`Hysteresis`] turns distances into
//! warnings; [`Judge`] counts false and missed warnings against true distances. Source of the task: thesis, section
//! 1.2.3.

mod fill;
mod hysteresis;
mod judge;
mod surface;

pub use hysteresis::{Hysteresis, Rule};
pub use judge::{Judge, Verdict};
pub use surface::{Lens, Nearest, Surface};
