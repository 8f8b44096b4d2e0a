//! Projective geometry: homographies and robust estimation.

pub mod anchor_fit;
mod fit;
pub mod homography;
pub mod lost;
pub mod narrow;
mod normalizer;
pub mod plausible;
pub mod ransac;
pub mod rms;
pub mod roi;
mod solve;
pub mod stability;
#[cfg(test)]
mod tests;

pub use anchor_fit::{AnchorFit, shift_of};
pub(crate) use homography::length;
pub use homography::{Homography, Point, SINGULAR_DETERMINANT};
pub use lost::RegistrationMonitor;
pub use plausible::Plausibility;
pub use ransac::{Ransac, RansacError, RansacFit, RansacParams};
pub use rms::{RmsWatch, rms_of};
pub use roi::{overlap_roi, overlap_rois};
pub(crate) use solve::{median, solve_regular, solve_symmetric};
pub use stability::{RegistrationState, Stability, StabilityParams, Stabilized, explains_as_well, median_error};
