//! The crop of a panorama: which rectangle of the reference plane is drawn, held over seconds.
//!
//! Edges of the views on the plane move with every new registration. The rectangle does not: it shrinks when a part of
//! it has been empty for [`SHRINK_S`], grows when a larger one has been covered for as long as
//! [`CompositeParams::crop_hold_s`], and is otherwise left alone. Its sides are at multiples of a cell of 4 px (for
//! views of up to 1279 columns), so that a change is a step and never a drift.

mod coverage;
mod rectangle;
#[cfg(test)]
mod tests;

use super::canvas::Bounds;
use super::params::{Canvas, CompositeParams, CropMethod};
use super::warp::Span;
use coverage::{CellRect, Coverage};
pub(super) use rectangle::LargestRectangle;

/// Time between two updates of the covered area.
const LOOK_S: f64 = 0.25;
/// Time for which a part of a filled rectangle may be empty: so that one bad registration does not change it.
const SHRINK_S: f64 = 0.5;
/// Minimum growth of the area of a filled rectangle, in percent.
const GROW_PERCENT: usize = 6;
/// Number of cells by which a side must differ before a bounding box changes.
const OFF_CELLS: i32 = 3;
/// A filled rectangle smaller than this share of the reference view, in percent, is not used.
const MIN_PERCENT: usize = 25;
/// Distance of a filled rectangle from a moving edge, cells.
const SPARE_CELLS: i32 = 1;
/// Columns of a view per cell.
const COLUMNS_PER_CELL: usize = 160;
/// Sides of cells are multiples of this, px; encoders like even sizes.
const CELL_STEP_PX: usize = 4;

/// Chooses the rectangle and holds it. Allocates only for a larger grid than before.
#[derive(Debug, Default)]
pub(super) struct Crop {
    coverage: Coverage,
    largest: LargestRectangle,
    held: Option<CellRect>,
    /// Time until the next update, s.
    to_look_s: f64,
    since_change_s: f64,
    unfit_s: f64,
    gain_percent: Option<f64>,
}

impl Crop {
    /// Forgets rectangle and cover.
    pub fn forget(&mut self) {
        self.coverage.forget();
        self.held = None;
        self.gain_percent = None;
        (self.to_look_s, self.since_change_s, self.unfit_s) = (0.0, 0.0, 0.0);
    }

    /// Advances the time.
    pub fn elapse(&mut self, seconds: f64) {
        self.to_look_s -= seconds;
        self.since_change_s += seconds;
    }

    /// The rectangle in force as a canvas.
    pub fn canvas(&self) -> Option<Canvas> {
        let side = self.coverage.cell_px() as i32;
        self.held.map(|held| Canvas {
            width: ((held.x1 - held.x0) * side) as usize,
            height: ((held.y1 - held.y0) * side) as usize,
            left: -held.x0 * side,
            top: -held.y0 * side,
        })
    }

    /// How much larger the covered area of the rectangle is than the lit part of the reference view, percent; `None`
    /// before the first look.
    pub fn gain_percent(&self) -> Option<f64> {
        self.gain_percent
    }

    /// Whether an update of the covered area is due.
    pub fn is_due(&self) -> bool {
        self.held.is_none() || self.to_look_s <= 0.0
    }

    /// A canvas that holds all of `bounds`, for the next [`update`](Self::update). `columns`: those of the reference
    /// view.
    pub fn whole(&mut self, bounds: Bounds, columns: usize) -> Canvas {
        let cell_px = (columns / COLUMNS_PER_CELL / CELL_STEP_PX * CELL_STEP_PX).max(CELL_STEP_PX);
        self.coverage.canvas(bounds, cell_px)
    }

