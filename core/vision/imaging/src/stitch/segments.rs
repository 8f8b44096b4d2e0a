//! Content of each canvas row, as runs of columns.

use super::seam::Seam;
use super::warp::Span;

/// Nothing covers the pixels.
pub const EMPTY: u8 = 0;
/// Only the images so far.
pub const BASE_ONLY: u8 = 1;
/// Both; the images so far are shown.
pub const BASE_SHOWN: u8 = 2;
/// Both; the new view is shown.
pub const NEW_SHOWN: u8 = 3;
/// Only the new view.
pub const NEW_ONLY: u8 = 4;

/// A run of columns of one kind, end excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment {
    /// First column.
    pub start: u32,
    /// One past the last.
    pub end: u32,
    /// One of the constants above.
    pub kind: u8,
}

impl Segment {
    /// The part of the run inside `start..end`, if any.
    pub fn clip(&self, start: usize, end: usize) -> Option<(usize, usize)> {
        let (a, b) = ((self.start as usize).max(start), (self.end as usize).min(end));
        (a < b).then_some((a, b))
    }

    /// True where both images exist.
    pub fn both(&self) -> bool {
        matches!(self.kind, BASE_SHOWN | NEW_SHOWN)
    }
}

/// Runs of all rows.
#[derive(Debug, Default)]
pub struct Segments {
    list: Vec<Segment>,
    starts: Vec<u32>,
    edges: Vec<u32>,
    crossings: Vec<u32>,
    values: Vec<f32>,
}

impl Segments {
    /// Runs of row `y`, from column 0 to the last.
    pub fn row(&self, y: usize) -> &[Segment] {
        &self.list[self.starts[y] as usize..self.starts[y + 1] as usize]
    }

    /// Reserves memory for `height` rows over `cells` columns of seam cells.
    pub fn reserve(&mut self, height: usize, cells: usize) {
        let room = |have: usize, want: usize| want.saturating_sub(have);
        self.list.reserve(room(self.list.len(), height * 12));
        self.starts.reserve(room(self.starts.len(), height + 1));
        self.values.reserve(room(self.values.len(), cells));
        self.crossings.reserve(room(self.crossings.len(), cells));
        self.edges.reserve(room(self.edges.len(), cells + 2 + 2 * super::params::MAX_VIEWS));
    }

    /// Builds the runs from the spans of the views so far, the new view's and the seam.
    pub fn build(
        &mut self,
        (width, height): (usize, usize),
        base: &[Vec<Span>],
        new: &[Span],
        seam: &Seam,
        scale: usize,
    ) {
        self.list.clear();
        self.starts.clear();
        self.starts.push(0);
        let width = width as u32;
        // Where no label changes, one view holds the whole overlap: any covered cell shows which.
        let cells = match seam.bounds() {
            Some((x0, _, x1, _)) => (x0.saturating_sub(2), (x1 + 2).min(seam.columns)),
            None => (0, seam.columns),
        };
        for y in 0..height {
            let starts_new = seam.crossings(y, scale, cells, &mut self.values, &mut self.crossings);
            self.edges.clear();
            self.edges.extend([0, width]);
            for span in base.iter().map(|b| b[y]).chain([new[y]]).filter(|s| !s.is_empty()) {
                self.edges.extend([span.start, span.end.min(width)]);
            }
            self.edges.extend(self.crossings.iter().map(|c| (*c).min(width)));
            self.edges.sort_unstable();
            let mut passed = 0;
            for pair in self.edges.windows(2) {
                let (start, end) = (pair[0], pair[1]);
                if start >= end {
                    continue;
                }
                while passed < self.crossings.len() && self.crossings[passed] <= start {
                    passed += 1;
                }
                let shows_new = starts_new ^ (passed % 2 == 1);
                let kind = match (base.iter().any(|b| b[y].contains(start)), new[y].contains(start)) {
                    (false, false) => EMPTY,
                    (true, false) => BASE_ONLY,
                    (false, true) => NEW_ONLY,
                    (true, true) => {
                        if shows_new {
                            NEW_SHOWN
                        } else {
                            BASE_SHOWN
                        }
                    }
                };
                match self.list.last_mut() {
                    Some(last) if last.end == start && last.kind == kind && start != 0 => last.end = end,
                    _ => self.list.push(Segment { start, end, kind }),
                }
            }
            self.starts.push(self.list.len() as u32);
        }
    }
}
