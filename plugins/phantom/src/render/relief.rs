//! The shape of the tissue: a periodic height field on a lattice of nodes, bilinear between them.
//!
//! Scene frame: x right, y down, z away from the resting camera, mm. The surface is `z = H(x, y)`; between
//! nodes `H` is bilinear *by definition*, so that depth and disparity are exact for the surface drawn.

use panoscope_imaging::{Parallel, SharedMut};

use super::kinds::SceneKind;
use super::marks;
use super::math::smoothstep;
use super::noise::Layers;
use super::params::SceneParams;
use super::table::Table;

/// Number of nodes per period in each direction.
pub const NODES: usize = 512;

/// Number of blocks per period in each direction with their own slope bound.
pub const BLOCKS: usize = 32;

/// Height and tissue kind of every node.
#[derive(Clone, Debug)]
pub struct Relief {
    /// Period of the field in x and y, mm.
    pub period_mm: f32,
    /// `z` of each node at rest, mm, row after row.
    pub z_mm: Table<f32>,
    /// Displacement of each node along z for one mm of breathing.
    pub breath: Table<f32>,
    /// Share of the scene's second tissue (fat, mesentery, the deeper organ), 0..1.
    pub second: Table<f32>,
    /// Upper bound of the slope anywhere, breathing included.
    pub max_slope: f32,
    /// Upper bound of the slope within a block of nodes and the blocks around it, rows of [`BLOCKS`].
    pub block_slope: Vec<f32>,
    /// Smallest and largest `z`, breathing included.
    pub z_range_mm: [f32; 2],
}

impl Relief {
    /// Shapes the scene. Features keep their size in mm at any distance; only their height decreases when the camera is nearer than 50 mm, so that it
    /// never enters the tissue.
    pub fn new(params: &SceneParams, pool: &dyn Parallel) -> Self {
        let distance = params.distance_mm as f32;
        let period_mm = if distance < 32.0 { 64.0 } else { 128.0 };
        let shape = Shape::new(params, period_mm);
        let plane = || Table::from(vec![0.0; NODES * NODES]);
        let (mut z_mm, mut second, mut breath) = (plane(), plane(), plane());
        let swell = Layers::new(params.seed, 90, &[(4, 0.25)]);
        {
            let (z, s, b) = (SharedMut::new(&mut z_mm), SharedMut::new(&mut second), SharedMut::new(&mut breath));
            pool.run(NODES, &|row| {
                // SAFETY: each chunk takes its own row of each plane.
                let (z, s, b) =
                    unsafe { (z.part(row * NODES, NODES), s.part(row * NODES, NODES), b.part(row * NODES, NODES)) };
                let y = row as f32 / NODES as f32;
                for column in 0..NODES {
                    let x = column as f32 / NODES as f32;
                    let (height, share) = shape.at(x, y);
                    z[column] = distance + height;
                    s[column] = share;
                    b[column] = -(0.75 + swell.at(x, y));
                }
            });
        }
        if matches!(params.scene, SceneKind::Box | SceneKind::Board) {
            breath.fill(0.0);
        }
        let mut relief =
            Self { period_mm, z_mm, breath, second, max_slope: 0.0, block_slope: Vec::new(), z_range_mm: [0.0; 2] };
        relief.measure(params.breathing_mm as f32);
        relief
    }

    /// Spacing of the nodes, mm.
    pub fn cell_mm(&self) -> f32 {
        self.period_mm / NODES as f32
    }

    fn measure(&mut self, breathing_mm: f32) {
        let cell = self.cell_mm();
        let mut range = [f32::MAX, f32::MIN];
        let mut swell: f32 = 0.0;
        let mut blocks = vec![0.0f32; BLOCKS * BLOCKS];
        for y in 0..NODES {
            for x in 0..NODES {
                let (row, below) = (y * NODES, (y + 1) % NODES * NODES);
                let right = (x + 1) % NODES;
                let step = |a: usize, b: usize| {
                    (self.z_mm[b] - self.z_mm[a]).abs() + (self.breath[b] - self.breath[a]).abs() * breathing_mm
                };
                // A bilinear patch is nowhere steeper than its steepest edges of both directions together.
                let along = step(row + x, row + right).max(step(below + x, below + right)) / cell;
                let across = step(row + x, below + x).max(step(row + right, below + right)) / cell;
                let block = &mut blocks[y * BLOCKS / NODES * BLOCKS + x * BLOCKS / NODES];
                *block = block.max(along * along + across * across);
                let z = self.z_mm[row + x];
                range = [range[0].min(z), range[1].max(z)];
                swell = swell.max(self.breath[row + x].abs());
            }
        }
        let around = |i: usize| {
            let (x, y) = (i % BLOCKS + BLOCKS, i / BLOCKS + BLOCKS);
            let at = |k: usize| blocks[(y + k / 3 - 1) % BLOCKS * BLOCKS + (x + k % 3 - 1) % BLOCKS];
            (0..9).map(at).fold(0.0, f32::max).sqrt()
        };
        self.block_slope = (0..BLOCKS * BLOCKS).map(around).collect();
        self.max_slope = self.block_slope.iter().copied().fold(0.0, f32::max);
        self.z_range_mm = [range[0] - swell * breathing_mm, range[1] + swell * breathing_mm];
    }

