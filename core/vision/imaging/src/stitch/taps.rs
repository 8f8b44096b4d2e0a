//! Coarse samples of the views on the canvas: the input of seam and exposure.

use super::drawing::Samples;
use super::exposure::OverlapLight;
use super::mesh::Mapping;
use super::seam::{BASE, BOTH, NEW, Seam};
use super::warp::{self, BLOCK, Block, Pixels, Span, UNIT_GAIN};
use crate::{Parallel, SharedMut, View};

/// Samples per seam cell, each way.
pub const TAPS: usize = 2;
/// Tap rows per chunk.
const ROWS: usize = 8;

/// Samples of one view: B, G, R, 0 each, without gain.
#[derive(Debug, Default)]
pub struct Taps {
    /// Samples per row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Covered samples per row.
    pub spans: Vec<Span>,
    /// Samples; those outside the spans are stale.
    pub values: Vec<[u8; 4]>,
    /// Position of each sample in the view, see [`Samples`].
    positions: Vec<[u32; 2]>,
}

/// Calls `each` with the index of the first sample of a block, the block, and the number of its samples, for all
/// samples that the view covers.
fn each_block<S: Default>(
    spans: &[Span],
    columns: usize,
    view: &View<u8>,
    source_from_tap: Mapping,
    pool: &dyn Parallel,
    avx2: bool,
    each: impl Fn(&mut S, usize, &Block, usize) + Sync,
) {
    pool.run(spans.len().div_ceil(ROWS), &|chunk| {
        let (mut block, mut work) = (Block::default(), S::default());
        for (y, span) in spans.iter().enumerate().skip(chunk * ROWS).take(ROWS) {
            let mut x = span.start as usize;
            while x < span.end as usize {
                let n = (span.end as usize - x).min(BLOCK);
                let size = (view.width, view.height, view.stride);
                source_from_tap.locate((x, y), size, n, &mut block, avx2);
                each(&mut work, y * columns + x, &block, n);
                x += n;
            }
        }
    });
}

impl Taps {
    /// Sets the grid and the geometry: `source_from_tap` maps sample indices to pixels of the view.
    pub fn place(&mut self, columns: usize, rows: usize, source_from_tap: Mapping, view: (usize, usize)) {
        (self.columns, self.rows) = (columns, rows);
        self.values.resize(columns * rows, [0; 4]);
        source_from_tap.coverage(view, columns, rows, &mut self.spans);
    }

    /// Samples the view.
    pub fn fill(&mut self, view: &View<u8>, source_from_tap: Mapping, pool: &dyn Parallel, avx2: bool) {
        let values = SharedMut::new(&mut self.values);
        let sample = |pixels: &mut Pixels, first: usize, block: &Block, n: usize| {
            warp::sample(view, block, n, &UNIT_GAIN, pixels, avx2);
            // SAFETY: rows are split between chunks.
            let out = unsafe { values.part(first, n) };
            for (o, p) in out.iter_mut().zip(pixels.0.as_chunks::<4>().0) {
                *o = *p;
            }
        };
        each_block(&self.spans, self.columns, view, source_from_tap, pool, avx2, sample);
    }

    /// Finds where [`Taps::fill`] would read a view of this size and stride. The result gets the samples.
    pub fn locate(
        &mut self,
        view: &View<u8>,
        source_from_tap: Mapping,
        pool: &dyn Parallel,
        avx2: bool,
    ) -> Samples<'_> {
        self.positions.clear();
        self.positions.resize(self.values.len(), [0; 2]);
        let positions = SharedMut::new(&mut self.positions);
        let keep = |_: &mut (), first: usize, block: &Block, n: usize| {
            // SAFETY: rows are split between chunks.
            let out = unsafe { positions.part(first, n) };
            for (out, position) in out.iter_mut().zip(block.offset.iter().zip(&block.weights)) {
                *out = [*position.0, *position.1];
            }
        };
        each_block(&self.spans, self.columns, view, source_from_tap, pool, avx2, keep);
        let size = (view.width, view.height);
        Samples { size, stride: view.stride, positions: &self.positions, values: &mut self.values }
    }
}

/// The images joined so far, as samples with gains applied; lane 3 is 255 where there is one.
#[derive(Debug, Default)]
pub struct Joined {
    values: Vec<[u8; 4]>,
}

