//! Panoramas drawn on the GPU: views sampled by their matrix or mesh, with the blended columns around the seam as a patch.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use panoscope_imaging::rows::each_row;
use panoscope_imaging::stitch::{Drawing, DrawnView, PaintError, Painter, Patch, Samples};
use panoscope_imaging::{Parallel, ViewMut};
use panoscope_node::device::{DeviceImage, Gpu, Kernel, MARGIN_BYTES, PIXELS, Steps, Store};
use panoscope_node::{Result, error};

/// Words of a view's placement in the shader.
const PLACE_WORDS: usize = 40;
const HEAD_WORDS: usize = 8;
const CANVAS_BYTES: usize = 4 * (HEAD_WORDS + 2 * PLACE_WORDS);
/// Threads in a row of those that sample.
const SAMPLES_PER_ROW: usize = 1024;

/// The images of the next panorama on the GPU.
#[derive(Debug, Default)]
pub struct DeviceFrame {
    /// The views, in the order in which the compositor gets them.
    pub views: Vec<DeviceImage>,
    /// The panorama, if it stays on the GPU.
    pub panorama: Option<DeviceImage>,
}

/// A [`DeviceFrame`] that a node fills and its [`Warper`] reads.
pub type SharedFrame = Arc<Mutex<DeviceFrame>>;

/// The content of a frame, for the time of the guard.
pub fn locked(frame: &SharedFrame) -> MutexGuard<'_, DeviceFrame> {
    frame.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Draws panoramas of one or two views. Keeps its memory on the GPU.
#[derive(Debug)]
pub struct Warper {
    gpu: Gpu,
    kernel: Kernel,
    taps: Kernel,
    frame: SharedFrame,
    /// Memory of both kernels, by binding.
    stores: [Store; 8],
    /// What the processor reads, on the GPU and in the host's memory.
    target: Store,
    read: Vec<u8>,
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

/// Writes a view's placement for the shader; `stride` is the bytes of a row, `first_vertex` its first vertex, `middle`
/// a position near the pixels that are drawn.
fn put_place(words: &mut Vec<u8>, view: &DrawnView<'_>, stride: usize, first_vertex: usize, middle: [f64; 2]) {
    put(words, integers([0, stride as i64, view.size.0 as i64, view.size.1 as i64]));
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
    // Counted from the middle, single precision holds positions well below 1/64 px.
    let m = &view.source_from_canvas;
    for row in 0..3 {
        let [a, b, c] = [m[3 * row], m[3 * row + 1], m[3 * row + 2]];
        put(words, floats([a, b, c + a * middle[0] + b * middle[1], 0.0]));
    }
    put(words, floats([middle[0], middle[1], 0.0, 0.0]));
}

/// What the drawing kernel reads besides the views.
struct Job<'a> {
    views: &'a [DrawnView<'a>],
    /// See [`put_place`].
    middle: [f64; 2],
    /// Head of the canvas in the shader.
    head: [usize; HEAD_WORDS],
    /// First runs of the rows of the canvas, and first columns of those of the patch.
    rows: [&'a [u32]; 2],
    runs: Vec<u32>,
    patch: &'a [u8],
}

impl Warper {
    /// Prepares the GPU. The caller puts the images of each panorama into `frame` first.
    ///
    /// # Errors
    /// It rejects a shader.
    pub fn new(gpu: Gpu, frame: SharedFrame) -> Result<Self> {
        let sample = include_str!("sample.wgsl");
        let kernel = gpu.kernel("warp", &[include_str!("warp.wgsl"), sample, PIXELS])?;
        let taps = gpu.kernel("taps", &[include_str!("taps.wgsl"), sample, PIXELS])?;
        let (stores, target) = Default::default();
        Ok(Self { gpu, kernel, taps, frame, stores, target, read: Vec::new() })
    }

    /// The first and the last of the views of the frame, which have these sizes.
    fn sources(&self, sizes: impl ExactSizeIterator<Item = (usize, usize)>) -> Result<[DeviceImage; 2]> {
        let (frame, count) = (locked(&self.frame), sizes.len());
        if !(1..=2).contains(&count) || !sizes.eq(frame.views.iter().take(count).map(|view| (view.width, view.height)))
        {
            return Err(error!("the views on the GPU are not those of the panorama"));
        }
        Ok([frame.views[0], frame.views[count - 1]])
    }

    /// The buffers of these bindings, with room for as many bytes.
    fn reserve<const N: usize>(&mut self, bindings: [(usize, usize); N]) -> Result<[u64; N]> {
        let mut buffers = [0; N];
        for (buffer, (binding, bytes)) in buffers.iter_mut().zip(bindings) {
            *buffer = self.stores[binding].reserve(self.gpu, bytes + MARGIN_BYTES)?;
        }
        Ok(buffers)
    }

