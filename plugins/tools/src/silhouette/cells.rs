//! The part of an image around a box as cells, with colour and depth of each.

use std::ops::Range;

use panoscope_node::View;
use panoscope_node::pick::Grid;

/// Cues that distinguish an instrument from tissue; at least one of both is required.
#[derive(Clone, Copy)]
pub struct Cues<'a> {
    /// Width and height of the image, px.
    pub size: (usize, usize),
    /// The image: blue, green, red.
    pub picture: Option<View<'a, u8>>,
    /// A value proportional to 1/depth (disparity); NaN where unknown.
    pub nearness: Option<&'a dyn Nearness>,
}

/// A value proportional to 1/depth.
pub trait Nearness {
    /// Appends the values of a part of row `y`; NaN where unknown.
    fn extend_row(&self, y: usize, columns: Range<usize>, values: &mut Vec<f32>);
}

/// Margin around a box in which its instrument is searched: as a share of the box's sides, and the minimum, px.
const MARGIN: f32 = 0.15;
const MARGIN_PX: f32 = 6.0;
/// Maximum number of cells along the longer side of the region.
const MAX_CELLS: f32 = 128.0;
/// Minimum number of pixels that are read along each side of a large cell.
const SAMPLES: usize = 4;
/// Minimum number of cells of a region that can be segmented.
pub(super) const MIN_CELLS: usize = 64;
/// Brightness (sum of three channels) below which colour fades to gray.
const DARK: f32 = 36.0;
/// Number of classes of redness and of brightness for learned colours.
pub(super) const REDS: usize = 16;
pub(super) const BRIGHTS: usize = 8;
pub(super) const COLOURS: usize = REDS * BRIGHTS;

/// A region of the image as cells.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Region {
    pub(super) x_px: usize,
    pub(super) y_px: usize,
    /// Side of a cell, px.
    pub(super) pitch: usize,
    pub(super) width: usize,
    pub(super) height: usize,
    /// First and last cells of the box itself: left, top, right, bottom.
    pub(super) own: [usize; 4],
}

impl Region {
    pub(super) fn around([x0, y0, x1, y1]: [f32; 4], (width, height): (usize, usize)) -> Option<Self> {
        let all = [x0, y0, x1, y1];
        if !all.iter().all(|v| v.is_finite()) || x1 <= x0 || y1 <= y0 {
            return None;
        }
        let clip = |v: f32, most: usize| v.clamp(0.0, most as f32) as usize;
        let (dx, dy) = (((x1 - x0) * MARGIN).max(MARGIN_PX), ((y1 - y0) * MARGIN).max(MARGIN_PX));
        let (left, top) = (clip(x0 - dx, width), clip(y0 - dy, height));
        let (right, bottom) = (clip((x1 + dx).ceil(), width), clip((y1 + dy).ceil(), height));
        let pitch = ((right - left).max(bottom - top) as f32 / MAX_CELLS).ceil().max(1.0) as usize;
        let (columns, rows) = ((right - left) / pitch, (bottom - top) / pitch);
        if columns * rows < MIN_CELLS {
            return None;
        }
        let cell =
            |v: f32, from: usize, most: usize| (((v - from as f32) / pitch as f32).max(0.0) as usize).min(most - 1);
        let own = [cell(x0, left, columns), cell(y0, top, rows), cell(x1, left, columns), cell(y1, top, rows)];
        Some(Self { x_px: left, y_px: top, pitch, width: columns, height: rows, own })
    }
}

/// A region's cells; reuses its buffers.
#[derive(Debug, Default)]
pub(super) struct Cells {
    pub(super) region: Region,
    /// Per cell: redness (0 gray), brightness (0 to 1), nearness; NaN where unknown.
    pub(super) redness: Vec<f32>,
    pub(super) bright: Vec<f32>,
    pub(super) near: Vec<f32>,
    /// For each cell: class of its colour, see [`class_of`].
    pub(super) class: Vec<u8>,
    /// Work memory.
    values: Vec<f32>,
    colour_sums: Vec<[u32; 3]>,
    near_sums: Vec<[f32; 2]>,
}

impl Region {
    /// Spacing of the pixels of a cell that are read. Large cells are sampled: the mean of sixteen pixels is sufficient.
    fn step(&self) -> usize {
        (self.pitch / SAMPLES).max(1)
    }

