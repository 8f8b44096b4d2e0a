//! Intersects rays with the height field: a robust march on the corners of 8x8 tiles, Newton steps between them.

use super::lanes::{LANES, Lanes};
use super::lens::{Lens, TILE};
use super::relief::{BLOCKS, NODES};
use super::solid::{Entry, Part, Solid};

/// Depth along the optical axis assigned to rays that hit nothing, mm.
pub const FAR_MM: f32 = 2000.0;

/// Minimum step towards the surface, mm along the optical axis.
const MIN_STEP_MM: f32 = 0.04;

/// The height field of one frame.
#[derive(Clone, Copy)]
pub struct Field<'a> {
    /// `z` of the nodes, mm, row after row.
    pub z_mm: &'a [f32],
    /// Nodes per mm.
    pub per_mm: f32,
    /// Upper bound of the slope.
    pub max_slope: f32,
    /// Upper bound of the slope around each block of nodes.
    pub block_slope: &'a [f32],
    /// Lower bound of z, mm.
    pub nearest_mm: f32,
}

/// One camera's position in one (sub-)frame, in the scene frame wrapped to the first period.
#[derive(Clone, Copy, Debug, Default)]
pub struct Station {
    /// Centre of projection, mm.
    pub centre: [f32; 3],
    /// Rows of `scene_from_camera`'s rotation.
    pub rotation: [[f32; 3]; 3],
    /// Position of the light, mm.
    pub light: [f32; 3],
}

/// How the rays of an 8x8 tile are intersected.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tile {
    /// A depth in front of the first hit of any ray, mm; 0 where the corners may be interpolated instead, because no silhouette passes between them.
    pub start_mm: f32,
    /// Upper bound of the slope from there on.
    pub slope: f32,
}

/// Result of the coarse pass for a view.
#[derive(Clone, Debug, Default)]
pub struct Coarse {
    /// Depth along the axis at each corner, mm; rows of `grid_padded`.
    pub depth_mm: Vec<f32>,
    /// How to intersect the rays of each tile.
    pub tiles: Vec<Tile>,
    /// Instruments in the camera's frame.
    pub parts: Vec<Solid>,
    /// For each tile, bit `i` set where a ray may meet `parts[i]`; empty without instruments.
    pub part_masks: Vec<u64>,
    /// Position of the light in the camera's frame, mm.
    pub light: [f64; 3],
}

impl Coarse {
    /// Allocates the buffers for a lens.
    pub fn new(lens: &Lens) -> Self {
        Self {
            depth_mm: vec![0.0; lens.grid_padded * lens.grid_height],
            tiles: vec![Tile::default(); (lens.grid_width - 1) * (lens.grid_height - 1)],
            ..Self::default()
        }
    }

    /// Finds the parts that each tile may contain: first for squares of 8x8 tiles, then for the tiles inside.
    pub fn sort_parts(&mut self, lens: &Lens) {
        if self.parts.is_empty() {
            self.part_masks.clear();
            return;
        }
        let (columns, rows) = (lens.grid_width - 1, lens.grid_height - 1);
        self.part_masks.resize(columns * rows, 0);
        let touched = |left: usize, top: usize, right: usize, bottom: usize, among: u64| {
            let corner = |u: usize, v: usize| {
                let at = v * lens.grid_padded + u;
                [f64::from(lens.corner_x[at]), f64::from(lens.corner_y[at])]
            };
            let ends = [corner(left, top), corner(right, top), corner(left, bottom), corner(right, bottom)];
            let middle = [0, 1].map(|k| ends.iter().map(|e| e[k]).sum::<f64>() * 0.25);
            let square =
                |e: &[f64; 2]| (e[0] - middle[0]) * (e[0] - middle[0]) + (e[1] - middle[1]) * (e[1] - middle[1]);
            // On the plane one unit away no angle is larger than its chord; a fifth more allows for curved edges.
            let spread = 1.2 * ends.iter().map(square).fold(0.0, f64::max).sqrt() + 1e-4;
            let inv = 1.0 / (middle[0] * middle[0] + middle[1] * middle[1] + 1.0).sqrt();
            let d = [middle[0] * inv, middle[1] * inv, inv];
            let mut mask = 0;
            for (i, part) in self.parts.iter().enumerate().take(64) {
                if among >> i & 1 == 1 && part.part.near(d, spread) {
                    mask |= 1 << i;
                }
            }
            mask
        };
        for top in (0..rows).step_by(8) {
            for left in (0..columns).step_by(8) {
                let (right, bottom) = ((left + 8).min(columns), (top + 8).min(rows));
                let among = touched(left, top, right, bottom, u64::MAX);
                for row in top..bottom {
                    for column in left..right {
                        let mask = if among == 0 { 0 } else { touched(column, row, column + 1, row + 1, among) };
                        self.part_masks[row * columns + column] = mask;
                    }
                }
            }
        }
    }

