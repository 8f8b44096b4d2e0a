//! `colorize`: shows a map of numbers as an image.

use panoscope_imaging::draw::{self, Colormap, ScaleBar};
use panoscope_imaging::fit::Fit;
use panoscope_node::abi::Scalar;
use panoscope_node::device::{Device, DeviceImage, OnDevice};
use panoscope_node::{
    Bgr8, Choice, Confidence, Context, Depth, Disparity, Image, Node, NodeError, NodeInfo, Open, Params, Ports, Result,
    Slot, Validation, Value, View, ViewMut,
};

use crate::fit::{enlargement, usual_range};
use crate::gpu::colors::MapPainter;

/// Colour maps.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colors {
    /// Dark blue through green and yellow to dark red.
    Rainbow,
    /// Dark violet through teal to yellow, with uniform brightness.
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

/// Inputs: connect one map.
#[derive(Ports)]
pub struct In<'f> {
    /// Disparity in px.
    pub disparity: Option<Image<'f, Disparity>>,
    /// Depth in mm.
    pub depth: Option<Image<'f, Depth>>,
    /// Confidence, 0 to 1.
    pub confidence: Option<Image<'f, Confidence>>,
    /// Above 0 while the calibration does not fit the views, as a matcher reports it. The scale of depths then shows near and far instead of mm.
    pub drifted: Option<Value<'f, Scalar>>,
}

/// Output ports of `colorize`.
#[derive(Ports)]
pub struct Out<'f> {
    /// The coloured map. Unknown pixels are dark gray; numbers below the range are black, those above it white (in `gray`: blue and red).
    pub image: Slot<'f, Bgr8>,
}

/// Parameters of `colorize`.
#[derive(Params)]
pub struct Settings {
    /// Value of the first colour. When `high` is not greater, the range is that of the image, rounded; it is held as long as it fits.
    #[param(default = 0.0, range = -100000.0..=100000.0)]
    pub low: f32,
    /// Value of the last colour.
    #[param(default = 0.0, range = -100000.0..=100000.0)]
    pub high: f32,
    /// Colour map.
    #[param(default = "rainbow")]
    pub colors: Colors,
    /// Draws the colour scale with its values.
    #[param(default = true)]
    pub scale_bar: bool,
    /// Puts the scale in a strip to the right of the map instead of on it: the image is wider, and its coordinates do not change.
    #[param(default = false)]
    pub scale_beside: bool,
    /// Width to which a small map with its scale next to it is enlarged, by the nearest integer factor, so that the text stays sharp on a large
    /// screen. 0 keeps its size.
    #[param(default = 0, range = 0..=4096, unit = "px")]
    pub wanted_width: usize,
    /// What paints the map. A GPU paints a map that was made there, is not enlarged and has no scale on it: the image stays there, and only a sample
    /// of the map is read. All else is painted by the processor, which does everything without a GPU, with a warning.
    #[param(default = "cpu")]
    pub device: Device,
}

/// Width of the strip for the scale in units of its text scale: the bar, and labels such as `100 mm`.
const STRIP: f32 = 50.0;
/// Gray level of that strip, as on a screen.
const GROUND: u8 = 16;

/// A range of rounded steps that is held as long as it fits, so that a colour keeps its meaning from image to image.
#[derive(Clone, Debug, Default)]
pub struct AutoRange {
    range: Option<(f32, f32)>,
    /// Number of consecutive images that the range did not fit.
    unsuited: u32,
    work: Vec<f32>,
}

/// Shares of an image's numbers outside the range: above the first the range changes at once, above the second when that lasts.
const BEYOND: [f32; 2] = [0.04, 0.015];
/// Minimum share of the range that the numbers must fill.
const MIN_FILLED: f32 = 0.45;
/// Number of consecutive images after which a range that does not fit changes.
const PATIENCE: u32 = 15;

/// The range around `low` and `high` in steps of 1, 2 or 5 times a power of ten, with a margin for small changes.
fn rounded((low, high): (f32, f32)) -> (f32, f32) {
    let span = (high - low).max(1e-3 * high.abs()).max(1e-3);
    let room = 0.06 * span;
    let decade = 10f32.powf((span / 8.0).log10().floor());
    let step = [1.0, 2.0, 5.0].into_iter().map(|m| m * decade).find(|step| 8.0 * step >= span).unwrap_or(10.0 * decade);
    let first = ((low - room) / step).floor() * step;
    // Depths and disparities have no numbers below zero.
    let first = if low >= 0.0 { first.max(0.0) } else { first };
    (first, ((high + room) / step).ceil() * step)
}

