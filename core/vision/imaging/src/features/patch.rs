//! Positions of the samples around a keypoint on a pyramid level.

use super::pyramid::{Level, Pyramid};

/// Samples of a descriptor patch along each side (differences of neighbours: one fewer).
pub(super) const PATCH: usize = 21;
/// Padded row length of every table and patch.
pub(crate) const ROW: usize = 32;
/// Samples of one keypoint's surroundings; work memory.
pub(super) type Patch = [[f32; ROW]; PATCH];

/// The pyramid level is the one on which s is at least this many pixels.
const MIN_STEP: f32 = 1.0;

/// Position of a patch on a pyramid level.
#[derive(Clone, Copy)]
pub(crate) struct Grid {
    /// Position of the patch's centre, in pixels of the level.
    pub(super) x: f32,
    pub(super) y: f32,
    /// Step along a row of the patch, in pixels of the level; a column's step is at right angles.
    pub(super) ux: f32,
    pub(super) uy: f32,
}

impl Grid {
    /// A patch around `(x, y)` with samples `step` apart, on the level that suits scale `scale`.
    pub(crate) fn on(pyramid: &Pyramid, x: f32, y: f32, scale: f32, step: f32, angle: f32) -> (&Level, Grid) {
        let wanted = (scale / MIN_STEP).max(1.0).log2() as usize;
        let (level, index) = pyramid.level(wanted);
        let shrink = 1.0 / (1u32 << index) as f32;
        let (sin, cos) = angle.sin_cos();
        let step = step * shrink;
        let grid = Grid { x: (x + 0.5) * shrink - 0.5, y: (y + 0.5) * shrink - 0.5, ux: cos * step, uy: sin * step };
        (level, grid)
    }
}

/// First sample of a row, step to the next, and the level's last pixel.
#[derive(Clone, Copy)]
pub(super) struct Start {
    pub x: f32,
    pub y: f32,
    pub ux: f32,
    pub uy: f32,
    pub limit_x: f32,
    pub limit_y: f32,
}

impl Start {
    #[inline(always)]
    pub(super) fn of(level: &Level, grid: Grid, half: f32, row: usize) -> Self {
        let down = row as f32 - half;
        Self {
            x: grid.x - down * grid.uy - half * grid.ux,
            y: grid.y + down * grid.ux - half * grid.uy,
            ux: grid.ux,
            uy: grid.uy,
            limit_x: level.width as f32 - 1.0,
            limit_y: level.height as f32 - 1.0,
        }
    }
}
