//! One image cut into two overlapping views, like the views of two cameras: images of real tissue with a true
//! homography.
//!
//! The left view is an unchanged part of the image. The right view shows the other side of it with a slowly changing
//! perspective, darker and tinted. Both have independent noise. All randomness is derived from a seed and the number of
//! the frame.

use std::f64::consts::TAU;
use std::fmt;

use super::warp::{self, BLOCK, Block, Pixels};
use crate::geometry::{Homography, Point};
use crate::{Parallel, SharedMut, Simd, View, ViewMut};
use panoscope_base::random::{SplitMix64, mix, unit};

/// Rows per chunk.
const ROWS: usize = 16;

/// Parameters of the cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutParams {
    /// Share of a view's width that the other view shows too, 0.1..=0.9.
    pub overlap: f64,
    /// Maximum inward displacement of each corner of the right view, px.
    pub perspective_px: f64,
    /// Amplitude of each corner's movement around its position, px.
    pub sway_px: f64,
    /// Period of the movement, frames.
    pub sway_frames: f64,
    /// Exposure of the right view relative to the left one.
    pub right_exposure: f32,
    /// Standard deviation of the noise of each view, levels.
    pub noise_levels: f32,
    /// Seed of corners, sway and noise.
    pub seed: u64,
}

impl Default for CutParams {
    fn default() -> Self {
        Self {
            overlap: 0.5,
            perspective_px: 12.0,
            sway_px: 2.0,
            sway_frames: 60.0,
            right_exposure: 0.9,
            noise_levels: 2.0,
            seed: 7,
        }
    }
}

/// An image that cannot be cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CutError {
    /// The image is too small for the margins.
    TooSmall {
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
        /// Margin for perspective and movement at each side.
        margin_px: usize,
    },
    /// An image is not BGR, or an output has the wrong size.
    Picture {
        /// The image, as the message names it.
        which: &'static str,
        /// Columns wanted.
        width: usize,
        /// Rows wanted.
        height: usize,
    },
}

impl fmt::Display for CutError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooSmall { width, height, margin_px } => write!(
                f,
                "a picture of {width}x{height} px is too small to be cut: with {margin_px} px drawn in from each side 64x64 px must be left for each view"
            ),
            Self::Picture { which, width, height } => write!(f, "the {which} must be BGR of {width}x{height} px"),
        }
    }
}

impl std::error::Error for CutError {}

/// Positions of the views of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutGeometry {
    /// Columns and rows of each view.
    pub size: (usize, usize),
    /// Column and row of the image at which the left view begins.
    pub left_at: (usize, usize),
    /// Maps pixels of the right view to pixels of the image.
    pub picture_from_right: Homography,
    /// Maps pixels of the right view to those of the left view.
    pub left_from_right: Homography,
}

/// The views of frame `frame` of an image of this size.
///
/// # Errors
/// When too little is left.
pub fn geometry(params: &CutParams, size: (usize, usize), frame: u64) -> Result<CutGeometry, CutError> {
    let margin = (params.perspective_px.max(0.0) / 2.0 + params.sway_px.max(0.0)).ceil() as usize + 1;
    let width = (size.0 as f64 / (2.0 - params.overlap.clamp(0.1, 0.9))).round() as usize;
    let (left, error) = (width.min(size.0), CutError::TooSmall { width: size.0, height: size.1, margin_px: margin });
    let height = size.1.checked_sub(2 * margin).filter(|h| *h >= 64).ok_or(error)?;
    let view = left.checked_sub(margin).filter(|w| *w >= 64).ok_or(error)?;
    let (right_x, last) = (size.0 - margin - view, [view as f64 - 1.0, height as f64 - 1.0]);
    let corner = |index: u64| -> Point {
        let (right, lower) = (index % 2 == 1, index / 2 == 1);
        let at = [if right { last[0] } else { 0.0 }, if lower { last[1] } else { 0.0 }];
        let drawn = |axis: u64| (unit(params.seed ^ (index * 4 + axis) << 40) - 0.5) * params.perspective_px;
        let sway = |axis: u64| {
            let phase = unit(params.seed ^ (index * 4 + 2 + axis) << 40);
            params.sway_px * (TAU * (frame as f64 / params.sway_frames.max(1.0) + phase)).sin()
        };
        [right_x as f64 + at[0] + drawn(0) + sway(0), margin as f64 + at[1] + drawn(1) + sway(1)]
    };
    let from = [[0.0, 0.0], [last[0], 0.0], [0.0, last[1]], last];
    let to: [Point; 4] = std::array::from_fn(|index| corner(index as u64));
    let picture_from_right = Homography::fit(&from, &to, |_| true).ok_or(error)?;
    let left_at = (0, margin);
    let shift = Homography::translation(-(left_at.0 as f64), -(left_at.1 as f64));
    let left_from_right = shift.compose(&picture_from_right).normalized();
    Ok(CutGeometry { size: (view, height), left_at, picture_from_right, left_from_right })
}

