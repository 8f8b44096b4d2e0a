//! Description of a panorama of one or two views before its seam is blended, for drawing on other devices.

use super::blend::Ranges;
use super::mesh::{Lattice, MeshGrid};
use super::segments::{NEW_ONLY, NEW_SHOWN, Segments};
use super::warp::Span;
use crate::{Parallel, Rect, View, ViewMut};

/// Why a [`Painter`] failed: each device has its own errors.
pub type PaintError = Box<dyn std::error::Error + Send + Sync>;

/// Draws the pixels of a panorama, for instance on a GPU.
pub trait Painter: std::fmt::Debug + Send {
    /// Draws all pixels of `out`, black outside all views.
    ///
    /// # Errors
    /// The drawing failed. The processor then draws the whole frame.
    fn paint(
        &mut self,
        drawing: &Drawing<'_>,
        out: &mut ViewMut<'_, u8>,
        pool: &dyn Parallel,
    ) -> Result<(), PaintError>;
}

/// The views of a panorama, and which of them each of its pixels shows.
#[derive(Debug)]
pub struct Drawing<'a> {
    /// One or two views.
    pub views: &'a [DrawnView<'a>],
    /// Which view each pixel shows.
    pub runs: &'a Runs,
}

/// A view and its placement on the canvas.
#[derive(Clone, Copy, Debug)]
pub struct DrawnView<'a> {
    /// Its pixels, BGR.
    pub view: View<'a, u8>,
    /// Matrix from canvas pixels to those of the view, row by row; its third row is positive inside the view.
    pub source_from_canvas: [f64; 9],
    /// Mesh that replaces the matrix.
    pub mesh: Option<DrawnMesh<'a>>,
    /// Columns and rows to add to a canvas position, if the view is only shifted.
    pub shift: Option<(i64, i64)>,
    /// Part of the canvas in which a view that is shifted elsewhere is drawn by its mesh.
    pub moved: Option<Rect>,
    /// Factor of each channel, B, G, R, in 1/16384.
    pub gain: [i16; 4],
}

/// Content of a [`Mesh`](super::Mesh).
#[derive(Clone, Copy, Debug)]
pub struct DrawnMesh<'a> {
    /// Places of its vertices on the reference plane.
    pub lattice: Lattice,
    /// Position of each vertex in the view, px, row after row.
    pub source: &'a [[f32; 2]],
    /// Position of the canvas's first pixel on the reference plane, px.
    pub origin: [f32; 2],
}

impl<'a> DrawnMesh<'a> {
    pub(super) fn of(grid: &MeshGrid<'a>) -> Self {
        Self { lattice: *grid.mesh.lattice(), source: grid.mesh.source(), origin: grid.origin }
    }
}

/// Runs of columns that show one view, row after row.
#[derive(Debug, Default)]
pub struct Runs {
    starts: Vec<u32>,
    list: Vec<(u32, u8)>,
}

impl Runs {
    /// Number of the first run of each row, and, after the last, the number of all runs.
    pub fn starts(&self) -> &[u32] {
        &self.starts
    }

    /// One past the last column of each run, and its view: 0 none, 1 the first, 2 the second. The runs of a row follow
    /// one another without gaps.
    pub fn list(&self) -> &[(u32, u8)] {
        &self.list
    }

    /// First column, one past the last, and view of the runs of row `y`.
    pub fn row(&self, y: usize) -> impl Iterator<Item = (usize, usize, u8)> {
        let own = &self.list[self.starts[y] as usize..self.starts[y + 1] as usize];
        own.iter().scan(0, |start, (end, view)| Some((std::mem::replace(start, *end) as usize, *end as usize, *view)))
    }

    /// Builds the runs: the first view, and over it the second view where it alone is shown, outside the blended
    /// columns.
    pub(super) fn build(
        &mut self,
        (width, height): (usize, usize),
        first: &[Span],
        second: Option<(&Segments, Option<Rect>, &Ranges)>,
    ) {
        self.starts.clear();
        self.list.clear();
        self.starts.push(0);
        for y in 0..height {
            let Some((segments, zone, ranges)) = second else {
                let span = first[y];
                self.push(span.start, 0, y);
                self.push(span.end.max(span.start), 1, y);
                self.push(width as u32, 0, y);
                self.starts.push(self.list.len() as u32);
                continue;
            };
            let blended = zone.filter(|zone| y >= zone.y && y < zone.y + zone.height).map_or((width, width), |zone| {
                let (a, b) = ranges.active(y - zone.y);
                (zone.x + a, zone.x + b)
            });
            for segment in segments.row(y) {
                match segment.kind {
                    super::segments::EMPTY => self.push(segment.end, 0, y),
                    NEW_ONLY => self.push(segment.end, 2, y),
                    NEW_SHOWN => {
                        let (a, b) = (blended.0 as u32, blended.1 as u32);
                        self.push(segment.end.min(a), 2, y);
                        self.push(segment.end.min(b), 1, y);
                        self.push(segment.end, 2, y);
                    }
                    _ => self.push(segment.end, 1, y),
                }
            }
            self.starts.push(self.list.len() as u32);
        }
    }

    /// Lengthens row `y`, the last one, up to column `end`, which may be before its current end.
    fn push(&mut self, end: u32, shows: u8, y: usize) {
        let first = self.starts[y] as usize;
        let begun = if self.list.len() > first { self.list[self.list.len() - 1].0 } else { 0 };
        if end <= begun {
            return;
        }
        match self.list.last_mut() {
            Some(last) if begun > 0 && last.1 == shows => last.0 = end,
            _ => self.list.push((end, shows)),
        }
    }
}
