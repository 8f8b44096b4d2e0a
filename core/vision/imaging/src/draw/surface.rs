//! Renders an organised point cloud from another viewpoint: the surface between neighbouring points, lit from the
//! viewer.
//!
//! Angles use the platform's sine, so that, unlike in the rest of this module, bytes may differ between machines.

use std::fmt::Write;

use super::contour::{Contour, RIM};
use super::corner::{Corner, NOWHERE};
use super::light::light;
use super::rims::{GradientLimit, Position, Rims};
use super::{Color, line, text};
use crate::ViewMut;

/// A known point of a cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrawnPoint {
    /// Position in the camera's frame.
    pub mm: [f32; 3],
    /// Its colour in the camera's image.
    pub color: Color,
    /// Whether it was filled in from the points around it: it is drawn in [`filled_color`] and has no depth in the
    /// image.
    pub is_filled: bool,
}

/// A cloud as rows of points.
pub trait SurfacePoints: Sync {
    /// Points per row, rows.
    fn size(&self) -> (usize, usize);
    /// Point at a column and row; `None` where unknown.
    fn at(&self, column: usize, row: usize) -> Option<DrawnPoint>;
    /// The known point nearest to a column and row, at most `reach` away in each direction, so that a single unknown
    /// point is not a hole.
    fn near(&self, column: usize, row: usize, reach: usize) -> Option<DrawnPoint> {
        nearest(self, (column, row), reach)
    }
}

/// The darker colour of a point that was filled in, so that it differs from what was measured.
pub fn filled_color(color: Color) -> Color {
    color.map(|value| (f32::from(value) * 0.8).round() as u8)
}

/// Viewpoint and zoom of an image of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// Turn about the vertical axis through the surface's middle, radians; 0 is the camera's view.
    pub yaw: f32,
    /// Turn about the horizontal axis, radians.
    pub pitch: f32,
    /// Size on the image; 1 fills it in the view from the front.
    pub zoom: f32,
    /// Spacing of corners, in points.
    pub step: usize,
    /// Limit that separates surfaces between neighbours.
    pub limit: GradientLimit,
    /// 0 keeps the colours, 1 darkens surfaces that face away.
    pub shading: f32,
    /// Offset of the surface's middle from the image's, as a share of the image's width: right, down.
    pub shift: [f32; 2],
    /// Whether a ruler with a length in mm is drawn.
    pub has_ruler: bool,
}

impl Default for Orbit {
    fn default() -> Self {
        Self {
            yaw: 0.0,
            pitch: 0.0,
            zoom: 1.0,
            step: 2,
            limit: GradientLimit::default(),
            shading: 0.6,
            shift: [0.0; 2],
            has_ruler: true,
        }
    }
}

/// Maps positions of the camera's frame to a painted image, and back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// Centre of rotation, mm.
    pub middle_mm: [f32; 3],
    /// Sine and cosine of yaw and of pitch.
    turn: [(f32, f32); 2],
    /// px per mm at the middle.
    scale: f32,
    /// Pixel of the middle.
    origin: [f32; 2],
}

impl Projection {
    /// Column, row and depth behind the middle (mm, seen from the viewer).
    pub fn project(&self, place_mm: [f32; 3]) -> [f32; 3] {
        let [(sy, cy), (sp, cp)] = self.turn;
        let [mx, my, mz] = self.middle_mm;
        let (x, y, z) = (place_mm[0] - mx, place_mm[1] - my, place_mm[2] - mz);
        let (x1, z1) = (cy * x + sy * z, cy * z - sy * x);
        let (y1, z2) = (cp * y - sp * z1, cp * z1 + sp * y);
        // The viewer stands as far away as the camera did, a little back.
        let shrink = self.scale * self.shrink(z2);
        [self.origin[0] + x1 * shrink, self.origin[1] + y1 * shrink, z2]
    }

    /// Depth behind the middle, mm, from which on positions are in front of the viewer.
    pub fn nearest_mm(&self) -> f32 {
        -1.15 * self.middle_mm[2]
    }

