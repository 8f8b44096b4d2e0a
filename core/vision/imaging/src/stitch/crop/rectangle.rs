//! The largest upright rectangle of set cells in a grid.

use crate::Rect;

/// Searches grids; with reusable buffers.
#[derive(Debug, Default)]
pub(in crate::stitch) struct LargestRectangle {
    /// Set cells above each cell of a row, that one included.
    heights: Vec<usize>,
    /// Open rectangles: first column and height.
    open: Vec<(usize, usize)>,
}

impl LargestRectangle {
    /// The largest rectangle of cells for which `is_set` holds, by the largest one below a histogram, row by row. Cells
    /// are numbered row by row.
    ///
    /// Empty when no cell is set. Of equal ones the first is returned. Cost O(columns x rows).
    pub fn find(&mut self, columns: usize, rows: usize, is_set: impl Fn(usize) -> bool) -> Rect {
        let mut best = Rect::new(0, 0, 0, 0);
        self.heights.clear();
        self.heights.resize(columns + 1, 0);
        for row in 0..rows {
            self.open.clear();
            for column in 0..=columns {
                let counts = column < columns && is_set(row * columns + column);
                let height = if counts { self.heights[column] + 1 } else { 0 };
                self.heights[column] = height;
                let mut first = column;
                while let Some(&(start, tall)) = self.open.last() {
                    if tall < height {
                        break;
                    }
                    self.open.pop();
                    if tall * (column - start) > best.width * best.height {
                        best = Rect::new(start, row + 1 - tall, column - start, tall);
                    }
                    first = start;
                }
                self.open.push((first, height));
            }
        }
        best
    }
}
