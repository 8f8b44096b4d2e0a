//! The tissue's surface: colour, gloss and fine relief, baked once into a periodic map of texels, the rows that a view needs at a time.

use std::sync::Arc;

use panoscope_imaging::{Parallel, SharedMut, Simd};

use super::boards;
use super::kinds::{BoardPrint, SceneKind};
use super::marks;
use super::math::{Stream, smoothstep};
use super::noise::Layers;
use super::params::SceneParams;
use super::relief::{NODES, Relief};
use super::table::Table;
use super::vessels::{Growth, draw_vessels};

/// Texels per period in each direction.
pub const TEXELS: usize = 2048;
/// Slopes are stored in 16 bits: `(slope + SLOPE_LIMIT) / (2 * SLOPE_LIMIT) * 65535`.
pub const SLOPE_LIMIT: f32 = 6.0;

/// Rows that are baked together.
const BAND_ROWS: usize = 32;
/// One bit per band of rows.
const BANDS: usize = TEXELS / BAND_ROWS;
const _: () = assert!(BANDS == u64::BITS as usize);

/// Eight bytes per texel, lowest first: blue, green, red (square roots of the albedo), gloss, slope along x (high byte, low byte), slope along
/// y (high, low). Bytes are interpolated linearly; a sum of linear functions is linear, so high and low bytes may be combined after interpolation.
///
/// A view sees a part of the period, so rows are baked when a view first needs them; the others are 0.
pub struct Texels {
    map: Table<u64>,
    skin: Skin,
    /// Bit `i` is set when band `i` is baked.
    baked: u64,
    avx2: bool,
}

impl Texels {
    /// Draws the vessels and the noise's lattices; bakes no row yet.
    pub fn new(params: &SceneParams, relief: &Arc<Relief>, pool: &dyn Parallel) -> Self {
        let palette = Palette::of(params.scene).drawn(params.texture);
        let vessels = vessels(params.seed, &palette.vessels, relief.period_mm, pool);
        Self {
            map: Table::from(vec![0u64; TEXELS * TEXELS]),
            skin: Skin::new(params, relief, palette, vessels),
            baked: 0,
            avx2: Simd::detect().avx2(),
        }
    }

    /// The map, row after row.
    pub fn map(&self) -> &[u64] {
        &self.map
    }

    /// Whether every row is baked.
    pub fn is_whole(&self) -> bool {
        self.baked == u64::MAX
    }

    /// Bakes the rows between two places along y, which repeats with the period; all rows if a place is not finite.
    pub fn bake(&mut self, from_mm: f32, to_mm: f32, pool: &dyn Parallel) {
        let band = |y_mm: f32| (y_mm / (self.skin.texel_mm * BAND_ROWS as f32)).floor();
        // A texel is interpolated with the next one.
        let (first, last) = (band(from_mm), band(to_mm + self.skin.texel_mm));
        let is_whole = !first.is_finite() || !last.is_finite() || last - first + 1.0 >= BANDS as f32;
        let wanted = match is_whole {
            true => u64::MAX,
            false => (first as i64..=last as i64).fold(0, |bits, i| bits | 1 << i.rem_euclid(BANDS as i64)),
        };
        let missing = wanted & !self.baked;
        if missing == 0 {
            return;
        }
        let (map, skin, avx2) = (SharedMut::new(&mut self.map), &self.skin, self.avx2);
        pool.run(missing.count_ones() as usize, &|chunk| {
            let rest = (0..chunk).fold(missing, |bits, _| bits & (bits - 1));
            let band = rest.trailing_zeros() as usize;
            // SAFETY: each chunk takes its own band of rows.
            let rows = unsafe { map.part(band * BAND_ROWS * TEXELS, BAND_ROWS * TEXELS) };
            skin.bake_band(band * BAND_ROWS, rows, avx2);
        });
        self.baked |= missing;
    }
}

