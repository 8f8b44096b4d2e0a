//! `measure`: distances, polylines, depths and angles in mm, each with its error (thesis, figs 3.14 and 3.15).

mod surface;

use panoscope_imaging::stereo::length::{self, Errors, Noise};
use panoscope_imaging::stereo::{CalibrationError, Rectification, SurfacePoint};
use panoscope_node::abi::{Calibration, CloudPoint, Scalar, Tip};
use panoscope_node::pick::{Grid, Parts};
use panoscope_node::{
    Choice, Cloud, Confidence, Context, Depth, Detections, Image, List, Node, NodeInfo, Open, Params, Ports, Result,
    Slot, TableData, TextPacket, Validation, Value, View, error,
};

use panoscope_data::calibration::packet as calibration;
use surface::{Surface, pixels};

/// Kind of measurement.
#[derive(Choice, Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Each pair of points: straight distance.
    Distance,
    /// All points in order: length along them.
    Polyline,
    /// Each point: depth from the left camera.
    Depth,
    /// Each triple of points: angle at the middle one.
    Angle,
}

impl Kind {
    /// Points of one item, and points from one item to the next.
    fn step(self) -> (usize, usize) {
        match self {
            Self::Distance => (2, 2),
            Self::Polyline => (2, 1),
            Self::Depth => (1, 1),
            Self::Angle => (3, 3),
        }
    }

    fn columns(self) -> &'static [&'static str] {
        match self {
            Self::Distance => &["u0_px", "v0_px", "u1_px", "v1_px", "distance_mm", "error_mm"],
            Self::Polyline => {
                &["u0_px", "v0_px", "u1_px", "v1_px", "segment_mm", "segment_error_mm", "length_mm", "error_mm"]
            }
            Self::Depth => &["u_px", "v_px", "depth_mm", "error_mm"],
            Self::Angle => &["u0_px", "v0_px", "u1_px", "v1_px", "u2_px", "v2_px", "angle_deg", "error_deg"],
        }
    }
}

/// Inputs: `cloud` or `depth`; points of tips and detections follow those of the parameter.
#[derive(Ports)]
pub struct In<'f> {
    /// Points of the left rectified view.
    cloud: Option<Cloud<'f>>,
    /// Depth of the left rectified view; needs `calibration`.
    depth: Option<Image<'f, Depth>>,
    /// Calibration of the rectified views; without it errors are unknown.
    calibration: Option<Value<'f, Calibration>>,
    /// Confidence of the disparity that the surface comes from, as a filter gives it: errors grow where it is low. Without it all errors are stated
    /// wide.
    confidence: Option<Image<'f, Confidence>>,
    /// State of the calibration, as a matcher gives it: above 0 it does not fit the views. Nothing is known then.
    drifted: Option<Value<'f, Scalar>>,
    /// Tips of tools: one point each, after those of the parameter. A tip that is missing in a tick is an unknown point.
    tips: Option<List<'f, Value<'f, Tip>>>,
    /// Boxes in the left rectified view: the centre of each is a point, after those of the parameter and the tips.
    detections: Option<Detections<'f>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// One row per item: its points, its value and the 95 % error bound; NaN where unknown.
    table: Slot<'f, TableData>,
    /// Why nothing is measured; empty while there is no reason.
    text: Slot<'f, TextPacket>,
}

/// Parameters.
#[derive(Params)]
pub struct MeasureParams {
    /// Kind of measurement.
    #[param(default = "distance")]
    kind: Kind,
    /// Points of the left rectified view in px: u, v, u, v, ...
    #[param(default = [], points)]
    points: Vec<f64>,
    /// Radius of the neighbourhood to which a surface is fitted at each point.
    #[param(default = 4, range = 1..=32, unit = "px")]
    radius_px: usize,
    /// Standard deviation of a filtered disparity, added as a square to the scatter around the point: 0.35 where `scale` of the matcher halves the views.
    #[param(default = Noise::USUAL.disparity_px, range = 0.0..=4.0, step = 0.01, unit = "px")]
    disparity_noise_px: f64,
    /// Standard deviation of the calibration's disparity offset; its reprojection error is used when larger. This and the two below count where the
    /// calibration does not state its own error.
    #[param(default = Noise::USUAL.offset_px, range = 0.0..=4.0, step = 0.01, unit = "px")]
    disparity_offset_px: f64,
    /// Standard deviation of the calibration's baseline.
    #[param(default = Noise::USUAL.baseline_mm, range = 0.0..=4.0, step = 0.01, unit = "mm")]
    baseline_error_mm: f64,
    /// Standard deviation of the calibration's focal length.
    #[param(default = Noise::USUAL.focal_percent, range = 0.0..=10.0, step = 0.01, unit = "%")]
    focal_error_percent: f64,
}

/// What is written in place of lengths.
const DRIFTED: &str = "no lengths: the calibration does not fit";

