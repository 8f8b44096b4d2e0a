//! Shading of wet tissue, the sensor model, and the loop over packets.

use panoscope_imaging::{SharedMut, ViewMut};

use super::cast::{Coarse, FAR_MM, Field, Rays, Station};
use super::lanes::{LANES, Lanes};
use super::lens::{Lens, TILE};
use super::material::{SLOPE_LIMIT, TEXELS};
use super::solid::{Entry, Part, add, dot};

/// Light and surface, the same for all cameras of a frame.
#[derive(Clone, Copy)]
pub struct Skin<'a> {
    /// Baked texels.
    pub texels: &'a [u64],
    /// Texels per mm.
    pub per_mm: f32,
    /// Strength of highlights.
    pub specular: f32,
    /// Irradiance at 1 mm.
    pub power: f32,
    /// Slope that breathing adds for one mm, sampled at nodes: plane of displacements and its gain.
    pub breath: &'a [f32],
    /// mm of breathing.
    pub breath_mm: f32,
    /// Nodes per mm.
    pub nodes_per_mm: f32,
}

/// The sensor of one camera in one frame.
#[derive(Clone, Copy)]
pub struct Sensor<'a> {
    /// Exposure times white balance: blue, green, red.
    pub gain: [f32; 3],
    /// Noise strength.
    pub noise: f32,
    /// Hash of seed, frame and camera.
    pub key: u32,
    /// Density of smoke at the corners of the coarse grid (rows of `grid_padded`), or empty.
    pub smoke: &'a [f32],
    /// Transparency of the lens for each pixel, 255 = clean; empty without drops.
    pub drops: &'a [u8],
}

/// Inputs for the rows of one image.
pub struct Picture<'a> {
    /// Rays.
    pub lens: &'a Lens,
    /// Sub-frames: the camera's position and the result of the coarse pass.
    pub stations: &'a [(Station, Coarse)],
    /// Surface.
    pub field: Field<'a>,
    /// Skin and light.
    pub skin: Skin<'a>,
    /// Sensor.
    pub sensor: Sensor<'a>,
}

/// Rays of the packet at `column`, `row`.
#[inline(always)]
pub fn packet_rays<L: Lanes>(lens: &Lens, station: &Station, column: usize, row: usize) -> Rays<L> {
    let (x, y) = if lens.distorted {
        let at = row * lens.padded + column * LANES;
        (load(&lens.x[at..]), load(&lens.y[at..]))
    } else {
        (load(&lens.x[column * LANES..]), L::splat(lens.y[row]))
    };
    Rays::new(station, x, y)
}

#[inline(always)]
fn load<L: Lanes>(values: &[f32]) -> L {
    match values.first_chunk::<LANES>() {
        Some(values) => L::load(values),
        None => L::splat(0.0),
    }
}

/// The eight channels of the map at eight points.
#[inline(always)]
fn texture<L: Lanes>(skin: &Skin, x: L, y: L) -> [L; LANES] {
    let scale = L::splat(skin.per_mm);
    let (tx, ty) = (x * scale, y * scale);
    let (fx, fy) = (tx.floor(), ty.floor());
    let (wx, wy) = ((tx - fx).store(), (ty - fy).store());
    let mask = L::u_splat(TEXELS as u32 - 1);
    let one = L::u_splat(1);
    let (ix, iy) = (L::u_and(fx.to_u32(), mask), fy.to_u32());
    let jx = L::u_and(L::u_add(ix, one), mask);
    let shift = TEXELS.trailing_zeros();
    let row = L::u_shl(L::u_and(iy, mask), shift);
    let below = L::u_shl(L::u_and(L::u_add(iy, one), mask), shift);
    let index = [
        L::u_store(L::u_add(row, ix)),
        L::u_store(L::u_add(row, jx)),
        L::u_store(L::u_add(below, ix)),
        L::u_store(L::u_add(below, jx)),
    ];
    // One length known to the compiler: masked indices need no bounds checks.
    let texels: &[u64; TEXELS * TEXELS] = match skin.texels.first_chunk() {
        Some(texels) => texels,
        None => return [L::splat(0.0); LANES],
    };
    let mut pixels = [L::splat(0.0); LANES];
    for lane in 0..LANES {
        let (u, v) = (L::splat(wx[lane]), L::splat(wy[lane]));
        let a = L::from_bytes(texels[index[0][lane] as usize & (TEXELS * TEXELS - 1)]);
        let b = L::from_bytes(texels[index[1][lane] as usize & (TEXELS * TEXELS - 1)]);
        let c = L::from_bytes(texels[index[2][lane] as usize & (TEXELS * TEXELS - 1)]);
        let d = L::from_bytes(texels[index[3][lane] as usize & (TEXELS * TEXELS - 1)]);
        let top = a + (b - a) * u;
        let bottom = c + (d - c) * u;
        pixels[lane] = top + (bottom - top) * v;
    }
    L::transpose(pixels)
}