    /// The first part that the ray `(x, y, 1)` of a tile enters.
    pub fn first_part(&self, tile: usize, x: f32, y: f32) -> Option<(Entry, &Part)> {
        let mut mask = self.part_masks.get(tile).copied().unwrap_or(0);
        let mut best: Option<(Entry, &Part)> = None;
        while mask != 0 {
            let part = &self.parts[mask.trailing_zeros() as usize];
            mask &= mask - 1;
            if let Some(entry) = part.enter([f64::from(x), f64::from(y), 1.0])
                && best.as_ref().is_none_or(|(nearest, _)| entry.t < nearest.t)
            {
                best = Some((entry, &part.part));
            }
        }
        best
    }
}

/// Eight rays from one station.
#[derive(Clone, Copy)]
pub struct Rays<L> {
    /// Direction in the scene; one unit is one mm of depth along the camera's axis.
    pub d: [L; 3],
}

/// One row of a rotation times `(x, y, 1)`. Kernels use no closures: those would be compiled separately, without the AVX2 feature.
#[inline(always)]
fn along<L: Lanes>(row: &[f32; 3], x: L, y: L) -> L {
    L::splat(row[0]) * x + L::splat(row[1]) * y + L::splat(row[2])
}

impl<L: Lanes> Rays<L> {
    /// Rays through `(x, y, 1)` of the camera.
    #[inline(always)]
    pub fn new(station: &Station, x: L, y: L) -> Self {
        Self {
            d: [
                along(&station.rotation[0], x, y),
                along(&station.rotation[1], x, y),
                along(&station.rotation[2], x, y),
            ],
        }
    }

    /// The points at depth `t`.
    #[inline(always)]
    pub fn at(&self, station: &Station, t: L) -> [L; 3] {
        let [x, y, z] = station.centre;
        [L::splat(x) + t * self.d[0], L::splat(y) + t * self.d[1], L::splat(z) + t * self.d[2]]
    }
}

