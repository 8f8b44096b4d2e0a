//! Description of a panorama of one or two views, for drawing on other devices.

use super::blend::Ranges;
use super::mesh::{Lattice, MeshGrid};
use super::segments::{EMPTY, NEW_ONLY, NEW_SHOWN, Segments};
use super::warp::Span;
use crate::{Parallel, Rect, View, ViewMut};

/// Why a [`Painter`] failed: each device has its own errors.
pub type PaintError = Box<dyn std::error::Error + Send + Sync>;

/// A view whose pixels may have to be copied from another memory before they are read.
pub trait LazyView {
    /// Size, stride and channels; the pixels may be missing.
    fn layout(&self) -> View<'_, u8>;

    /// The view with its pixels.
    fn pixels(&self) -> View<'_, u8>;
}

impl LazyView for View<'_, u8> {
    fn layout(&self) -> View<'_, u8> {
        *self
    }

    fn pixels(&self) -> View<'_, u8> {
        *self
    }
}

/// Draws panoramas of one or two views, for instance on a GPU that holds the views.
///
/// In each frame of two views it first samples them and draws their columns around the seam, with which the processor
/// finds and blends the seam; then it draws the panorama, with the result as a patch.
pub trait Painter: std::fmt::Debug + Send {
    /// Samples the first views, in their order. All sums are those of [`warp::sample`](super::warp::sample), with a
    /// gain of one.
    ///
    /// # Errors
    /// The device failed. The processor then draws the whole frame.
    fn sample(&mut self, samples: &mut [Samples<'_>]) -> Result<(), PaintError>;

    /// Draws the columns of `patch` from both views into its pixels.
    ///
    /// # Errors
    /// As of [`Painter::sample`].
    fn draw_columns(&mut self, views: &[DrawnView<'_>; 2], patch: &mut Patch) -> Result<(), PaintError>;

    /// Draws all pixels of `out`, black outside all views; without `out`, of the image on the device that the owner of
    /// the painter has provided.
    ///
    /// # Errors
    /// As of [`Painter::sample`].
    fn paint(
        &mut self,
        drawing: &Drawing<'_>,
        out: Option<&mut ViewMut<'_, u8>>,
        pool: &dyn Parallel,
    ) -> Result<(), PaintError>;
}

/// Samples of a view, BGR.
#[derive(Debug)]
pub struct Samples<'a> {
    /// Columns and rows of the view, px.
    pub size: (usize, usize),
    /// Bytes from one row of the view to the next.
    pub stride: usize,
    /// For each sample the byte offset of the upper left of the four pixels that it lies between, and its weights: from
    /// the low byte on those of the left and of the right column in 1/64, and that of the lower row in 1/16384, two
    /// bytes.
    pub positions: &'a [[u32; 2]],
    /// B, G, R, 0 of each sample.
    pub values: &'a mut [[u8; 4]],
}

/// The views of a panorama, and which of them each of its pixels shows.
#[derive(Debug)]
pub struct Drawing<'a> {
    /// Columns and rows of the canvas.
    pub size: (usize, usize),
    /// One or two views.
    pub views: &'a [DrawnView<'a>],
    /// Which view each pixel shows.
    pub runs: &'a Runs,
    /// The blended columns.
    pub patch: Option<&'a Patch>,
}

/// A view and its placement on the canvas.
#[derive(Clone, Copy, Debug)]
pub struct DrawnView<'a> {
    /// Its columns and rows, px.
    pub size: (usize, usize),
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

/// Columns of the canvas around the seam, as an image whose rows begin at different columns.
#[derive(Debug, Default)]
pub struct Patch {
    /// Canvas row of its first row.
    pub top: usize,
    /// Pixels of a row, a multiple of 4. The last ones may lie beyond the canvas.
    pub width: usize,
    /// Canvas column of the first pixel of each row.
    pub starts: Vec<u32>,
    /// The patch twice, BGR without padding: of the first view, blended before the panorama is painted, and of the
    /// second view.
    pub pixels: Vec<u8>,
}

impl Patch {
    /// Bytes of a row.
    pub fn stride(&self) -> usize {
        3 * self.width
    }

    /// Bytes of one of its two images.
    pub fn bytes(&self) -> usize {
        self.stride() * self.starts.len()
    }

    /// Takes the shape of the columns of a blend zone whose differences must be known.
    pub(super) fn shape(&mut self, zone: Rect, ranges: &Ranges) {
        self.top = zone.y;
        let needed = || (0..zone.height).map(|row| ranges.needed(row));
        self.width = needed().map(|(start, end)| end - start).max().unwrap_or(0).next_multiple_of(4);
        self.starts.clear();
        self.starts.extend(needed().map(|(start, _)| (zone.x + start) as u32));
        self.pixels.resize(2 * self.bytes(), 0);
    }
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

/// Runs of columns that show one view or the patch, row after row.
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

    /// One past the last column of each run, and what it shows: 0 nothing, 1 the first view, 2 the second, 3 the patch.
    /// The runs of a row follow one another without gaps.
    pub fn list(&self) -> &[(u32, u8)] {
        &self.list
    }

    /// Builds the runs of one view, or of two with the patch in the blended columns.
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
                let shows = match segment.kind {
                    EMPTY => 0,
                    NEW_ONLY | NEW_SHOWN => 2,
                    _ => 1,
                };
                self.push(segment.end.min(blended.0 as u32), shows, y);
                self.push(segment.end.min(blended.1 as u32), if shows == 0 { 0 } else { 3 }, y);
                self.push(segment.end, shows, y);
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
