//! Panoramas drawn on the GPU: views sampled by their matrix or mesh.

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use panoscope_imaging::rows::each_row;
use panoscope_imaging::stitch::{Drawing, DrawnView, PaintError, Painter, Runs};
use panoscope_imaging::{Parallel, ViewMut};
use panoscope_node::device::{DeviceImage, Gpu, Kernel, PIXELS, Steps, Store};
use panoscope_node::{Result, error};

/// Words of a view's placement in the shader.
const PLACE_WORDS: usize = 40;
const HEAD_WORDS: usize = 4;
const CANVAS_BYTES: usize = 4 * (HEAD_WORDS + 2 * PLACE_WORDS);

/// The views of the next panorama on the GPU, in the order in which the compositor gets them.
pub type Sources = Arc<Mutex<Vec<DeviceImage>>>;

/// Draws panoramas of one or two views. Keeps its memory on the GPU.
#[derive(Debug)]
pub struct Warper {
    gpu: Gpu,
    kernel: Kernel,
    sources: Sources,
    canvas: Store,
    vertices: Store,
    rows: Store,
    runs: Store,
    target: Store,
    /// What the GPU drew, in the host's memory.
    drawn: Vec<u8>,
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

/// Draws what is outside `columns`: the first view, shifted, or black.
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

/// Writes a view's placement for the shader; `stride` is the bytes of a row, `first_vertex` its first vertex.
fn put_place(words: &mut Vec<u8>, view: &DrawnView<'_>, stride: usize, first_vertex: usize, canvas: (usize, usize)) {
    let pixels = &view.view;
    put(words, integers([0, stride as i64, pixels.width as i64, pixels.height as i64]));
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
    /// Prepares the GPU. The caller puts the views of each panorama into `sources` first.
    ///
    /// # Errors
    /// It rejects the shader.
    pub fn new(gpu: Gpu, sources: Sources) -> Result<Self> {
        let kernel = gpu.kernel("warp", &[include_str!("warp.wgsl"), PIXELS])?;
        let (canvas, vertices, rows, runs, target) = Default::default();
        Ok(Self { gpu, kernel, sources, canvas, vertices, rows, runs, target, drawn: Vec::new() })
    }

    /// Draws a panorama; see [`Painter::paint`].
    ///
    /// # Errors
    /// Views that are not those of the sources; an image does not fit into the GPU or the GPU fails.
    pub fn draw(&mut self, drawing: &Drawing<'_>, out: &mut ViewMut<'_, u8>, pool: &dyn Parallel) -> Result<()> {
        let (views, runs) = (drawing.views, drawing.runs);
        let fits = (1..=2).contains(&views.len()) && out.channels == 3 && runs.starts().len() == out.height + 1;
        if !fits {
            return Err(error!("{} views on a canvas of {} rows", views.len(), out.height));
        }
        let sources: Vec<DeviceImage> = self.sources.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let is_that = |(view, source): (&DrawnView<'_>, &DeviceImage)| {
            (view.view.width, view.view.height) == (source.width, source.height)
        };
        if sources.len() < views.len() || !views.iter().zip(&sources).all(is_that) {
            return Err(error!("the views on the GPU are not those of the panorama"));
        }
        let columns = drawn_columns(views, runs, (out.width, out.height));
        if columns.is_empty() {
            draw_rest(drawing, &columns, out, pool);
            return Ok(());
        }
        let row_words = columns.len().div_ceil(4) * 3;
        let mut places = Vec::with_capacity(CANVAS_BYTES);
        put(&mut places, integers([columns.start, columns.end, out.height, row_words].map(|v| v as i64)));
        let mut vertices = Vec::new();
        for (view, source) in views.iter().zip(&sources) {
            let first_vertex = vertices.len() / 8;
            put_place(&mut places, view, source.stride_bytes, first_vertex, (out.width, out.height));
            for vertex in view.mesh.iter().flat_map(|mesh| mesh.source) {
                put(&mut vertices, vertex.map(f32::to_le_bytes));
            }
        }
        places.resize(CANVAS_BYTES, 0);
        let (mut starts, mut ends) = (Vec::new(), Vec::new());
        put(&mut starts, runs.starts().iter().map(|start| start.to_le_bytes()));
        put(&mut ends, runs.list().iter().map(|(end, shows)| ((end << 2) | u32::from(*shows)).to_le_bytes()));

        let gpu = self.gpu;
        let mut steps = Steps::default();
        let canvas = self.canvas.reserve(gpu, CANVAS_BYTES)?;
        let [held_vertices, held_rows, held_runs] =
            [(&mut self.vertices, &vertices), (&mut self.rows, &starts), (&mut self.runs, &ends)]
                .map(|(store, bytes)| store.reserve(gpu, bytes.len()));
        let (held_vertices, held_rows, held_runs) = (held_vertices?, held_rows?, held_runs?);
        steps.write(canvas, 0, &places);
        steps.write(held_vertices, 0, &vertices);
        steps.write(held_rows, 0, &starts);
        steps.write(held_runs, 0, &ends);
        let target_bytes = 4 * row_words * out.height;
        let target = self.target.reserve(gpu, target_bytes)?;
        let (first, last) = (sources[0].buffer, sources[views.len() - 1].buffer);
        let buffers = [canvas, first, last, held_vertices, held_rows, held_runs, target];
        steps.run(&self.kernel, &buffers, [columns.len().div_ceil(4), out.height]);
        gpu.submit(&steps)?;
        // The processor draws its part while the GPU works.
        draw_rest(drawing, &columns, out, pool);
        self.drawn.resize(target_bytes, 0);
        gpu.read(target, &mut self.drawn)?;
        let bytes = columns.len() * 3;
        each_row(out, pool, |y, row| {
            row[columns.start * 3..columns.end * 3].copy_from_slice(&self.drawn[y * 4 * row_words..][..bytes]);
        });
        Ok(())
    }
}

impl Painter for Warper {
    fn paint(
        &mut self,
        drawing: &Drawing<'_>,
        out: &mut ViewMut<'_, u8>,
        pool: &dyn Parallel,
    ) -> std::result::Result<(), PaintError> {
        self.draw(drawing, out, pool).map_err(|error| error.to_string().into())
    }
}