/// All families of vessels in one map of a byte per texel. Each family is drawn separately; the stronger one shows.
fn vessels(seed: u64, families: &[Growth], period_mm: f32, pool: &dyn Parallel) -> Table<u8> {
    let area = period_mm * period_mm / (128.0 * 128.0);
    let mut planes = vec![Table::from(vec![0u8; TEXELS * TEXELS]); families.len().max(1)];
    {
        let planes = SharedMut::new(&mut planes);
        pool.run(families.len(), &|family| {
            let growth = families[family];
            let trees = (growth.trees as f32 * area).ceil() as usize;
            let mut stream = Stream::new(seed, 200 + family as u32);
            // SAFETY: each chunk takes its own plane.
            let plane = unsafe { &mut planes.part(family, 1)[0] };
            draw_vessels(&mut stream, &Growth { trees, ..growth }, plane, TEXELS, period_mm / TEXELS as f32);
        });
    }
    let mut planes = planes.into_iter();
    let mut all = planes.next().unwrap_or_else(|| Vec::new().into());
    for plane in planes {
        all.iter_mut().zip(plane.iter()).for_each(|(texel, other)| *texel = (*texel).max(*other));
    }
    all
}

/// A tissue: display colour (blue, green, red, square-root scale), gloss, height of its grain in mm.
#[derive(Clone, Copy, Debug)]
struct Tissue {
    colour: [f32; 3],
    gloss: f32,
    grain_mm: f32,
    lobules_mm: f32,
    mottle: f32,
    flecks: f32,
}

struct Palette {
    first: Tissue,
    second: Tissue,
    vessels: Vec<Growth>,
    vessel: [f32; 3],
    vessel_share: f32,
    capillary_share: f32,
    membrane_share: f32,
}

impl Palette {
    fn of(scene: SceneKind) -> Self {
        let liver = Tissue {
            colour: [0.24, 0.25, 0.60],
            gloss: 0.9,
            grain_mm: 0.5,
            lobules_mm: 0.0,
            mottle: 1.3,
            flecks: 0.42,
        };
        let bowel = Tissue {
            colour: [0.60, 0.61, 0.90],
            gloss: 1.0,
            grain_mm: 0.7,
            lobules_mm: 0.0,
            mottle: 0.9,
            flecks: 0.22,
        };
        let fat = Tissue {
            colour: [0.40, 0.66, 0.92],
            gloss: 0.9,
            grain_mm: 1.3,
            lobules_mm: 0.30,
            mottle: 1.2,
            flecks: 0.32,
        };
        let fine = Growth { trees: 90, trunk_mm: 0.32, twig_mm: 0.07, branching_per_mm: 0.30, tortuosity: 0.10 };
        let arcade = Growth { trees: 26, trunk_mm: 1.1, twig_mm: 0.08, branching_per_mm: 0.22, tortuosity: 0.055 };
        match scene {
            SceneKind::Liver => Self {
                first: liver,
                second: fat,
                vessels: vec![fine, Growth { trees: 14, trunk_mm: 0.8, ..arcade }],
                vessel: [0.14, 0.10, 0.42],
                vessel_share: 0.65,
                capillary_share: 0.25,
                membrane_share: 0.35,
            },
            SceneKind::Bowel => Self {
                first: bowel,
                second: fat,
                vessels: vec![fine, arcade],
                vessel: [0.20, 0.15, 0.62],
                vessel_share: 0.85,
                capillary_share: 0.35,
                membrane_share: 0.15,
            },
            SceneKind::Cavity => Self {
                first: Tissue { colour: [0.36, 0.36, 0.74], ..bowel },
                second: Tissue { colour: [0.48, 0.56, 0.85], grain_mm: 1.2, lobules_mm: 0.12, ..fat },
                vessels: vec![fine, arcade],
                vessel: [0.16, 0.12, 0.50],
                vessel_share: 0.8,
                capillary_share: 0.35,
                membrane_share: 0.45,
            },
            SceneKind::Box | SceneKind::Board => {
                let card = Tissue {
                    colour: [0.74, 0.78, 0.78],
                    gloss: 0.05,
                    grain_mm: 0.0,
                    lobules_mm: 0.0,
                    mottle: 0.35,
                    flecks: 0.10,
                };
                Self {
                    first: card,
                    second: card,
                    vessels: Vec::new(),
                    vessel: [0.0; 3],
                    vessel_share: 0.0,
                    capillary_share: 0.0,
                    membrane_share: 0.0,
                }
            }
        }
    }
}

impl Palette {
    /// The same with the drawing on the tissue weakened by a factor of 0 to 1.
    fn drawn(self, share: f32) -> Self {
        let tissue = |tissue: Tissue| Tissue {
            grain_mm: tissue.grain_mm * share,
            lobules_mm: tissue.lobules_mm * share,
            mottle: tissue.mottle * share,
            flecks: tissue.flecks * share,
            ..tissue
        };
        Self {
            first: tissue(self.first),
            second: tissue(self.second),
            vessel_share: self.vessel_share * share,
            capillary_share: self.capillary_share * share,
            membrane_share: self.membrane_share * share,
            ..self
        }
    }
}