/// Draws both views of a frame; `geometry` is what [`geometry`] gave for the image's size.
///
/// # Errors
/// When an image is not BGR or has another size.
pub fn draw(
    params: &CutParams,
    geometry: &CutGeometry,
    frame: u64,
    picture: View<'_, u8>,
    pool: &dyn Parallel,
    left: &mut ViewMut<'_, u8>,
    right: &mut ViewMut<'_, u8>,
) -> Result<(), CutError> {
    let (width, height) = geometry.size;
    let (x, y) = geometry.left_at;
    if picture.channels != 3 || picture.width < x + width || picture.height < y + height {
        return Err(CutError::Picture { which: "picture", width: x + width, height: y + height });
    }
    for (which, view) in [("left view", &*left), ("right view", &*right)] {
        if (view.width, view.height, view.channels) != (width, height, 3) {
            return Err(CutError::Picture { which, width, height });
        }
    }
    let avx2 = Simd::detect().avx2();
    // A warmer tint, as the phantom's right camera has.
    let gain = [0.97, 1.0, 1.03].map(|tint| ((params.right_exposure * tint).clamp(0.0, 1.99) * 16384.0) as i16);
    let gain = [gain[0], gain[1], gain[2], 0];
    let noise = |side: u64, row: usize| Noise::new(params, side, frame, row);
    let (strides, chunks) = ([left.stride, right.stride], height.div_ceil(ROWS));
    let (to_left, to_right) = (SharedMut::new(&mut *left.data), SharedMut::new(&mut *right.data));
    let map = geometry.picture_from_right.0;
    pool.run(chunks, &|chunk| {
        let (mut block, mut pixels) = (Block::default(), Pixels::default());
        for row in chunk * ROWS..(chunk * ROWS + ROWS).min(height) {
            // SAFETY: rows are split between chunks.
            let (l, r) =
                unsafe { (to_left.part(row * strides[0], 3 * width), to_right.part(row * strides[1], 3 * width)) };
            l.copy_from_slice(&picture.row(y + row)[3 * x..3 * (x + width)]);
            noise(0, row).add(l);
            for start in (0..width).step_by(BLOCK) {
                let count = (width - start).min(BLOCK);
                let size = (picture.width, picture.height, picture.stride);
                warp::locate(&map, start, row, size.0, size.1, size.2, count, &mut block, avx2);
                warp::sample(&picture, &block, count, &gain, &mut pixels, avx2);
                warp::pack_bgr(&pixels, &mut r[3 * start..3 * (start + count)], avx2);
            }
            noise(1, row).add(r);
        }
    });
    Ok(())
}

/// Noise of one row: sums of four bytes, nearly normal.
struct Noise {
    random: SplitMix64,
    scale: f32,
}

