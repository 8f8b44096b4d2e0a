//! The tissue as a mesh of cells, without the instruments in front of it.

use super::fill::Fill;
use crate::tracking::vector::{add_scaled, dot, norm, sub};

/// Pixels along a cell.
const CELL_PX: usize = 4;
/// Minimum number of pixels with known depth per known cell.
const MIN_SAMPLES: usize = 4;
/// Minimum number of known cells among nine neighbours; isolated cells are wrong matches.
const MIN_AROUND: usize = 5;
/// Maximum distance over which holes are filled from known tissue, as a share of the focal length: half the width of a
/// thick instrument close to the camera (5 of 35 mm).
const FILLED: f64 = 0.15;

/// Pinhole projection: `u = fx x / z + cx`, `v = fy y / z + cy`, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Horizontal focal length, px.
    pub fx: f64,
    /// Vertical focal length, px.
    pub fy: f64,
    /// Horizontal principal point, px.
    pub cx: f64,
    /// Vertical principal point, px.
    pub cy: f64,
}

impl Lens {
    /// Position of a pixel at a depth, mm.
    pub fn place(&self, u: f64, v: f64, z: f64) -> [f64; 3] {
        [(u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z, z]
    }

    /// Pixel of a position.
    pub fn pixel(&self, place: [f64; 3]) -> [f64; 2] {
        [self.fx * place[0] / place[2] + self.cx, self.fy * place[1] / place[2] + self.cy]
    }
}

/// The point of the tissue that is nearest to a tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Distance, mm; below 0 where the tip is behind the surface.
    pub distance_mm: f64,
    /// The point, mm.
    pub place_mm: [f64; 3],
    /// The point in the image, px.
    pub pixel: [f64; 2],
    /// Whether the surface is visible there; otherwise it was filled in from its surroundings.
    pub is_seen: bool,
    /// Whether the surface straight ahead of the tip is known, visible or filled in; otherwise nearer tissue may exist.
    pub is_known_ahead: bool,
}

/// The tissue in a depth image.
///
/// Each cell of 4 x 4 px has the median depth of its tissue. Cells that an instrument touches, a rim around it (where
/// matchers mix depths), and cells without depth are filled in from their surroundings, because the tissue nearest to a
/// tip is nearly always hidden by its own instrument.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    columns: usize,
    rows: usize,
    lens: Option<Lens>,
    z_mm: Vec<f32>,
    rough: Vec<f32>,
    hidden: Vec<bool>,
    spread: Vec<bool>,
    sorted: Vec<f32>,
    fill: Fill,
}

impl Surface {
    /// Builds the surface from a depth image (mm, NaN where unknown) of `width` x `height` px and a test for instrument
    /// pixels.
    pub fn build(
        &mut self,
        (width, height): (usize, usize),
        lens: Lens,
        rim_px: usize,
        depth_mm: impl Fn(usize, usize) -> f32,
        is_tool: impl Fn(usize, usize) -> bool,
    ) {
        (self.columns, self.rows, self.lens) = (width / CELL_PX, height / CELL_PX, Some(lens));
        self.hide(rim_px.div_ceil(CELL_PX), is_tool);
        self.z_mm.clear();
        for row in 0..self.rows {
            for column in 0..self.columns {
                let mut z = f32::NAN;
                if !self.hidden[row * self.columns + column] {
                    self.sorted.clear();
                    for y in row * CELL_PX..(row + 1) * CELL_PX {
                        let known = (column * CELL_PX..(column + 1) * CELL_PX).map(|x| depth_mm(x, y));
                        self.sorted.extend(known.filter(|z| z.is_finite() && *z > 0.0));
                    }
                    if self.sorted.len() >= MIN_SAMPLES {
                        let middle = self.sorted.len() / 2;
                        z = *self.sorted.select_nth_unstable_by(middle, f32::total_cmp).1;
                    }
                }
                self.z_mm.push(z);
            }
        }
        self.smooth();
        let reach = (FILLED * lens.fx.max(lens.fy) / CELL_PX as f64).ceil().clamp(1.0, 1000.0) as u16;
        self.fill.fill(&mut self.z_mm, self.columns, self.rows, reach);
    }

    /// Gives each known cell the median of those around it: the nearest point is a minimum, which a single wrong depth
    /// would determine.
    fn smooth(&mut self) {
        let (columns, rows) = (self.columns, self.rows);
        self.rough.clone_from(&self.z_mm);
        for (at, z) in self.z_mm.iter_mut().enumerate().filter(|(_, z)| z.is_finite()) {
            let (column, row) = (at % columns, at / columns);
            self.sorted.clear();
            for y in row.saturating_sub(1)..(row + 2).min(rows) {
                let line = &self.rough[y * columns + column.saturating_sub(1)..y * columns + (column + 2).min(columns)];
                self.sorted.extend(line.iter().copied().filter(|z| z.is_finite()));
            }
            let middle = self.sorted.len() / 2;
            let median = *self.sorted.select_nth_unstable_by(middle, f32::total_cmp).1;
            *z = if self.sorted.len() >= MIN_AROUND { median } else { f32::NAN };
        }
    }