#[derive(Default)]
struct RowWork {
    scratch: Vec<f32>,
    rows: [Vec<f32>; 9],
}

/// Rows of noise from which colours are computed.
struct Noise<'a> {
    hue: &'a [f32],
    mottle: &'a [f32],
    net: &'a [f32],
    veil: &'a [f32],
    fleck: &'a [f32],
}

struct Skin {
    scene: SceneKind,
    board: BoardPrint,
    relief: Arc<Relief>,
    palette: Palette,
    texel_mm: f32,
    vessels: Table<u8>,
    grain: Layers,
    hue: Layers,
    mottle: Layers,
    net: Layers,
    veil: Layers,
    fleck: Layers,
    slopes: [Table<f32>; 2],
    open: Table<f32>,
}

impl Skin {
    fn new(params: &SceneParams, relief: &Arc<Relief>, palette: Palette, vessels: Table<u8>) -> Self {
        let cells = |mm: f32| ((relief.period_mm / mm) as usize).next_power_of_two().clamp(2, TEXELS);
        let layers = |purpose, list: &[(f32, f32)]| {
            let octaves: Vec<_> = list.iter().map(|&(mm, gain)| (cells(mm), gain)).collect();
            Layers::new(params.seed, purpose, &octaves)
        };
        let cell = relief.cell_mm();
        let slope = |dx: usize, dy: usize| {
            let z = |x: usize, y: usize| relief.z_mm[(y % NODES) * NODES + x % NODES];
            let at = |i: usize| {
                let (x, y) = (i % NODES + NODES, i / NODES + NODES);
                (z(x + dx, y + dy) - z(x - dx, y - dy)) / (2.0 * cell)
            };
            (0..NODES * NODES).map(at).collect()
        };
        Self {
            scene: params.scene,
            board: params.board,
            relief: relief.clone(),
            palette,
            texel_mm: relief.period_mm / TEXELS as f32,
            vessels,
            grain: layers(20, &[(4.0, 0.11), (2.0, 0.06), (1.0, 0.032), (0.5, 0.013), (0.25, 0.006)]),
            hue: layers(21, &[(16.0, 0.5), (8.0, 0.35), (4.0, 0.25)]),
            mottle: layers(22, &[(2.0, 0.32), (1.0, 0.30), (0.5, 0.34), (0.25, 0.34), (0.125, 0.28)]),
            net: layers(23, &[(4.0, 0.6), (2.0, 0.35), (1.0, 0.25)]),
            fleck: layers(25, &[(1.0, 0.35), (0.5, 0.8), (0.25, 0.35)]),
            veil: layers(24, &[(32.0, 0.7), (16.0, 0.4), (4.0, 0.2), (2.0, 0.12)]),
            slopes: [slope(1, 0), slope(0, 1)],
            open: openness(&relief.z_mm, (2.5 / cell) as usize),
        }
    }

    /// The rows of one band, which starts at row `first`.
    fn bake_band(&self, first: usize, out: &mut [u64], avx2: bool) {
        let mut work = RowWork::default();
        // With the rows above and below it, for the slopes.
        let mut bumps = vec![0f32; (BAND_ROWS + 2) * TEXELS];
        for (i, row) in bumps.chunks_exact_mut(TEXELS).enumerate() {
            self.bump_row((first + TEXELS + i - 1) % TEXELS, row, &mut work.scratch, avx2);
        }
        for (i, row) in out.chunks_exact_mut(TEXELS).enumerate() {
            self.texel_row(first + i, &bumps[i * TEXELS..][..3 * TEXELS], row, &mut work, avx2);
        }
    }

    /// Fine height in mm of one row of texels.
    fn bump_row(&self, y: usize, out: &mut [f32], scratch: &mut Vec<f32>, avx2: bool) {
        #[cfg(target_arch = "x86_64")]
        {
            // The same operations in the same order, on eight texels at once.
            #[target_feature(enable = "avx2")]
            fn with_avx2(skin: &Skin, y: usize, out: &mut [f32], scratch: &mut Vec<f32>) {
                skin.bump_row_body(y, out, scratch);
            }
            if avx2 {
                // SAFETY: the caller found AVX2 on this processor.
                unsafe { with_avx2(self, y, out, scratch) };
                return;
            }
        }
        let _ = avx2;
        self.bump_row_body(y, out, scratch);
    }