impl AutoRange {
    /// Updates the range for `plane` and returns it.
    pub fn follow(&mut self, plane: &View<'_, f32>) -> (f32, f32) {
        self.follow_sample(plane, sample_step(plane.width, plane.height))
    }

    /// As [`Self::follow`], for every `step`-th number of every `step`-th row.
    fn follow_sample(&mut self, plane: &View<'_, f32>, step: usize) -> (f32, f32) {
        if let Some(usual) = usual_range(plane, step, &mut self.work) {
            let (low, high) = *self.range.get_or_insert_with(|| rounded(usual));
            let beyond = self.work.iter().filter(|v| **v < low || **v > high).count() as f32 / self.work.len() as f32;
            let is_loose = usual.1 - usual.0 < MIN_FILLED * (high - low) && rounded(usual) != (low, high);
            self.unsuited = if is_loose || beyond > BEYOND[1] { self.unsuited + 1 } else { 0 };
            if beyond > BEYOND[0] || self.unsuited >= PATIENCE {
                (self.range, self.unsuited) = (Some(rounded(usual)), 0);
            }
        }
        self.range.unwrap_or((0.0, 1.0))
    }
}

/// Step between the numbers of a map of this size by which a range follows it.
fn sample_step(width: usize, height: usize) -> usize {
    1 + width.max(height) / 256
}

/// Step between the numbers by which [`beyond_share`] is found.
const SHARE_STEP: usize = 4;

/// Share of the known numbers outside a range, of every `step`-th number of every `step`-th row; `None` where nothing is known.
fn beyond_share(plane: &View<'_, f32>, step: usize, (low, high): (f32, f32)) -> Option<f64> {
    let (mut known, mut beyond) = (0, 0);
    for y in (0..plane.height).step_by(step) {
        for v in plane.row(y).iter().step_by(step).filter(|v| !v.is_nan()) {
            known += 1;
            beyond += usize::from(*v < low || *v > high);
        }
    }
    (known > 0).then(|| beyond as f64 / known as f64)
}

/// The connected map.
#[derive(Clone, Copy)]
enum Map<'f> {
    Disparity(Image<'f, Disparity>),
    Depth(Image<'f, Depth>),
    Confidence(Image<'f, Confidence>),
}

/// Does the same with any map.
macro_rules! of_map {
    ($map:expr, $image:ident => $do:expr) => {
        match $map {
            Map::Disparity($image) => $do,
            Map::Depth($image) => $do,
            Map::Confidence($image) => $do,
        }
    };
}

impl<'f> Map<'f> {
    fn size(&self) -> (usize, usize) {
        of_map!(self, image => (image.width(), image.height()))
    }

    fn view(&self) -> View<'f, f32> {
        of_map!(self, image => image.view())
    }

    fn is_from_device(&self) -> bool {
        of_map!(self, image => image.is_from_device())
    }

    fn on_device(&self) -> Result<DeviceImage> {
        of_map!(self, image => image.on_device())
    }

    fn unit(&self) -> &'static str {
        match self {
            Self::Disparity(_) => "px",
            Self::Depth(_) => "mm",
            Self::Confidence(_) => "",
        }
    }
}

/// Where the scale is in the image.
struct Layout {
    /// Columns and rows of the coloured map.
    size: (usize, usize),
    is_beside: bool,
    text_scale: f32,
    /// Width of the strip for the scale.
    strip_px: usize,
}

impl Layout {
    fn of(size: (usize, usize), is_beside: bool) -> Self {
        let height = size.1 as f32;
        // Beside the map there is room, so that it can be read on a screen on which the map is small.
        let text_scale = if is_beside { height / 120.0 } else { (height / 320.0).clamp(1.0, 3.0) };
        Self { size, is_beside, text_scale, strip_px: if is_beside { (STRIP * text_scale) as usize } else { 0 } }
    }

