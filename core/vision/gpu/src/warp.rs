//! Panoramas drawn on the device: views sampled by their matrix or mesh.

use std::ops::Range;
use std::sync::Arc;

use panoscope_imaging::stitch::{Drawing, DrawnView, PaintError, Painter, Runs};
use panoscope_imaging::{Parallel, ViewMut};

use crate::device::{Gpu, GpuError};
use crate::kernel::Kernel;
use crate::memory::{Store, Transfer, Upload, each_row, row_bytes, unpack};

/// Words of a view's placement in the shader.
const PLACE_WORDS: usize = 40;
const HEAD_WORDS: usize = 4;
const CANVAS_BYTES: u64 = 4 * (HEAD_WORDS + 2 * PLACE_WORDS) as u64;
/// Alignment of parts in the upload, bytes.
const ALIGNMENT: u64 = 16;

/// Draws panoramas of one or two views. Keeps its memory on the device.
#[derive(Debug)]
pub struct Warper {
    gpu: Arc<Gpu>,
    kernel: Kernel,
    canvas: Store,
    views: Store,
    vertices: Store,
    rows: Store,
    runs: Store,
    target: Store,
    transfer: Transfer,
    words: Vec<u8>,
}

/// Appends numbers of four bytes.
fn put(words: &mut Vec<u8>, values: impl IntoIterator<Item = [u8; 4]>) {
    values.into_iter().for_each(|value| words.extend(value));
}

fn floats<const N: usize>(values: [f64; N]) -> [[u8; 4]; N] {
    values.map(|value| (value as f32).to_le_bytes())
}

fn integers<const N: usize>(values: [i64; N]) -> [[u8; 4]; N] {
    values.map(|value| (value as i32).to_le_bytes())
}

