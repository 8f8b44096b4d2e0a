//! The image of the mosaic: keyframes summed with weights that are largest at their centres.
//!
//! A pixel shows mostly the keyframe in which it is nearest to the middle, where light and lens are best; the steep
//! weights give a short transition between equally near keyframes. Sums do not depend on the order of drawing except
//! for rounding, so a keyframe can be added, and a rectangle redrawn, independently of the rest.

use super::picture::Picture;
use super::rim::Lit;
use crate::Rect;
use crate::geometry::{Homography, Point};
use crate::stitch::warp::{self, Block, Pixels, Span, UNIT_GAIN};
use crate::{Parallel, SharedMut, Simd, ViewMut};

/// Pixels that are weighted together.
const RUN: usize = 64;
/// Rows per chunk.
const ROWS: usize = 16;
/// Sums per pixel: blue, green, red, weight.
const LANES: usize = 4;
/// Minimum weight of a pixel inside a frame.
const MIN_WEIGHT: f32 = 1e-6;
/// Width of the transition around the newest frame, as a share of the frame's half side.
const LIVE_EDGE: f32 = 0.12;
/// Samples along each side of a frame for comparing exposures.
const GAIN_SAMPLES: usize = 32;
const MIN_SAMPLES: usize = 24;
/// Maximum ratio of the weights of a frame and of the mosaic where exposures are compared.
const GAIN_BAND: f32 = 4.0;
/// Range of gray levels that are used to measure exposure.
const GAIN_LEVELS: (f64, f64) = (12.0, 245.0);
/// Largest gain; the smallest is its inverse.
const MAX_GAIN: f64 = 1.6;
/// Share of a measured exposure difference that is compensated; less than 1, so that gains do not drift along a chain.
const GAIN_SHARE: f64 = 0.9;

/// The image and its sums.
#[derive(Clone, Debug)]
pub(super) struct Canvas {
    pub width: usize,
    pub height: usize,
    pub picture_from_mosaic: Homography,
    sums: Vec<f32>,
    bgr: Vec<u8>,
    spans: Vec<Span>,
    avx2: bool,
}

/// A frame to draw.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub picture: &'a Picture,
    pub mosaic_from_frame: Homography,
    /// Of full size.
    pub size: (usize, usize),
    pub gain: [f32; 3],
    /// What is lit of it, if it has a rim.
    pub lit: Option<&'a Lit>,
}

/// A frame at the size that suits the output, with its map.
struct Ready<'a> {
    view: crate::View<'a, u8>,
    source_from_picture: [f64; 9],
    gain: [i16; 4],
    lit: Option<&'a Lit>,
}

fn fixed(gain: [f32; 3]) -> [i16; 4] {
    std::array::from_fn(|c| gain.get(c).map_or(0, |g| (g * f32::from(UNIT_GAIN[0])).clamp(0.0, 32767.0) as i16))
}

/// Place in the frame, from 0 to 2 in both directions.
#[inline(always)]
fn place(m: &[f32; 6], i: f32, over: [f32; 2]) -> (f32, f32) {
    let scale = 1.0 / (m[4] + m[5] * i);
    ((m[0] + m[1] * i) * scale * over[0], (m[2] + m[3] * i) * scale * over[1])
}

/// Nearness of a place to the frame's middle, 1 in the middle and 0 at the border, in both directions.
#[inline(always)]
fn nearness((u, v): (f32, f32)) -> (f32, f32) {
    ((1.0 - (u - 1.0).abs()).max(0.0), (1.0 - (v - 1.0).abs()).max(0.0))
}

/// Weight of a pixel by its nearness to the middle in both directions, multiplied.
#[inline(always)]
fn weight_of(near: f32) -> f32 {
    let square = near * near;
    square * square * square + MIN_WEIGHT
}

