//! Shared by registration nodes: outputs, the parameters that hold a homography, warnings.

use panoscope_imaging::Rect;
use panoscope_imaging::geometry::{self, RegistrationMonitor, RegistrationState, RmsWatch};
use panoscope_node::abi::{self, Homography, Roi};
use panoscope_node::{Context, Params, Ports, Result, Slot};

/// Outputs of a registration.
#[derive(Ports)]
pub struct Out<'f> {
    /// Maps right-view pixels to left-view pixels, with its state: fresh, held or lost.
    homography: Slot<'f, Homography>,
    /// Part of the left view that the right view also shows.
    roi_left: Slot<'f, Roi>,
    /// Part of the right view that the left view also shows.
    roi_right: Slot<'f, Roi>,
}

/// Parameters of every registration: how long a homography is held, and when it is lost.
#[derive(Params, Clone, PartialEq)]
pub struct HoldParams {
    /// Keeps the previous homography while its median error on the new inliers is below this; 0 fits every frame independently.
    #[param(default = 0.8, range = 0.0..=10.0, step = 0.1, unit = "px")]
    pub stability_px: f64,
    /// Weight of the previous frame's homography relative to all inliers. It stabilises the parts of the image that the overlap does not determine; 0
    /// fits only the inliers.
    #[param(default = 1.0, range = 0.0..=4.0, step = 0.05, unit = "ratio")]
    pub anchor_fit: f64,
    /// Maximum root mean square error of the inliers. A worse homography is not used: the previous one is held, then lost. 0 uses all.
    #[param(default = 18.0, range = 0.0..=100.0, step = 0.5, unit = "px")]
    pub max_rms_px: f64,
    /// Number of consecutive failed frames during which the previous homography counts as held; after that it is lost.
    #[param(default = 5, range = 0..=1000, unit = "frames")]
    pub hold_frames: u32,
}

/// Logs when a registration gets worse or is lost, and sets the outputs.
#[derive(Default)]
pub struct Reporter {
    rms: RmsWatch,
    lost: RegistrationMonitor,
}

impl Reporter {
    /// Finishes one tick. `help` says what a user can do when the views no longer match.
    ///
    /// # Errors
    /// The host has no frame memory left.
    pub fn finish(
        &mut self,
        cx: &Context<'_>,
        out: &mut Out<'_>,
        found: &Registered<'_>,
        max_rms_px: f64,
        help: &str,
    ) -> Result<()> {
        self.rms.look(cx, found.rms_px, found.refused_rms_px, max_rms_px);
        self.lost.observe(cx, found.state, help);
        out.set(found)
    }
}

/// Result of a registration kernel.
pub struct Registered<'a> {
    /// Maps right-view pixels to left-view pixels.
    pub left_from_right: &'a geometry::Homography,
    /// Root mean square distance of the inliers in px.
    pub rms_px: f64,
    /// The same for a homography that was refused because of it.
    pub refused_rms_px: Option<f64>,
    /// Number of inliers.
    pub inliers: usize,
    /// State of the registration: fresh, held or lost.
    pub state: RegistrationState,
    /// Overlap in the left view.
    pub roi_left: &'a Rect,
    /// Overlap in the right view.
    pub roi_right: &'a Rect,
}

/// Converts the state to a constant of the ABI.
fn abi_state(state: RegistrationState) -> u32 {
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
    /// Sets all outputs.
    fn set(&mut self, found: &Registered<'_>) -> Result<()> {
        self.homography.set(Homography {
            left_from_right: found.left_from_right.0,
            rms_px: found.rms_px,
            inliers: found.inliers as u32,
            state: abi_state(found.state),
        })?;
        self.roi_left.set(roi(found.roi_left))?;
        self.roi_right.set(roi(found.roi_right))
    }
}