    /// Draws the scale, with its strip, on an image that begins at column `left`.
    fn draw_scale(
        &self,
        picture: &mut ViewMut<'_, u8>,
        left: usize,
        (low, high): (f32, f32),
        (unit, labels): (&str, usize),
        map: Colormap,
    ) {
        let (width, height) = (self.size.0 as i32, self.size.1 as i32);
        let ground = 3 * (self.size.0 - left);
        (0..self.size.1).for_each(|y| picture.row_mut(y)[ground..].fill(GROUND));
        let (x, height_px) = if self.is_beside {
            (width + 2 + (3.0 * self.text_scale) as i32, height * 3 / 4)
        } else {
            (width / 40 + 4, height / 2)
        };
        let bar = ScaleBar {
            x: x - left as i32,
            y: if self.is_beside { height / 8 } else { height / 12 + 4 },
            width_px: if self.is_beside { (5.0 * self.text_scale) as i32 } else { (width / 50).max(6) },
            height_px,
            low,
            high,
            unit,
            map,
            labels,
            text_scale: self.text_scale,
        };
        draw::scale_bar(picture, &bar);
    }
}

/// Colours maps of numbers.
#[derive(Default)]
pub struct Colorize {
    auto: AutoRange,
    /// The coloured map before it is enlarged.
    small: Vec<u8>,
    fit: Fit,
    on_device: OnDevice<MapPainter>,
    /// The strip for the scale of a map on the GPU.
    strip: Vec<u8>,
}