    #[inline(always)]
    fn bump_row_body(&self, y: usize, out: &mut [f32], scratch: &mut Vec<f32>) {
        self.grain.fill_row(y, out, scratch);
        let mut second = vec![0.0; TEXELS];
        Relief::upsample_row(&self.relief.second, y, &mut second);
        let mut net = vec![0.0; TEXELS];
        self.net.fill_row(y, &mut net, scratch);
        let vessels = &self.vessels[y * TEXELS..][..TEXELS];
        let (a, b) = (&self.palette.first, &self.palette.second);
        for x in 0..TEXELS {
            let vessel = f32::from(vessels[x]) * (1.0 / 255.0);
            let lobule = lobule(net[x]) * (a.lobules_mm + (b.lobules_mm - a.lobules_mm) * second[x]);
            out[x] =
                -(out[x] * (a.grain_mm + (b.grain_mm - a.grain_mm) * second[x]) + lobule + 0.035 * vessel * vessel);
        }
    }

    /// One row of texels from the fine heights of the row above it, the row itself and the row below.
    fn texel_row(&self, y: usize, bumps: &[f32], out: &mut [u64], work: &mut RowWork, avx2: bool) {
        #[cfg(target_arch = "x86_64")]
        {
            // The same operations in the same order, on eight texels at once.
            #[target_feature(enable = "avx2")]
            fn with_avx2(skin: &Skin, y: usize, bumps: &[f32], out: &mut [u64], work: &mut RowWork) {
                skin.texel_row_body(y, bumps, out, work);
            }
            if avx2 {
                // SAFETY: the caller found AVX2 on this processor.
                unsafe { with_avx2(self, y, bumps, out, work) };
                return;
            }
        }
        let _ = avx2;
        self.texel_row_body(y, bumps, out, work);
    }

    #[inline(always)]
    fn texel_row_body(&self, y: usize, bumps: &[f32], out: &mut [u64], work: &mut RowWork) {
        let RowWork { scratch, rows } = work;
        for row in rows.iter_mut() {
            row.resize(TEXELS, 0.0);
        }
        let [hue, mottle, net, veil, fleck, second, open, slope_x, slope_y] = rows;
        self.hue.fill_row(y, hue, scratch);
        self.mottle.fill_row(y, mottle, scratch);
        self.net.fill_row(y, net, scratch);
        self.veil.fill_row(y, veil, scratch);
        self.fleck.fill_row(y, fleck, scratch);
        Relief::upsample_row(&self.relief.second, y, second);
        Relief::upsample_row(&self.open, y, open);
        Relief::upsample_row(&self.slopes[0], y, slope_x);
        Relief::upsample_row(&self.slopes[1], y, slope_y);
        let line = |dy: usize| &bumps[dy * TEXELS..][..TEXELS];
        let (above, here, below) = (line(0), line(1), line(2));
        let half = 0.5 / self.texel_mm;
        let vessels = &self.vessels[y * TEXELS..][..TEXELS];
        // Slopes first, so that the loop over colours has no neighbours.
        for x in [0, TEXELS - 1] {
            slope_x[x] += (here[(x + 1) % TEXELS] - here[(x + TEXELS - 1) % TEXELS]) * half;
        }
        for (slope, near) in slope_x[1..].iter_mut().zip(here.windows(3)) {
            *slope += (near[2] - near[0]) * half;
        }
        for (slope, (above, below)) in slope_y.iter_mut().zip(above.iter().zip(below)) {
            *slope += (below - above) * half;
        }
        let noise = Noise { hue, mottle, net, veil, fleck };
        match self.scene {
            SceneKind::Box | SceneKind::Board => {
                self.colour_row::<true>(y, &noise, second, open, vessels, [slope_x, slope_y], out);
            }
            _ => self.colour_row::<false>(y, &noise, second, open, vessels, [slope_x, slope_y], out),
        }
    }