fn gained(pixel: [u8; 4], gain: &[i16; 4]) -> [u8; 4] {
    let channel = |c: usize| ((i32::from(pixel[c]) * i32::from(gain[c]) + 8192) >> 14).min(255) as u8;
    [channel(0), channel(1), channel(2), 255]
}

impl Joined {
    /// Starts with the first view.
    pub fn start(&mut self, taps: &Taps, gain: &[i16; 4]) {
        self.values.clear();
        self.values.resize(taps.values.len(), [0; 4]);
        for (y, span) in taps.spans.iter().enumerate() {
            for x in span.start as usize..span.end as usize {
                self.values[y * taps.columns + x] = gained(taps.values[y * taps.columns + x], gain);
            }
        }
    }

    /// Light of the overlap in the joined images and in the view.
    pub fn light(&self, taps: &Taps) -> OverlapLight {
        let mut light = OverlapLight::default();
        // Two samples of a cell measure its brightness as well as four.
        for (y, span) in taps.spans.iter().enumerate().step_by(2) {
            let (start, end) = (span.start as usize, (span.end as usize).max(span.start as usize));
            for i in y * taps.columns + start..y * taps.columns + end {
                if self.values[i][3] == 255 {
                    light.add(self.values[i], taps.values[i]);
                }
            }
        }
        light
    }

    /// Fills class, cost and gradient of every cell of the seam grid.
    pub fn measure(&self, taps: &Taps, gain: &[i16; 4], seam: &mut Seam, pool: &dyn Parallel) {
        let (columns, cells) = (seam.columns, seam.columns * seam.rows);
        let class = SharedMut::new(&mut seam.class[..cells]);
        let cost = SharedMut::new(&mut seam.cost[..cells]);
        let gradient = SharedMut::new(&mut seam.gradient[..cells]);
        let rows = seam.rows;
        pool.run(rows.div_ceil(ROWS), &|chunk| {
            for cy in chunk * ROWS..(chunk * ROWS + ROWS).min(rows) {
                let at = cy * columns;
                // SAFETY: rows are split between chunks.
                let row = unsafe { (class.part(at, columns), cost.part(at, columns), gradient.part(at, columns)) };
                self.measure_row(taps, gain, cy, row);
            }
        });
    }

    fn measure_row(
        &self,
        taps: &Taps,
        gain: &[i16; 4],
        cy: usize,
        (classes, costs, gradients): (&mut [u8], &mut [f32], &mut [f32]),
    ) {
        let columns = taps.columns;
        for cx in 0..classes.len() {
            let (mut class, mut cost, mut gradient, mut count) = (0, 0.0f32, 0i32, 0);
            for y in cy * TAPS..cy * TAPS + TAPS {
                for x in cx * TAPS..cx * TAPS + TAPS {
                    let i = y * columns + x;
                    let base = self.values[i];
                    let covered = taps.spans[y].contains(x as u32);
                    class |= if base[3] == 255 { BASE } else { 0 } | if covered { NEW } else { 0 };
                    if base[3] != 255 || !covered {
                        continue;
                    }
                    let new = gained(taps.values[i], gain);
                    let square = |c: usize| (i32::from(base[c]) - i32::from(new[c])).pow(2);
                    cost += ((square(0) + square(1) + square(2)) as f32).sqrt();
                    count += 1;
                    if taps.spans[y].contains(x as u32 + 1) && self.values.get(i + 1).is_some_and(|v| v[3] == 255) {
                        let step = |a: u8, b: u8| (i32::from(a) - i32::from(b)).abs();
                        gradient +=
                            step(self.values[i + 1][1], base[1]) + step(taps.values[i + 1][1], taps.values[i][1]);
                    }
                }
            }
            classes[cx] = if count > 0 { BOTH } else { class.min(NEW) };
            // Euclidean over three channels, brought back to levels of one.
            costs[cx] = if count > 0 { cost / count as f32 * 0.577_350_26 } else { 0.0 };
            gradients[cx] = if count > 0 { gradient as f32 / (2 * count) as f32 } else { 0.0 };
        }
    }

    /// Adds the view where the seam shows it.
    pub fn add(&mut self, taps: &Taps, gain: &[i16; 4], seam: &Seam) {
        for (y, span) in taps.spans.iter().enumerate() {
            for x in span.start as usize..span.end as usize {
                let i = y * taps.columns + x;
                if self.values[i][3] != 255 || seam.take[y / TAPS * seam.columns + x / TAPS] == 1 {
                    self.values[i] = gained(taps.values[i], gain);
                }
            }
        }
    }
}
