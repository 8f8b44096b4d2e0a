//! The position of a tool's tip in space, from the depth of its ends.

use std::ops::Range;

use nalgebra::Vector3;
use panoscope_node::pick::Grid;
use panoscope_node::{Instances, Rect, View};

use crate::hidden_jaw::{HiddenJaw, KnownEnd, Lens, Pixels};
use crate::second_view::SecondView;
use crate::shaft::{End, Mask, TipFinder};
use crate::silhouette::{Nearness, Silhouette};

/// Minimum number of depth values around the tip for a position in space.
const MIN_VALUES: usize = 6;

/// Maximum multiple of the radius within which a mask's own depth is searched.
const WIDER: usize = 8;
/// Range of depths in which an end is searched in the other view, mm.
const REACH_MM: (f64, f64) = (20.0, 250.0);
/// Maximum difference of depth between two jaws of one instrument, mm.
const JAWS_MM: f64 = 10.0;
/// Maximum distance of the ends of open jaws from their middle, mm, and time for which it is stored while one jaw hides the other, ns.
const MAX_HALF_MM: f64 = 12.0;
const HALF_NS: i64 = 2_000_000_000;
/// Time in which the stored opening halves while the jaws are seen closer together, ns.
const HALF_FADES_NS: f64 = 0.7e9;
/// Maximum age of the last tip that decides which jaw is in view, ns.
const LAST_NS: i64 = 200_000_000;

/// Depth and disparity of the left view.
pub struct Space<'a> {
    /// Depth, mm; takes precedence if both are known.
    pub depth: Option<View<'a, f32>>,
    /// Disparity, px.
    pub disparity: Option<View<'a, f32>>,
    /// Disparity times depth, px mm; NaN without calibration.
    pub focal_baseline: f64,
}

impl Space<'_> {
    /// Columns and rows.
    pub fn size(&self) -> Option<(usize, usize)> {
        self.depth.as_ref().or(self.disparity.as_ref()).map(|view| (view.width, view.height))
    }

    /// Depth at a pixel, mm; NaN where unknown.
    fn depth_mm(&self, x: usize, y: usize) -> f32 {
        match (&self.depth, &self.disparity) {
            (Some(view), _) => view.row(y)[x],
            (None, Some(view)) => (self.focal_baseline / f64::from(view.row(y)[x])) as f32,
            (None, None) => f32::NAN,
        }
    }
}

impl Nearness for Space<'_> {
    fn extend_row(&self, y: usize, columns: Range<usize>, values: &mut Vec<f32>) {
        match (&self.depth, &self.disparity) {
            (_, Some(view)) => values.extend_from_slice(&view.row(y)[columns]),
            (Some(view), None) => values.extend(view.row(y)[columns].iter().map(|depth_mm| 1.0 / depth_mm)),
            (None, None) => values.extend(columns.map(|_| f32::NAN)),
        }
    }
}

/// A tool whose position is searched, and the data around it.
pub struct Scene<'a> {
    /// Depth of the left view.
    pub space: &'a Space<'a>,
    /// Columns and rows of the depth.
    pub size: (usize, usize),
    /// Projection of the left rectified view, 3x4 row by row.
    pub projection: &'a [f64; 12],
    /// Masks of all tools, of the size of the depth.
    pub masks: Option<Instances<'a>>,
    /// Index of the tool among the masks.
    pub item: usize,
    /// Number of tools.
    pub items: usize,
    /// The silhouette from which the tip was found.
    pub cut: Option<&'a Silhouette>,
    /// Left and right image, to find the depth of ends of the silhouette.
    pub views: Option<(&'a View<'a, u8>, &'a View<'a, u8>)>,
    /// Radius within which depth is read, px.
    pub radius_px: usize,
    /// The tool's number in the output.
    pub tool: i64,
    /// Capture time, ns.
    pub now_ns: i64,
}

impl Scene<'_> {
    fn lens(&self) -> Lens {
        let p = self.projection;
        Lens { focal_px: [p[0], p[5]], centre_px: [p[2], p[6]] }
    }

    /// Whether a pixel belongs to the mask of a tool.
    fn covers(&self, item: usize, x: usize, y: usize) -> bool {
        self.masks.as_ref().is_some_and(|m| Mask::new(m.mask(item), self.size.0, self.size.1).contains(x, y))
    }

    /// Depth at a pixel, mm. If the tool's pixels are known, other surfaces are ignored.
    fn own_depth(&self, x: usize, y: usize) -> f32 {
        let is_own = match self.masks {
            Some(_) => self.covers(self.item, x, y),
            None => self.cut.is_none_or(|silhouette| silhouette.contains(x, y)),
        };
        if is_own { self.space.depth_mm(x, y) } else { f32::NAN }
    }

    /// As [`Self::own_depth`], without depth that a matcher took from the surface behind a thin end.
    fn clear_depth(&self, x: usize, y: usize) -> f32 {
        if self.cut.is_some_and(|silhouette| silhouette.has_surface_depth(x, y)) {
            f32::NAN
        } else {
            self.own_depth(x, y)
        }
    }
}