    /// Packed colours of a row. Only `PRINTED` scenes have marks; without them the loop has no branches.
    #[inline(always)]
    fn colour_row<const PRINTED: bool>(
        &self,
        y: usize,
        noise: &Noise<'_>,
        second: &[f32],
        open: &[f32],
        vessels: &[u8],
        slopes: [&[f32]; 2],
        out: &mut [u64],
    ) {
        let is_bare = self.palette.vessels.is_empty();
        let Noise { hue, mottle, net, veil, fleck } = noise;
        let (hue, mottle, net, veil) = (&hue[..TEXELS], &mottle[..TEXELS], &net[..TEXELS], &veil[..TEXELS]);
        let (fleck, second, open, vessels) = (&fleck[..TEXELS], &second[..TEXELS], &open[..TEXELS], &vessels[..TEXELS]);
        let [slope_x, slope_y] = slopes.map(|row| &row[..TEXELS]);
        let out = &mut out[..TEXELS];
        for x in 0..TEXELS {
            let vessel = f32::from(vessels[x]) * (1.0 / 255.0);
            let (mut colour, gloss) =
                self.colour::<PRINTED>(x, y, hue[x], mottle[x], net[x], veil[x], fleck[x], second[x], vessel);
            // Light reaches a hollow by way of its red walls.
            let open = open[x];
            let red = if is_bare { open } else { 0.35 + 0.65 * open };
            colour = [colour[0] * open, colour[1] * open, colour[2] * red];
            out[x] = pack(colour, gloss * open, slope_x[x], slope_y[x]);
        }
    }

    #[inline(always)]
    fn colour<const PRINTED: bool>(
        &self,
        x: usize,
        y: usize,
        hue: f32,
        mottle: f32,
        net: f32,
        veil: f32,
        fleck: f32,
        second: f32,
        vessel: f32,
    ) -> ([f32; 3], f32) {
        let p = &self.palette;
        let (a, b) = (&p.first, &p.second);
        // Fat comes in lobules: the border between the tissues is broken up by the mid-sized noise.
        let share = smoothstep(0.3, 0.7, second + 0.35 * hue * second * (1.0 - second) * 4.0);
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let mut colour: [f32; 3] = std::array::from_fn(|c| mix(a.colour[c], b.colour[c], share));
        let strength = mix(a.mottle, b.mottle, share);
        let tone = 1.0 + strength * (0.13 * mottle + 0.07 * hue);
        // Blood content moves green and blue more than red.
        let blood = if p.vessels.is_empty() { 0.0 } else { strength } * (0.10 * hue + 0.05 * net + 0.04 * mottle);
        colour = [colour[0] * (tone - blood), colour[1] * (tone - blood), colour[2] * (tone - 0.25 * blood)];
        // Petechiae and pale lobule centres: small round spots, darker or lighter.
        let spots = mix(a.flecks, b.flecks, share);
        let (dark, pale) = (spots * smoothstep(0.25, 1.5, fleck), spots * smoothstep(-0.25, -1.5, fleck));
        colour = [colour[0] * (1.0 - dark), colour[1] * (1.0 - dark), colour[2] * (1.0 - 0.55 * dark)];
        colour = [colour[0] + 0.22 * pale, colour[1] + 0.22 * pale, colour[2] + 0.22 * pale];
        let crease = share * b.lobules_mm * (1.0 - lobule(net));
        colour = [colour[0] * (1.0 - 0.9 * crease), colour[1] * (1.0 - 1.0 * crease), colour[2] * (1.0 - 0.5 * crease)];
        let white = [0.78, 0.82, 0.93];
        let film = p.membrane_share * smoothstep(0.35, 1.0, veil);
        colour = std::array::from_fn(|c| mix(colour[c], white[c], film));
        let capillary =
            p.capillary_share * smoothstep(0.08, 0.0, net.abs()) * smoothstep(-0.1, 0.5, hue) * (1.0 - 0.7 * share);
        let red = p.vessel_share * vessel * (1.0 - 0.35 * share) * (1.0 - 0.5 * film);
        let blush = capillary.max(red);
        colour = std::array::from_fn(|c| mix(colour[c], p.vessel[c], blush));
        let mut gloss = mix(a.gloss, b.gloss, share) * (0.75 + 0.25 * veil).clamp(0.3, 1.0);
        if !PRINTED {
            return (colour, gloss);
        }
        let place = |texel: usize| marks::centred(texel as f32 / TEXELS as f32, self.relief.period_mm);
        match self.scene {
            SceneKind::Box => {
                let ink = marks::box_ink(place(x), place(y), self.texel_mm);
                colour = colour.map(|c| mix(c, 0.10, ink));
            }
            SceneKind::Board => match boards::ink(self.board, place(x), place(y), self.texel_mm) {
                Some(ink) => colour = [mix(0.93, 0.12, ink); 3],
                None => {
                    colour = [0.35 + 0.05 * mottle, 0.42 + 0.05 * mottle, 0.40 + 0.05 * mottle];
                    gloss = 0.0;
                }
            },
            _ => {}
        }
        (colour, gloss)
    }
}