/// Light (blue, green, red; 1 is a well-lit white) along eight rays.
#[inline(always)]
fn shade<L: Lanes>(picture: &Picture, station: &Station, rays: &Rays<L>, t: L) -> [L; 3] {
    let skin = &picture.skin;
    let [x, y, z] = rays.at(station, t);
    let [blue, green, red, gloss, sxh, sxl, syh, syl] = texture(skin, x, y);
    let unit = L::splat(2.0 * SLOPE_LIMIT / 65535.0);
    let offset = L::splat(SLOPE_LIMIT);
    let high = L::splat(256.0);
    let mut sx = (sxh * high + sxl) * unit - offset;
    let mut sy = (syh * high + syl) * unit - offset;
    if skin.breath_mm != 0.0 {
        let (bx, by) = breath_slope(skin, x.store()[0], y.store()[0]);
        sx = sx + L::splat(bx);
        sy = sy + L::splat(by);
    }
    let one = L::splat(1.0);
    let zero = L::splat(0.0);
    // Unnormalised: normal (sx, sy, -1), towards the light l, towards the buffers -d.
    let [lx, ly, lz] = [L::splat(station.light[0]) - x, L::splat(station.light[1]) - y, L::splat(station.light[2]) - z];
    let l2 = lx * lx + ly * ly + lz * lz;
    let inv_l = one / l2.sqrt();
    let inv_n = one / (sx * sx + sy * sy + one).sqrt();
    let [dx, dy, dz] = rays.d;
    let inv_d = one / (dx * dx + dy * dy + dz * dz).sqrt();
    let facing = (lx * sx + ly * sy - lz) * inv_l * inv_n;
    // The beam is brightest along the camera's axis.
    let [ax, ay, az] = [station.rotation[0][2], station.rotation[1][2], station.rotation[2][2]];
    let beam = (zero - (lx * L::splat(ax) + ly * L::splat(ay) + lz * L::splat(az)) * inv_l).max(zero);
    let beam2 = beam * beam;
    let light = L::splat(skin.power) * inv_l * inv_l * beam2 * beam2 * beam2;
    // Light that entered nearby leaves here: more so for red.
    let byte = L::splat(1.0 / 255.0);
    let (b, g, r) = (blue * byte, green * byte, red * byte);
    let mut colour =
        [b * b * wrap(facing, 0.10) * light, g * g * wrap(facing, 0.14) * light, r * r * wrap(facing, 0.30) * light];
    if skin.specular > 0.0 {
        let [hx, hy, hz] = [lx * inv_l - dx * inv_d, ly * inv_l - dy * inv_d, lz * inv_l - dz * inv_d];
        let inv_h = one / (hx * hx + hy * hy + hz * hz + L::splat(1e-12)).sqrt();
        let mirror = ((hx * sx + hy * sy - hz) * inv_h * inv_n).max(zero);
        let p2 = mirror * mirror;
        let p4 = p2 * p2;
        let p8 = p4 * p4;
        let p16 = p8 * p8;
        let p32 = p16 * p16;
        let p128 = p32 * p32 * p32 * p32;
        let p256 = p128 * p128;
        let p512 = p256 * p256;
        let p1280 = p512 * p512 * p256;
        let strength = gloss * L::splat(skin.specular / 255.0) * light;
        let shine = strength * (L::splat(0.012) * p16 + L::splat(5.0) * p1280);
        colour = [colour[0] + shine, colour[1] + shine, colour[2] + shine];
    }
    colour
}

/// Cosine law for a translucent surface: `(cos + w) / (1 + w)`, not below 0.
#[inline(always)]
fn wrap<L: Lanes>(facing: L, w: f32) -> L {
    ((facing + L::splat(w)) * L::splat(1.0 / (1.0 + w))).max(L::splat(0.0))
}

