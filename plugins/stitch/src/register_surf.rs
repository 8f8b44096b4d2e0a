//! `register_surf`: computes the homography between two views by their features (thesis, chapter 2, Algs 2.1 and 2.2).

use panoscope_imaging::features::{self, MatchParams, RegisterParams, SurfParams};
use panoscope_imaging::geometry::ransac::RansacParams;
use panoscope_node::{Context, Gray8, Image, Node, NodeInfo, Open, Params, Ports, Result};

use crate::registration::{HoldParams, Out, Registered, Reporter};

/// Parameters of the registration.
#[derive(Params, Clone, PartialEq)]
pub struct RegisterSurfParams {
    /// Searches only the overlap of the previous frame, reduced by `scale`. Off: searches whole frames at full size.
    #[param(default = true)]
    roi: bool,
    /// Factor by which the search regions are reduced when `roi` is on.
    #[param(default = 2, range = 1..=8)]
    scale: u32,
    /// Minimum determinant of the Hessian of a keypoint.
    #[param(default = 50.0, range = 1.0..=20000.0, step = 1.0)]
    hessian_threshold: f32,
    /// Maximum number of keypoints per view, strongest first.
    #[param(default = 400, range = 16..=10000, unit = "points")]
    max_points: u32,
    /// Distributes the keypoints over the search region: each cell of a 6 x 4 grid takes its share before the strongest fill the rest.
    #[param(default = true)]
    spread: bool,
    /// Locates each keypoint more precisely with Gaussian derivatives; doubles the time.
    #[param(default = false)]
    second_look: bool,
    /// Octaves of the scale space.
    #[param(default = 4, range = 1..=4)]
    octaves: u32,
    /// Ignores the orientation of keypoints, for cameras that are hardly rotated relative to each other.
    #[param(default = true)]
    upright: bool,
    /// Maximum ratio of the best to the second-best distance of a match.
    #[param(default = 0.8, range = 0.3..=1.0, step = 0.01, unit = "ratio")]
    ratio: f32,
    /// Maximum reprojection error of an inlier.
    #[param(default = 5.0, range = 0.2..=20.0, step = 0.1, unit = "px")]
    ransac_px: f64,
    /// Minimum number of inliers of a registration.
    #[param(default = 8, range = 4..=1000, unit = "points")]
    min_inliers: u32,
    #[param(flatten)]
    keep: HoldParams,
    /// Also finds narrow overlaps: when whole views do not match, searches facing sides at full size. Only with `roi`.
    #[param(default = false)]
    strips: bool,
}

/// Columns and rows of the grid on a search region.
const SPREAD: (usize, usize) = (6, 4);

impl RegisterSurfParams {
    fn kernel(&self) -> RegisterParams {
        let default = RegisterParams::default();
        RegisterParams {
            surf: SurfParams {
                hessian_threshold: self.hessian_threshold,
                octaves: self.octaves as usize,
                upright: self.upright,
                max_points: self.max_points as usize,
                second_look: self.second_look,
                spread: if self.spread { SPREAD } else { (0, 0) },
                ..default.surf
            },
            roi: self.roi,
            shrink: self.scale as usize,
            matching: MatchParams { ratio: self.ratio, ..default.matching },
            ransac: RansacParams { threshold_px: self.ransac_px, ..default.ransac },
            min_inliers: self.min_inliers as usize,
            stability_px: self.keep.stability_px,
            anchor_fit: self.keep.anchor_fit,
            max_rms_px: self.keep.max_rms_px,
            hold_frames: self.keep.hold_frames as usize,
            strips: self.strips,
            ..default
        }
    }
}

/// Settings of the kernel with this node's defaults.
pub(crate) fn by_default(keep: &HoldParams) -> RegisterParams {
    RegisterSurfParams {
        roi: true,
        scale: 2,
        hessian_threshold: 50.0,
        max_points: 400,
        spread: true,
        second_look: false,
        octaves: 4,
        upright: true,
        ratio: 0.8,
        ransac_px: 5.0,
        min_inliers: 8,
        keep: keep.clone(),
        strips: false,
    }
    .kernel()
}

/// Inputs of the registration.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view; the homography maps to its pixels.
    left: Image<'f, Gray8>,
    /// Right view of the same instant.
    right: Image<'f, Gray8>,
}

/// The `register_surf` node.
pub struct RegisterSurf {
    kernel: features::RegisterSurf,
    reporter: Reporter,
}

impl Node for RegisterSurf {
    const INFO: NodeInfo = NodeInfo::compute(
        "register_surf",
        "stitch",
        "Finds the homography between two overlapping views by SURF and RANSAC, on the overlap seen last.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = RegisterSurfParams;

    fn open(_: &Open<'_>, params: &RegisterSurfParams) -> Result<Self> {
        Ok(Self { kernel: features::RegisterSurf::new(params.kernel()), reporter: Reporter::default() })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &RegisterSurfParams,
    ) -> Result<()> {
        let wanted = params.kernel();
        if *self.kernel.params() != wanted {
            self.kernel.set_params(wanted);
        }
        let found = self.kernel.register(input.left.view(), input.right.view(), cx.pool());
        let found = Registered {
            left_from_right: &found.left_from_right,
            rms_px: found.rms_px,
            refused_rms_px: found.refused_rms_px,
            inliers: found.inliers,
            state: found.state,
            roi_left: &found.roi_left,
            roi_right: &found.roi_right,
        };
        let help = "move back, clean the lenses, or set `strips = true`";
        self.reporter.finish(cx, &mut out, &found, params.keep.max_rms_px, help)
    }
}
