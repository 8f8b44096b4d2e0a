//! Detections of instruments in the reference view.

use crate::View;

/// Spacing of the kept samples of a mask, px.
const MASK_STEP: usize = 4;

/// Knowledge of a position before its disparity is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Hint {
    Nothing,
    /// Inside the box of an instrument, which also holds tissue.
    Likely,
    /// Inside the mask of one.
    Certain,
}

/// Boxes and a mask of instruments, px of the reference view. Empty without a detector.
#[derive(Clone, Debug, Default)]
pub struct InstrumentHints {
    /// Left, top, right and lower edge.
    boxes: Vec<[f64; 4]>,
    /// Every [`MASK_STEP`]th pixel of the mask, each way.
    mask: Vec<bool>,
    columns: usize,
}

impl InstrumentHints {
    /// Forgets boxes and mask.
    pub fn clear(&mut self) {
        self.boxes.clear();
        self.mask.clear();
    }

    /// Adds a box: its upper left corner and its size, px.
    pub fn push_box(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2]) {
        self.boxes.push([x, y, x + width, y + height]);
    }

    /// Adds a mask of the size of the reference view: nonzero on instruments.
    pub fn add_mask(&mut self, mask: View<'_, u8>) {
        let columns = mask.width.div_ceil(MASK_STEP);
        let count = columns * mask.height.div_ceil(MASK_STEP);
        if (self.columns, self.mask.len()) != (columns, count) {
            self.mask.clear();
            self.mask.resize(count, false);
            self.columns = columns;
        }
        for (row, line) in self.mask.chunks_exact_mut(columns.max(1)).enumerate() {
            let pixels = mask.row(row * MASK_STEP).iter().step_by(MASK_STEP);
            line.iter_mut().zip(pixels).for_each(|(is_tool, pixel)| *is_tool |= *pixel != 0);
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.boxes.is_empty() && self.mask.is_empty()
    }

    pub(super) fn at(&self, [x, y]: [f64; 2]) -> Hint {
        let (column, row) = (x.max(0.0) as usize / MASK_STEP, y.max(0.0) as usize / MASK_STEP);
        if column < self.columns && self.mask.get(row * self.columns + column).is_some_and(|is_tool| *is_tool) {
            return Hint::Certain;
        }
        let is_inside = |[x0, y0, x1, y1]: &[f64; 4]| (*x0..*x1).contains(&x) && (*y0..*y1).contains(&y);
        if self.boxes.iter().any(is_inside) { Hint::Likely } else { Hint::Nothing }
    }
}
