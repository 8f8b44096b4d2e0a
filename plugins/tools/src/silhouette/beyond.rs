//! Where an instrument continues beyond its box, or leaves the view: its shaft.

use panoscope_node::View;

use super::cells::{class_of, shade};
use super::{GRAY, GROWS, Silhouette};
use crate::shaft::Moments;

/// Number of directions that are tried.
const DIRECTIONS: usize = 48;
/// Distances of compared lines from the middle of a shaft, as shares of the instrument's width: lines on it, and lines next to it.
const ON: [f64; 3] = [-0.25, 0.0, 0.25];
const NEXT: [f64; 2] = [-1.3, 1.3];
/// Length along which a shaft is followed beyond its box, as a share of the box's diagonal, and minimum number of compared places.
const LENGTH_SHARE: f64 = 1.0;
const MIN_PLACES: usize = 6;
/// Minimum share of instrument on a shaft, and how much higher it must be than next to it, and than in the opposite direction.
const MIN_ON: f64 = 0.6;
const MIN_LEAD: f64 = 0.35;
/// Lead of a direction in which the instrument reaches the box's side and the view ends there.
const LEAVES: f64 = 0.5;
/// Minimum share of instrument between its middle and the box's side.
const MIN_WITHIN: f64 = 0.6;
/// Brightness below which a pixel may belong to the dark rim of a round image, the length of the rim, px, and the brightness below which a pixel has
/// no colour.
const RIM: f32 = 0.03;
const RIM_PX: f64 = 6.0;
const COLOURLESS: f32 = 0.06;

/// Middle of an instrument's pixels in the image, and its width, px.
struct Extent {
    middle: [f64; 2],
    width: f64,
}

impl Silhouette {
    /// Unit vector from the last instrument towards the side on which its shaft leaves the box: there it goes on, as a strip with more of its colours
    /// than next to it, or the view ends. `None` if no direction is clearly better than the opposite one. `picture`: the image that was segmented.
    pub fn shaft_direction(&self, picture: &View<'_, u8>) -> Option<[f64; 2]> {
        let extent = self.extent()?;
        let leads: [f64; DIRECTIONS] = std::array::from_fn(|index| {
            let angle = index as f64 / DIRECTIONS as f64 * std::f64::consts::TAU;
            self.lead(picture, &extent, [angle.cos(), angle.sin()])
        });
        // Neighbours agree on a real shaft.
        let smooth = |index: usize| {
            let at = |step: usize| leads[(index + DIRECTIONS + step - 1) % DIRECTIONS].max(0.0);
            0.25 * at(0) + 0.5 * at(1) + 0.25 * at(2)
        };
        let best = (0..DIRECTIONS).max_by(|a, b| smooth(*a).total_cmp(&smooth(*b)))?;
        let opposite = (0..DIRECTIONS).filter(|index| {
            let apart = index.abs_diff(best);
            apart.min(DIRECTIONS - apart) > DIRECTIONS / 4
        });
        let other = opposite.map(smooth).fold(0.0, f64::max);
        let angle = best as f64 / DIRECTIONS as f64 * std::f64::consts::TAU;
        (leads[best] >= MIN_LEAD && smooth(best) >= other + MIN_LEAD / 2.0).then(|| [angle.cos(), angle.sin()])
    }

    /// Middle and width of the instrument.
    fn extent(&self) -> Option<Extent> {
        let region = &self.cells.region;
        let moments = Moments::of(&self.mask())?;
        let (pitch, [x, y]) = (region.pitch as f64, moments.centre);
        let middle = [region.x_px as f64 + (x + 0.5) * pitch, region.y_px as f64 + (y + 0.5) * pitch];
        Some(Extent { middle, width: (moments.width() * pitch).max(3.0) })
    }

    /// How much more instrument there is on a line beyond the box than next to it, -1 to 1; [`LEAVES`] if the view ends where the instrument reaches the
    /// box's side; -1 if the line is not on an instrument.
    fn lead(&self, picture: &View<'_, u8>, extent: &Extent, [dx, dy]: [f64; 2]) -> f64 {
        let Extent { middle: [cx, cy], width } = *extent;
        let region = &self.cells.region;
        let side = |cell: usize, from: usize| (from + cell * region.pitch) as f64;
        let [left, top, right, bottom] = region.own;
        let (left, right) = (side(left, region.x_px), side(right + 1, region.x_px));
        let (top, bottom) = (side(top, region.y_px), side(bottom + 1, region.y_px));
        let reach = |at: f64, low: f64, high: f64, d: f64| match d {
            d if d > 1e-9 => (high - at) / d,
            d if d < -1e-9 => (low - at) / d,
            _ => f64::INFINITY,
        };
        let first = reach(cx, left, right, dx).min(reach(cy, top, bottom, dy)) + 1.0;
        let step = (width / 6.0).max(1.0);
        let within = (first / step) as usize;
        let own = (0..within).filter(|place| {
            let along = *place as f64 * step;
            let (x, y) = (cx + along * dx, cy + along * dy);
            x >= 0.0 && y >= 0.0 && self.contains(x as usize, y as usize)
        });
        if (own.count() as f64) < MIN_WITHIN * within as f64 {
            return -1.0;
        }
        let mut ends = false;
        let count = (LENGTH_SHARE * (right - left).hypot(bottom - top) / step) as usize;
        let (mut places, mut on, mut next, mut dark) = (0, 0.0, 0.0, 0.0);
        for place in 0..count {
            let along = first + place as f64 * step;
            let at = |aside: f64| self.pixel(picture, cx + along * dx - aside * dy, cy + along * dy + aside * dx);
            let bright = at(0.0).map(|(_, bright)| bright);
            dark = if bright.is_some_and(|bright| bright < RIM) { dark + step } else { 0.0 };
            if bright.is_none() || dark >= RIM_PX {
                ends = true;
                break;
            }
            let share = |lines: &[f64]| {
                let metals = lines.iter().filter_map(|line| at(line * width)).map(|(is_metal, _)| f64::from(is_metal));
                metals.sum::<f64>() / lines.len() as f64
            };
            (places, on, next) = (places + 1, on + share(&ON), next + share(&NEXT));
        }
        // What the rim's first pixels were taken for.
        if ends && places < MIN_PLACES + (dark / step) as usize {
            return LEAVES;
        }
        if places < MIN_PLACES || on < MIN_ON * places as f64 {
            return -1.0;
        }
        (on - next) / places as f64
    }

    /// Whether a pixel has an instrument's colour, 1 or 0, and its brightness; `None` outside the image.
    fn pixel(&self, picture: &View<'_, u8>, x: f64, y: f64) -> Option<(u8, f32)> {
        let is_inside = x >= 0.0 && y >= 0.0 && x < picture.width as f64 && y < picture.height as f64;
        let pixel = is_inside.then(|| &picture.row(y as usize)[3 * x as usize..])?.first_chunk::<3>()?;
        let (redness, bright) = shade(pixel.map(f32::from));
        let (centre, deviation) = self.tissue?;
        let ratio = self.log_ratios.get(class_of(redness, bright) as usize).copied().unwrap_or_default();
        let is_metal = bright > COLOURLESS && ((centre - redness) / deviation > GRAY || ratio > GROWS);
        Some((u8::from(is_metal), bright))
    }
}
