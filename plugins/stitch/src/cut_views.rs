//! `cut_views`: cuts one image into two overlapping views with a known homography between them.

use panoscope_imaging::stitch::cut::{self, CutParams};
use panoscope_node::abi::{self, Homography, Roi};
use panoscope_node::{Bgr8, Context, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot};

/// Parameters of the cut.
#[derive(Params, Clone, PartialEq)]
pub struct CutViewsParams {
    /// Overlap of both views, as a share of their width.
    #[param(default = 0.5, range = 0.1..=0.9, step = 0.05, unit = "ratio")]
    overlap: f64,
    /// Maximum displacement of the right view's corners by its perspective.
    #[param(default = 12.0, range = 0.0..=200.0, step = 1.0, unit = "px")]
    perspective_px: f64,
    /// Amplitude of the movement of each corner of the right view; 0 keeps it still.
    #[param(default = 2.0, range = 0.0..=50.0, step = 0.5, unit = "px")]
    sway_px: f64,
    /// Period of the movement.
    #[param(default = 60, range = 2..=10000, unit = "frames")]
    sway_frames: u32,
    /// Exposure of the right view relative to the left one.
    #[param(default = 0.9, range = 0.25..=1.9, step = 0.01, unit = "ratio")]
    right_exposure: f32,
    /// Standard deviation of the noise added to each view, gray levels.
    #[param(default = 2.0, range = 0.0..=32.0, step = 0.5)]
    noise_levels: f32,
    /// Seed of shape, movement and noise.
    #[param(default = 7, range = 0..=1_000_000_000)]
    seed: u64,
}

impl CutViewsParams {
    fn kernel(&self) -> CutParams {
        CutParams {
            overlap: self.overlap,
            perspective_px: self.perspective_px,
            sway_px: self.sway_px,
            sway_frames: f64::from(self.sway_frames),
            right_exposure: self.right_exposure,
            noise_levels: self.noise_levels,
            seed: self.seed,
        }
    }
}

/// Inputs of the cut.
#[derive(Ports)]
pub struct In<'f> {
    /// Image to cut.
    image: Image<'f, Bgr8>,
}

/// Outputs of the cut.
#[derive(Ports)]
pub struct Out<'f> {
    /// Left part of the image, with noise.
    left: Slot<'f, Bgr8>,
    /// Right part with another perspective, exposure and tint, with noise.
    right: Slot<'f, Bgr8>,
    /// True homography: maps right-view pixels to left-view pixels.
    homography: Slot<'f, Homography>,
    /// Rectangle of the left view in the image, px.
    left_in_image: Slot<'f, Roi>,
}

/// The `cut_views` node.
pub struct CutViews;

impl Node for CutViews {
    const INFO: NodeInfo = NodeInfo::compute(
        "cut_views",
        "stitch",
        "Cuts an image into two overlapping views with different perspective, exposure and noise: real images with a true homography.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = CutViewsParams;

    fn open(_: &Open<'_>, _: &CutViewsParams) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &CutViewsParams,
    ) -> Result<()> {
        let (params, frame, picture) = (params.kernel(), cx.tick().seq, input.image.view());
        let geometry = cut::geometry(&params, (picture.width, picture.height), frame)?;
        let (width, height) = geometry.size;
        let (mut left, mut right) = (out.left.alloc(width, height)?, out.right.alloc(width, height)?);
        cut::draw(&params, &geometry, frame, picture, cx.pool(), &mut left, &mut right)?;
        let (x, y) = geometry.left_at;
        out.left_in_image.set(Roi { x: x as i32, y: y as i32, width: width as i32, height: height as i32 })?;
        out.homography.set(Homography {
            left_from_right: geometry.left_from_right.0,
            rms_px: 0.0,
            inliers: 0,
            state: abi::STATE_FRESH,
        })
    }
}
