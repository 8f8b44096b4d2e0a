//! How near tips are to tissue and to each other, and when to warn.
//!
//! [`Surface`] is the tissue that a depth picture shows, with what instruments hide of it filled in; [`Hysteresis`] makes warnings of distances;
//! [`Judge`] counts false and missed ones beside true distances. Source of the task: thesis, section 1.2.3.

mod fill;
mod hysteresis;
mod judge;
mod surface;

pub use hysteresis::{Hysteresis, Rule};
pub use judge::{Judge, Verdict};
pub use surface::{Lens, Nearest, Surface};