    /// Marks cells that an instrument touches, and those up to `rim` cells away.
    fn hide(&mut self, rim: usize, is_tool: impl Fn(usize, usize) -> bool) {
        let (columns, rows) = (self.columns, self.rows);
        self.spread.clear();
        for row in 0..rows {
            for column in 0..columns {
                let mut pixels =
                    (0..CELL_PX * CELL_PX).map(|k| (column * CELL_PX + k % CELL_PX, row * CELL_PX + k / CELL_PX));
                self.spread.push(pixels.any(|(x, y)| is_tool(x, y)));
            }
        }
        self.hidden.clear();
        for row in 0..rows {
            let line = &self.spread[row * columns..(row + 1) * columns];
            self.hidden
                .extend((0..columns).map(|x| line[x.saturating_sub(rim)..(x + rim + 1).min(columns)].contains(&true)));
        }
        for row in 0..rows {
            for column in 0..columns {
                let mut near = row.saturating_sub(rim)..(row + rim + 1).min(rows);
                self.spread[row * columns + column] = near.any(|y| self.hidden[y * columns + column]);
            }
        }
        std::mem::swap(&mut self.hidden, &mut self.spread);
    }

    /// Middle of a cell, px.
    fn middle(column: usize, row: usize) -> (f64, f64) {
        let half = (CELL_PX as f64 - 1.0) / 2.0;
        ((column * CELL_PX) as f64 + half, (row * CELL_PX) as f64 + half)
    }

    /// Position of a cell, mm; `None` if its depth is unknown.
    fn place(&self, column: usize, row: usize) -> Option<[f64; 3]> {
        let z = self.z_mm.get(row * self.columns + column).copied().filter(|z| z.is_finite())?;
        let (u, v) = Self::middle(column, row);
        Some(self.lens?.place(u, v, f64::from(z)))
    }

    /// Depth of the surface at a pixel, mm, between the middles of cells; `None` outside the image and where it is
    /// unknown.
    pub fn depth_at(&self, u: f64, v: f64) -> Option<f64> {
        let half = (CELL_PX as f64 - 1.0) / 2.0;
        let inside = |p: f64, cells: usize| p >= -0.5 && p <= (cells * CELL_PX) as f64 - 0.5;
        if !(inside(u, self.columns) && inside(v, self.rows)) || self.columns < 2 || self.rows < 2 {
            return None;
        }
        let cell = |p: f64, cells: usize| ((p - half) / CELL_PX as f64).clamp(0.0, (cells - 1) as f64);
        let (x, y) = (cell(u, self.columns), cell(v, self.rows));
        let (column, row) = ((x as usize).min(self.columns - 2), (y as usize).min(self.rows - 2));
        let (a, b) = (x - column as f64, y - row as f64);
        let z = |dx: usize, dy: usize| f64::from(self.z_mm[(row + dy) * self.columns + column + dx]);
        let depth = (z(0, 0) * (1.0 - a) + z(1, 0) * a) * (1.0 - b) + (z(0, 1) * (1.0 - a) + z(1, 1) * a) * b;
        depth.is_finite().then_some(depth)
    }

    /// The nearest point to a tip; `None` if no depth is known.
    pub fn nearest(&self, tip_mm: [f64; 3]) -> Option<Nearest> {
        let lens = self.lens?;
        let mut best: Option<(f64, usize, usize)> = None;
        for row in 0..self.rows {
            for column in 0..self.columns {
                if let Some(place) = self.place(column, row) {
                    let away = sub(place, tip_mm);
                    let square = dot(away, away);
                    if best.is_none_or(|(least, ..)| square < least) {
                        best = Some((square, column, row));
                    }
                }
            }
        }
        let (_, column, row) = best?;
        let mut place_mm = self.place(column, row)?;
        // Exactly, on the triangles that meet in this cell.
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (Some(left), Some(top)) = ((column + dx).checked_sub(1), (row + dy).checked_sub(1)) else { continue };
            if left + 1 >= self.columns || top + 1 >= self.rows {
                continue;
            }
            let corner = |x: usize, y: usize| self.place(left + x, top + y);
            let (Some(a), Some(b), Some(c), Some(d)) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)) else {
                continue;
            };
            for triangle in [[a, b, c], [b, d, c]] {
                let on = nearest_on(triangle, tip_mm);
                if norm(sub(on, tip_mm)) < norm(sub(place_mm, tip_mm)) {
                    place_mm = on;
                }
            }
        }
        let [u, v] = lens.pixel(tip_mm);
        let ahead = self.depth_at(u, v).filter(|_| tip_mm[2] > 0.0);
        let is_behind = ahead.is_some_and(|z| tip_mm[2] > z);
        let distance_mm = norm(sub(place_mm, tip_mm)) * if is_behind { -1.0 } else { 1.0 };
        let is_seen = !self.fill.is_filled(row * self.columns + column);
        Some(Nearest { distance_mm, place_mm, pixel: lens.pixel(place_mm), is_seen, is_known_ahead: ahead.is_some() })
    }
}

