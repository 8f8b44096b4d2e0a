//! `features_surf`: SURF keypoints of two views and their matches, as tables.

use panoscope_imaging::features::{Features, Match, MatchParams, Matcher, Surf, SurfParams};
use panoscope_node::{Context, Gray8, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData};

/// Parameters of the features.
#[derive(Params, Clone, PartialEq)]
pub struct FeaturesSurfParams {
    /// Minimum determinant of the Hessian of a keypoint.
    #[param(default = 100.0, range = 0.0..=20000.0, step = 1.0)]
    hessian_threshold: f32,
    /// Maximum number of keypoints per view, strongest first; 0 keeps all.
    #[param(default = 0, range = 0..=100_000, unit = "points")]
    max_points: u32,
    /// Octaves of the scale space.
    #[param(default = 4, range = 1..=4)]
    octaves: u32,
    /// Number of filters per octave.
    #[param(default = 4, range = 3..=8)]
    layers: u32,
    /// Ignores the orientation of keypoints, for cameras that are hardly rotated relative to each other.
    #[param(default = false)]
    upright: bool,
    /// Exponent of the size by which responses are divided for ranking: larger values prefer fine detail, which is located more precisely.
    #[param(default = 1.0, range = 0.0..=4.0, step = 0.1)]
    fine_bias: f32,
    /// Doubles the size of the image first: finer keypoints, about four times the time. Only with `scale` 1.
    #[param(default = false)]
    upsample: bool,
    /// Size of the descriptor's window relative to the usual one.
    #[param(default = 1.0, range = 0.5..=4.0, step = 0.05, unit = "ratio")]
    window: f32,
    /// Descriptors of 128 instead of 64 elements, from a narrow and a wide window: more correct matches, slower.
    #[param(default = false)]
    extended: bool,
    /// Locates each keypoint more precisely with Gaussian derivatives; slow.
    #[param(default = true)]
    second_look: bool,
    /// Factor by which the image is reduced before the search.
    #[param(default = 1, range = 1..=8)]
    scale: u32,
    /// Maximum ratio of the best to the second-best distance of a match.
    #[param(default = 0.8, range = 0.3..=1.0, step = 0.01, unit = "ratio")]
    ratio: f32,
    /// Keeps a match only when each point is the other's best.
    #[param(default = true)]
    mutual: bool,
}

impl FeaturesSurfParams {
    fn surf(&self) -> SurfParams {
        SurfParams {
            hessian_threshold: self.hessian_threshold,
            max_points: self.max_points as usize,
            octaves: self.octaves as usize,
            layers: self.layers as usize,
            upright: self.upright,
            fine_bias: self.fine_bias,
            upsample: self.upsample,
            window: self.window,
            extended: self.extended,
            second_look: self.second_look,
            ..SurfParams::default()
        }
    }
}

/// Inputs of the features.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view, or the only one.
    left: Image<'f, Gray8>,
    /// Right view, of any size. Without it no matches are made.
    right: Option<Image<'f, Gray8>>,
}

/// Outputs of the features.
#[derive(Ports)]
pub struct Out<'f> {
    /// Keypoints of the left view, strongest first.
    left_points: Slot<'f, TableData>,
    /// Keypoints of the right view.
    right_points: Slot<'f, TableData>,
    /// Matches: row numbers in both tables.
    matches: Slot<'f, TableData>,
}

/// The `features_surf` node.
pub struct FeaturesSurf {
    surf: Surf,
    matcher: Matcher,
    left: Features,
    right: Features,
    matches: Vec<Match>,
    values: Vec<f64>,
}

fn table<'a>(features: &Features, values: &'a mut Vec<f64>) -> &'a [f64] {
    let points = &features.keypoints;
    values.clear();
    for i in 0..points.len() {
        let row =
            [points.x_px[i], points.y_px[i], points.size_px[i], points.angle_rad[i].to_degrees(), points.response[i]];
        values.extend(row.map(f64::from));
    }
    values
}

impl Node for FeaturesSurf {
    const INFO: NodeInfo =
        NodeInfo::compute("features_surf", "stitch", "Finds and matches SURF features of two views.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = FeaturesSurfParams;

    fn open(_: &Open<'_>, params: &FeaturesSurfParams) -> Result<Self> {
        Ok(Self {
            surf: Surf::new(params.surf()),
            matcher: Matcher::new(),
            left: Features::default(),
            right: Features::default(),
            matches: Vec::new(),
            values: Vec::new(),
        })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &FeaturesSurfParams,
    ) -> Result<()> {
        const POINTS: [&str; 5] = ["x_px", "y_px", "size_px", "angle_deg", "response"];
        let (pool, scale) = (cx.pool(), params.scale as usize);
        self.surf.set_params(params.surf());
        self.surf.detect_and_describe(input.left.view(), None, scale, pool, &mut self.left);
        out.left_points.set_table(&POINTS, table(&self.left, &mut self.values))?;
        let Some(right) = &input.right else { return Ok(()) };
        self.surf.detect_and_describe(right.view(), None, scale, pool, &mut self.right);
        let matching = MatchParams { ratio: params.ratio, mutual: params.mutual, same_sign: true };
        self.matcher.match_features(&self.left, &self.right, &matching, None, pool, &mut self.matches);
        cx.metric("matches", self.matches.len() as f64);
        out.right_points.set_table(&POINTS, table(&self.right, &mut self.values))?;
        self.values.clear();
        for m in &self.matches {
            let row = [f64::from(m.left), f64::from(m.right), f64::from(m.distance), f64::from(m.ratio)];
            self.values.extend(row);
        }
        out.matches.set_table(&["left_index", "right_index", "distance", "ratio"], &self.values)
    }
}
