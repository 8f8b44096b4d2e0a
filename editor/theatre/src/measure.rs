//! Measures distances by two taps on a frozen image whose points in space are known.

use std::collections::HashMap;
use std::sync::Arc;

use eframe::egui::{Context, InputState};
use panoscope_editor_model::texts::{decimal, text};
use panoscope_imaging::ViewMut;
use panoscope_imaging::draw;
use panoscope_imaging::stereo::length::{self, Errors, Noise};
use panoscope_imaging::stereo::{CalibrationError, SurfacePoint};

use panoscope_editor_model::content::Rig;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::picture::RenderedPacket;
use panoscope_editor_model::pixels::Pixels;
use panoscope_editor_model::surface::Cloud;
use panoscope_editor_widgets::OutputCache;
use panoscope_editor_widgets::crosshair::Crosshair;

/// A point that was tapped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tapped {
    /// Column and row in the image.
    pub at_px: (f32, f32),
    /// Its position in space with its uncertainty; `None` where the depth is unknown.
    pub position: Option<SurfacePoint>,
}

/// A length with its 95 % error bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Length {
    /// The length, mm.
    pub mm: f64,
    /// Its 95 % error bound, mm.
    pub error_mm: f64,
}

impl Length {
    /// The length and its error in the language of the window.
    pub fn words(&self) -> String {
        text!("measure-length", length = decimal(self.mm, 1), error = decimal(self.error_mm.max(MIN_ERROR_MM), 1))
    }

    /// As [`Self::words`], of a depth.
    pub fn depth_words(&self) -> String {
        text!("measure-depth", length = decimal(self.mm, 1), error = decimal(self.error_mm.max(MIN_ERROR_MM), 1))
    }
}

/// The smallest error that is shown, mm.
const MIN_ERROR_MM: f64 = 0.1;

/// As files have it, in every language.
impl std::fmt::Display for Length {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.1} ± {:.1} mm", self.mm, self.error_mm.max(MIN_ERROR_MM))
    }
}

/// Radius of the neighbourhood that a point is estimated from, px.
const RADIUS_PX: usize = 4;

/// The state of measuring: off, waiting for an image, or on with up to two points.
#[derive(Default)]
pub struct Measure {
    is_waiting: bool,
    on: Option<Active>,
    /// The quantities that determine the error.
    rig: Option<(Rig, Noise)>,
    /// Why no length can be relied on now.
    doubt: Option<&'static str>,
}

struct Active {
    /// For choosing points by keys.
    crosshair: Crosshair,
    cloud: Arc<Cloud>,
    output: Output,
    frozen: OutputCache,
    points: Vec<Tapped>,
}

impl Measure {
    /// Starts measuring: waits for the next image with points.
    pub fn begin() -> Self {
        Self { is_waiting: true, ..Self::default() }
    }

    /// Sets the stereo geometry of the points and its uncertainty.
    pub fn set_rig(&mut self, rig: Rig, noise: Noise) {
        self.rig = Some((rig, noise));
    }

    /// Sets why no length can be relied on: while there is a reason, none is shown or saved. An image to measure in keeps its reason: that the
    /// cameras are right again does not change that.
    pub fn set_doubt(&mut self, doubt: Option<&'static str>) {
        self.doubt = doubt.or(self.doubt.filter(|_| self.on.is_some()));
    }

    /// Whether measuring was started.
    pub fn is_on(&self) -> bool {
        self.is_waiting || self.on.is_some()
    }

    /// Whether it waits for an image with points.
    pub fn is_waiting(&self) -> bool {
        self.is_waiting
    }

    /// Sets the image to measure in.
    pub fn take(&mut self, ctx: &Context, output: &Output, packet: RenderedPacket) {
        let Some(cloud) = packet.cloud.clone() else { return };
        let mut frozen = OutputCache::default();
        frozen.update(ctx, HashMap::from([(output.clone(), packet)]));
        let on = Active { crosshair: Crosshair::default(), cloud, output: output.clone(), frozen, points: Vec::new() };
        *self = Self { is_waiting: false, on: Some(on), ..std::mem::take(self) };
    }

    /// The image to measure in, and its output.
    pub fn picture(&self) -> Option<(&OutputCache, &Output)> {
        self.on.as_ref().map(|on| (&on.frozen, &on.output))
    }

    /// Adds a point at fractions of the image's width and height. A third point starts a new measurement.
    pub fn tap(&mut self, x: f32, y: f32) {
        let Some(on) = &mut self.on else { return };
        if !((0.0..=1.0).contains(&x) && (0.0..=1.0).contains(&y)) {
            return;
        }
        // The next tap replaces a point without depth.
        on.points.retain(|p| p.position.is_some());
        if on.points.len() >= 2 {
            on.points.clear();
        }
        let at_px = (x * on.cloud.width as f32 - 0.5, y * on.cloud.height as f32 - 0.5);
        on.points.push(Tapped { at_px, position: on.cloud.surface_point(at_px, RADIUS_PX) });
    }