/// Slope of breathing near one point; it varies over centimetres, so one value serves a packet.
#[inline(always)]
fn breath_slope(skin: &Skin, x: f32, y: f32) -> (f32, f32) {
    const N: usize = super::relief::NODES;
    let (ix, iy) = ((x * skin.nodes_per_mm).floor() as i32 as usize, (y * skin.nodes_per_mm).floor() as i32 as usize);
    let (row, below) = ((iy & (N - 1)) * N, (iy.wrapping_add(1) & (N - 1)) * N);
    let (column, right) = (ix & (N - 1), ix.wrapping_add(1) & (N - 1));
    let here = skin.breath[row + column];
    let gain = skin.breath_mm * skin.nodes_per_mm;
    ((skin.breath[row + right] - here) * gain, (skin.breath[below + column] - here) * gain)
}

/// Sum of four bytes of a hash: approximately normal; mean 510, standard deviation 147.8.
#[inline(always)]
fn bell<L: Lanes>(h: L::U) -> L {
    let even = L::u_splat(0x00ff_00ff);
    let pairs = L::u_add(L::u_and(h, even), L::u_and(L::u_shr::<8>(h), even));
    let sum = L::u_and(L::u_add(pairs, L::u_shr::<16>(pairs)), L::u_splat(0xffff));
    (L::from_i32(sum) - L::splat(510.0)) * L::splat(1.0 / 147.8)
}

/// Tone curve: linear in the shadows, a shoulder to white at about 3, then a square root; 0 to 255 and above.
#[inline(always)]
fn tone<L: Lanes>(light: L, gain: f32) -> L {
    let v = light * L::splat(gain);
    let one = L::splat(1.0);
    let bent = v * (one + v * L::splat(0.2)) / (one + v * L::splat(0.53));
    bent.sqrt() * L::splat(255.0)
}

/// Converts light to bytes: knee, square-root curve, shot and read noise.
#[inline(always)]
fn expose<L: Lanes>(sensor: &Sensor, light: [L; 3], pixel: u32, out: &mut [u8; 24]) {
    let mut value = [tone(light[0], sensor.gain[0]), tone(light[1], sensor.gain[1]), tone(light[2], sensor.gain[2])];
    if sensor.noise > 0.0 {
        // Shot noise is even after a square root; read noise shows in the dark.
        let mut h = L::u_xor(L::u_ramp(pixel), L::u_splat(sensor.key));
        h = L::u_mul(L::u_xor(h, L::u_shr::<16>(h)), L::u_splat(0x7feb_352d));
        h = L::u_xor(h, L::u_shr::<15>(h));
        for (value, word) in value.iter_mut().zip([0x846c_a68b, 0x9e37_79b1, 0xc2b2_ae3d]) {
            let m = L::u_mul(h, L::u_splat(word));
            let n = bell::<L>(L::u_xor(m, L::u_shr::<16>(m)));
            let spread = L::splat(1.1) + L::splat(24.0) / (*value + L::splat(12.0));
            *value = *value + n * spread * L::splat(sensor.noise);
        }
    }
    L::pack_bgr(value[0].clamp(0.0, 255.0), value[1].clamp(0.0, 255.0), value[2].clamp(0.0, 255.0), out);
}

/// Replaces the tissue where an instrument is in front of it.
#[inline(never)]
fn solids(
    picture: &Picture,
    coarse: &Coarse,
    tile: usize,
    column: usize,
    row: usize,
    depth: &[f32; LANES],
    seen: &mut [[f32; LANES]; 3],
) {
    for lane in 0..LANES {
        let [x, y] = picture.lens.ray(column * LANES + lane, row);
        if let Some((entry, part)) = coarse.first_part(tile, x, y)
            && (entry.t as f32) < depth[lane]
        {
            let colour = steel(&picture.skin, coarse, [f64::from(x), f64::from(y), 1.0], &entry, part);
            (seen[0][lane], seen[1][lane], seen[2][lane]) = (colour[0], colour[1], colour[2]);
        }
    }
}

