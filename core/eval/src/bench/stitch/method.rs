//! The methods of stitching that are timed, as graph text.

use std::fmt::Write as _;

use crate::bench::CAMERA_HZ;
use crate::inputs::pairs::Pairs;

/// Images that are rendered and played in a loop.
pub const PICTURES: u64 = 16;

/// Frames in which the timed composite finds a seam.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seam {
    /// The default parameters.
    Default,
    EveryFrame,
    /// In the first frame only; OpenCV's composite, which keeps none, uses no seam.
    Once,
}

/// A method of stitching.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    Roi,
    Conventional,
    Grid,
    Mesh,
    OpencvFull,
    OpencvTenth,
    OpencvPath,
}

impl Method {
    pub fn is_opencv(self) -> bool {
        matches!(self, Self::OpencvFull | Self::OpencvTenth | Self::OpencvPath)
    }

    /// Whether it finds a seam in each frame by default.
    pub fn always_finds(self) -> bool {
        self.is_opencv() || self == Self::Conventional
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Roi => "roi",
            Self::Conventional => "conventional",
            Self::Grid => "grid",
            Self::Mesh => "mesh",
            Self::OpencvFull => "OpenCV full",
            Self::OpencvTenth => "OpenCV 0.1 MP",
            Self::OpencvPath => "OpenCV shortest path",
        }
    }

    /// Nodes `match` (grid only), `register` and `wide`, scaled as the thesis does: a whole frame shrunk to about
    /// 320x240.
    pub fn nodes(self, width: u32, threads: usize, seam: Seam) -> String {
        let (scale, scale_of_seam) = ((width / 320).clamp(1, 8), (width / 64).clamp(2, 64));
        let views = "left = \"files.left\", right = \"files.right\"";
        let register = match self {
            Self::Roi => format!("type = \"register_surf\"\ninputs = {{ {views} }}\nparams = {{ roi = true, scale = {scale} }}"),
            Self::Conventional => format!(
                "type = \"register_surf\"\ninputs = {{ {views} }}\nparams = {{ roi = false, spread = false, second_look = true, max_points = 2000, upright = false, stability_px = 0.0 }}"
            ),
            Self::Grid | Self::Mesh => "type = \"register_grid\"\ninputs = { disparity = \"match.disparity\", calibration = \"files.calibration\" }\nparams = { ransac_px = 12.0 }".to_owned(),
            Self::OpencvFull | Self::OpencvTenth | Self::OpencvPath => {
                let work = if self == Self::OpencvFull { 0.0 } else { 0.6 };
                format!(
                    "type = \"register_opencv\"\ninputs = {{ {views} }}\nparams = {{ threads = {threads}, mutual = false, work_megapixels = {work:?} }}"
                )
            }
        };
        let (kind, mut params) = match self {
            Self::Roi | Self::Grid => ("composite", format!("seam_scale = {scale_of_seam}")),
            Self::Mesh => (
                "composite_mesh",
                format!(
                    "seam_scale = {scale_of_seam}, seam = \"dynamic_programming\", blend = \"feather\", blend_px = 24"
                ),
            ),
            // What is left without the seam does not sample the overlap at full size either.
            Self::Conventional if seam == Seam::Once => ("composite", "seam_scale = 10".to_owned()),
            Self::Conventional => ("composite", "seam_scale = 1".to_owned()),
            Self::OpencvFull => ("composite_opencv", format!("threads = {threads}")),
            Self::OpencvTenth | Self::OpencvPath => {
                ("composite_opencv", format!("threads = {threads}, seam_megapixels = 0.1"))
            }
        };
        params.push_str(match (self, seam) {
            (Self::OpencvFull | Self::OpencvTenth | Self::OpencvPath, Seam::Once) => ", seam = \"none\"",
            (Self::OpencvFull | Self::OpencvTenth, _) => "",
            (Self::OpencvPath, _) => ", seam = \"dynamic_programming\"",
            (_, Seam::Once) => ", seam_interval = 10000",
            (Self::Conventional, _) | (_, Seam::EveryFrame) => ", seam_interval = 1",
            (Self::Roi | Self::Grid | Self::Mesh, Seam::Default) => "",
        });
        let depth = if self == Self::Mesh {
            ", disparity = \"match.disparity\", calibration = \"files.calibration\""
        } else {
            ""
        };
        let mut text = format!(
            "[nodes.register]\n{register}\nbudget_ms = 60000\n[nodes.wide]\nbudget_ms = 60000\ntype = \"{kind}\"\ninputs = {{ {views}, homography = \"register.homography\"{depth} }}\nparams = {{ {params} }}\n"
        );
        if matches!(self, Self::Grid | Self::Mesh) {
            let _ = write!(
                text,
                "[nodes.match]\ntype = \"stereo_bm\"\ninputs = {{ {views}, roi = {{ from = \"register.roi_left\", delay = 1 }} }}\nparams = {{ scale = {scale} }}\n"
            );
        }
        text
    }

    pub fn frames(self, width: u32, quick: bool) -> u64 {
        let many = if quick { 24 } else { 72 };
        match self {
            Self::Roi => many,
            Self::Grid | Self::Mesh => many / 2,
            Self::Conventional => many / 6,
            // Each pair once: how long a cut takes depends on the pair more than on anything else.
            Self::OpencvFull if width > 640 => 2,
            Self::OpencvFull | Self::OpencvTenth if quick => PICTURES / 2,
            Self::OpencvFull | Self::OpencvTenth | Self::OpencvPath => PICTURES,
        }
    }
}

/// Graph of one method on rendered pairs.
pub fn text_of(pairs: &Pairs, width: u32, method: Method, seam: Seam, threads: usize) -> String {
    format!(
        "mode = \"batch\"\nplugins = [\"capture\", \"stereo\", \"stitch\", \"opencv\", \"flow\"]\n[nodes.files]\n{}{}\
         [nodes.sink]\ntype = \"drain\"\ninputs = {{ image = \"wide.panorama\" }}\n",
        pairs.node("off", CAMERA_HZ),
        method.nodes(width, threads, seam)
    )
}