impl Canvas {
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            picture_from_mosaic: Homography::identity(),
            sums: vec![0.0; width * height * LANES],
            bgr: vec![0; width * height * 3],
            spans: Vec::with_capacity(height),
            avx2: Simd::detect().avx2(),
        }
    }

    pub fn whole(&self) -> Rect {
        Rect::new(0, 0, self.width, self.height)
    }

    /// The part of the image within bounds of the mosaic: left, top, right, bottom.
    pub fn rect_of(&self, bounds: [f64; 4]) -> Rect {
        let [a, b] = [
            self.picture_from_mosaic.map([bounds[0], bounds[1]]),
            self.picture_from_mosaic.map([bounds[2], bounds[3]]),
        ];
        let low = |v: f64, most: usize| v.floor().clamp(0.0, most as f64) as usize;
        let high = |v: f64, most: usize| (v.ceil() + 1.0).clamp(0.0, most as f64) as usize;
        let (x, y) = (low(a[0], self.width), low(a[1], self.height));
        let (right, bottom) = (high(b[0], self.width), high(b[1], self.height));
        Rect::new(x, y, right.saturating_sub(x), bottom.saturating_sub(y))
    }

    /// Clears a part.
    pub fn clear(&mut self, part: Rect) {
        for y in part.y..part.y + part.height {
            let at = y * self.width + part.x;
            self.sums[at * LANES..(at + part.width) * LANES].fill(0.0);
            self.bgr[at * 3..(at + part.width) * 3].fill(0);
        }
    }

    fn ready<'a>(&self, source: &Source<'a>) -> Option<Ready<'a>> {
        let picture_from_frame = self.picture_from_mosaic.compose(&source.mosaic_from_frame);
        let middle = [(source.size.0 as f64 - 1.0) / 2.0, (source.size.1 as f64 - 1.0) / 2.0];
        let (view, level_from_frame) = source.picture.level(scale_at(&picture_from_frame, middle));
        let map = level_from_frame.compose(&picture_from_frame.inverse()?);
        // `coverage` needs a positive weight inside the frame.
        let weight = map.weight(picture_from_frame.map(middle));
        let sign = if weight < 0.0 { -1.0 } else { 1.0 };
        let source_from_picture = map.0.map(|v| v * sign);
        Some(Ready { view, source_from_picture, gain: fixed(source.gain), lit: source.lit })
    }

    /// Adds a frame to the sums, within a part of the image.
    pub fn add(&mut self, source: &Source<'_>, part: Rect, pool: &dyn Parallel) {
        let Some(ready) = self.ready(source) else { return };
        let size = (ready.view.width, ready.view.height);
        warp::coverage(&ready.source_from_picture, size, part.x + part.width, part.y + part.height, &mut self.spans);
        let (width, spans, avx2) = (self.width, &self.spans, self.avx2);
        let sums = SharedMut::new(&mut self.sums);
        pool.run(part.height.div_ceil(ROWS), &|chunk| {
            let (mut block, mut pixels) = (Block::default(), Pixels::default());
            let first = part.y + chunk * ROWS;
            for y in first..(first + ROWS).min(part.y + part.height) {
                let Some((start, end)) = clip(spans, y, part) else { continue };
                // SAFETY: each row belongs to one chunk.
                let row = unsafe { sums.part((y * width + start) * LANES, (end - start) * LANES) };
                for (index, out) in row.chunks_mut(RUN * LANES).enumerate() {
                    let (x, count) = (start + index * RUN, out.len() / LANES);
                    ready.sample(x, y, count, &mut block, &mut pixels, avx2);
                    let (m, over) = ready.along(x, y);
                    // Plain loops, which the compiler turns into vector code.
                    let weights: [f32; RUN] = match ready.lit {
                        None => std::array::from_fn(|i| {
                            let (a, b) = nearness(place(&m, i as f32, over));
                            weight_of(a * b)
                        }),
                        Some(lit) => std::array::from_fn(|i| {
                            let (u, v) = place(&m, i as f32, over);
                            lit.at(u, v).map_or(0.0, |(a, b)| weight_of(a * b))
                        }),
                    };
                    let pixels = pixels.0.as_chunks::<LANES>().0.iter().zip(&weights);
                    for (out, (pixel, weight)) in out.as_chunks_mut::<LANES>().0.iter_mut().zip(pixels) {
                        // The fourth byte of a pixel is 0: its position takes the weight itself.
                        let levels = [f32::from(pixel[0]), f32::from(pixel[1]), f32::from(pixel[2]), 1.0];
                        for lane in 0..LANES {
                            out[lane] += weight * levels[lane];
                        }
                    }
                }
            }
        });
    }

    /// Computes the image of a part from its sums.
    pub fn finish(&mut self, part: Rect, pool: &dyn Parallel) {
        let (width, sums) = (self.width, &self.sums);
        let bgr = SharedMut::new(&mut self.bgr);
        pool.run(part.height.div_ceil(ROWS), &|chunk| {
            let first = part.y + chunk * ROWS;
            for y in first..(first + ROWS).min(part.y + part.height) {
                let at = y * width + part.x;
                // SAFETY: each row belongs to one chunk.
                let row = unsafe { bgr.part(at * 3, part.width * 3) };
                let sums = sums[at * LANES..(at + part.width) * LANES].as_chunks::<LANES>().0;
                for (out, sum) in row.as_chunks_mut::<3>().0.iter_mut().zip(sums) {
                    let scale = if sum[3] > 0.0 { 1.0 / sum[3] } else { 0.0 };
                    for c in 0..3 {
                        out[c] = (sum[c] * scale + 0.5) as u8;
                    }
                }
            }
        });
    }

    /// Gains that match a frame's colours to the mosaic's where they overlap; 1 without overlap.
    pub fn gain_of(&self, source: &Source<'_>) -> [f32; 3] {
        let plain = Source { gain: [1.0; 3], ..*source };
        let Some(ready) = self.ready(&plain) else { return [1.0; 3] };
        let map = Homography(ready.source_from_picture);
        let Some(back) = map.inverse() else { return [1.0; 3] };
        let (mut own, mut shown, mut count) = ([0.0; 3], [0.0; 3], 0);
        for i in 0..GAIN_SAMPLES * GAIN_SAMPLES {
            let sample_at = |index: usize, side: usize| (2 * index + 1) * side / (2 * GAIN_SAMPLES);
            let (x, y) =
                (sample_at(i % GAIN_SAMPLES, ready.view.width), sample_at(i / GAIN_SAMPLES, ready.view.height));
            let [u, v] = back.map([x as f64, y as f64]).map(|value| value + 0.5);
            let inside = u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64;
            let at = if inside { v as usize * self.width + u as usize } else { continue };
            // Light falls off towards the border of a frame: only where the frame and what is shown are about equally near to their middles, along
            // the seam between them, do their levels measure exposure. Anything else would brighten a chain step by step.
            let place = |at: usize, side: usize| 2.0 * at as f32 / (side as f32 - 1.0);
            let (across, down) = (place(x, ready.view.width), place(y, ready.view.height));
            let near = match ready.lit {
                None => nearness((across, down)),
                Some(lit) => lit.at(across, down).unwrap_or_default(),
            };
            let own_weight = weight_of(near.0 * near.1);
            let ratio = self.sums[at * LANES + 3] / own_weight;
            if !(1.0 / GAIN_BAND..GAIN_BAND).contains(&ratio) {
                continue;
            }
            let (a, b) = (&ready.view.row(y)[3 * x..3 * x + 3], &self.bgr[at * 3..at * 3 + 3]);
            let is_useful =
                |p: &[u8]| p.iter().all(|&v| (f64::from(v) > GAIN_LEVELS.0) & (f64::from(v) < GAIN_LEVELS.1));
            if is_useful(a) && is_useful(b) {
                count += 1;
                for c in 0..3 {
                    own[c] += f64::from(a[c]);
                    shown[c] += f64::from(b[c]);
                }
            }
        }
        if count < MIN_SAMPLES {
            return [1.0; 3];
        }
        std::array::from_fn(|c| (shown[c] / own[c]).powf(GAIN_SHARE).clamp(1.0 / MAX_GAIN, MAX_GAIN) as f32)
    }

    /// Copies the image.
    pub fn copy(&self, out: &mut ViewMut<'_, u8>) {
        for (y, row) in self.bgr.chunks_exact(self.width * 3).enumerate() {
            out.row_mut(y).copy_from_slice(row);
        }
    }

    /// Draws a frame over a copy of the image, fading towards its border over existing pixels.
    pub fn draw_over(&mut self, source: &Source<'_>, out: &mut ViewMut<'_, u8>, pool: &dyn Parallel) {
        let Some(ready) = self.ready(source) else { return };
        let size = (ready.view.width, ready.view.height);
        warp::coverage(&ready.source_from_picture, size, self.width, self.height, &mut self.spans);
        let (width, height, spans, sums, avx2) = (self.width, self.height, &self.spans, &self.sums, self.avx2);
        let (stride, whole) = (out.stride, Rect::new(0, 0, width, height));
        let target = SharedMut::new(&mut *out.data);
        pool.run(height.div_ceil(ROWS), &|chunk| {
            let (mut block, mut pixels) = (Block::default(), Pixels::default());
            for y in chunk * ROWS..(chunk * ROWS + ROWS).min(height) {
                let Some((start, end)) = clip(spans, y, whole) else { continue };
                // SAFETY: each row belongs to one chunk.
                let row = unsafe { target.part(y * stride + start * 3, (end - start) * 3) };
                for (index, out) in row.chunks_mut(RUN * 3).enumerate() {
                    let (x, count) = (start + index * RUN, out.len() / 3);
                    ready.sample(x, y, count, &mut block, &mut pixels, avx2);
                    let (m, over) = ready.along(x, y);
                    let known = sums[(y * width + x) * LANES..].as_chunks::<LANES>().0;
                    let pixels = pixels.0.as_chunks::<4>().0.iter().zip(known);
                    for (i, (out, (pixel, known))) in out.as_chunks_mut::<3>().0.iter_mut().zip(pixels).enumerate() {
                        let (u, v) = place(&m, i as f32, over);
                        let near = ready.lit.map_or_else(|| Some(nearness((u, v))), |lit| lit.at(u, v));
                        let alpha = match near {
                            None => continue,
                            Some((a, b)) if known[3] > 0.0 => (a.min(b) * (1.0 / LIVE_EDGE)).min(1.0),
                            Some(_) => 1.0,
                        };
                        for c in 0..3 {
                            let below = f32::from(out[c]);
                            out[c] = (below + (f32::from(pixel[c]) - below) * alpha + 0.5) as u8;
                        }
                    }
                }
            }
        });
    }
}