/// Result of the search for a tip.
pub enum Position {
    /// Another instrument hides the complete end of the tool.
    Hidden,
    /// Position in the image and in space; NaN where unknown.
    At {
        /// Column and row, px.
        pixel: (f64, f64),
        /// Position in the left camera's frame, mm.
        xyz_mm: [f64; 3],
        /// Whether all values are known.
        is_valid: bool,
    },
}

/// Finds positions; keeps what earlier ticks showed of the jaws.
#[derive(Default)]
pub struct TipPosition {
    near: Vec<f32>,
    second: SecondView,
    /// Distance of both ends of open jaws from the middle between them, mm, and when it was seen, ns.
    half: Option<(f64, i64)>,
    /// Jaws of which another instrument hides one.
    hidden: HiddenJaw,
    /// Position of the last tip, mm, and its capture time, ns.
    last: Option<([f64; 3], i64)>,
}

/// The point in space at a pixel and depth `z`, mm.
fn point(lens: &Lens, (u, v): (f64, f64), z: f64) -> [f64; 3] {
    [(u - lens.centre_px[0]) / lens.focal_px[0] * z, (v - lens.centre_px[1]) / lens.focal_px[1] * z, z]
}

/// Disparities within which an end is searched in the other view, px.
fn search_px(focal_baseline: f64) -> (f64, f64) {
    (focal_baseline / REACH_MM.1, focal_baseline / REACH_MM.0)
}

/// The parts of the left and the right view of `size` in which the ends of a silhouette are compared.
pub fn compared(ends: &[End], size: (usize, usize), focal_baseline: f64) -> [Vec<Grid>; 2] {
    let areas = ends.iter().filter_map(|end| SecondView::areas(end, size, search_px(focal_baseline)));
    areas.map(|areas| areas.map(Grid::of_area)).fold(Default::default(), |[mut left, mut right], areas| {
        let [a, b] = areas;
        left.push(a);
        right.push(b);
        [left, right]
    })
}

/// The parts of a depth map of `size` that are read around ends without masks.
pub fn around(ends: &[End], size: (usize, usize), radius_px: usize) -> Vec<Grid> {
    let ends = ends.iter().filter(|end| end.u_px.is_finite() && end.v_px.is_finite());
    let areas = ends.map(|end| {
        let middle = Rect::new(end.u_px.max(0.0) as usize, end.v_px.max(0.0) as usize, 1, 1);
        // Searched from half a radius inside.
        middle.grown((WIDER + 1) * radius_px + 1, size.0, size.1)
    });
    areas.map(Grid::of_area).collect()
}

impl TipPosition {
    /// Position of a tip with one or two ends. `finder` must have been given the tool's mask last.
    pub fn find(&mut self, scene: &Scene<'_>, tip: &End, ends: &[End], finder: &mut TipFinder) -> Position {
        let lens = scene.lens();
        let depths = self.depths(scene, ends);
        self.remember_opening(scene, &lens, ends, depths);
        let depth_of = |x: usize, y: usize| scene.space.depth_mm(x, y);
        let is_own = |x: usize, y: usize| scene.covers(scene.item, x, y);
        let is_other =
            |x: usize, y: usize| (0..scene.items).any(|other| other != scene.item && scene.covers(other, x, y));
        let pixels = Pixels {
            size: scene.size,
            depth_mm: &depth_of,
            is_own: &is_own,
            is_other: &is_other,
            has_others: scene.items > 1,
        };
        let mut known_ends = [KnownEnd::default(); 2];
        let mut count = 0;
        for (end, z) in ends.iter().zip(depths).filter_map(|(end, depth)| Some((end, depth?))) {
            let at = (end.u_px, end.v_px);
            let is_hidden = pixels.is_hidden(at, z as f32, scene.radius_px);
            known_ends[count] = KnownEnd { at_mm: point(&lens, at, z).into(), is_hidden };
            count += 1;
        }
        let known_ends = &known_ends[..count];
        if count > 0 && known_ends.iter().all(|end| end.is_hidden) {
            return Position::Hidden;
        }
        let is_whole = count == ends.len() && scene.masks.is_some() && scene.cut.is_none();
        let middle = is_whole
            .then(|| self.hidden.middle(scene.now_ns, scene.tool, known_ends, finder, &lens, scene.radius_px, &pixels));
        let mut pixel = (tip.u_px, tip.v_px);
        let mut xyz_mm = [f64::NAN; 3];
        // Between jaws the middle in space, which is not exactly the middle in the picture.
        let middle: Option<Vector3<f64>> =
            middle.flatten().or_else(|| (count > 1).then(|| (known_ends[0].at_mm + known_ends[1].at_mm) / 2.0));
        if let Some(middle) = middle {
            xyz_mm = middle.into();
            pixel = lens.pixel(&middle);
        } else if let [end] = known_ends {
            let z = end.at_mm.z;
            xyz_mm = point(&lens, pixel, if scene.views.is_some() { self.middle_mm(z, scene.now_ns) } else { z });
        }
        let is_valid = xyz_mm.iter().all(|v| v.is_finite()) && pixel.0.is_finite() && pixel.1.is_finite();
        if is_valid {
            self.last = Some((xyz_mm, scene.now_ns));
        }
        Position::At { pixel, xyz_mm, is_valid }
    }