/// The range of the colours, and the share of the known numbers beyond it. `coarse` and `fine`: the map and the step between the numbers that are
/// taken of it, or such a sample of it and 1.
fn measure(
    auto: &mut AutoRange,
    [coarse, fine]: [(&View<'_, f32>, usize); 2],
    map: &Map<'_>,
    params: &Settings,
) -> ((f32, f32), Option<f64>) {
    let range = if params.high > params.low {
        (params.low, params.high)
    } else if matches!(map, Map::Confidence(_)) {
        (0.0, 1.0)
    } else {
        auto.follow_sample(coarse.0, coarse.1)
    };
    (range, beyond_share(fine.0, fine.1, range))
}

impl Colorize {
    /// Paints a map that was made on the GPU there. `false` where the processor has to do it.
    fn paint_on_device(
        &mut self,
        cx: &Context<'_>,
        map: &Map<'_>,
        slot: &mut Slot<'_, Bgr8>,
        layout: &Layout,
        labels: usize,
        params: &Settings,
    ) -> Result<bool> {
        let Self { auto, strip, on_device, .. } = self;
        let (width, height) = layout.size;
        on_device.attempt(cx, |painter| {
            let there = map.on_device()?;
            let [coarse, fine] = painter.sample(there, [sample_step(width, height), SHARE_STEP])?;
            let (range, beyond) = measure(auto, [(&coarse, 1), (&fine, 1)], map, params);
            strip.resize(3 * layout.strip_px * height, 0);
            if layout.strip_px > 0 {
                let mut picture = ViewMut::new(strip, layout.strip_px, height, 3);
                layout.draw_scale(&mut picture, width, range, (map.unit(), labels), params.colors.into());
            }
            let out = slot.alloc_on_device(width + layout.strip_px, height)?;
            painter.paint(there, range, params.colors.into(), strip, out)?;
            if let Some(share) = beyond {
                cx.metric("beyond_pct", 100.0 * share);
            }
            Ok(())
        })
    }
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
            check.node_error(
                "more than one map is connected, but the node colours one",
                "use a separate `colorize` node for each map",
            );
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let mut colorize = Self::default();
        colorize.on_device.choose(params.device, open, MapPainter::new);
        Ok(colorize)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Settings) -> Result<()> {
        self.on_device.choose(params.device, cx, MapPainter::new);
        let maps =
            [input.disparity.map(Map::Disparity), input.depth.map(Map::Depth), input.confidence.map(Map::Confidence)];
        if maps.iter().flatten().count() > 1 {
            return Err(NodeError::new(
                "more than one map is connected: use a separate `colorize` node for each of `disparity`, `depth` and `confidence`",
            ));
        }
        let Some(map) = maps.into_iter().flatten().next() else { return Ok(()) };
        let is_drifted = input.drifted.as_ref().is_some_and(|drifted| drifted.value > 0.0);
        let labels = if is_drifted && map.unit() == "mm" { 0 } else { 5 };
        let is_beside = params.scale_bar && params.scale_beside;
        let factor = if is_beside { enlargement(map.size().0, params.wanted_width) } else { 1 };
        let layout = Layout::of((factor * map.size().0, factor * map.size().1), is_beside);
        let is_plain = factor == 1 && is_beside == params.scale_bar && map.is_from_device();
        if is_plain && self.paint_on_device(cx, &map, &mut out.image, &layout, labels, params)? {
            return Ok(());
        }
        let plane = map.view();
        let samples = [(&plane, sample_step(plane.width, plane.height)), (&plane, SHARE_STEP)];
        let ((low, high), beyond) = measure(&mut self.auto, samples, &map, params);
        if let Some(share) = beyond {
            cx.metric("beyond_pct", 100.0 * share);
        }
        let size = layout.size;
        let mut picture = out.image.alloc(size.0 + layout.strip_px, size.1)?;
        let stride = picture.stride;
        let mut colored = ViewMut::with_stride(&mut *picture.data, size.0, size.1, 3, stride);
        if factor == 1 {
            draw::colorize(&plane, low, high, params.colors.into(), &mut colored);
        } else {
            self.small.resize(3 * plane.width * plane.height, 0);
            let mut small = ViewMut::new(&mut self.small, plane.width, plane.height, 3);
            draw::colorize(&plane, low, high, params.colors.into(), &mut small);
            self.fit.place(&mut colored, &small.as_view(), (0, 0), size);
        }
        if params.scale_bar {
            layout.draw_scale(&mut picture, 0, (low, high), (map.unit(), labels), params.colors.into());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that grow evenly from `low` to `high`.
    fn ramp(low: f32, high: f32) -> Vec<f32> {
        (0..6400).map(|k| low + (high - low) * k as f32 / 6399.0).collect()
    }

    #[test]
    fn a_range_has_round_ends_around_the_numbers() {
        assert_eq!(rounded((42.0, 97.0)), (30.0, 110.0));
        assert_eq!(rounded((0.4, 60.0)), (0.0, 70.0));
        let (low, high) = rounded((0.12, 0.18));
        assert!((low - 0.11).abs() < 1e-4 && (high - 0.19).abs() < 1e-4, "{low} {high}");
        let (low, high) = rounded((50.0, 50.0));
        assert!(low < 50.0 && high > 50.0 && high - low < 1.0, "{low} {high}");
    }

    #[test]
    fn a_range_is_held_while_it_suits_and_follows_when_it_does_not() {
        let mut auto = AutoRange::default();
        let mut follow = |low, high| auto.follow(&View::new(&ramp(low, high), 80, 80, 1));
        let first = follow(42.0, 97.0);
        // The scope comes a little nearer.
        (0..60).for_each(|k| assert_eq!(follow(42.0 - 0.1 * k as f32, 97.0), first));
        // Elsewhere: at once, because colours would say nothing.
        let far = follow(120.0, 180.0);
        assert!(far.0 <= 120.0 && far.1 >= 180.0 && far != first, "{far:?}");
        // A flat place: the colours stay for a while, then tell it apart.
        assert_eq!(follow(150.0, 160.0), far);
        let flat = (0..PATIENCE).map(|_| follow(150.0, 160.0)).last().unwrap();
        assert!(flat.0 <= 150.0 && flat.1 >= 160.0 && flat.1 - flat.0 < 20.0, "{flat:?}");
        // Nothing known keeps it.
        assert_eq!(auto.follow(&View::new(&[f32::NAN; 4], 2, 2, 1)), flat);
    }

    #[test]
    fn little_lies_beyond_a_range_that_follows() {
        for (low, high) in [(30.0, 100.0), (5.0, 8.0), (61.3, 240.9), (0.0, 1.0)] {
            let (first, last) = AutoRange::default().follow(&View::new(&ramp(low, high), 80, 80, 1));
            assert!(first <= low && last >= high && last - first < 1.7 * (high - low), "{low} {high}: {first} {last}");
        }
    }
}