    fn shrink(&self, z2: f32) -> f32 {
        let mz = self.middle_mm[2];
        1.2 * mz / (1.2 * mz + z2).max(0.05 * mz)
    }

    /// The position at a column and row, `depth_mm` behind the middle, in mm.
    pub fn unproject(&self, column: f32, row: f32, depth_mm: f32) -> [f32; 3] {
        let [(sy, cy), (sp, cp)] = self.turn;
        let shrink = self.scale * self.shrink(depth_mm);
        let (x1, y1) = ((column - self.origin[0]) / shrink, (row - self.origin[1]) / shrink);
        let (y, z1) = (cp * y1 + sp * depth_mm, cp * depth_mm - sp * y1);
        let (x, z) = (cy * x1 - sy * z1, cy * z1 + sy * x1);
        [x + self.middle_mm[0], y + self.middle_mm[1], z + self.middle_mm[2]]
    }
}

/// Draws surfaces; with reusable buffers.
#[derive(Default)]
pub struct SurfacePainter {
    corners: Vec<Corner>,
    /// The corners' positions, without those between surfaces.
    positions: Vec<Position>,
    depth: Vec<f32>,
    /// Whether a pixel shows a part of the surface that was filled in.
    is_filled: Vec<bool>,
    sorted: Vec<f32>,
    rims: Rims,
    /// Share of the corners on surfaces that are cut off.
    cut_share: f32,
    /// Text next to the ruler.
    length: String,
    contour: Contour,
}

const BACKGROUND: u8 = 18;

/// See [`SurfacePoints::near`].
fn nearest(points: &(impl SurfacePoints + ?Sized), (x, y): (usize, usize), reach: usize) -> Option<DrawnPoint> {
    if let Some(point) = points.at(x, y) {
        return Some(point);
    }
    let (width, height) = points.size();
    for r in 1..=reach {
        let (left, right) = (x.saturating_sub(r), (x + r).min(width - 1));
        let (top, bottom) = (y.saturating_sub(r), (y + r).min(height - 1));
        let places =
            [(x, top), (left, y), (right, y), (x, bottom), (left, top), (right, top), (left, bottom), (right, bottom)];
        if let Some(point) = places.into_iter().find_map(|(x, y)| points.at(x, y)) {
            return Some(point);
        }
    }
    None
}

/// Steps in columns and rows between the points whose median is the middle, and between those that give the width.
pub fn middle_steps((width, height): (usize, usize)) -> [[usize; 2]; 2] {
    [[1 + width / 64, 1 + height / 64], [1 + width / 64, 1 + height / 32]]
}