impl Field<'_> {
    /// Height and slopes of the bilinear patch under `(x, y)`.
    #[inline(always)]
    pub fn sample<L: Lanes>(&self, x: L, y: L) -> (L, L, L) {
        let scale = L::splat(self.per_mm);
        let (gx, gy) = (x * scale, y * scale);
        let (fx, fy) = (gx.floor(), gy.floor());
        let (ux, uy) = (gx - fx, gy - fy);
        let mask = L::u_splat(NODES as u32 - 1);
        let one = L::u_splat(1);
        let (ix, iy) = (L::u_and(fx.to_u32(), mask), fy.to_u32());
        let jx = L::u_and(L::u_add(ix, one), mask);
        let shift = NODES.trailing_zeros();
        let row = L::u_shl(L::u_and(iy, mask), shift);
        let below = L::u_shl(L::u_and(L::u_add(iy, one), mask), shift);
        let z00 = L::gather(self.z_mm, L::u_add(row, ix));
        let z10 = L::gather(self.z_mm, L::u_add(row, jx));
        let z01 = L::gather(self.z_mm, L::u_add(below, ix));
        let z11 = L::gather(self.z_mm, L::u_add(below, jx));
        let (dx0, dx1) = (z10 - z00, z11 - z01);
        let (a, b) = (z00 + dx0 * ux, z01 + dx1 * ux);
        (a + (b - a) * uy, (dx0 + (dx1 - dx0) * uy) * scale, (b - a) * scale)
    }

    /// Distance of the surface behind the ray's point at `t` along z, and how fast it decreases with `t`.
    #[inline(always)]
    fn gap<L: Lanes>(&self, station: &Station, rays: &Rays<L>, t: L) -> (L, L) {
        let [x, y, z] = rays.at(station, t);
        let (height, sx, sy) = self.sample(x, y);
        (height - z, rays.d[2] - sx * rays.d[0] - sy * rays.d[1])
    }

    /// First hit at or after depth `start`: steps that cannot pass the surface, because it is nowhere steeper than `slope`, then Newton steps.
    #[inline(always)]
    pub fn march<L: Lanes>(&self, station: &Station, rays: &Rays<L>, start: L, slope: f32) -> L {
        let lateral = (rays.d[0] * rays.d[0] + rays.d[1] * rays.d[1]).sqrt();
        let safe = L::splat(1.0) / (rays.d[2].max(L::splat(0.0)) + L::splat(slope) * lateral + L::splat(1e-3));
        // Close to the surface a least step ends the approach, which would else take for ever where the ray
        // grazes it; it is far smaller than a node, and Newton mends what was overshot.
        let near = L::splat(2e-3);
        let least = L::splat(MIN_STEP_MM);
        let zero = L::splat(0.0);
        let mut t = start;
        let mut steps = 0;
        loop {
            let (gap, _) = self.gap(station, rays, t);
            let open = near.less_mask(gap) & t.less_mask(L::splat(FAR_MM));
            let ahead = (gap * safe).max(least);
            t = (t + L::select_lt(near, gap, ahead, zero)).min(L::splat(FAR_MM));
            steps += 1;
            if open == 0 || steps >= 400 {
                break;
            }
        }
        self.polish(station, rays, t, 8, 0.1).0
    }

    /// Newton steps of at most `reach_mm`, until the last one is below 0.5 um in all lanes, or `limit` steps. The second value is true when they
    /// converged.
    #[inline(always)]
    fn polish<L: Lanes>(&self, station: &Station, rays: &Rays<L>, start: L, limit: u32, reach_mm: f32) -> (L, bool) {
        let mut t = start;
        let least = L::splat(0.04);
        let enough = L::splat(5e-4);
        for _ in 0..limit {
            let (gap, closing) = self.gap(station, rays, t);
            let step = gap / closing.max(least);
            t = (t + step.clamp(-reach_mm, reach_mm)).min(L::splat(FAR_MM));
            if enough.less_mask(step.abs()) == 0 {
                return (t, true);
            }
        }
        (t, false)
    }

    /// Depths of the eight pixels of a packet that lies in tile (`column`, `row / 8`).
    #[inline(always)]
    pub fn packet<L: Lanes>(
        &self,
        station: &Station,
        rays: &Rays<L>,
        lens: &Lens,
        coarse: &Coarse,
        column: usize,
        row: usize,
    ) -> L {
        let tile_row = row / TILE;
        let tile = coarse.tiles[tile_row * (lens.grid_width - 1) + column];
        if tile.start_mm == 0.0 {
            let v = (row % TILE) as f32 * (1.0 / TILE as f32);
            let top = &coarse.depth_mm[tile_row * lens.grid_padded + column..][..2];
            let below = &coarse.depth_mm[(tile_row + 1) * lens.grid_padded + column..][..2];
            let (left, right) = (top[0] + (below[0] - top[0]) * v, top[1] + (below[1] - top[1]) * v);
            let part = L::load(&[0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875]);
            let guess = L::splat(left) + L::splat(right - left) * part;
            let (t, done) = self.polish(station, rays, guess, 6, 1.0);
            if done {
                return t;
            }
        }
        let (start, slope) = self.safe_start(station, rays, tile);
        self.march(station, rays, start, slope)
    }

    /// The tile's start and slope if that start is above the surface, else the plane in front of the whole relief.
    #[inline(always)]
    pub fn safe_start<L: Lanes>(&self, station: &Station, rays: &Rays<L>, tile: Tile) -> (L, f32) {
        if tile.start_mm > 0.0 {
            let t = L::splat(tile.start_mm);
            let (gap, _) = self.gap(station, rays, t);
            if L::splat(0.0).less_mask(gap) == (1 << LANES) - 1 {
                return (t, tile.slope);
            }
        }
        // Rays that climb, or run within a degree of level, meet nothing.
        let level = L::splat(0.02);
        let top = L::splat(self.nearest_mm - station.centre[2]) / rays.d[2].max(level);
        (L::select_lt(rays.d[2], level, L::splat(FAR_MM), top.max(L::splat(0.0))), self.max_slope)
    }

    /// Bound of the slope near a point.
    fn slope_near(&self, x: f32, y: f32) -> f32 {
        let scale = self.per_mm * (BLOCKS as f32 / NODES as f32);
        let (i, j) = ((x * scale).floor() as i32 as usize, (y * scale).floor() as i32 as usize);
        self.block_slope[(j & (BLOCKS - 1)) * BLOCKS + (i & (BLOCKS - 1))]
    }

    /// Whether `t` is a hit and not a ray that hit nothing.
    #[inline(always)]
    pub fn hit_mask<L: Lanes>(&self, station: &Station, rays: &Rays<L>, t: L) -> u32 {
        let (gap, _) = self.gap(station, rays, t);
        gap.abs().less_mask(L::splat(2e-2)) & t.less_mask(L::splat(FAR_MM * 0.99))
    }
}

