//! Pieces of a map: pixels that are connected through their four neighbours, as runs of pixels in its rows.

use std::ops::Range;

/// What a piece counts besides its pixels.
pub(crate) trait Tally: Copy {
    /// Adds the counts of another part of the same piece.
    fn add(&mut self, other: Self);
}

/// Neighbouring pixels of one row and one piece.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Run<T> {
    row: u32,
    start: u32,
    end: u32,
    /// A run of the same piece; its own index at the piece's root.
    parent: u32,
    /// Pixels of the piece at its root.
    area: u32,
    /// Counts of the piece at its root.
    pub tally: T,
}

impl<T> Run<T> {
    pub fn row(&self) -> usize {
        self.row as usize
    }

    pub fn columns(&self) -> Range<usize> {
        self.start as usize..self.end as usize
    }

    /// Number of pixels; of a root that of its piece.
    pub fn area(&self) -> usize {
        self.area as usize
    }
}

/// The runs of a map in the order of its rows. Reuses its memory.
///
/// For each row [`push`](Self::push) its runs from left to right, then [`end_row`](Self::end_row).
#[derive(Debug, Default)]
pub(crate) struct Runs<T> {
    runs: Vec<Run<T>>,
    /// The runs of the last row that has ended.
    above: Range<usize>,
}

impl<T: Tally> Runs<T> {
    pub fn clear(&mut self) {
        self.runs.clear();
        self.above = 0..0;
    }

    pub fn len(&self) -> usize {
        self.runs.len()
    }

    /// The run of an index. Its tally is that of its piece only at the piece's root.
    pub fn get(&self, index: usize) -> Run<T> {
        self.runs[index]
    }

    /// Adds a run of the present row, a piece for itself.
    pub fn push(&mut self, row: usize, columns: Range<usize>, tally: T) {
        let (parent, area) = (self.runs.len() as u32, columns.len() as u32);
        self.runs.push(Run {
            row: row as u32,
            start: columns.start as u32,
            end: columns.end as u32,
            parent,
            area,
            tally,
        });
    }

    /// Joins the runs of the present row with those above. `touches` says of the columns that two runs share whether they belong to one piece.
    pub fn end_row(&mut self, mut touches: impl FnMut(Range<usize>) -> bool) {
        let first = self.above.end;
        let (mut upper, mut lower) = (self.above.start, first);
        while upper < first && lower < self.runs.len() {
            let (over, under) = (self.runs[upper], self.runs[lower]);
            let shared = over.start.max(under.start) as usize..over.end.min(under.end) as usize;
            if !shared.is_empty() && touches(shared) {
                self.join(upper, lower);
            }
            if over.end <= under.end { upper += 1 } else { lower += 1 }
        }
        self.above = first..self.runs.len();
    }

    /// Index of the run that has the counts of the piece of a run. Shortens the path to it.
    pub fn root(&mut self, mut index: usize) -> usize {
        while self.runs[index].parent as usize != index {
            let next = self.runs[self.runs[index].parent as usize].parent;
            self.runs[index].parent = next;
            index = next as usize;
        }
        index
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        if a != b {
            let Run { area, tally, .. } = self.runs[b];
            self.runs[b].parent = a as u32;
            self.runs[a].area += area;
            self.runs[a].tally.add(tally);
        }
    }
}
