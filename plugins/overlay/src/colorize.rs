//! `colorize`: a map of numbers as a picture.

use panoscope_imaging::draw::{self, Colormap, ScaleBar};
use panoscope_node::{
    Bgr8, Choice, Confidence, Context, Depth, Disparity, Image, Node, NodeError, NodeInfo, Open, Params, Ports, Result,
    Slot, Validation, View, ViewMut,
};

use crate::fit::usual_range;

/// Colours of the values.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colors {
    /// Dark blue over green and yellow to dark red.
    Rainbow,
    /// Dark violet over teal to yellow, even brightness.
    Viridian,
    /// Black to white.
    Gray,
}

impl From<Colors> for Colormap {
    fn from(colors: Colors) -> Self {
        match colors {
            Colors::Rainbow => Self::Rainbow,
            Colors::Viridian => Self::Viridian,
            Colors::Gray => Self::Gray,
        }
    }
}

/// Inputs: connect one of them.
#[derive(Ports)]
pub struct In<'f> {
    /// Disparity in px.
    pub disparity: Option<Image<'f, Disparity>>,
    /// Depth in mm.
    pub depth: Option<Image<'f, Depth>>,
    /// Confidence, 0 to 1.
    pub confidence: Option<Image<'f, Confidence>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// The coloured map; unknown pixels are dark gray.
    pub image: Slot<'f, Bgr8>,
}

/// Parameters.
#[derive(Params)]
pub struct Settings {
    /// Value of the first colour. When `high` is not above it, the range follows the picture.
    #[param(default = 0.0, range = -100000.0..=100000.0)]
    pub low: f32,
    /// Value of the last colour.
    #[param(default = 0.0, range = -100000.0..=100000.0)]
    pub high: f32,
    /// Colours.
    #[param(default = "rainbow")]
    pub colors: Colors,
    /// Draws the colour scale with its values.
    #[param(default = true)]
    pub scale_bar: bool,
    /// Puts the scale in a strip to the right of the map instead of onto it: the picture is wider, and its coordinates stay.
    #[param(default = false)]
    pub scale_beside: bool,
}

/// Width of the strip for the scale in units of the scale of its text: the bar, and labels such as `100 mm`.
const STRIP: f32 = 50.0;
/// Colour of that strip: that of a screen.
const GROUND: u8 = 16;

/// A range that follows the pictures without flicker.
#[derive(Clone, Debug, Default)]
pub struct AutoRange {
    range: Option<(f32, f32)>,
    work: Vec<f32>,
}

impl AutoRange {
    /// Part of the way to a picture's own range that one picture moves.
    const STEP: f32 = 0.15;

    /// The range for `plane`.
    pub fn follow(&mut self, plane: &View<'_, f32>) -> (f32, f32) {
        let step = 1 + plane.width.max(plane.height) / 256;
        if let Some((low, high)) = usual_range(plane, step, &mut self.work) {
            let (old_low, old_high) = *self.range.get_or_insert((low, high));
            self.range = Some((old_low + (low - old_low) * Self::STEP, old_high + (high - old_high) * Self::STEP));
        }
        let (low, high) = self.range.unwrap_or((0.0, 1.0));
        (low, high.max(low + 1e-3))
    }
}

/// Colours maps of numbers.
#[derive(Default)]
pub struct Colorize {
    auto: AutoRange,
}

impl Node for Colorize {
    const INFO: NodeInfo =
        NodeInfo::compute("colorize", "overlay", "Shows a disparity, depth or confidence map in colours.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn validate(_: &Settings, check: &mut Validation<'_>) {
        let is_connected = |name: &&&str| check.is_connected(name) == Some(true);
        if ["disparity", "depth", "confidence"].iter().filter(is_connected).count() > 1 {
            check.node_error("it colours one map, and more than one is connected", "give each map a `colorize`");
        }
    }

    fn open(_: &Open<'_>, _: &Settings) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Settings) -> Result<()> {
        let maps = [
            input.disparity.map(|plane| (plane.view(), "px")),
            input.depth.map(|plane| (plane.view(), "mm")),
            input.confidence.map(|plane| (plane.view(), "")),
        ];
        if maps.iter().flatten().count() > 1 {
            return Err(NodeError::new(
                "one map at a time: give `disparity`, `depth` and `confidence` a `colorize` each",
            ));
        }
        let is_confidence = maps[2].is_some();
        let Some((plane, unit)) = maps.into_iter().flatten().next() else { return Ok(()) };
        let (low, high) = if params.high > params.low {
            (params.low, params.high)
        } else if is_confidence {
            (0.0, 1.0)
        } else {
            self.auto.follow(&plane)
        };
        let (width, height) = (plane.width as i32, plane.height as i32);
        let is_beside = params.scale_bar && params.scale_beside;
        // Beside the map there is room, so that it can be read on a screen on which the map is small.
        let text_scale = if is_beside { height as f32 / 180.0 } else { (height as f32 / 320.0).clamp(1.0, 3.0) };
        let strip_px = if is_beside { (STRIP * text_scale) as usize } else { 0 };
        let mut picture = out.image.alloc(plane.width + strip_px, plane.height)?;
        let (stride, columns) = (picture.stride, plane.width * 3);
        let mut map = ViewMut::with_stride(&mut *picture.data, plane.width, plane.height, 3, stride);
        draw::colorize(&plane, low, high, params.colors.into(), &mut map);
        if params.scale_bar {
            (0..plane.height).for_each(|y| picture.row_mut(y)[columns..].fill(GROUND));
            let (x, high_px) = if is_beside {
                (width + 2 + (3.0 * text_scale) as i32, height * 3 / 4)
            } else {
                (width / 40 + 4, height / 2)
            };
            let bar = ScaleBar {
                x,
                y: if is_beside { height / 8 } else { height / 12 + 4 },
                width_px: if is_beside { (5.0 * text_scale) as i32 } else { (width / 50).max(6) },
                height_px: high_px,
                low,
                high,
                unit,
                map: params.colors.into(),
                labels: 5,
                text_scale,
            };
            draw::scale_bar(&mut picture, &bar);
        }
        Ok(())
    }
}