    /// Handles keys: arrows move a crosshair, Enter adds a point there.
    pub fn tap_by_key(&mut self, input: &mut InputState) {
        let (width, height) = self.size_px();
        let tapped = self.on.as_mut().and_then(|on| on.crosshair.steer(input, width as f32 / height as f32));
        if let Some([x, y]) = tapped {
            self.tap(x, y);
        }
    }

    /// The crosshair for choosing points by keys.
    pub fn crosshair(&self) -> Crosshair {
        self.on.as_ref().map(|on| on.crosshair).unwrap_or_default()
    }

    /// The points so far.
    pub fn points(&self) -> &[Tapped] {
        self.on.as_ref().map_or(&[], |on| &on.points)
    }

    /// Width and height of the image in px.
    pub fn size_px(&self) -> (usize, usize) {
        self.on.as_ref().map_or((1, 1), |on| (on.cloud.width.max(1), on.cloud.height.max(1)))
    }

    /// A length computed from points by `measure`, with its error bound. `None` where the error is not known: no length is shown without it.
    fn length(&self, points: &[SurfacePoint], measure: fn(&[[f64; 3]]) -> f64) -> Option<Length> {
        let (rig, noise) = self.rig.filter(|_| self.doubt.is_none())?;
        let stated = CalibrationError::of_bits(rig.stated_error);
        let errors = Errors::of(rig.focal_px, rig.baseline_mm, rig.rms_px, stated, &noise);
        let (mm, error_mm) = length::with_error(points, Some(&errors), measure);
        error_mm.is_finite().then_some(Length { mm, error_mm })
    }

    /// The distance between the two points, with its error.
    pub fn distance(&self) -> Option<Length> {
        match self.points() {
            [Tapped { position: Some(a), .. }, Tapped { position: Some(b), .. }] => {
                self.length(&[*a, *b], length::distance)
            }
            _ => None,
        }
    }

    /// The depth of the last point, with its error.
    pub fn depth(&self) -> Option<Length> {
        self.length(&[self.points().last()?.position?], length::depth)
    }

    /// What the user should do next.
    pub fn hint(&self) -> &'static str {
        if let Some(doubt) = self.doubt.filter(|_| !self.is_waiting) {
            return doubt;
        }
        match self.points() {
            _ if self.is_waiting => text!("measure-waiting"),
            [.., Tapped { position: None, .. }] => text!("measure-no-depth"),
            [_, ..] if self.rig.is_none() => text!("measure-no-error"),
            [] => text!("measure-first"),
            [_] => text!("measure-second"),
            _ => text!("measure-again"),
        }
    }

    /// The measurement as a row of a node `measure`, as JSON: pixels of the image, mm, the 95 % error bound.
    pub fn row(&self) -> Option<serde_json::Value> {
        match (self.points(), self.distance(), self.depth()) {
            ([a, b], Some(length), _) => Some(serde_json::json!({
                "u0_px": a.at_px.0, "v0_px": a.at_px.1, "u1_px": b.at_px.0, "v1_px": b.at_px.1,
                "distance_mm": length.mm, "error_mm": length.error_mm,
            })),
            ([a], _, Some(depth)) => Some(serde_json::json!({
                "u_px": a.at_px.0, "v_px": a.at_px.1, "depth_mm": depth.mm, "error_mm": depth.error_mm,
            })),
            _ => None,
        }
    }

    /// The image with the measurement drawn on it, for a still. Its words stand below the image, never on tissue.
    pub fn pixels(&self) -> Option<Pixels> {
        let on = self.on.as_ref()?;
        let mut pixels = on.frozen.pixels(&on.output)?.clone();
        let (width, height) = (pixels.width, pixels.height);
        // The drawing functions need three channels.
        let mut rgb: Vec<u8> = pixels.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        let mut out = ViewMut::new(&mut rgb, width, height, 3);
        let color = [0x56, 0xB4, 0xE9];
        if let [a, b] = on.points[..] {
            draw::line(&mut out, a.at_px, b.at_px, 2.0, color);
        }
        for point in &on.points {
            draw::circle(&mut out, point.at_px.0, point.at_px.1, 6.0, 2.0, color);
        }
        pixels.rgba = rgb.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
        if let Some(length) = self.distance() {
            add_line_below(&mut pixels, &length.to_string(), color);
        }
        Some(pixels)
    }
}

/// Height of a line of words below an image, as a fraction of the image's height.
const LINE_SHARE: f32 = 0.08;