    /// Draws into a buffer.
    fn run(&mut self, job: &Job<'_>, target: u64) -> Result<()> {
        let sources = self.sources(job.views.iter().map(|view| view.size))?;
        let mut canvas = Vec::with_capacity(CANVAS_BYTES);
        put(&mut canvas, integers(job.head.map(|value| value as i64)));
        let mut first_vertex = 0;
        for (view, source) in job.views.iter().zip(&sources) {
            put_place(&mut canvas, view, source.stride_bytes, first_vertex, job.middle);
            first_vertex += view.mesh.map_or(0, |mesh| mesh.source.len());
        }
        canvas.resize(CANVAS_BYTES, 0);
        let [row_bytes, run_bytes] = [4 * (job.rows[0].len() + job.rows[1].len()), 4 * job.runs.len()];
        let sizes = [(0, CANVAS_BYTES), (3, 8 * first_vertex), (4, row_bytes), (5, run_bytes), (6, job.patch.len())];
        let [places, vertices, rows, runs, patch] = self.reserve(sizes)?;
        let mut steps = Steps::default();
        steps.write(places, 0, &canvas);
        let mut first_vertex = 0;
        for mesh in job.views.iter().filter_map(|view| view.mesh) {
            steps.write_plain(vertices, 8 * first_vertex, mesh.source.as_flattened());
            first_vertex += mesh.source.len();
        }
        steps.write_plain(rows, 0, job.rows[0]);
        steps.write_plain(rows, 4 * job.rows[0].len(), job.rows[1]);
        steps.write_plain(runs, 0, &job.runs);
        steps.write(patch, 0, job.patch);
        let [first, second] = sources.map(|source| source.buffer);
        let [width, height, ..] = job.head;
        let buffers = [places, first, second, vertices, rows, runs, patch, target];
        steps.run(&self.kernel, &buffers, [width.div_ceil(4), height]);
        self.gpu.submit(&steps)
    }

    fn sample_views(&mut self, samples: &mut [Samples<'_>]) -> Result<()> {
        let sources = self.sources(samples.iter().map(|samples| samples.size))?;
        if samples.iter().zip(&sources).any(|(samples, source)| samples.stride != source.stride_bytes) {
            return Err(error!("the rows of the views on the GPU are not those of the panorama"));
        }
        let counts = samples.iter().map(|samples| samples.values.len());
        let (first, all) = (samples[0].values.len(), counts.sum::<usize>());
        let words = [first, all, sources[0].stride_bytes, sources[1].stride_bytes].map(|word| word as u32);
        let [head, positions] = self.reserve([(0, CANVAS_BYTES), (7, 8 * all)])?;
        let target = self.target.reserve(self.gpu, 4 * all)?;
        let mut steps = Steps::default();
        steps.write_plain(head, 0, &words);
        for (samples, offset) in samples.iter().zip([0, 8 * first]) {
            steps.write_plain(positions, offset, samples.positions.as_flattened());
        }
        let buffers = [head, sources[0].buffer, sources[1].buffer, positions, target];
        steps.run(&self.taps, &buffers, [SAMPLES_PER_ROW, all.div_ceil(SAMPLES_PER_ROW)]);
        self.gpu.submit(&steps)?;
        self.read.resize(4 * all, 0);
        self.gpu.read(target, &mut self.read)?;
        let values = samples.iter_mut().flat_map(|samples| samples.values.iter_mut());
        values.zip(self.read.as_chunks::<4>().0).for_each(|(value, read)| *value = *read);
        Ok(())
    }

    fn draw_patch(&mut self, views: &[DrawnView<'_>; 2], patch: &mut Patch) -> Result<()> {
        let (stride, rows) = (patch.stride(), patch.starts.len());
        let middle = [f64::from(patch.starts[rows / 2]), (patch.top + rows / 2) as f64];
        let head = [patch.width, 2 * rows, stride / 4, 1, patch.top, rows, stride, 0];
        let target = self.target.reserve(self.gpu, patch.pixels.len())?;
        self.run(&Job { views, middle, head, rows: [&patch.starts, &[]], runs: Vec::new(), patch: &[] }, target)?;
        self.gpu.read(target, &mut patch.pixels)
    }

    fn draw(&mut self, drawing: &Drawing<'_>, out: Option<&mut ViewMut<'_, u8>>, pool: &dyn Parallel) -> Result<()> {
        let (width, height) = drawing.size;
        let stride = DeviceImage::stride_bytes(width, 3);
        let target = match &out {
            Some(_) => self.target.reserve(self.gpu, stride * height)?,
            None => locked(&self.frame)
                .panorama
                .take()
                .filter(|image| (image.width, image.height, image.stride_bytes) == (width, height, stride))
                .map(|image| image.buffer)
                .ok_or_else(|| error!("no image of {width}x{height} on the GPU for the panorama"))?,
        };
        let starts = drawing.patch.map_or(&[][..], |patch| &patch.starts);
        let rows = [drawing.runs.starts(), starts];
        let runs = drawing.runs.list().iter().map(|(end, shows)| (end << 2) | u32::from(*shows)).collect();
        let [top, patch_stride] = drawing.patch.map_or([0; 2], |patch| [patch.top, patch.stride()]);
        let patch = drawing.patch.map_or(&[][..], |patch| &patch.pixels[..patch.bytes()]);
        let head = [width, height, stride / 4, 0, top, starts.len(), patch_stride, height + 1];
        let middle = [(width / 2) as f64, (height / 2) as f64];
        self.run(&Job { views: drawing.views, middle, head, rows, runs, patch }, target)?;
        let Some(out) = out else { return Ok(()) };
        self.read.resize(stride * height, 0);
        self.gpu.read(target, &mut self.read)?;
        each_row(out, pool, |y, row| row.copy_from_slice(&self.read[y * stride..][..3 * width]));
        Ok(())
    }
}

fn painted(result: Result<()>) -> std::result::Result<(), PaintError> {
    result.map_err(|error| error.to_string().into())
}

impl Painter for Warper {
    fn sample(&mut self, samples: &mut [Samples<'_>]) -> std::result::Result<(), PaintError> {
        painted(self.sample_views(samples))
    }

    fn draw_columns(&mut self, views: &[DrawnView<'_>; 2], patch: &mut Patch) -> std::result::Result<(), PaintError> {
        painted(self.draw_patch(views, patch))
    }

    fn paint(
        &mut self,
        drawing: &Drawing<'_>,
        out: Option<&mut ViewMut<'_, u8>>,
        pool: &dyn Parallel,
    ) -> std::result::Result<(), PaintError> {
        painted(self.draw(drawing, out, pool))
    }
}
