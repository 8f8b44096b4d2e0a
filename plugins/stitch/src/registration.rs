//! What every registration node gives out, whatever it looks at.

use panoscope_imaging::Rect;
use panoscope_imaging::geometry::{self, RegistrationState};
use panoscope_node::abi::{self, Homography, Roi};
use panoscope_node::{Ports, Result, Slot};

/// Outputs of a registration.
#[derive(Ports)]
pub struct Out<'f> {
    /// Maps right-view pixels to left-view pixels; fresh, held or lost.
    homography: Slot<'f, Homography>,
    /// Part of the left view that the right view shares.
    roi_left: Slot<'f, Roi>,
    /// Part of the right view that the left view shares.
    roi_right: Slot<'f, Roi>,
}

/// What a kernel found, in words that the kernels share.
pub struct Found<'a> {
    /// Maps right-view pixels to left-view pixels.
    pub left_from_right: &'a geometry::Homography,
    /// Root mean square distance of the inliers in px.
    pub rms_px: f64,
    /// Correspondences that agree.
    pub inliers: usize,
    /// Fresh, held or lost.
    pub state: RegistrationState,
    /// Overlap in the left view.
    pub roi_left: &'a Rect,
    /// Overlap in the right view.
    pub roi_right: &'a Rect,
}

/// As the contract states it.
fn contract(state: RegistrationState) -> u32 {
    match state {
        RegistrationState::Fresh => abi::STATE_FRESH,
        RegistrationState::Held => abi::STATE_HELD,
        RegistrationState::Lost => abi::STATE_LOST,
    }
}

fn roi(rect: &Rect) -> Roi {
    Roi { x: rect.x as i32, y: rect.y as i32, width: rect.width as i32, height: rect.height as i32 }
}

impl Out<'_> {
    /// Makes all outputs.
    pub fn set(&mut self, found: &Found<'_>) -> Result<()> {
        self.homography.set(Homography {
            left_from_right: found.left_from_right.0,
            rms_px: found.rms_px,
            inliers: found.inliers as u32,
            state: contract(found.state),
        })?;
        self.roi_left.set(roi(found.roi_left))?;
        self.roi_right.set(roi(found.roi_right))
    }
}
