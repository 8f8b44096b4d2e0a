//! The tip of jaws of which another instrument hides one.

use nalgebra::{Vector2, Vector3};
use panoscope_arm_core::tracking::jaws::{Axis, Jaws};

use crate::shaft::TipFinder;

/// Minimum distance of an occluder in front of a tip, mm.
const BEFORE_MM: f32 = 1.0;
/// Minimum share of the pixels around a tip that belong to another instrument for the tip to count as hidden.
const HIDING_SHARE: f32 = 0.12;
/// Minimum share of the pixels around the end of a jaw that belong to the jaw or to its occluder.
const JAW_SHARE: f32 = 0.3;

/// Assumed length of jaws that have not been seen open yet, mm.
const USUAL_MM: f64 = 15.0;
/// Radius around an end in which a second jaw of the instrument may be, mm.
const AROUND_MM: f64 = 24.0;
/// Minimum length of a shaft whose own direction is used, as a share of the jaws' length.
const LONG_SHARE: f64 = 0.6;

/// Depth and segmentation of an image, per pixel.
pub struct Pixels<'a> {
    /// Columns and rows.
    pub size: (usize, usize),
    /// Depth, mm; NaN where unknown.
    pub depth_mm: &'a dyn Fn(usize, usize) -> f32,
    /// Whether a pixel belongs to the instrument.
    pub is_own: &'a dyn Fn(usize, usize) -> bool,
    /// Whether a pixel belongs to another instrument.
    pub is_other: &'a dyn Fn(usize, usize) -> bool,
    /// Whether there are other instruments in the image.
    pub has_others: bool,
}

impl Pixels<'_> {
    /// Two shares of the pixels within a radius around a position, px: those that another instrument covers in front of a depth, mm; and these plus
    /// the instrument's own pixels. 0 outside the image.
    fn shares(&self, (u, v): (f64, f64), z_mm: f32, radius_px: usize) -> (f32, f32) {
        let (u, v, r) = (u.round() as isize, v.round() as isize, radius_px as isize);
        let (mut all, mut covered, mut own) = (0.0_f32, 0.0, 0.0);
        for y in v.saturating_sub(r).max(0)..=v.saturating_add(r).min(self.size.1 as isize - 1) {
            for x in u.saturating_sub(r).max(0)..=u.saturating_add(r).min(self.size.0 as isize - 1) {
                if (x - u).pow(2) + (y - v).pow(2) <= r * r {
                    let (x, y) = (x as usize, y as usize);
                    all += 1.0;
                    if (self.depth_mm)(x, y) < z_mm - BEFORE_MM && (self.is_other)(x, y) {
                        covered += 1.0;
                    } else if (self.is_own)(x, y) {
                        own += 1.0;
                    }
                }
            }
        }
        if all > 0.0 { (covered / all, (covered + own) / all) } else { (0.0, 0.0) }
    }

    /// Whether another instrument is within a distance of a position, px, at any depth.
    fn is_near(&self, (u, v): (f64, f64), around_px: usize) -> bool {
        let (u, v, r) = (u.round() as isize, v.round() as isize, around_px as isize);
        let rows = v.saturating_sub(r).max(0)..=v.saturating_add(r).min(self.size.1 as isize - 1);
        let columns = u.saturating_sub(r).max(0)..=u.saturating_add(r).min(self.size.0 as isize - 1);
        self.has_others
            && rows.step_by(2).any(|y| columns.clone().step_by(2).any(|x| (self.is_other)(x as usize, y as usize)))
    }

    /// Whether another instrument is around a tip and in front of it.
    pub fn is_hidden(&self, at_px: (f64, f64), z_mm: f32, radius_px: usize) -> bool {
        self.shares(at_px, z_mm, radius_px).0 > HIDING_SHARE
    }
}

/// An end of an instrument with known depth.
#[derive(Clone, Copy, Debug, Default)]
pub struct KnownEnd {
    /// Position, mm, in the left camera's frame.
    pub at_mm: Vector3<f64>,
    /// Whether another instrument hides what is beyond this end.
    pub is_hidden: bool,
}

/// Finds tips of instruments with one hidden jaw.
#[derive(Debug, Default)]
pub struct HiddenJaw {
    jaws: Jaws,
    /// Number of the instrument that was seen last.
    tool: i64,
}

