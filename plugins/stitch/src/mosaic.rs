//! `mosaic`: builds a growing image of everything that one moving camera has seen (thesis, section 2.5).

use std::fmt::Write;

use panoscope_imaging::features::{MatchParams, SurfParams};
use panoscope_imaging::geometry::RansacParams;
use panoscope_imaging::mosaic::{self, MosaicModel, MosaicParams, MosaicReport, MosaicState, MosaicView};
use panoscope_node::abi::{self, Homography};
use panoscope_node::{
    Bgr8, Choice, Context, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData, TextPacket, Validation,
};

/// Model of the maps between keyframes.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Model {
    /// Eight parameters: exact for a plane, however the camera moves.
    Homography,
    /// Six parameters: no perspective.
    Affine,
    /// Four parameters: translation, rotation and scale.
    Similarity,
}

/// Region of the mosaic that is shown.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum ShownPart {
    /// The whole mosaic, scaled down in steps as it grows.
    Fit,
    /// The region around the newest frame, at the scale `zoom`.
    Follow,
}

/// Parameters of the mosaic.
#[derive(Params, Clone, PartialEq)]
pub struct MosaicNodeParams {
    /// Width of the output image.
    #[param(default = 1280, range = 64..=8192, unit = "px")]
    width: u32,
    /// Height of the output image.
    #[param(default = 960, range = 64..=8192, unit = "px")]
    height: u32,
    /// Region of the mosaic that is shown.
    #[param(default = "fit")]
    view: ShownPart,
    /// Pixels of the output per pixel of the first frame: the maximum for `fit`, fixed for `follow`.
    #[param(default = 1.0, range = 0.05..=2.0, step = 0.05, unit = "ratio")]
    zoom: f64,
    /// Also registers against earlier keyframes, and distributes the error of closed loops. Off: registers only against the newest keyframes.
    #[param(default = true)]
    loop_closure: bool,
    /// Maximum number of keyframes. Beyond it a new one replaces the oldest, together with its part of the mosaic. A keyframe of 640x480 takes 1.4
    /// MB.
    #[param(default = 60, range = 2..=500)]
    max_keyframes: u32,
    /// Overlap with keyframes below which a frame becomes a keyframe.
    #[param(default = 0.7, range = 0.3..=0.95, step = 0.01, unit = "ratio")]
    keyframe_overlap: f64,
    /// Model of the maps between keyframes. Fewer parameters drift less on curved tissue but fit a tilting camera worse.
    #[param(default = "homography")]
    model: Model,
    /// Factor by which the image is reduced before features are found.
    #[param(default = 2, range = 1..=8)]
    scale: u32,
    /// Minimum determinant of the Hessian of a keypoint.
    #[param(default = 50.0, range = 1.0..=20000.0, step = 1.0)]
    hessian_threshold: f32,
    /// Maximum number of keypoints per frame.
    #[param(default = 500, range = 50..=10000, unit = "points")]
    max_points: u32,
    /// Ignores the orientation of keypoints, for a scope that hardly rotates about its axis.
    #[param(default = false)]
    upright: bool,
    /// Maximum ratio of the best to the second-best distance of a match.
    #[param(default = 0.8, range = 0.3..=1.0, step = 0.01, unit = "ratio")]
    ratio: f32,
    /// Radius around the predicted position in which matches are searched first; 0 searches everywhere.
    #[param(default = 80.0, range = 0.0..=1000.0, step = 1.0, unit = "px")]
    gate_px: f32,
    /// Maximum reprojection error of an inlier.
    #[param(default = 3.0, range = 0.2..=20.0, step = 0.1, unit = "px")]
    ransac_px: f64,
    /// Minimum number of inliers of a registration; 1.6 times as many without a prediction and for closed loops.
    #[param(default = 15, range = 6..=1000, unit = "points")]
    min_inliers: u32,
    /// Minimum share of matches that are inliers; 1.6 times as large without a prediction and for closed loops.
    #[param(default = 0.25, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_inlier_share: f64,
    /// Movement of keyframes in the image after which the mosaic is redrawn.
    #[param(default = 1.0, range = 0.0..=20.0, step = 0.1, unit = "px")]
    redraw_px: f64,
    /// Equalises the exposure of keyframes.
    #[param(default = true)]
    exposure: bool,
    /// Draws the newest frame on top, with its border.
    #[param(default = true)]
    live: bool,
    /// Marks the output while the camera is lost.
    #[param(default = true)]
    mark_lost: bool,
    /// Each change of this number starts a new mosaic.
    #[param(default = 0, range = 0..=1_000_000)]
    restart: u32,
}

