//! Pictures of disparities and of their errors.

use std::path::Path;

use crate::canvas::Canvas;
use crate::error::Result;
use panoscope_imaging::draw::{Colormap, colorize};
use panoscope_imaging::{View, ViewMut};

/// A view as it is.
pub fn view(path: &Path, (width, height): (usize, usize), bgr: Vec<u8>) -> Result<()> {
    Canvas { width, height, bgr }.save(path)
}

/// A map in colours from its 2nd to its 98th percentile, unknown places dark gray.
pub fn map(path: &Path, size: (usize, usize), values: &[f32]) -> Result<()> {
    let mut known: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
    known.sort_by(f32::total_cmp);
    let at = |share: usize| known.get((known.len().max(1) - 1) * share / 100).copied().unwrap_or(0.0);
    let mut bgr = vec![0; 3 * size.0 * size.1];
    let plane = View::new(values, size.0, size.1, 1);
    colorize(
        &plane,
        at(2),
        at(98).max(at(2) + 1e-3),
        Colormap::Rainbow,
        &mut ViewMut::new(&mut bgr, size.0, size.1, 3),
    );
    view(path, size, bgr)
}

/// Errors: white none, over yellow to red from 4 px on; missing values blue, unknown truth black.
pub fn errors(
    path: &Path,
    size: (usize, usize),
    found: &[f32],
    truth: &[f32],
    counts: impl Fn(usize) -> bool,
) -> Result<()> {
    const RED_PX: f32 = 4.0;
    let colour = |index: usize| -> [u8; 3] {
        if !truth[index].is_finite() || !counts(index) {
            return [0, 0, 0];
        }
        if !found[index].is_finite() {
            return [160, 70, 30];
        }
        let part = ((found[index] - truth[index]).abs() / RED_PX).min(1.0);
        let fade = |from: f32, to: f32| (from + (to - from) * part) as u8;
        [fade(255.0, 0.0), (255.0 * (1.0 - part * part)) as u8, fade(255.0, 200.0)]
    };
    view(path, size, (0..size.0 * size.1).flat_map(colour).collect())
}