/// See the module.
pub struct Measure {
    views: Option<(Calibration, Rectification)>,
    /// Points of the tick: u, v each.
    given: Vec<[f64; 2]>,
    samples: Vec<[f64; 5]>,
    places: Vec<Option<SurfacePoint>>,
    rows: Vec<f64>,
    leftover: bool,
    seen: Seen,
}

impl MeasureParams {
    fn errors(&self, packet: &Calibration, views: &Rectification) -> Errors {
        let noise = Noise {
            disparity_px: self.disparity_noise_px,
            offset_px: self.disparity_offset_px,
            baseline_mm: self.baseline_error_mm,
            focal_percent: self.focal_error_percent,
        };
        let stated = CalibrationError::of_bits(packet.stated_error);
        Errors::of(views.left.focal_px, views.baseline_mm, packet.rms_px, stated, &noise)
    }
}

/// The surface of a tick, and its confidence: of frames on the GPU only the parts around the points.
#[derive(Default)]
struct Seen {
    cloud: Parts<CloudPoint>,
    depth: Parts<f32>,
    confidence: Parts<f32>,
}

/// The points of a tick: those of the parameter, tips, centres of boxes. A missing tip is an unknown point.
fn points_of(input: &In<'_>, params: &MeasureParams, given: &mut Vec<[f64; 2]>) {
    given.clear();
    given.extend_from_slice(params.points.as_chunks::<2>().0);
    let tips = input.tips.as_ref();
    let tips = tips.into_iter().flat_map(|tips| (0..tips.len()).map(move |index| tips.get(index)));
    given.extend(tips.map(|tip| tip.map_or([f64::NAN; 2], |tip| [tip.u_px, tip.v_px])));
    let middle = |from: f32, length: f32| f64::from(from) + f64::from(length) / 2.0;
    let boxes = input.detections.as_ref().map_or(&[][..], Detections::items).iter();
    given.extend(boxes.map(|found| [middle(found.x_px, found.width_px), middle(found.y_px, found.height_px)]));
}

impl Measure {
    /// Finds the places of the points of the tick.
    fn gather(&mut self, input: &In<'_>, surface: &Surface<'_>, trust: Option<View<'_, f32>>, params: &MeasureParams) {
        self.places.clear();
        let first_tip = params.points.len() / 2;
        for (index, point) in self.given.iter().enumerate() {
            let seen = surface.at(*point, params.radius_px, trust, &mut self.samples);
            let tip = index.checked_sub(first_tip).and_then(|index| input.tips.as_ref()?.get(index));
            // The tip finder has already separated the tool from what lies behind it.
            let given = tip
                .filter(|tip| tip.xyz_valid == 1)
                .map(|tip| tip.xyz_mm)
                .filter(|xyz| xyz[2] > 0.0 && xyz.iter().all(|v| v.is_finite()));
            self.places.push(given.map_or(seen, |[x, y, z]| {
                let (scatter, confidence) = seen.map_or((0.0, None), |point| (point.scatter, point.confidence));
                Some(SurfacePoint { ray: [x / z, y / z], inverse_depth: 1.0 / z, scatter, confidence })
            }));
        }
    }

    /// Writes the rows of all items.
    fn measure(&mut self, params: &MeasureParams, errors: Option<&Errors>) {
        let (size, step) = params.kind.step();
        let (mut length, mut length_error) = (0.0, 0.0);
        self.rows.clear();
        let starts = (0..self.places.len()).step_by(step).take_while(|start| start + size <= self.places.len());
        for start in starts {
            self.rows.extend(self.given[start..start + size].iter().flatten());
            let mut points =
                [SurfacePoint { ray: [0.0; 2], inverse_depth: f64::NAN, scatter: f64::NAN, confidence: None };
                    length::MAX_POINTS];
            for (point, place) in points.iter_mut().zip(&self.places[start..start + size]) {
                *point = place.unwrap_or(*point);
            }
            let measure = match params.kind {
                Kind::Distance | Kind::Polyline => length::distance,
                Kind::Depth => length::depth,
                Kind::Angle => length::angle,
            };
            let (value, error) = length::with_error(&points[..size], errors, measure);
            self.rows.extend([value, error]);
            if params.kind == Kind::Polyline {
                length += value;
                // Neighbouring segments share a point and all share the calibration: errors may add up.
                length_error += error;
                self.rows.extend([length, length_error]);
            }
        }
    }
}