impl MosaicNodeParams {
    fn kernel(&self) -> MosaicParams {
        let default = MosaicParams::default();
        MosaicParams {
            surf: SurfParams {
                hessian_threshold: self.hessian_threshold,
                max_points: self.max_points as usize,
                upright: self.upright,
                ..default.surf
            },
            shrink: self.scale as usize,
            matching: MatchParams { ratio: self.ratio, ..default.matching },
            gate_px: self.gate_px,
            ransac: RansacParams { threshold_px: self.ransac_px, ..default.ransac },
            min_inliers: self.min_inliers as usize,
            min_inlier_share: self.min_inlier_share,
            model: match self.model {
                Model::Homography => MosaicModel::Homography,
                Model::Affine => MosaicModel::Affine,
                Model::Similarity => MosaicModel::Similarity,
            },
            keyframe_overlap: self.keyframe_overlap,
            max_keyframes: self.max_keyframes as usize,
            loop_closure: self.loop_closure,
            redraw_px: self.redraw_px,
            width: self.width as usize,
            height: self.height as usize,
            view: match self.view {
                ShownPart::Fit => MosaicView::Fit,
                ShownPart::Follow => MosaicView::Follow,
            },
            zoom: self.zoom,
            exposure: self.exposure,
            live: self.live,
            mark_lost: self.mark_lost,
            ..default
        }
    }
}

/// Inputs of the mosaic.
#[derive(Ports)]
pub struct In<'f> {
    /// Frames of the camera; all of one size.
    image: Image<'f, Bgr8>,
}

/// Outputs of the mosaic.
#[derive(Ports)]
pub struct Out<'f> {
    /// The mosaic; black where nothing has been seen. The dark rim of a scope's frames is not shown.
    mosaic: Slot<'f, Bgr8>,
    /// Maps pixels of this frame to those of the first keyframe. State: fresh, or lost (with the last good map).
    homography: Slot<'f, Homography>,
    /// Maps pixels of the first keyframe to those of `mosaic`.
    view: Slot<'f, Homography>,
    /// One row per tick. `state`: 0 fresh, 2 lost. `coverage_pct`: area of the keyframes in percent of one frame. `drift_px`, `drift_pct`: error of
    /// the last closed loop before it was distributed, in px and as a percentage of the loop's length; NaN before the first one. `spread_px`:
    /// distance of the keyframes' shared points after the last adjustment.
    table: Slot<'f, TableData>,
    /// The main figures as text, one line each.
    text: Slot<'f, TextPacket>,
}

/// Columns of the table.
pub const COLUMNS: [&str; 14] = [
    "state",
    "keyframes",
    "closures",
    "coverage_pct",
    "drift_px",
    "drift_pct",
    "inliers",
    "rms_px",
    "lost_frames",
    "relocalised",
    "dropped",
    "redraws",
    "path_px",
    "spread_px",
];

/// The `mosaic` node.
pub struct Mosaic {
    kernel: mosaic::Mosaic,
    restart: u32,
    was_lost: bool,
    words: String,
}

fn state_of(report: &MosaicReport) -> u32 {
    match report.state {
        MosaicState::Fresh => abi::STATE_FRESH,
        MosaicState::Lost => abi::STATE_LOST,
    }
}

impl Mosaic {
    /// Logs once each when the camera is lost and when it is found again.
    fn log_state(&mut self, cx: &Context<'_>, report: &MosaicReport) {
        let is_lost = report.state == MosaicState::Lost;
        if is_lost && !self.was_lost && report.keyframes == 0 {
            cx.warn("the mosaic cannot start: the frame has too few features; lower `hessian_threshold`, or check the source");
        } else if is_lost && !self.was_lost {
            cx.warn(
                "the camera is lost: the frame matches no keyframe, and nothing is added until one does; move the scope back to what the mosaic shows, or change `restart` to start a new mosaic",
            );
        } else if !is_lost && self.was_lost {
            cx.info("the camera has been found again");
        }
        self.was_lost = is_lost;
    }