/// Columns of the canvas that the device draws: those with the second view, and those in which the first one is not
/// merely shifted. Whole groups of four.
fn drawn_columns(views: &[DrawnView<'_>], runs: &Runs, (width, height): (usize, usize)) -> Range<usize> {
    if views[0].shift.is_none() {
        return 0..width;
    }
    let moved = views[0].moved.map(|moved| (moved.x, (moved.x + moved.width).min(width)));
    let second = (0..height).flat_map(|y| runs.row(y)).filter(|run| run.2 == 2).map(|(start, end, _)| (start, end));
    let (start, end) = second.chain(moved).fold((width, 0), |(a, b), (start, end)| (a.min(start), b.max(end)));
    if start < end { start / 4 * 4..end } else { 0..0 }
}

/// First column of a view that the device needs to draw the columns from `first` on.
fn first_needed(view: &DrawnView<'_>, first: usize) -> usize {
    let Some((dx, _)) = view.shift else { return 0 };
    // A mesh moves the view by as much as its vertices, at most.
    let most = view.mesh.map_or(0.0, |mesh| {
        let place = |at: usize| mesh.lattice.position(at % mesh.lattice.columns, at / mesh.lattice.columns)[0];
        let moves = mesh.source.iter().enumerate().map(|(at, source)| (f64::from(source[0]) - place(at)).abs());
        moves.fold(0.0, f64::max)
    });
    (first as f64 + dx as f64 - most - 2.0).max(0.0) as usize
}

/// Draws what lies outside `columns`: the first view, shifted, or black.
fn draw_rest(drawing: &Drawing<'_>, columns: &Range<usize>, out: &mut ViewMut<'_, u8>, pool: &dyn Parallel) {
    let first = &drawing.views[0];
    let (dx, dy) = first.shift.unwrap_or_default();
    each_row(out, pool, |y, row| {
        for (start, end, shows) in drawing.runs.row(y) {
            for (a, b) in [(start, end.min(columns.start)), (start.max(columns.end), end)] {
                if a >= b {
                    continue;
                }
                let target = &mut row[3 * a..3 * b];
                let source = usize::try_from(y as i64 + dy).ok().filter(|y| shows == 1 && *y < first.view.height);
                let from = usize::try_from(a as i64 + dx).ok();
                let pixels = source.zip(from).and_then(|(y, x)| first.view.row(y).get(3 * x..3 * (x + b - a)));
                match pixels {
                    Some(pixels) => target.copy_from_slice(pixels),
                    None => target.fill(0),
                }
            }
        }
    });
}

/// Writes a view's placement for the shader; `start` is the offset of its first pixel, `stride` the bytes of a row,
/// `first_vertex` its first vertex.
fn put_place(
    words: &mut Vec<u8>,
    view: &DrawnView<'_>,
    (start, stride): (i64, usize),
    first_vertex: usize,
    canvas: (usize, usize),
) {
    let pixels = &view.view;
    put(words, integers([start, stride as i64, pixels.width as i64, pixels.height as i64]));
    put(words, integers(view.gain.map(i64::from)));
    let (dx, dy) = view.shift.unwrap_or_default();
    put(words, integers([dx, dy, i64::from(view.shift.is_some()), 0]));
    let moved = view.moved.map_or([0; 4], |m| [m.x, m.y, m.x + m.width, m.y + m.height]);
    put(words, integers(moved.map(|v| v as i64)));
    let (columns, rows) = view.mesh.map_or((0, 0), |mesh| (mesh.lattice.columns, mesh.lattice.rows));
    put(words, integers([first_vertex as i64, columns as i64, rows as i64, 0]));
    let grid = view.mesh.map_or([0.0; 4], |mesh| {
        let cell = mesh.lattice.cell_px as f64;
        let at = |k: usize| f64::from(mesh.origin[k]) / cell - f64::from(mesh.lattice.first[k]);
        [at(0), at(1), 1.0 / cell, 0.0]
    });
    put(words, floats(grid));
    // Counted from the middle of the canvas, single precision holds positions well below 1/64 px.
    let middle = [(canvas.0 / 2) as f64, (canvas.1 / 2) as f64];
    let m = &view.source_from_canvas;
    for row in 0..3 {
        let [a, b, c] = [m[3 * row], m[3 * row + 1], m[3 * row + 2]];
        put(words, floats([a, b, c + a * middle[0] + b * middle[1], 0.0]));
    }
    put(words, floats([middle[0], middle[1], 0.0, 0.0]));
}

impl Warper {
    /// Prepares a device.
    ///
    /// # Errors
    /// [`GpuError::Failed`] if it rejects the shader.
    pub fn new(gpu: Arc<Gpu>) -> Result<Self, GpuError> {
        let parts = [include_str!("shaders/warp.wgsl"), include_str!("shaders/bytes.wgsl")];
        let kernel = Kernel::new(&gpu, "warp", &parts)?;
        let (canvas, views, vertices, rows, runs, target) = Default::default();
        Ok(Self {
            gpu,
            kernel,
            canvas,
            views,
            vertices,
            rows,
            runs,
            target,
            transfer: Transfer::default(),
            words: Vec::new(),
        })
    }

    /// Draws a panorama; see [`Painter::paint`].
    ///
    /// # Errors
    /// When an image does not fit into the device or the device fails.
    pub fn draw(
        &mut self,
        drawing: &Drawing<'_>,
        out: &mut ViewMut<'_, u8>,
        pool: &dyn Parallel,
    ) -> Result<(), GpuError> {
        let (views, runs) = (drawing.views, drawing.runs);
        let fits = (1..=2).contains(&views.len()) && out.channels == 3 && runs.starts().len() == out.height + 1;
        if !fits {
            return Err(GpuError::Input { what: format!("{} views on a canvas of {} rows", views.len(), out.height) });
        }
        let columns = drawn_columns(views, runs, (out.width, out.height));
        if columns.is_empty() {
            draw_rest(drawing, &columns, out, pool);
            return Ok(());
        }
        let mut uploads = Vec::with_capacity(2);
        let row_words = row_bytes(columns.len()) / 4;
        // One upload holds: places, the vertices of both views, starts of rows, runs, both views.
        self.words.clear();
        put(&mut self.words, integers([columns.start, columns.end, out.height, row_words].map(|v| v as i64)));
        let (mut first_vertex, mut view_bytes) = (0, 0);
        for view in views {
            let first = first_needed(view, columns.start);
            let upload = Upload::new(view.view, first);
            let start = view_bytes as i64 - 3 * first as i64;
            put_place(&mut self.words, view, (start, upload.stride()), first_vertex, (out.width, out.height));
            first_vertex += view.mesh.map_or(0, |mesh| mesh.source.len());
            view_bytes += upload.bytes();
            uploads.push(upload);
        }
        self.words.resize(CANVAS_BYTES as usize, 0);
        let mut parts = [CANVAS_BYTES, 0, 0, 0];
        let mut close = |part: usize, words: &mut Vec<u8>, before: u64| {
            words.resize(words.len().max(before as usize + 16).next_multiple_of(ALIGNMENT as usize), 0);
            parts[part] = words.len() as u64 - before;
            words.len() as u64
        };
        for vertex in views.iter().filter_map(|view| view.mesh).flat_map(|mesh| mesh.source) {
            put(&mut self.words, vertex.map(f32::to_le_bytes));
        }
        let at = close(1, &mut self.words, CANVAS_BYTES);
        put(&mut self.words, runs.starts().iter().map(|start| start.to_le_bytes()));
        let at = close(2, &mut self.words, at);
        put(&mut self.words, runs.list().iter().map(|(end, shows)| ((end << 2) | u32::from(*shows)).to_le_bytes()));
        close(3, &mut self.words, at);

        let gpu = &*self.gpu;
        let target_bytes = (row_bytes(columns.len()) * out.height) as u64;
        let up = self.transfer.begin(gpu, self.words.len() as u64 + view_bytes)?;
        up.write(0, &self.words)?;
        let mut from = self.words.len();
        for upload in &uploads {
            up.write_rows(from, upload, pool)?;
            from += upload.bytes() as usize;
        }
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut from = 0;
        let stores = [&mut self.canvas, &mut self.vertices, &mut self.rows, &mut self.runs];
        for (store, bytes) in stores.into_iter().zip(parts) {
            self.transfer.send(&mut encoder, from, store.reserve(gpu, bytes)?, bytes);
            from += bytes;
        }
        self.transfer.send(&mut encoder, from, self.views.reserve(gpu, view_bytes)?, view_bytes);
        let target = self.target.reserve(gpu, target_bytes)?;
        let stores = [&self.canvas, &self.views, &self.vertices, &self.rows, &self.runs];
        let held: Vec<&wgpu::Buffer> = stores.into_iter().filter_map(Store::buffer).chain([target]).collect();
        self.kernel.encode(gpu, &mut encoder, &held, [columns.len().div_ceil(4), out.height]);
        // The processor draws its part while the device works.
        let out = std::cell::RefCell::new(out);
        let rest = || draw_rest(drawing, &columns, &mut out.borrow_mut(), pool);
        let drawn = |rows: &[u8]| unpack(rows, columns.clone(), &mut out.borrow_mut(), pool);
        self.transfer.finish(gpu, encoder, target, target_bytes, rest, drawn)
    }
}

impl Painter for Warper {
    fn paint(
        &mut self,
        drawing: &Drawing<'_>,
        out: &mut ViewMut<'_, u8>,
        pool: &dyn Parallel,
    ) -> Result<(), PaintError> {
        Ok(self.draw(drawing, out, pool)?)
    }
}