/// Openness of the surface at each node: 1 on ridges and planes, less in hollows. Computed from the depth below the mean of a square of `2 * radius +
/// 1` nodes, applied twice.
fn openness(z_mm: &[f32], radius: usize) -> Table<f32> {
    let mean_along = |plane: &[f32], step: usize, across: usize| {
        let mut out = Table::from(vec![0.0; NODES * NODES]);
        for line in 0..NODES {
            let at = |k: usize| line * across + (k % NODES) * step;
            let mut sum: f64 = (0..=2 * radius).map(|k| f64::from(plane[at(k + NODES - radius)])).sum();
            for k in 0..NODES {
                out[at(k)] = (sum / (2 * radius + 1) as f64) as f32;
                sum += f64::from(plane[at(k + radius + 1)]) - f64::from(plane[at(k + NODES - radius)]);
            }
        }
        out
    };
    let blur = |plane: &[f32]| mean_along(&mean_along(plane, 1, NODES), NODES, 1);
    let mean = blur(&blur(z_mm));
    z_mm.iter().zip(mean.iter()).map(|(z, mean)| 1.0 - 0.45 * smoothstep(0.0, 2.2, z - mean)).collect()
}

/// Round lobes between the zero lines of the noise, 0..1.
#[inline(always)]
fn lobule(net: f32) -> f32 {
    let v = 1.0 - (net.abs() * 1.5).min(1.0);
    1.0 - v * v
}

#[inline(always)]
fn pack(colour: [f32; 3], gloss: f32, slope_x: f32, slope_y: f32) -> u64 {
    // In 32 bits, which processors convert eight at a time.
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as i32 as u32;
    let word = |slope: f32| {
        let scaled = (slope + SLOPE_LIMIT) * (65535.0 / (2.0 * SLOPE_LIMIT));
        let v = (scaled + 0.5).clamp(0.0, 65535.0) as i32 as u32;
        (v >> 8) | (v & 0xff) << 8
    };
    let low = byte(colour[0]) | byte(colour[1]) << 8 | byte(colour[2]) << 16 | byte(gloss) << 24;
    u64::from(low) | u64::from(word(slope_x) | word(slope_y) << 16) << 32
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_imaging::Serial;

    #[test]
    fn every_processor_makes_the_same_texels() {
        for scene in [SceneKind::Bowel, SceneKind::Board] {
            let params = SceneParams { scene, seed: 5, ..SceneParams::default() };
            let relief = Arc::new(Relief::new(&params, &Serial));
            let [portable, fast] = [false, Simd::detect().avx2()].map(|avx2| {
                let mut texels = Texels { avx2, ..Texels::new(&params, &relief, &Serial) };
                texels.bake(f32::NEG_INFINITY, f32::INFINITY, &Serial);
                texels.map
            });
            assert!(portable == fast, "{scene:?}");
        }
    }

    #[test]
    fn rows_are_the_same_in_whatever_order_they_are_baked() {
        let params = SceneParams { scene: SceneKind::Liver, seed: 3, ..SceneParams::default() };
        let relief = Arc::new(Relief::new(&params, &Serial));
        let mut whole = Texels::new(&params, &relief, &Serial);
        whole.bake(f32::NAN, 0.0, &Serial);
        assert_eq!(whole.baked, u64::MAX);
        let mut parts = Texels::new(&params, &relief, &Serial);
        let period = relief.period_mm;
        // Below zero is the end of the period.
        for (from, to, bands) in [(-1.0, 0.5, 2), (0.0, 0.0, 2), (period + 0.1, period + 0.2, 2), (40.0, 45.0, 5)] {
            parts.bake(from, to, &Serial);
            assert_eq!(parts.baked.count_ones(), bands, "{from} to {to} mm");
        }
        for (i, (part, row)) in parts.map.chunks(TEXELS).zip(whole.map.chunks(TEXELS)).enumerate() {
            let is_baked = parts.baked >> (i / BAND_ROWS) & 1 == 1;
            assert!(if is_baked { part == row } else { part.iter().all(|&t| t == 0) }, "row {i}");
        }
    }
}