impl Noise {
    fn new(params: &CutParams, side: u64, frame: u64, row: usize) -> Self {
        let random = SplitMix64(mix(params.seed ^ mix(frame << 1 ^ side) ^ (row as u64) << 32));
        // Four bytes have a deviation of 147.8.
        Self { random, scale: params.noise_levels.clamp(0.0, 64.0) / 147.8 }
    }

    fn add(mut self, row: &mut [u8]) {
        if self.scale == 0.0 {
            return;
        }
        for pair in row.chunks_mut(2) {
            let bytes = self.random.bits().to_le_bytes();
            for (value, four) in pair.iter_mut().zip(bytes.as_chunks::<4>().0) {
                let sum: i32 = four.iter().map(|b| i32::from(*b)).sum();
                *value = (f32::from(*value) + (sum - 510) as f32 * self.scale + 0.5).clamp(0.0, 255.0) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Serial;

    const SIZE: (usize, usize) = (400, 260);

    fn picture() -> Vec<u8> {
        (0..SIZE.0 * SIZE.1)
            .flat_map(|i| {
                let (x, y) = ((i % SIZE.0) as f32, (i / SIZE.0) as f32);
                let wave = |a: f32, b: f32| (128.0 + 60.0 * (x * a).sin() * (y * b).cos()) as u8;
                [wave(0.05, 0.07), wave(0.04, 0.03), wave(0.06, 0.05)]
            })
            .collect()
    }

    #[test]
    fn views_show_the_picture_where_the_homography_says() {
        let params = CutParams { noise_levels: 0.0, right_exposure: 1.0, ..CutParams::default() };
        let bgr = picture();
        let cut = geometry(&params, SIZE, 11).unwrap();
        let (width, height) = cut.size;
        let (mut left, mut right) = (vec![0; 3 * width * height], vec![0; 3 * width * height]);
        let views = (&mut ViewMut::new(&mut left, width, height, 3), &mut ViewMut::new(&mut right, width, height, 3));
        draw(&params, &cut, 11, View::new(&bgr, SIZE.0, SIZE.1, 3), &Serial, views.0, views.1).unwrap();
        let mut compared = 0;
        for y in (0..height).step_by(7) {
            for x in (0..width).step_by(7) {
                let [u, v] = cut.left_from_right.map([x as f64, y as f64]);
                if u < 0.0 || v < 0.0 || u > width as f64 - 1.0 || v > height as f64 - 1.0 {
                    continue;
                }
                compared += 1;
                let at = 3 * (v.round() as usize * width + u.round() as usize) + 1;
                let (a, b) = (f32::from(left[at]), f32::from(right[3 * (y * width + x) + 1]));
                assert!((a - b).abs() < 4.0, "{x} {y}: {a} {b}");
            }
        }
        assert!(compared > 100, "{compared}");
    }

    #[test]
    fn frames_differ_and_repeat() {
        let params = CutParams::default();
        let bgr = picture();
        let draw_frame = |frame: u64| {
            let cut = geometry(&params, SIZE, frame).unwrap();
            let (width, height) = cut.size;
            let (mut left, mut right) = (vec![0; 3 * width * height], vec![0; 3 * width * height]);
            let (l, r) =
                (&mut ViewMut::new(&mut left, width, height, 3), &mut ViewMut::new(&mut right, width, height, 3));
            draw(&params, &cut, frame, View::new(&bgr, SIZE.0, SIZE.1, 3), &Serial, l, r).unwrap();
            (left, right, cut)
        };
        assert_eq!(draw_frame(3), draw_frame(3));
        assert_ne!(draw_frame(3).0, draw_frame(4).0);
        assert_ne!(draw_frame(3).2.left_from_right, draw_frame(4).2.left_from_right);
    }

    #[test]
    fn small_pictures_are_refused() {
        let error = geometry(&CutParams::default(), (90, 400), 0).unwrap_err();
        assert!(error.to_string().contains("90x400"), "{error}");
    }
}