/// Light that an instrument reflects: plastic like tissue, steel mostly as a mirror of the red cavity and of the light.
fn steel(skin: &Skin, coarse: &Coarse, d: [f64; 3], entry: &Entry, part: &Part) -> [f32; 3] {
    let unit = |v: [f64; 3]| {
        let inv = 1.0 / dot(v, v).sqrt().max(1e-12);
        v.map(|c| c * inv)
    };
    let place = d.map(|v| v * entry.t);
    let to_light = add(coarse.light, place, -1.0);
    let square = dot(to_light, to_light).max(25.0);
    let (n, l, view) = (unit(entry.normal), unit(to_light), unit(d));
    let beam = (-l[2]).max(0.0);
    let beam2 = beam * beam;
    let light = f64::from(skin.power) / square * beam2 * beam2 * beam2;
    let facing = dot(n, l).max(0.0);
    let mirrored = add(view, n, -2.0 * dot(view, n));
    let gleam = dot(mirrored, l).max(0.0);
    let (g4, g2) = (gleam * gleam * gleam * gleam, gleam * gleam);
    let (g16, metal) = (g4 * g4 * g4 * g4, f64::from(part.paint.metal));
    let g64 = g16 * g16 * g16 * g16;
    // What a mirror shows: lit tissue ahead, darkness behind the scope.
    let ahead = 0.5 + 0.5 * mirrored[2];
    let ahead = 0.12 + 0.88 * ahead * ahead;
    let shine = f64::from(skin.specular)
        * light
        * (metal * (0.05 * g4 + 0.16 * g16 + 1.2 * g64) + (1.0 - metal) * 0.5 * g64 * g2);
    let room = f64::from(skin.power) / (dot(place, place) + 400.0);
    [0, 1, 2].map(|c| {
        let albedo = f64::from(part.paint.albedo[c]);
        let tissue = [0.060, 0.062, 0.095][c];
        let matt = albedo * light * facing * (1.0 - 0.86 * metal) + albedo * room * 0.02;
        (matt + metal * albedo * tissue * ahead * room + shine) as f32
    })
}

/// Draws rows `first..last`.
#[inline(always)]
fn rows<L: Lanes>(picture: &Picture, first: usize, out: &mut ViewMut<u8>) {
    let lens = picture.lens;
    let share = L::splat(1.0 / picture.stations.len() as f32);
    let sensor = &picture.sensor;
    for line in 0..out.height {
        let row = first + line;
        let pixels = out.row_mut(line);
        for column in 0..lens.padded / LANES {
            let mut light = [L::splat(0.0); 3];
            for (station, coarse) in picture.stations {
                let rays = packet_rays::<L>(lens, station, column, row);
                let t = picture.field.packet(station, &rays, lens, coarse, column, row);
                let seen = shade(picture, station, &rays, t);
                let limit = L::splat(FAR_MM * 0.99);
                let mut seen = [
                    L::select_lt(t, limit, seen[0], L::splat(0.0)),
                    L::select_lt(t, limit, seen[1], L::splat(0.0)),
                    L::select_lt(t, limit, seen[2], L::splat(0.0)),
                ];
                let tile = row / TILE * (lens.grid_width - 1) + column;
                if coarse.part_masks.get(tile).is_some_and(|&mask| mask != 0) {
                    let mut lanes = [seen[0].store(), seen[1].store(), seen[2].store()];
                    solids(picture, coarse, tile, column, row, &t.store(), &mut lanes);
                    seen = [L::load(&lanes[0]), L::load(&lanes[1]), L::load(&lanes[2])];
                }
                for (sum, value) in light.iter_mut().zip(seen) {
                    *sum = *sum + value * share;
                }
            }
            if !sensor.smoke.is_empty() {
                let density = corner_lerp::<L>(lens, sensor.smoke, column, row);
                for (value, grey) in light.iter_mut().zip([0.52, 0.50, 0.50]) {
                    *value = *value + (L::splat(grey) - *value) * density;
                }
            }
            if let Some(clear) = sensor.drops.get(row * lens.padded + column * LANES..).and_then(|d| d.first_chunk()) {
                let clear = L::from_bytes(u64::from_le_bytes(*clear)) * L::splat(1.0 / 255.0);
                let stain = L::splat(1.0) - clear;
                light = [light[0] * clear * clear, light[1] * clear * clear, light[2] * clear + stain * L::splat(0.06)];
            }
            let mut bytes = [0; 24];
            expose(sensor, light, (row * lens.padded + column * LANES) as u32, &mut bytes);
            let at = column * 24;
            let keep = (pixels.len() - at).min(24);
            pixels[at..at + keep].copy_from_slice(&bytes[..keep]);
        }
    }
}

