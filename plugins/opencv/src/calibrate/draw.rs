//! Pictures that show how good a calibration is: corners found, their coverage, rows after rectification.

use panoscope_data::calibration::packet;
use panoscope_imaging::draw::{Color, cross, fill_circle, fill_rectangle, line, text};
use panoscope_imaging::stereo::{RemapTable, StereoError};
use panoscope_imaging::{Parallel, Rect, View, ViewMut};
use panoscope_node::abi::Calibration;

use super::grid::Points;
use super::solution::Pair;
use super::solve::rectified_px;

/// Columns and rows of the coverage's cells.
pub const CELLS: (usize, usize) = (8, 6);
const WHITE: Color = [255, 255, 255];
const GREEN: Color = [90, 220, 90];

/// The part of a picture for one side of a pair side by side.
fn half<'a>(out: &'a mut ViewMut<'_, u8>, side: usize, width: usize, height: usize) -> ViewMut<'a, u8> {
    ViewMut::with_stride(&mut out.data[side * width * 3..], width, height, 3, out.stride)
}

fn gray(view: View<'_, u8>, out: &mut ViewMut<'_, u8>) {
    for y in 0..view.height {
        let pixels = out.row_mut(y).chunks_exact_mut(3);
        pixels.zip(view.row(y)).for_each(|(pixel, value)| pixel.fill(*value));
    }
}

/// Both views side by side, the points found from red (first) to blue (last).
pub fn corners(views: [View<'_, u8>; 2], points: [&Points; 2], count: usize, out: &mut ViewMut<'_, u8>) {
    for side in 0..2 {
        let mut part = half(out, side, views[side].width, views[side].height);
        gray(views[side], &mut part);
        let mut last: Option<(f32, f32)> = None;
        for (index, [x, y]) in points[side] {
            let place = *index as f32 / count.max(2) as f32;
            let color = [(255.0 * place) as u8, 120, (255.0 * (1.0 - place)) as u8];
            if let Some(last) = last {
                line(&mut part, last, (*x, *y), 1.0, color);
            }
            cross(&mut part, *x, *y, 4.0, 1.0, color);
            last = Some((*x, *y));
        }
        if points[side].is_empty() {
            text(&mut part, 8.0, 8.0, "no board", 3.0, [60, 60, 255]);
        }
    }
}

/// Share of the picture's cells that contain points of the pairs.
pub fn covered(pairs: &[&Pair], side: usize, size: (usize, usize)) -> f64 {
    let counts = count_cells(pairs, side, size);
    counts.iter().filter(|count| **count > 0).count() as f64 / counts.len() as f64
}

fn count_cells(pairs: &[&Pair], side: usize, size: (usize, usize)) -> Vec<usize> {
    let mut counts = vec![0; CELLS.0 * CELLS.1];
    for [x, y] in pairs.iter().flat_map(|pair| &pair.px[side]) {
        let cell = |place: f32, length: usize, cells: usize| {
            ((place.max(0.0) as usize * cells) / length.max(1)).min(cells - 1)
        };
        counts[cell(*y, size.1, CELLS.1) * CELLS.0 + cell(*x, size.0, CELLS.0)] += 1;
    }
    counts
}

/// Coverage by points, left and right: cells without points are red, others greener with more points.
pub fn coverage(pairs: &[&Pair], size: (usize, usize), out: &mut ViewMut<'_, u8>) {
    let (width, height) = size;
    for side in 0..2 {
        let mut part = half(out, side, width, height);
        for (index, count) in count_cells(pairs, side, size).into_iter().enumerate() {
            let (x, y) = (index % CELLS.0, index / CELLS.0);
            let (from_x, to_x) = (x * width / CELLS.0, (x + 1) * width / CELLS.0);
            let (from_y, to_y) = (y * height / CELLS.1, (y + 1) * height / CELLS.1);
            let color = if count == 0 { [30, 30, 110] } else { [30, 40 + (count * 3).min(90) as u8, 30] };
            let (w, h) = ((to_x - from_x) as i32 - 1, (to_y - from_y) as i32 - 1);
            fill_rectangle(&mut part, from_x as i32, from_y as i32, w, h, color, 1.0);
        }
        for (index, pair) in pairs.iter().enumerate() {
            // Steps of the golden angle keep neighbours apart.
            let hue = index as f32 * 2.4;
            let color: Color =
                std::array::from_fn(|c| (170.0 + 85.0 * (hue + c as f32 * 2.1).sin()).clamp(0.0, 255.0) as u8);
            pair.px[side].iter().for_each(|[x, y]| fill_circle(&mut part, *x, *y, 2.0, color, 1.0));
        }
        let name = if side == 0 { "left" } else { "right" };
        let words = format!("{name}: {} views, {:.0}% of cells", pairs.len(), 100.0 * covered(pairs, side, size));
        text(&mut part, 8.0, 8.0, &words, 2.0, WHITE);
    }
}

/// The rectified pair side by side with rows ruled across both and the points marked: each should lie on one row.
///
/// # Errors
/// When the calibration cannot be used.
pub fn epipolar(
    calibration: &Calibration,
    views: [View<'_, u8>; 2],
    pair: &Pair,
    error_px: Option<f64>,
    pool: &dyn Parallel,
    out: &mut ViewMut<'_, u8>,
) -> Result<(), StereoError> {
    let rectification = packet::rectification(calibration)?;
    let cameras = [packet::camera(&calibration.left)?, packet::camera(&calibration.right)?];
    let (width, height) = (rectification.width, rectification.height);
    let all = Rect::whole(width, height);
    let tables = [
        RemapTable::left(&cameras[0], &rectification, all, pool)?,
        RemapTable::right(&cameras[1], &rectification, all, pool)?,
    ];
    let mut plain = vec![0; width * height];
    for side in 0..2 {
        tables[side].remap(views[side], ViewMut::new(&mut plain, width, height, 1), pool)?;
        gray(View::new(&plain, width, height, 1), &mut half(out, side, width, height));
    }
    for y in (0..height).step_by((height / 20).max(8)) {
        let y = y as f32;
        line(out, (0.0, y), (2.0 * width as f32, y), 1.0, GREEN);
    }
    for side in 0..2 {
        let mut part = half(out, side, width, height);
        for place in &pair.px[side] {
            let [x, y] = rectified_px(&cameras[side], &rectification, side == 0, *place);
            cross(&mut part, x as f32, y as f32, 4.0, 1.0, [60, 160, 255]);
        }
    }
    let words = match error_px {
        Some(error) => format!("rows differ by {error:.2} px"),
        None => "this view was left out".to_owned(),
    };
    text(out, 8.0, 8.0, &words, 2.0, WHITE);
    Ok(())
}