/// Depths of the corners of one row of the coarse grid.
#[inline(always)]
pub fn corner_row<L: Lanes>(field: &Field, station: &Station, lens: &Lens, row: usize, depth: &mut [f32]) {
    let x = &lens.corner_x[row * lens.grid_padded..][..lens.grid_padded];
    let y = &lens.corner_y[row * lens.grid_padded..][..lens.grid_padded];
    for ((x, y), out) in
        x.as_chunks::<LANES>().0.iter().zip(y.as_chunks::<LANES>().0).zip(depth.as_chunks_mut::<LANES>().0)
    {
        let rays = Rays::<L>::new(station, L::load(x), L::load(y));
        let (start, slope) = field.safe_start(station, &rays, Tile::default());
        *out = field.march(station, &rays, start, slope).store();
    }
}

/// Decides for each tile of one row whether its corners may be interpolated.
pub fn classify_row(field: &Field, station: &Station, lens: &Lens, depth: &[f32], row: usize, tiles: &mut [Tile]) {
    let (columns, rows) = (lens.grid_width, lens.grid_height);
    let (top, bottom) = (row.saturating_sub(1), (row + 2).min(rows - 1));
    let line = |v: usize| &depth[v * lens.grid_padded..][..lens.grid_padded];
    for (column, tile) in tiles.iter_mut().enumerate() {
        let (left, right) = (column.saturating_sub(1), (column + 2).min(columns - 1));
        let (mut nearest, mut farthest, mut bend) = (f32::MAX, 0f32, 0f32);
        for v in top..=bottom {
            let here = &line(v)[left..=right];
            for &t in here {
                nearest = nearest.min(t);
                farthest = farthest.max(t);
            }
            for three in here.windows(3) {
                bend = bend.max((three[0] - 2.0 * three[1] + three[2]).abs());
            }
        }
        for v in top + 1..bottom {
            let (above, here, below) = (line(v - 1), line(v), line(v + 1));
            for u in left..=right {
                bend = bend.max((above[u] - 2.0 * here[u] + below[u]).abs());
            }
        }
        // Straight corners: no silhouette passes between them. A bend of 0.3 % of the depth is several times
        // what a surface of 4 mm radius makes of 8 px.
        if bend < 0.003 * nearest {
            *tile = Tile::default();
            continue;
        }
        let (mut steepest, mut lateral) = (0f32, 0f32);
        for v in top..=bottom {
            for u in left..=right {
                let (x, y, t) =
                    (lens.corner_x[v * lens.grid_padded + u], lens.corner_y[v * lens.grid_padded + u], line(v)[u]);
                let r = &station.rotation;
                let d = [0, 1, 2].map(|i| r[i][0] * x + r[i][1] * y + r[i][2]);
                steepest = steepest.max(field.slope_near(station.centre[0] + t * d[0], station.centre[1] + t * d[1]));
                lateral = lateral.max((d[0] * d[0] + d[1] * d[1]).sqrt() / d[2].max(0.05));
            }
        }
        // The bounds hold one block around each hit; a tile whose rays run farther sideways takes the global one.
        let block_mm = NODES as f32 / (BLOCKS as f32 * field.per_mm);
        let slope = if (farthest - 0.95 * nearest) * lateral < block_mm { steepest } else { field.max_slope };
        // Where the surface is nowhere steep enough to turn away from the rays there are no silhouettes.
        let single = slope * lateral < 0.9;
        *tile = Tile { start_mm: if single { 0.0 } else { (0.985 * nearest).max(0.01) }, slope };
    }
}