impl Node for Measure {
    const INFO: NodeInfo = NodeInfo::compute(
        "measure",
        "stereo",
        "Measures distances, polylines, depths and angles between points of the picture in mm, with their errors.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = MeasureParams;

    fn validate(params: &MeasureParams, check: &mut Validation<'_>) {
        let is_connected = |name: &str| check.is_connected(name);
        match (is_connected("cloud"), is_connected("depth"), is_connected("calibration")) {
            (Some(true), Some(true), _) => {
                check.node_error("`cloud` and `depth` are both connected", "connect one of them")
            }
            (Some(false), Some(true), Some(false)) => check.node_error(
                "`depth` alone has no rays: `calibration` is not connected",
                "connect `calibration` too, or `cloud` instead",
            ),
            (Some(false), Some(false), _) => {
                check.node_warning(
                    "neither `cloud` nor `depth` is connected: nothing is measured",
                    "connect one of them",
                );
            }
            _ if is_connected("confidence") == Some(false) && is_connected("calibration") == Some(true) => {
                check.node_warning(
                    "`confidence` is not connected: all errors are stated wide",
                    "connect the `confidence` of the filter that the surface comes from",
                );
            }
            _ => {}
        }
        if !params.points.len().is_multiple_of(2) {
            let message = format!("`points` has {} numbers: half a point is left over", params.points.len());
            check.warning("points", message, "each point is two numbers: u, v");
        }
    }

    fn open(_: &Open<'_>, _: &MeasureParams) -> Result<Self> {
        Ok(Self {
            views: None,
            given: Vec::new(),
            samples: Vec::new(),
            places: Vec::new(),
            rows: Vec::new(),
            leftover: false,
            seen: Seen::default(),
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &MeasureParams) -> Result<()> {
        if let Some(given) = &input.calibration
            && self.views.as_ref().is_none_or(|(seen, _)| !calibration::same(seen, given))
        {
            self.views = None;
            self.views = Some((**given, calibration::of_rectified_views(given)?));
        }
        let views = self.views.take();
        let size = match (&input.cloud, &input.depth, &views) {
            (Some(_), Some(_), _) => return Err(error!("connect `cloud` or `depth`, not both")),
            (Some(cloud), None, _) => (cloud.width(), cloud.height()),
            (None, Some(depth), Some(_)) => (depth.width(), depth.height()),
            (None, Some(_), None) => {
                return Err(error!("`depth` alone has no rays: connect `calibration` too, or `cloud`"));
            }
            (None, None, _) => {
                self.views = views;
                return Ok(());
            }
        };
        if let Some((_, views)) = &views
            && size != (views.width, views.height)
        {
            return Err(error!(
                "the surface is {}x{}, the calibration was made for {}x{}",
                size.0, size.1, views.width, views.height
            ));
        }
        if let Some(map) = &input.confidence
            && (map.width(), map.height()) != size
        {
            return Err(error!(
                "the confidence is {}x{}, the surface {}x{}: connect the confidence of the same disparity",
                map.width(),
                map.height(),
                size.0,
                size.1
            ));
        }
        points_of(&input, params, &mut self.given);
        let is_there = input.cloud.is_some_and(|cloud| cloud.is_from_device())
            || input.depth.is_some_and(|depth| depth.is_from_device())
            || input.confidence.is_some_and(|confidence| confidence.is_from_device());
        let given = self.given.iter().filter(|_| is_there);
        let parts: Vec<Grid> = given.flat_map(|point| pixels(size, *point, params.radius_px)).collect();
        let mut seen = std::mem::take(&mut self.seen);
        let surface = match (&input.cloud, &input.depth, &views) {
            (Some(cloud), ..) => Some(Surface::Cloud(seen.cloud.view(*cloud, &parts))),
            (None, Some(depth), Some((_, views))) => Some(Surface::Depth(seen.depth.view(*depth, &parts), views)),
            _ => None,
        };
        let trust = input.confidence.map(|map| seen.confidence.view(map, &parts));
        if let Some(surface) = &surface {
            self.gather(&input, surface, trust, params);
        }
        self.seen = seen;
        // NaN counts as no statement.
        let is_drifted = input.drifted.as_ref().is_some_and(|drifted| drifted.value > 0.0);
        if is_drifted {
            self.places.fill(None);
        }
        if out.text.is_read() {
            out.text.set_text(if is_drifted { DRIFTED } else { "" })?;
        }
        let errors = views.as_ref().map(|(packet, views)| params.errors(packet, views));
        self.measure(params, errors.as_ref());
        self.views = views;

        let (item, step) = params.kind.step();
        let points = self.places.len();
        let odd = params.points.len() % 2 == 1;
        let leftover = odd || if step < item { points == 1 } else { !points.is_multiple_of(item) };
        if leftover && !self.leftover {
            let half = if odd { " and a half" } else { "" };
            cx.warn(&format!(
                "{points} points{half} (u, v each) are no whole items of {item}: the last ones are not measured"
            ));
        }
        self.leftover = leftover;
        let unknown = self.places.iter().filter(|place| place.is_none()).count();
        cx.metric("unknown_points", unknown as f64);
        out.table.set_table(params.kind.columns(), &self.rows)
    }
}
