//! Which view must show a place: instruments are whole only where one view shows all of them.

/// View that a place must be shown from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kept {
    /// Either view.
    #[default]
    Free,
    /// The reference view, and those before.
    Reference,
    /// The view that the mesh draws.
    Other,
}

/// The view that must show a place, and how much that matters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Keep {
    /// The view.
    pub view: Kept,
    /// An instrument is known to be there. Else it is only likely: the place lies beside one, or nothing is matched there.
    pub is_sure: bool,
}

/// The view that must show each cell of the reference view; without cells where all are free.
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

    /// Takes over another one in the memory that is there.
    pub fn copy_from(&mut self, other: &Self) {
        (self.cell_px, self.columns) = (other.cell_px, other.columns);
        self.cells.clone_from(&other.cells);
    }

    /// Becomes the one on pictures that are larger by a factor.
    pub fn enlarge(&mut self, small: &Self, factor: usize) {
        self.copy_from(small);
        self.cell_px *= factor;
    }
}