impl Ready<'_> {
    fn sample(&self, x: usize, y: usize, count: usize, block: &mut Block, pixels: &mut Pixels, avx2: bool) {
        let v = &self.view;
        warp::locate(&self.source_from_picture, x, y, v.width, v.height, v.stride, count, block, avx2);
        warp::sample(v, block, count, &self.gain, pixels, avx2);
    }

    /// Position in the frame along a row, and the factor that scales it to 0..2.
    fn along(&self, x: usize, y: usize) -> ([f32; 6], [f32; 2]) {
        let m = &self.source_from_picture;
        let at = |r: usize| (m[r] * x as f64 + m[r + 1] * y as f64 + m[r + 2]) as f32;
        let over = |side: usize| 2.0 / (side as f32 - 1.0);
        ([at(0), m[0] as f32, at(3), m[3] as f32, at(6), m[6] as f32], [over(self.view.width), over(self.view.height)])
    }
}

/// Length of a pixel's side after a map, at a point.
pub(super) fn scale_at(map: &Homography, point: Point) -> f64 {
    let [x, y] = map.map(point);
    let ([x1, y1], [x2, y2]) = (map.map([point[0] + 1.0, point[1]]), map.map([point[0], point[1] + 1.0]));
    ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)).abs().sqrt()
}

/// Columns of a row that a frame covers within a part.
fn clip(spans: &[Span], y: usize, part: Rect) -> Option<(usize, usize)> {
    let span = spans.get(y)?;
    let (start, end) = ((span.start as usize).max(part.x), (span.end as usize).min(part.x + part.width));
    (start < end).then_some((start, end))
}