    /// The pixels that are read.
    pub(super) fn pixels(&self) -> Grid {
        let along = |from: usize, cells: usize| -> Vec<u32> {
            let cells = (0..cells).map(|cell| from + cell * self.pitch);
            cells.flat_map(|from| (from..from + self.pitch).step_by(self.step())).map(|px| px as u32).collect()
        };
        Grid { columns: along(self.x_px, self.width), rows: along(self.y_px, self.height) }
    }
}

impl Cells {
    /// Reads the cells of a region.
    pub(super) fn sample(&mut self, region: Region, cues: &Cues<'_>) {
        self.region = region;
        let count = self.region.width * self.region.height;
        for plane in [&mut self.redness, &mut self.bright, &mut self.near] {
            plane.clear();
            plane.resize(count, f32::NAN);
        }
        for row in 0..self.region.height {
            if let Some(picture) = &cues.picture {
                self.sample_colours(picture, row);
            }
            if let Some(nearness) = cues.nearness {
                self.sample_nearness(nearness, row);
            }
        }
        self.class.clear();
        self.class.extend(self.redness.iter().zip(&self.bright).map(|(red, bright)| class_of(*red, *bright) as u8));
    }

    /// The pixel rows of a row of cells that are read, the pixel columns of all of them, and the step at which those are read.
    fn sampled(&self, row: usize) -> (impl Iterator<Item = usize> + use<>, Range<usize>, usize) {
        let Region { x_px, y_px, pitch, width, .. } = self.region;
        let step = self.region.step();
        let top = y_px + row * pitch;
        ((top..top + pitch).step_by(step), x_px..x_px + width * pitch, step)
    }

    /// Sets redness and brightness of a row of cells.
    fn sample_colours(&mut self, picture: &View<'_, u8>, row: usize) {
        let (rows, columns, step) = self.sampled(row);
        let Region { pitch, width, .. } = self.region;
        let pixels = |y: usize| &picture.row(y)[3 * columns.start..3 * columns.end];
        let cells = row * width..(row + 1) * width;
        let shades = self.redness[cells.clone()].iter_mut().zip(&mut self.bright[cells]);
        if pitch == 1 {
            for ((redness, bright), pixel) in shades.zip(pixels(self.region.y_px + row).as_chunks::<3>().0) {
                (*redness, *bright) = shade(pixel.map(f32::from));
            }
            return;
        }
        self.colour_sums.clear();
        self.colour_sums.resize(width, [0; 3]);
        for y in rows {
            for (sum, cell) in self.colour_sums.iter_mut().zip(pixels(y).chunks_exact(3 * pitch)) {
                for pixel in cell.as_chunks::<3>().0.iter().step_by(step) {
                    sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += u32::from(*value));
                }
            }
        }
        let count = pitch.div_ceil(step).pow(2) as f32;
        for ((redness, bright), sum) in shades.zip(&self.colour_sums) {
            (*redness, *bright) = shade(sum.map(|sum| sum as f32 / count));
        }
    }

    /// Sets the nearness of a row of cells.
    fn sample_nearness(&mut self, nearness: &dyn Nearness, row: usize) {
        let (rows, columns, step) = self.sampled(row);
        let Region { pitch, width, .. } = self.region;
        self.near_sums.clear();
        self.near_sums.resize(width, [0.0; 2]);
        for y in rows {
            self.values.clear();
            nearness.extend_row(y, columns.clone(), &mut self.values);
            for (sum, cell) in self.near_sums.iter_mut().zip(self.values.chunks_exact(pitch)) {
                for value in cell.iter().step_by(step).filter(|v| v.is_finite() && **v > 0.0) {
                    *sum = [sum[0] + value, sum[1] + 1.0];
                }
            }
        }
        // NaN where none is known.
        let near = &mut self.near[row * width..(row + 1) * width];
        near.iter_mut().zip(&self.near_sums).for_each(|(near, [sum, count])| *near = sum / count);
    }
}

/// Class of a colour: see [`REDS`] and [`BRIGHTS`].
pub(super) fn class_of(redness: f32, bright: f32) -> i32 {
    let red = ((redness + 0.2) / 0.8 * REDS as f32).clamp(0.0, REDS as f32 - 1.0) as i32;
    // Finer where it is dark.
    let bright = (bright.max(0.0).sqrt() * BRIGHTS as f32).min(BRIGHTS as f32 - 1.0) as i32;
    red * BRIGHTS as i32 + bright
}

/// Redness (0 gray) and brightness (0 to 1) of a colour: blue, green and red from 0 to 255.
pub(super) fn shade([b, g, r]: [f32; 3]) -> (f32, f32) {
    ((r - b) / (r + g + b + DARK), (r + g + b) / (3.0 * 255.0))
}
