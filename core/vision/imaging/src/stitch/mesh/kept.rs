//! View that must show a position, so that each instrument is shown completely by one view.

/// View that must show a position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kept {
    /// Either view.
    #[default]
    Free,
    /// The reference view or an earlier view.
    Reference,
    /// The view drawn by the mesh.
    Other,
}

/// The view that must show a position, with its certainty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Keep {
    /// The view.
    pub view: Kept,
    /// Whether an instrument is certain there; otherwise it is likely: the position is next to one, or unmatched.
    pub is_sure: bool,
}

/// The view that must show each cell of the reference view; empty if all are free.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeptCells {
    cell_px: usize,
    columns: usize,
    cells: Vec<Keep>,
}

impl KeptCells {
    /// The view that must show a position of the reference plane; free outside the reference view.
    pub fn at(&self, [x, y]: [f32; 2]) -> Keep {
        if self.cell_px == 0 || x < 0.0 || y < 0.0 {
            return Keep::default();
        }
        let (column, row) = (x as usize / self.cell_px, y as usize / self.cell_px);
        if column >= self.columns {
            return Keep::default();
        }
        self.cells.get(row * self.columns + column).copied().unwrap_or_default()
    }

    /// Whether all cells are free.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Frees all cells.
    pub fn clear(&mut self) {
        self.cells.clear();
    }

    /// Sets the grid and frees all cells of it.
    pub fn reset(&mut self, cell_px: usize, columns: usize, rows: usize) -> &mut [Keep] {
        (self.cell_px, self.columns) = (cell_px, columns);
        self.cells.clear();
        self.cells.resize(columns * rows, Keep::default());
        &mut self.cells
    }

    /// Copies another one into the existing memory.
    pub fn copy_from(&mut self, other: &Self) {
        (self.cell_px, self.columns) = (other.cell_px, other.columns);
        self.cells.clone_from(&other.cells);
    }

    /// Becomes the one on images that are larger by a factor.
    pub fn enlarge(&mut self, small: &Self, factor: usize) {
        self.copy_from(small);
        self.cell_px *= factor;
    }
}