/// Intrinsics of a rectified camera, px.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    /// Focal lengths along x and y.
    pub focal_px: [f64; 2],
    /// Principal point.
    pub centre_px: [f64; 2],
}

impl Lens {
    fn direction(&self, [u, v]: [f64; 2]) -> Vector2<f64> {
        Vector2::new((u - self.centre_px[0]) / self.focal_px[0], (v - self.centre_px[1]) / self.focal_px[1])
    }

    /// Projects a point of its frame (mm) to the image, px.
    pub fn pixel(&self, at_mm: &Vector3<f64>) -> (f64, f64) {
        let [fx, fy] = self.focal_px;
        (fx * at_mm.x / at_mm.z + self.centre_px[0], fy * at_mm.y / at_mm.z + self.centre_px[1])
    }
}

impl HiddenJaw {
    /// The point midway between the jaws of an instrument, mm, where one of its ends is hidden. `ends`: one or two ends of the mask that `finder` was
    /// given last. `None` where nothing is hidden, and where the jaws of this instrument are not known from earlier frames.
    pub fn middle(
        &mut self,
        now_ns: i64,
        tool: i64,
        ends: &[KnownEnd],
        finder: &mut TipFinder,
        lens: &Lens,
        radius_px: usize,
        pixels: &Pixels<'_>,
    ) -> Option<Vector3<f64>> {
        if self.tool != tool {
            (self.tool, self.jaws) = (tool, Jaws::default());
        }
        let mut clear = ends.iter().filter(|end| !end.is_hidden).map(|end| end.at_mm);
        let (end_mm, second_mm) = (clear.next()?, clear.next());
        let px_per_mm = lens.focal_px[0] / end_mm.z;
        let is_other = pixels.is_other;
        if let Some(second_mm) = second_mm {
            let length_px = finder.jaws_px()?;
            let axis = finder.axis(pixels.size, length_px, is_other)?;
            // From the shaft to the tip: longer than the part of the shaft that is in view.
            let middle_mm = (end_mm + second_mm) / 2.0;
            let along = middle_mm.xy() / middle_mm.z - lens.direction(axis.from_px);
            let along = along.try_normalize(1e-9)?;
            self.jaws.see_both(now_ns, [end_mm, second_mm], along, length_px / px_per_mm);
            return None;
        }
        let length_px = self.jaws.length_mm(now_ns).unwrap_or(USUAL_MM) * px_per_mm;
        let axis = finder.axis(pixels.size, length_px, is_other);
        let around_px = (AROUND_MM * px_per_mm) as usize;
        if ends.len() == 1 && !pixels.is_near(lens.pixel(&end_mm), around_px) {
            match axis {
                Some(axis) => self.jaws.see_closed(now_ns, end_mm, axis_of(lens, &axis), length_px / px_per_mm),
                None => self.jaws.see_tip(now_ns, end_mm),
            }
            return None;
        }
        // The direction of a short part of the shaft is less exact than the one that was seen from there to the tip.
        let axis = axis.map(|axis| {
            let (share, fitted) = ((axis.length_px / (LONG_SHARE * length_px)).min(1.0), axis_of(lens, &axis));
            let along = self
                .jaws
                .along(now_ns)
                .and_then(|known| (fitted.along * share + known * (1.0 - share)).try_normalize(1e-9));
            Axis { along: along.unwrap_or(fitted.along), ..fitted }
        });
        let found = self.jaws.of_one(now_ns, end_mm, axis).filter(|found| {
            let (_, known) = pixels.shares(lens.pixel(&found.other_mm), found.other_mm.z as f32, radius_px);
            // Where tissue is in view, there is no other jaw: they have closed.
            ends.len() > 1 || known >= JAW_SHARE
        });
        match found {
            Some(found) => {
                self.jaws.see_one(now_ns, end_mm, &found, axis);
                Some(found.middle_mm)
            }
            None => {
                self.jaws.see_tip(now_ns, end_mm);
                None
            }
        }
    }
}

/// A shaft's axis in normalised coordinates (divided by the focal length).
fn axis_of(lens: &Lens, axis: &crate::shaft::ShaftAxis) -> Axis {
    let [fx, fy] = lens.focal_px;
    let along = Vector2::new(axis.along[0] / fx, axis.along[1] / fy);
    Axis { from: lens.direction(axis.from_px), along: along / along.norm() }
}