    fn describe(&mut self, report: &MosaicReport) {
        self.words.clear();
        let views = report.coverage_pct / 100.0;
        let plural = |count: u64| if count == 1 { "" } else { "s" };
        let mut line = |words: std::fmt::Arguments<'_>| {
            // Writing to a string cannot fail.
            let _ = self.words.write_fmt(words);
        };
        line(format_args!("mosaic {views:.1} views, {} keyframe{}", report.keyframes, plural(report.keyframes as u64)));
        if report.dropped > 0 {
            line(format_args!(", {} dropped", report.dropped));
        }
        if report.closures > 0 {
            line(format_args!(
                "\n{} loop{} closed, the last {:.1} px off ({:.1} %)",
                report.closures,
                plural(report.closures),
                report.drift_px,
                report.drift_pct
            ));
        }
        if report.state == MosaicState::Lost {
            line(format_args!("\ncamera lost"));
        }
    }
}

impl Node for Mosaic {
    const INFO: NodeInfo = NodeInfo::compute(
        "mosaic",
        "stitch",
        "Adds each frame of one moving camera to a mosaic of everything it has seen; closed loops remove the drift.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = MosaicNodeParams;

    fn validate(params: &MosaicNodeParams, check: &mut Validation<'_>) {
        if u64::from(params.min_inliers) * 2 > u64::from(params.max_points) {
            check.error(
                "min_inliers",
                format!(
                    "`min_inliers` asks for {} inliers, but a frame has at most {} keypoints",
                    params.min_inliers, params.max_points
                ),
                "lower `min_inliers` to half of `max_points` or less",
            );
        }
    }

    fn open(_: &Open<'_>, params: &MosaicNodeParams) -> Result<Self> {
        Ok(Self {
            kernel: mosaic::Mosaic::new(params.kernel()),
            restart: params.restart,
            was_lost: false,
            words: String::new(),
        })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &MosaicNodeParams,
    ) -> Result<()> {
        let wanted = params.kernel();
        if *self.kernel.params() != wanted {
            self.kernel.set_params(wanted, cx.pool());
        }
        if self.restart != params.restart {
            self.restart = params.restart;
            self.kernel.reset();
        }
        let report = match self.kernel.add(input.image.view(), cx.pool()) {
            Ok(report) => report,
            // An error would close the node, and the mosaic would be lost with it.
            Err(error) => {
                cx.fault(&error.to_string());
                return Ok(());
            }
        };
        self.log_state(cx, &report);
        if out.mosaic.is_read() {
            let mut picture = out.mosaic.alloc(params.width as usize, params.height as usize)?;
            self.kernel.draw(&mut picture, cx.pool())?;
        }
        let state = state_of(&report);
        let (inliers, rms_px) = (report.inliers as u32, report.rms_px);
        out.homography.set(Homography { left_from_right: report.mosaic_from_frame.0, rms_px, inliers, state })?;
        out.view.set(Homography { left_from_right: report.picture_from_mosaic.0, rms_px: 0.0, inliers: 0, state })?;
        for (name, value) in [
            ("keyframes", report.keyframes as f64),
            ("closures", report.closures as f64),
            ("coverage_pct", report.coverage_pct),
            ("lost_frames", report.lost_frames as f64),
            ("dropped_keyframes", report.dropped as f64),
        ] {
            cx.metric(name, value);
        }
        if out.text.is_read() {
            self.describe(&report);
            out.text.set_text(&self.words)?;
        }
        let row = [
            f64::from(state),
            report.keyframes as f64,
            report.closures as f64,
            report.coverage_pct,
            report.drift_px,
            report.drift_pct,
            report.inliers as f64,
            report.rms_px,
            report.lost_frames as f64,
            report.relocalised as f64,
            report.dropped as f64,
            report.redraws as f64,
            report.path_px,
            report.spread_px,
        ];
        out.table.set_table(&COLUMNS, &row)
    }
}
