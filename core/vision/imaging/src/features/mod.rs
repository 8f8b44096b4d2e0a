//! Local features: integral image, SURF, matching.

pub mod checker;
pub mod color;
mod describe;
pub mod evaluate;
mod hessian;
pub mod integral;
mod isotropic;
pub mod matching;
mod orientation;
mod patch;
mod pyramid;
pub mod registration;
mod sampling;
mod strips;
pub mod surf;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod upright;

pub use color::{GrayBuffer, gray_from, shrink_gray};
pub use describe::{DESCRIPTOR_LEN, Descriptor};
pub use evaluate::{Precision, Repeatability, precision, repeatability};
pub use integral::Integral;
pub use matching::{Gate, Match, MatchParams, Matcher};
pub use registration::{RegisterParams, RegisterSurf, Registration};
pub use surf::{Features, Keypoints, Surf, SurfParams};