    /// Samples a node plane bilinearly between nodes (for shading and masks): row `y` of a map of `out.len()` texels per period.
    #[inline(always)]
    pub fn upsample_row(plane: &[f32], y: usize, out: &mut [f32]) {
        let step = out.len() / NODES;
        let inv = 1.0 / step as f32;
        let (row, v) = (y / step, (y % step) as f32 / step as f32);
        let (a, b) = (&plane[row * NODES..][..NODES], &plane[(row + 1) % NODES * NODES..][..NODES]);
        for (i, cell) in out.chunks_exact_mut(step).enumerate() {
            let j = (i + 1) % NODES;
            let (left, right) = (a[i] + (b[i] - a[i]) * v, a[j] + (b[j] - a[j]) * v);
            for (k, value) in cell.iter_mut().enumerate() {
                *value = left + (right - left) * (k as f32 * inv);
            }
        }
    }
}

/// The functions that define the surface at the nodes.
struct Shape {
    kind: SceneKind,
    period_mm: f32,
    scale: f32,
    broad: Layers,
    middle: Layers,
    lumps: Layers,
    edge: Layers,
    bend: Layers,
}

impl Shape {
    fn new(params: &SceneParams, period_mm: f32) -> Self {
        let cells = |mm: f32| ((period_mm / mm) as usize).next_power_of_two().max(2);
        let layers = |purpose, list: &[(f32, f32)]| {
            let octaves: Vec<_> = list.iter().map(|&(mm, gain)| (cells(mm), gain)).collect();
            Layers::new(params.seed, purpose, &octaves)
        };
        Self {
            kind: params.scene,
            period_mm,
            scale: (params.distance_mm as f32 / 50.0).min(1.0) * params.relief as f32,
            broad: layers(1, &[(32.0, 4.5), (16.0, 1.2)]),
            middle: layers(2, &[(16.0, 1.0), (8.0, 0.45)]),
            lumps: layers(3, &[(4.0, 0.7), (2.0, 0.25)]),
            edge: layers(4, &[(32.0, 1.0), (16.0, 0.25), (8.0, 0.08)]),
            bend: layers(5, &[(32.0, 1.0), (16.0, 0.3)]),
        }
    }

    /// Height (negative: nearer to the camera) in mm and share of the second tissue at `(x, y)` periods.
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        match self.kind {
            SceneKind::Liver => self.liver(x, y),
            SceneKind::Bowel => self.bowel(x, y),
            SceneKind::Cavity => self.cavity(x, y),
            SceneKind::Box => {
                (marks::box_height_mm(marks::centred(x, self.period_mm), marks::centred(y, self.period_mm)), 0.0)
            }
            SceneKind::Board => (0.0, 0.0),
        }
    }

    /// A smooth lobe whose rounded edge hangs over lumpy fat.
    fn liver(&self, x: f32, y: f32) -> (f32, f32) {
        let edge = self.edge.at(x, y) + 0.25;
        let lobe = smoothstep(-0.10, 0.22, edge);
        let rim = lobe * (2.0 - lobe);
        let height =
            self.broad.at(x, y) * 0.8 - 6.5 * rim + (1.0 - lobe) * (self.middle.at(x, y) + self.lumps.at(x, y)) + 4.0;
        (height * self.scale, 1.0 - smoothstep(-0.06, 0.03, edge))
    }

    /// Round loops side by side, meandering, with mesentery in the creases.
    fn bowel(&self, x: f32, y: f32) -> (f32, f32) {
        let loops = self.period_mm / 16.0;
        let phase = y * loops + 0.9 * self.bend.at(x, y) + 0.15 * self.middle.at(x, y);
        let u = (phase - phase.floor()) * 2.0 - 1.0;
        // A cord of fat lies in the crease; where it meets the loop the two are rounded into each other.
        let inward = 1.0 - u.abs();
        let (tube, cord) = (1.0 - u * u, 0.30 - 2.2 * inward * inward + 0.05 * self.middle.at(x, y + 0.21));
        let blend = (0.5 + (tube - cord) * (0.5 / 0.13)).clamp(0.0, 1.0);
        let dome = cord + (tube - cord) * blend + 0.13 * blend * (1.0 - blend);
        // Haustra: soft rings around each loop.
        let ring = self.middle.at(y + 0.37, x) * 0.35;
        let height =
            4.0 - 8.0 * dome + self.broad.at(x, y) * 0.45 + ring * blend + 0.35 * (1.0 - blend) * self.lumps.at(x, y);
        (height * self.scale, 1.0 - smoothstep(0.25, 0.75, blend))
    }

    /// Terraces of organs, each much deeper than the last.
    fn cavity(&self, x: f32, y: f32) -> (f32, f32) {
        let edge = self.edge.at(x, y) - self.edge.at(0.06, 0.0);
        let near = smoothstep(-0.12, 0.30, edge - 0.25);
        let far = smoothstep(-0.15, 0.25, -0.35 - edge);
        let height = -22.0 * near * (2.0 - near)
            + 34.0 * far
            + self.broad.at(x, y) * 0.7
            + self.lumps.at(x, y) * 0.3 * (1.0 - near);
        (height * self.scale, 1.0 - smoothstep(0.0, 0.1, near))
    }
}