    /// Depth of each end, mm.
    fn depths(&mut self, scene: &Scene<'_>, ends: &[End]) -> [Option<f64>; 2] {
        let Self { near, second, .. } = self;
        let focal_baseline = scene.space.focal_baseline;
        let mut depths: [Option<f64>; 2] = [None; 2];
        if let (Some(silhouette), Some((left, right))) = (scene.cut, scene.views) {
            let range = search_px(focal_baseline);
            for (depth, end) in depths.iter_mut().zip(ends) {
                let disparity = second.disparity(end, silhouette, [left, right], range);
                *depth = disparity.map(|disparity| focal_baseline / disparity);
            }
        }
        let known_mm = depths.iter().flatten().copied().next();
        let widest = if scene.masks.is_some() || scene.cut.is_some() { WIDER } else { 1 };
        for (depth, end) in depths.iter_mut().zip(ends).filter(|(depth, _)| depth.is_none()) {
            // Searched a little inside the tool: at its end half of the pixels are tissue.
            let step = scene.radius_px as f64 / 2.0;
            let inside = (end.u_px - end.direction[0] * step, end.v_px - end.direction[1] * step);
            let mut within = |depth_of: &dyn Fn(usize, usize) -> f32| {
                let mut radii = (1..=widest).map(|times| times * scene.radius_px);
                radii.find_map(|radius| depth_at(near, inside, radius, scene.size, depth_of))
            };
            let mut z = within(&|x, y| scene.clear_depth(x, y));
            // Where both views were compared, no position is better than one that may be the tissue's.
            if z.is_none() && scene.views.is_none() {
                z = within(&|x, y| scene.own_depth(x, y));
            }
            // A jaw is near the other one, whose depth was found in both views.
            *depth = z.map(f64::from).filter(|z| known_mm.is_none_or(|known| (z - known).abs() <= JAWS_MM));
        }
        depths
    }

    /// Stores the opening of jaws whose ends are both visible in both views.
    fn remember_opening(&mut self, scene: &Scene<'_>, lens: &Lens, ends: &[End], depths: [Option<f64>; 2]) {
        let ([Some(one), Some(two)], [a, b], Some(_)) = (depths, ends, scene.views) else { return };
        let at = |end: &End, z: f64| point(lens, (end.u_px, end.v_px), z);
        let apart = at(a, one).iter().zip(at(b, two)).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        // Just before one jaw hides the other, both ends seem to be the nearer one: the stored opening decays slowly.
        let faded = self.half.map_or(0.0, |(half, at_ns)| {
            half * 0.5_f64.powf(scene.now_ns.saturating_sub(at_ns).max(0) as f64 / HALF_FADES_NS)
        });
        self.half = Some(((apart / 2.0).max(faded), scene.now_ns)).filter(|(half, _)| *half <= MAX_HALF_MM);
    }

    /// Depth of the middle of open jaws of which one end is visible at `z_mm`, mm. Jaws that open along the viewing direction hide each other, and
    /// the tip would jump to the nearer one. Returns the depth nearer to the last tip's.
    fn middle_mm(&self, z_mm: f64, now_ns: i64) -> f64 {
        let is_recent = |at_ns: i64, max_ns: i64| (0..=max_ns).contains(&now_ns.saturating_sub(at_ns));
        let half = self.half.filter(|(_, at_ns)| is_recent(*at_ns, HALF_NS));
        let last = self.last.filter(|(_, at_ns)| is_recent(*at_ns, LAST_NS));
        match (half, last) {
            (Some((half, _)), Some((last, _))) if (z_mm + half - last[2]).abs() < (z_mm - last[2]).abs() => z_mm + half,
            _ => z_mm,
        }
    }
}

/// Median depth of the tool around the tip: the nearer surface, because a tool is in front of the tissue.
fn depth_at(
    near: &mut Vec<f32>,
    at: (f64, f64),
    radius: usize,
    size: (usize, usize),
    depth_of: &dyn Fn(usize, usize) -> f32,
) -> Option<f32> {
    let (u, v, r) = (at.0.round() as isize, at.1.round() as isize, radius as isize);
    near.clear();
    for y in (v - r).max(0)..=(v + r).min(size.1 as isize - 1) {
        for x in (u - r).max(0)..=(u + r).min(size.0 as isize - 1) {
            let z = depth_of(x as usize, y as usize);
            if (x - u).pow(2) + (y - v).pow(2) <= r * r && z.is_finite() && z > 0.0 {
                near.push(z);
            }
        }
    }
    if near.len() < MIN_VALUES {
        return None;
    }
    near.sort_unstable_by(f32::total_cmp);
    Some(near[near.len() / 4])
}