    /// Updates the crop with the columns that the views cover in each row of the canvas from [`whole`](Self::whole).
    ///
    /// `size`: columns and rows of the reference view; `lit_px`: its lit pixels.
    pub fn update(&mut self, spans: &[Vec<Span>], size: (usize, usize), lit_px: f64, params: &CompositeParams) {
        self.to_look_s = LOOK_S;
        self.coverage.look(spans);
        let steady_looks = (f64::from(params.crop_hold_s) / LOOK_S).clamp(1.0, 254.0) as u8;
        let changed = match params.crop {
            CropMethod::None => None,
            CropMethod::Content => self.content(steady_looks, f64::from(params.crop_hold_s)),
            CropMethod::Filled => self.filled(steady_looks, f64::from(params.crop_hold_s), size),
        };
        if let Some(rect) = changed {
            self.held = Some(rect);
            (self.since_change_s, self.unfit_s) = (0.0, 0.0);
        }
        self.gain_percent = self.held.map(|held| {
            let covered = self.coverage.cells(held).filter(|cell| self.coverage.looks(*cell) > 0).count();
            let area_px = (covered * self.coverage.cell_px().pow(2)) as f64;
            100.0 * (area_px / lit_px.max(1.0) - 1.0)
        });
    }

    /// The bounding box of the covered area, if the current one has differed for `hold_s`.
    fn content(&mut self, steady_looks: u8, hold_s: f64) -> Option<CellRect> {
        let (columns, rows) = self.coverage.size();
        let mut found: Option<[usize; 4]> = None;
        for cell in (0..columns * rows).filter(|cell| self.coverage.looks(*cell) >= steady_looks) {
            let (x, y) = (cell % columns, cell / columns);
            let [x0, y0, x1, y1] = found.unwrap_or([x, y, x, y]);
            found = Some([x0.min(x), y0.min(y), x1.max(x), y1.max(y)]);
        }
        let [x0, y0, x1, y1] = found?;
        let wanted = self.coverage.on_plane(crate::Rect::new(x0, y0, x1 + 1 - x0, y1 + 1 - y0));
        let Some(held) = self.held else { return Some(wanted) };
        if held.distance(&wanted) < OFF_CELLS {
            self.unfit_s = 0.0;
            return None;
        }
        self.unfit_s += LOOK_S;
        (self.unfit_s >= hold_s).then_some(wanted)
    }

    /// The largest covered rectangle, if the current one has a gap or is much smaller.
    fn filled(&mut self, steady_looks: u8, hold_s: f64, size: (usize, usize)) -> Option<CellRect> {
        if let Some(held) = self.held {
            let has_gap = self.coverage.cells(held).count() < held.area()
                || self.coverage.cells(held).any(|cell| self.coverage.looks(cell) == 0);
            self.unfit_s = if has_gap { self.unfit_s + LOOK_S } else { 0.0 };
            let is_due = if has_gap { self.unfit_s >= SHRINK_S } else { self.since_change_s >= hold_s };
            if !is_due {
                return None;
            }
        }
        let (columns, rows) = self.coverage.size();
        let (coverage, largest) = (&self.coverage, &mut self.largest);
        let best = largest.find(columns, rows, |cell| coverage.looks(cell) >= steady_looks);
        let best = keep_off(coverage.on_plane(best), size, coverage.cell_px());
        let cell_area = coverage.cell_px() * coverage.cell_px();
        let is_usable = best.area() * cell_area * 100 >= size.0 * size.1 * MIN_PERCENT;
        let is_better = match self.held {
            None => true,
            Some(_) if self.unfit_s > 0.0 => true,
            Some(held) => best.area() * 100 >= held.area() * (100 + GROW_PERCENT),
        };
        if is_usable && is_better {
            return Some(best);
        }
        // Nothing lit to show: the reference view as it is.
        let whole = CellRect {
            x0: 0,
            y0: 0,
            x1: (size.0 / coverage.cell_px()).max(1) as i32,
            y1: (size.1 / coverage.cell_px()).max(1) as i32,
        };
        (!is_usable && self.held.is_none()).then_some(whole)
    }
}

/// Moves sides inwards that do not belong to the reference view, because other views and rims move relative to it.
fn keep_off(rect: CellRect, size: (usize, usize), cell_px: usize) -> CellRect {
    let [columns, rows] = [size.0, size.1].map(|length| (length / cell_px) as i32);
    let spare = |is_fixed: bool| if is_fixed { 0 } else { SPARE_CELLS };
    CellRect {
        x0: rect.x0 + spare(rect.x0 == 0),
        y0: rect.y0 + spare(rect.y0 == 0),
        x1: rect.x1 - spare(rect.x1 == columns),
        y1: rect.y1 - spare(rect.y1 == rows),
    }
}