/// Makes an image higher by a black line with words.
fn add_line_below(pixels: &mut Pixels, words: &str, color: [u8; 3]) {
    let height = ((pixels.height as f32 * LINE_SHARE) as usize).max(20);
    let mut rgb = vec![0; pixels.width * height * 3];
    let scale = height as f32 / 20.0;
    draw::text(&mut ViewMut::new(&mut rgb, pixels.width, height, 3), 6.0 * scale, 3.0 * scale, words, scale, color);
    pixels.rgba.extend(rgb.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]));
    pixels.height += height;
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIG: Rig = Rig { focal_px: 750.0, baseline_mm: 15.0, rms_px: f64::NAN, stated_error: 0 };

    fn on() -> Measure {
        // 1 mm per pixel at 50 mm; the right third is unknown.
        let point = |i: usize| {
            let (x, y) = ((i % 30) as f32, (i / 30) as f32);
            if x >= 20.0 { [f32::NAN; 3] } else { [x, y, 50.0] }
        };
        let cloud = Cloud { width: 30, height: 20, xyz_mm: (0..600).map(point).collect(), confidence: vec![1.0; 600] };
        let pixels = Pixels { width: 30, height: 20, rgba: vec![7; 30 * 20 * 4] };
        let mut measure = Measure::begin();
        let packet = RenderedPacket { cloud: Some(Arc::new(cloud)), pixels: Some(pixels), ..RenderedPacket::default() };
        measure.take(&Context::default(), &Output::new("p", "cloud"), packet);
        measure
    }

    #[test]
    fn two_taps_measure_and_the_third_starts_again() {
        let mut measure = on();
        assert_eq!(measure.hint(), "Tap the first point");
        measure.tap(5.5 / 30.0, 5.5 / 20.0);
        assert_eq!((measure.distance(), measure.depth()), (None, None));
        measure.set_rig(RIG, Noise::USUAL);
        assert_eq!((measure.distance(), measure.hint()), (None, "Tap the second point"));
        assert!(measure.depth().is_some_and(|depth| (depth.mm - 50.0).abs() < 1e-6));
        measure.rig = None;
        measure.tap(15.5 / 30.0, 5.5 / 20.0);
        assert_eq!((measure.distance(), measure.row()), (None, None), "no length without its error");
        assert!(measure.hint().contains("its error is not known"), "{}", measure.hint());
        measure.set_rig(RIG, Noise::USUAL);
        let length = measure.distance().expect("both points and the rig are known");
        assert!((length.mm - 10.0).abs() < 1e-6, "{length:?}");
        let error = length.error_mm;
        assert!((0.01..1.0).contains(&error), "{error} mm");
        assert!(length.to_string().starts_with("10.0 ± 0."), "{length}");
        let row = measure.row().expect("a measurement");
        assert!(
            row["u0_px"].as_f64().zip(row["u1_px"].as_f64()).is_some_and(|(a, b)| (b - a - 10.0).abs() < 1e-3),
            "{row}"
        );
        assert!(row["distance_mm"].as_f64().is_some_and(|mm| (mm - 10.0).abs() < 1e-6), "{row}");
        assert_eq!(row["error_mm"].as_f64(), Some(error));
        let still = measure.pixels().expect("a still");
        assert_eq!((still.height, still.rgba.len()), (40, 30 * 40 * 4), "the words stand below the image");
        let is_line = |p: &[u8]| p[..3] == [0x56, 0xB4, 0xE9];
        assert!(still.rgba[..30 * 20 * 4].chunks_exact(4).any(is_line), "the line is drawn");
        // Their edges are smooth: hardly a pixel has the whole colour.
        let is_word = |p: &[u8]| p[2] > 0x60 && p[2] > p[0];
        assert!(still.rgba[30 * 20 * 4..].chunks_exact(4).any(is_word), "the words are drawn");
        measure.tap(0.1, 0.1);
        assert_eq!(measure.points().len(), 1);
        assert!(measure.row().is_some_and(|row| row["depth_mm"].as_f64().is_some_and(|mm| (mm - 50.0).abs() < 1e-6)));
    }

    #[test]
    fn a_calibration_in_doubt_gives_no_length() {
        let mut measure = on();
        measure.set_rig(RIG, Noise::USUAL);
        measure.tap(5.5 / 30.0, 5.5 / 20.0);
        measure.tap(15.5 / 30.0, 5.5 / 20.0);
        assert!(measure.distance().is_some());
        measure.set_doubt(Some("No distance: in doubt"));
        assert_eq!((measure.distance(), measure.depth(), measure.row()), (None, None, None));
        assert_eq!(measure.hint(), "No distance: in doubt");
        assert_eq!(measure.pixels().map(|still| still.height), Some(20), "a still has no length below it");
        measure.set_doubt(None);
        assert_eq!(measure.distance(), None, "the image is the same");
        assert_eq!(measure.hint(), "No distance: in doubt");
        let mut measure = Measure::begin();
        measure.set_doubt(Some("No distance: in doubt"));
        measure.set_doubt(None);
        assert_eq!(measure.doubt, None, "no image is held yet");
    }

    #[test]
    fn a_point_without_depth_is_reported_and_replaced() {
        let mut measure = on();
        measure.set_rig(RIG, Noise::USUAL);
        measure.tap(0.95, 0.5);
        assert_eq!(measure.hint(), "No depth at this point: tap beside it");
        measure.tap(0.1, 0.5);
        assert_eq!((measure.points().len(), measure.hint()), (1, "Tap the second point"));
        measure.tap(2.0, 0.5);
        assert_eq!(measure.points().len(), 1, "outside the picture");
    }
}