/// Nearest point of a triangle (Ericson 2005, "Real-time collision detection", 5.1.5).
fn nearest_on([a, b, c]: [[f64; 3]; 3], p: [f64; 3]) -> [f64; 3] {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return add_scaled(a, ab, d1 / (d1 - d3));
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return add_scaled(a, ac, d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return add_scaled(b, sub(c, b), (d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let whole = va + vb + vc;
    add_scaled(add_scaled(a, ab, vb / whole), ac, vc / whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Lens = Lens { fx: 375.0, fy: 375.0, cx: 159.5, cy: 119.5 };
    const SIZE: (usize, usize) = (320, 240);

    /// Intersection of the ray of a pixel with the plane `z = z0 + slope x`.
    fn plane(u: usize, z0: f64, slope: f64) -> f32 {
        (z0 / (1.0 - slope * (u as f64 - LENS.cx) / LENS.fx)) as f32
    }

    #[test]
    fn a_tip_before_a_plane_has_the_planes_distance_though_its_tool_hides_the_place() {
        let (z0, slope) = (60.0, 0.3);
        let length = (1.0_f64 + slope * slope).sqrt();
        let mut surface = Surface::default();
        for (x, y, before) in [(0.0, 0.0, 5.0), (6.0, -4.0, 1.0), (-5.0, 3.0, 0.2), (2.0, 2.0, -1.5)] {
            let tip = [x, y, z0 + slope * x - before * length];
            let [u, v] = LENS.pixel(tip);
            // A tool of 5 mm to the right of the tip, 20 mm before the tissue.
            let is_tool = |x: usize, y: usize| x as f64 > u - 6.0 && (y as f64 - v).abs() < 16.0;
            let depth = |x: usize, y: usize| if is_tool(x, y) { 40.0 } else { plane(x, z0, slope) };
            surface.build(SIZE, LENS, 4, depth, is_tool);
            let nearest = surface.nearest(tip).unwrap();
            assert!((nearest.distance_mm - before).abs() < 0.12, "{before}: {nearest:?}");
            assert!(!nearest.is_seen);
            // Without leaving the tool out, what is nearest is the tool.
            surface.build(SIZE, LENS, 0, depth, |_, _| false);
            let wrong = surface.nearest(tip).unwrap();
            assert!((wrong.distance_mm - before).abs() > 0.5 || before == 5.0, "{wrong:?}");
        }
        surface.build(SIZE, LENS, 0, |_, _| f32::NAN, |_, _| false);
        assert_eq!(surface.nearest([0.0, 0.0, 50.0]), None);
    }

    #[test]
    fn single_wrong_depths_are_left_out_and_what_no_camera_matched_is_not_known() {
        // Twelve wrong pixels of one cell stand before the tissue, and the left third was not matched.
        let is_wrong = |x: usize, y: usize| (200..204).contains(&x) && (100..103).contains(&y);
        let depth = |x: usize, y: usize| match () {
            () if x < 110 => f32::NAN,
            () if is_wrong(x, y) => 42.0,
            () => 60.0,
        };
        let mut surface = Surface::default();
        surface.build(SIZE, LENS, 0, depth, |_, _| false);
        let nearest = surface.nearest(LENS.place(202.0, 101.0, 40.0)).unwrap();
        assert!((nearest.distance_mm - 20.0).abs() < 0.1 && nearest.is_known_ahead, "{nearest:?}");
        let nearest = surface.nearest(LENS.place(20.0, 120.0, 59.0)).unwrap();
        assert!(!nearest.is_known_ahead && nearest.distance_mm > 1.0, "{nearest:?}");
    }

    #[test]
    fn a_wall_beside_the_tip_is_nearer_than_the_floor_behind_it() {
        let depth = |x: usize, _: usize| if x < 160 { 70.0 } else { 50.0 };
        let mut surface = Surface::default();
        surface.build(SIZE, LENS, 0, depth, |_, _| false);
        let wall_mm = (160.0 + 1.5 - LENS.cx) / LENS.fx * 50.0;
        let nearest = surface.nearest([wall_mm - 3.0, 0.0, 50.0]).unwrap();
        assert!(nearest.is_seen && (nearest.distance_mm - 3.0).abs() < 0.3, "{nearest:?}");
    }

    #[test]
    fn nearest_points_of_a_triangle_lie_inside_on_edges_and_in_corners() {
        let triangle = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];
        for (p, want) in [
            ([1.0, 1.0, 3.0], [1.0, 1.0, 0.0]),
            ([2.0, -1.0, 1.0], [2.0, 0.0, 0.0]),
            ([-1.0, 2.0, 1.0], [0.0, 2.0, 0.0]),
            ([3.0, 3.0, -1.0], [2.0, 2.0, 0.0]),
            ([-1.0, -1.0, 0.0], [0.0, 0.0, 0.0]),
            ([6.0, -1.0, 0.0], [4.0, 0.0, 0.0]),
            ([-1.0, 6.0, 0.0], [0.0, 4.0, 0.0]),
        ] {
            let at = nearest_on(triangle, p);
            assert!(norm(sub(at, want)) < 1e-12, "{p:?}: {at:?}");
        }
    }
}