/// Interpolates corner values over a packet.
#[inline(always)]
fn corner_lerp<L: Lanes>(lens: &Lens, corners: &[f32], column: usize, row: usize) -> L {
    let v = (row % TILE) as f32 * (1.0 / TILE as f32);
    let top = &corners[row / TILE * lens.grid_padded + column..][..2];
    let below = &corners[(row / TILE + 1) * lens.grid_padded + column..][..2];
    let (left, right) = (top[0] + (below[0] - top[0]) * v, top[1] + (below[1] - top[1]) * v);
    L::splat(left) + L::splat(right - left) * L::load(&[0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875])
}

/// Depths along the axis of rows `first..`, mm; NaN where a ray hits nothing.
#[inline(always)]
fn depth_rows<L: Lanes>(field: &Field, lens: &Lens, station: &Station, coarse: &Coarse, first: usize, out: &mut [f32]) {
    for (line, pixels) in out.chunks_exact_mut(lens.width).enumerate() {
        let row = first + line;
        for column in 0..lens.padded / LANES {
            let rays = packet_rays::<L>(lens, station, column, row);
            let t = field.packet(station, &rays, lens, coarse, column, row);
            let hit = field.hit_mask(station, &rays, t);
            let values = t.store();
            let tile = row / TILE * (lens.grid_width - 1) + column;
            let solid = coarse.part_masks.get(tile).is_some_and(|&mask| mask != 0);
            for (lane, pixel) in pixels[column * LANES..].iter_mut().take(LANES).enumerate() {
                *pixel = if hit >> lane & 1 == 1 { values[lane] } else { f32::NAN };
                if solid {
                    let [x, y] = lens.ray(column * LANES + lane, row);
                    let entry = coarse.first_part(tile, x, y).map_or(f32::NAN, |(entry, _)| entry.t as f32);
                    *pixel = pixel.min(entry);
                }
            }
        }
    }
}

/// The kernels for one kind of lanes, each entered once per chunk.
macro_rules! entries {
    ($lanes:ty, $(#[$attribute:meta])*) => {
        use super::*;
        use crate::render::cast::{Tile, classify_row, corner_row};

        /// Colours of the rows of `out`, which starts at row `first`.
        $(#[$attribute])*
        pub fn colour(picture: &Picture, first: usize, out: &mut ViewMut<u8>) {
            rows::<$lanes>(picture, first, out);
        }
        /// Depths of rows.
        $(#[$attribute])*
        pub fn depth(field: &Field, lens: &Lens, station: &Station, coarse: &Coarse, first: usize, out: &mut [f32]) {
            depth_rows::<$lanes>(field, lens, station, coarse, first, out);
        }
        /// Depths of one row of corners.
        $(#[$attribute])*
        pub fn corners(field: &Field, station: &Station, lens: &Lens, row: usize, out: &mut [f32]) {
            corner_row::<$lanes>(field, station, lens, row, out);
        }
        /// Which tiles of a row are smooth.
        $(#[$attribute])*
        pub fn classify(field: &Field, station: &Station, lens: &Lens, depth: &[f32], row: usize, tiles: &mut [Tile]) {
            classify_row(field, station, lens, depth, row, tiles);
        }
        /// First hits of eight rays given by normalised camera coordinates, starting from depth `start` where that is in front of the surface.
        $(#[$attribute])*
        pub fn first_hits(field: &Field, station: &Station, x: &[f32; LANES], y: &[f32; LANES], start: f32) -> [f32; LANES] {
            let rays = Rays::<$lanes>::new(station, <$lanes>::load(x), <$lanes>::load(y));
            let tile = Tile { start_mm: start, slope: field.max_slope };
            let (start, slope) = field.safe_start(station, &rays, tile);
            field.march(station, &rays, start, slope).store()
        }
    };
}

/// Kernels on arrays.
pub mod portable {
    entries!(crate::render::lanes::Portable,);
}

/// Kernels on AVX2 registers; call them only if AVX2 was detected.
#[cfg(target_arch = "x86_64")]
pub mod avx2 {
    entries!(crate::render::lanes::Avx2, #[target_feature(enable = "avx2")]);
}

/// Rows of an image as a view, for chunks that write disjoint rows of one image.
///
/// # Safety
/// No two parts that are alive at the same time may share rows.
pub unsafe fn rows_of<'a>(
    shared: &SharedMut<'a, u8>,
    stride: usize,
    width: usize,
    first: usize,
    count: usize,
) -> ViewMut<'a, u8> {
    // SAFETY: rows first..first + count, without the last one's padding; disjointness is the caller's promise.
    let data = unsafe { shared.part(first * stride, (count - 1) * stride + width * 3) };
    ViewMut::with_stride(data, width, count, 3, stride)
}