/// Median of the known points, sampled.
fn median(points: &dyn SurfacePoints, axis: usize, sorted: &mut Vec<f32>) -> Option<f32> {
    let (width, height) = points.size();
    let [[step_x, step_y], _] = middle_steps((width, height));
    sorted.clear();
    for y in (0..height).step_by(step_y) {
        sorted.extend((0..width).step_by(step_x).filter_map(|x| points.at(x, y)).map(|p| p.mm[axis]));
    }
    sorted.sort_unstable_by(f32::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// A round length of about a fifth of the visible width.
fn ruler_mm(visible_mm: f32) -> f32 {
    let wanted = visible_mm / 5.0;
    let decade = 10f32.powf(wanted.max(1e-3).log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|m| m * decade).find(|l| *l <= wanted).unwrap_or(decade)
}

impl SurfacePainter {
    /// For each pixel of the last image the depth behind the middle as in [`Projection`], infinite without a surface
    /// and where it was filled in.
    pub fn depth_mm(&self) -> &[f32] {
        &self.depth
    }

    /// Share of the surface points of the last image that are known but not drawn, because they are close to a step
    /// of depth or at ragged rims. Points on the ramp between two depths do not count as surface.
    pub fn cut_share(&self) -> f32 {
        self.cut_share
    }

    /// Draws the surface into `out` (BGR), optionally with a ruler in mm at the depth of its middle. Without known
    /// points it draws only the background and returns `None`.
    pub fn paint(
        &mut self,
        points: &dyn SurfacePoints,
        orbit: &Orbit,
        out: &mut ViewMut<'_, u8>,
    ) -> Option<Projection> {
        self.depth.clear();
        for y in 0..out.height {
            out.row_mut(y).fill(BACKGROUND);
        }
        let middle: [Option<f32>; 3] = std::array::from_fn(|axis| median(points, axis, &mut self.sorted));
        let [Some(mx), Some(my), Some(mz)] = middle else { return None };
        let (columns, rows) = points.size();
        let step = orbit.step.max(1);
        let (w, h) = (columns.div_ceil(step), rows.div_ceil(step));
        if w < 2 || h < 2 || out.width < 8 || out.height < 8 || mz <= 0.0 {
            return None;
        }
        // Seen from the front at its own distance, the cloud's picture fills the width.
        let left = (0..rows).step_by(step).filter_map(|y| points.at(0, y)).next();
        let half = self.half_width(points, mx).max(left.map_or(0.0, |p| (mx - p.mm[0]).abs())).max(1.0);
        let scale = orbit.zoom * 0.48 * out.width as f32 / half;
        let turn = [orbit.yaw, orbit.pitch].map(f32::sin_cos);
        let origin =
            [out.width as f32 * (0.5 + orbit.shift[0]), out.height as f32 / 2.0 + out.width as f32 * orbit.shift[1]];
        let projection = Projection { middle_mm: [mx, my, mz], turn, scale, origin };
        self.corners.clear();
        self.corners.resize(w * h, NOWHERE);
        for j in 0..h {
            for i in 0..w {
                if let Some(DrawnPoint { mm, color, is_filled }) = points.near(i * step, j * step, step / 2) {
                    let color = if is_filled { filled_color(color) } else { color };
                    self.corners[j * w + i] = Corner { world: mm, color, is_filled, ..NOWHERE };
                }
            }
        }
        self.positions.clear();
        self.positions.extend(self.corners.iter().map(|corner| corner.world));
        let before = self.positions.iter().filter(|position| !position[0].is_nan()).count();
        self.rims.clean(&mut self.positions, w, orbit.limit);
        let on_surfaces = before - self.rims.ramp_corners();
        for (corner, position) in self.corners.iter_mut().zip(&self.positions) {
            match position[0].is_nan() {
                true => *corner = NOWHERE,
                false => corner.place = projection.project(*position),
            }
        }
        self.contour.find(&mut self.corners, w, orbit.limit, |world| projection.project(world));
        let is_shown = |(position, inside): &(&Position, &f32)| !position[0].is_nan() && **inside >= RIM;
        let shown = self.positions.iter().zip(self.contour.inside()).filter(is_shown).count();
        self.cut_share = on_surfaces.saturating_sub(shown) as f32 / on_surfaces.max(1) as f32;
        let [(sy, cy), (sp, cp)] = turn;
        light(&mut self.corners, w, [-cp * sy, sp, cp * cy], orbit.shading);
        self.depth.resize(out.width * out.height, f32::INFINITY);
        self.is_filled.clear();
        self.is_filled.resize(out.width * out.height, false);
        for j in 0..h - 1 {
            for i in 0..w - 1 {
                let at = j * w + i;
                let [a, b, c, d] = [at, at + 1, at + w, at + w + 1];
                self.triangle(out, orbit.limit, [a, b, c]);
                self.triangle(out, orbit.limit, [b, d, c]);
            }
        }
        let shown = self.depth.iter_mut().zip(&self.is_filled);
        shown.filter(|(_, filled)| **filled).for_each(|(depth, _)| *depth = f32::INFINITY);
        if orbit.has_ruler {
            self.ruler(out, scale);
        }
        Some(projection)
    }

    /// Draws a ruler of a round length, `scale` px per mm.
    fn ruler(&mut self, out: &mut ViewMut<'_, u8>, scale: f32) {
        let length = ruler_mm(out.width as f32 / scale);
        let (x, y) = (out.width as f32 * 0.04, out.height as f32 * 0.94);
        line(out, (x, y), (x + length * scale, y), 2.0, [230; 3]);
        for end in [x, x + length * scale] {
            line(out, (end, y - 4.0), (end, y + 4.0), 2.0, [230; 3]);
        }
        let size = (out.height as f32 / 140.0).clamp(1.0, 6.0);
        self.length.clear();
        let _ = write!(self.length, "{length} mm");
        text(out, x, y - 14.0 * size, &self.length, size, [230; 3]);
    }

    fn half_width(&mut self, points: &dyn SurfacePoints, mx: f32) -> f32 {
        let (width, height) = points.size();
        let [_, [step_x, step_y]] = middle_steps((width, height));
        self.sorted.clear();
        for y in (0..height).step_by(step_y) {
            let known = (0..width).step_by(step_x).filter_map(|x| points.at(x, y));
            self.sorted.extend(known.map(|p| (p.mm[0] - mx).abs()));
        }
        self.sorted.sort_unstable_by(f32::total_cmp);
        self.sorted.get(self.sorted.len() * 98 / 100).copied().unwrap_or(1.0)
    }

    /// Draws the part of the triangle between three corners that is inside the surface's rim.
    fn triangle(&mut self, out: &mut ViewMut<'_, u8>, limit: GradientLimit, corners: [usize; 3]) {
        let t = corners.map(|at| self.corners[at]);
        let inside = corners.map(|at| self.contour.inside()[at]);
        if t.iter().any(|c| c.place[0].is_nan()) || inside.iter().all(|v| *v < RIM) {
            return;
        }
        let is_filled = t.iter().any(|c| c.is_filled);
        let is_whole = inside.iter().all(|v| *v >= RIM);
        // Beyond its rim a surface could reach another one.
        let is_inner = corners.iter().all(|at| !self.positions[*at][0].is_nan());
        let is_steep = |a: usize, b: usize| {
            let (a, b) = (t[a].world, t[b].world);
            if is_inner { limit.parts(a, b) } else { limit.parts_at_rim(a, b) }
        };
        if is_steep(0, 1) || is_steep(0, 2) || is_steep(1, 2) {
            return;
        }
        let [p, q, r] = [t[0].place, t[1].place, t[2].place];
        let area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
        if area.abs() < 1e-6 {
            return;
        }
        let bound = |a: f32, b: f32, c: f32, size: usize| {
            let (low, high) = (a.min(b).min(c).ceil().max(0.0), a.max(b).max(c).floor().min(size as f32 - 1.0));
            (low as usize, high as isize)
        };
        let ((x0, x1), (y0, y1)) = (bound(p[0], q[0], r[0], out.width), bound(p[1], q[1], r[1], out.height));
        for y in y0 as isize..=y1 {
            for x in x0 as isize..=x1 {
                let (fx, fy) = (x as f32, y as f32);
                let u = ((fx - p[0]) * (r[1] - p[1]) - (fy - p[1]) * (r[0] - p[0])) / area;
                let v = ((q[0] - p[0]) * (fy - p[1]) - (q[1] - p[1]) * (fx - p[0])) / area;
                if u < 0.0 || v < 0.0 || u + v > 1.0 {
                    continue;
                }
                if !is_whole && inside[0] + u * (inside[1] - inside[0]) + v * (inside[2] - inside[0]) < RIM {
                    continue;
                }
                let z = p[2] + u * (q[2] - p[2]) + v * (r[2] - p[2]);
                let (x, y) = (x as usize, y as usize);
                let held = &mut self.depth[y * out.width + x];
                if z < *held {
                    *held = z;
                    self.is_filled[y * out.width + x] = is_filled;
                    let light = t[0].light + u * (t[1].light - t[0].light) + v * (t[2].light - t[0].light);
                    let pixel = &mut out.row_mut(y)[3 * x..3 * x + 3];
                    for (k, value) in pixel.iter_mut().enumerate() {
                        let [a, b, c] = [t[0].color[k], t[1].color[k], t[2].color[k]].map(f32::from);
                        *value = (light * (a + u * (b - a) + v * (c - a))) as u8;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(mm: [f32; 3], color: Color) -> Option<DrawnPoint> {
        Some(DrawnPoint { mm, color, is_filled: false })
    }

    /// A plane at 50 mm, 20 mm wide, with a step in its right half.
    struct Step(f32);
    impl SurfacePoints for Step {
        fn size(&self) -> (usize, usize) {
            (40, 30)
        }
        fn at(&self, x: usize, y: usize) -> Option<DrawnPoint> {
            let z = if x < 20 { 50.0 } else { 50.0 + self.0 };
            measured([x as f32 * 0.5 - 10.0, y as f32 * 0.5 - 7.5, z], [200, 100, 50])
        }
    }

    fn painted(step: f32, yaw: f32) -> (usize, Vec<u8>) {
        let mut data = vec![0; 160 * 120 * 3];
        let orbit = Orbit {
            yaw,
            zoom: if yaw == 0.0 { 1.0 } else { 0.5 },
            step: 1,
            limit: GradientLimit { max_gradient: 1.5, baseline_mm: 15.0 },
            shading: 0.0,
            ..Orbit::default()
        };
        SurfacePainter::default().paint(&Step(step), &orbit, &mut ViewMut::new(&mut data, 160, 120, 3));
        (data.chunks_exact(3).filter(|p| *p == [200, 100, 50]).count(), data)
    }

    #[test]
    fn a_plane_has_no_holes_and_a_step_is_no_wall() {
        let (front, data) = painted(0.0, 0.0);
        assert!(front > 100 * 80, "{front}");
        assert_eq!(data[(60 * 160 + 80) * 3..(60 * 160 + 80) * 3 + 3], [200, 100, 50]);
        // Seen from the side the step leaves a gap instead of a wall.
        let (_, data) = painted(8.0, 0.9);
        let row: Vec<bool> = (0..160).map(|x| data[(60 * 160 + x) * 3] == 200).collect();
        let inside: Vec<&bool> = row.iter().skip_while(|b| !**b).collect();
        let last = inside.iter().rposition(|b| **b).unwrap_or(0);
        assert!(inside[..last].iter().any(|b| !**b), "a gap between the two halves");
    }

    /// Tissue at 67 mm and, at the image's right edge, an instrument 45 mm away, as a camera sees them.
    struct Instrument;
    impl SurfacePoints for Instrument {
        fn size(&self) -> (usize, usize) {
            (160, 120)
        }
        fn at(&self, x: usize, y: usize) -> Option<DrawnPoint> {
            let is_instrument = x >= 100 && (40..80).contains(&y);
            let (z, color) = if is_instrument { (45.0, [60; 3]) } else { (67.0, [200; 3]) };
            measured([(x as f32 - 80.0) / 175.0 * z, (y as f32 - 60.0) / 175.0 * z, z], color)
        }
    }

    #[test]
    fn no_thread_joins_an_instrument_at_the_edge_to_the_tissue() {
        for (yaw, pitch) in [(0.5, 0.4), (-0.5, 0.4), (0.9, -0.3)] {
            let mut data = vec![0; 320 * 240 * 3];
            let orbit = Orbit { yaw, pitch, zoom: 0.6, step: 1, shading: 0.0, ..Orbit::default() };
            SurfacePainter::default().paint(&Instrument, &orbit, &mut ViewMut::new(&mut data, 320, 240, 3));
            // The ruler and its words are below.
            let drawn: Vec<u8> = data[..320 * 200 * 3].chunks_exact(3).map(|p| p[0]).collect();
            assert!(drawn.iter().filter(|v| **v == 60).count() > 300, "the instrument, from {yaw}");
            let between = drawn.iter().filter(|v| (64..196).contains(*v)).count();
            assert_eq!(between, 0, "pixels of both, from {yaw}, {pitch}");
        }
    }

    /// A wall 60 mm away as cameras with a short baseline measure it: disparity in steps of one px of 67, which are 0.9
    /// mm each.
    struct Terraces;
    impl SurfacePoints for Terraces {
        fn size(&self) -> (usize, usize) {
            (320, 240)
        }
        fn at(&self, x: usize, y: usize) -> Option<DrawnPoint> {
            let z = 750.0 * 5.4 / (60.0 + (x / 20) as f32);
            measured([(x as f32 - 160.0) / 750.0 * z, (y as f32 - 120.0) / 750.0 * z, z], [200, 100, 50])
        }
    }

    #[test]
    fn steps_of_one_px_of_disparity_are_no_holes() {
        let mut data = vec![0; 320 * 240 * 3];
        let limit = GradientLimit { baseline_mm: 5.4, ..GradientLimit::default() };
        let orbit = Orbit { step: 1, shading: 0.0, limit, ..Orbit::default() };
        let mut painter = SurfacePainter::default();
        painter.paint(&Terraces, &orbit, &mut ViewMut::new(&mut data, 320, 240, 3));
        assert!(painter.cut_share() < 0.02, "{}", painter.cut_share());
        // From the front, away from rims and the ruler.
        let holes = (40..180).flat_map(|y| (30..290).map(move |x| (y * 320 + x) * 3)).filter(|at| data[*at] != 200);
        assert_eq!(holes.count(), 0);
    }

    /// A plane at 50 mm whose middle was filled in.
    struct Filled;
    impl SurfacePoints for Filled {
        fn size(&self) -> (usize, usize) {
            (80, 60)
        }
        fn at(&self, x: usize, y: usize) -> Option<DrawnPoint> {
            let mm = [x as f32 * 0.25 - 10.0, y as f32 * 0.25 - 7.5, 50.0];
            Some(DrawnPoint { mm, color: [200; 3], is_filled: x.abs_diff(40) <= 1 && y == 30 })
        }
    }

    #[test]
    fn what_was_filled_in_is_shown_darker_and_has_no_depth() {
        let mut data = vec![0; 160 * 120 * 3];
        let orbit = Orbit { step: 1, shading: 0.0, ..Orbit::default() };
        let mut painter = SurfacePainter::default();
        painter.paint(&Filled, &orbit, &mut ViewMut::new(&mut data, 160, 120, 3));
        // Around the middle, away from rims and the ruler.
        let inside = (40..80).flat_map(|y| (40..120).map(move |x| y * 160 + x));
        let (filled, measured): (Vec<_>, Vec<_>) = inside.partition(|at| painter.depth_mm()[*at].is_infinite());
        let darkest = filled.iter().map(|at| data[3 * at]).min();
        assert!((8..40).contains(&filled.len()) && darkest.is_some_and(|v| v.abs_diff(160) <= 2), "{darkest:?}");
        assert!(measured.iter().all(|at| data[3 * at] == 200));
    }

    #[test]
    fn what_turns_away_gets_narrower() {
        assert!(painted(0.0, 1.2).0 < painted(0.0, 0.1).0 * 6 / 10);
    }

    #[test]
    fn places_are_found_again_under_their_pixels() {
        let mut data = vec![0; 160 * 120 * 3];
        let orbit = Orbit { yaw: 0.4, pitch: -0.3, zoom: 0.7, step: 1, shift: [0.05, -0.1], ..Orbit::default() };
        let mut painter = SurfacePainter::default();
        let out = &mut ViewMut::new(&mut data, 160, 120, 3);
        let projection = painter.paint(&Step(0.0), &orbit, out).unwrap();
        let place = [3.0, -2.0, 50.0];
        let [x, y, depth] = projection.project(place);
        let back = projection.unproject(x, y, depth);
        assert!(place.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-3), "{back:?}");
        // The picture's own depth there names a place of the plane.
        let held = painter.depth_mm()[y.round() as usize * 160 + x.round() as usize];
        let seen = projection.unproject(x.round(), y.round(), held);
        assert!((seen[2] - 50.0).abs() < 0.05 && (seen[0] - 3.0).abs() < 0.5, "{seen:?}");
    }

    #[test]
    fn rulers_have_round_lengths() {
        assert_eq!((ruler_mm(50.0), ruler_mm(37.0), ruler_mm(300.0)), (10.0, 5.0, 50.0));
    }
}
