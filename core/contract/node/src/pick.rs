//! Parts of frames that are on the GPU: what a node of the processor reads of them is copied, not the frame.

use std::marker::PhantomData;

use panoscope_base::{Rect, View, ViewMut};

use crate::abi::{CloudPoint, Frame};
use crate::device::{DeviceImage, Gpu, Kernel, Steps, Store, bytes_of_words};
use crate::error::Result;
use crate::input::{Cloud, Image};
use crate::packet::{Plain, Plane, bytes_of, bytes_of_mut};

/// Words that the shader reads about a call.
const CALL_BYTES: usize = 28;

/// A frame whose pixels can be picked.
pub trait Pixels<'f>: Copy {
    /// One channel of one pixel.
    type Element: Plain;
    /// Elements per pixel.
    const CHANNELS: usize;

    /// The frame as the host describes it.
    fn frame(&self) -> &'f Frame;

    /// All pixels, copied to the host's memory if they are not there.
    fn whole(&self) -> View<'f, Self::Element>;
}

impl<'f, P: Plane> Pixels<'f> for Image<'f, P> {
    type Element = P::Element;
    const CHANNELS: usize = P::CHANNELS;

    fn frame(&self) -> &'f Frame {
        Image::frame(self)
    }

    fn whole(&self) -> View<'f, P::Element> {
        self.view()
    }
}

impl<'f> Pixels<'f> for Cloud<'f> {
    type Element = CloudPoint;
    const CHANNELS: usize = 1;

    fn frame(&self) -> &'f Frame {
        Cloud::frame(self)
    }

    fn whole(&self) -> View<'f, CloudPoint> {
        View::new(self.points(), self.width(), self.height(), 1)
    }
}

/// Rows and columns of an image, ascending.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Grid {
    /// Columns, px.
    pub columns: Vec<u32>,
    /// Rows.
    pub rows: Vec<u32>,
}

impl Grid {
    /// All pixels of an area.
    pub fn of_area(area: Rect) -> Self {
        let range = |from: usize, length: usize| (from as u32..(from + length) as u32).collect();
        Self { columns: range(area.x, area.width), rows: range(area.y, area.height) }
    }

    /// Each `step`-th column and row of an image.
    pub fn of_steps((width, height): (usize, usize), [x, y]: [usize; 2]) -> Self {
        let range = |length: usize, step: usize| (0..length as u32).step_by(step.max(1)).collect();
        Self { columns: range(width, x), rows: range(height, y) }
    }

    fn is_empty(&self) -> bool {
        self.columns.is_empty() || self.rows.is_empty()
    }

    /// Words of a row, and of all.
    fn words(&self, pixel_bytes: usize) -> (usize, usize) {
        let row = (self.columns.len() * pixel_bytes).div_ceil(4);
        (row, row * self.rows.len())
    }
}

/// Picks pixels on the GPU.
#[derive(Debug)]
pub struct Picker {
    gpu: Gpu,
    kernel: Kernel,
    call: Store,
    chosen: Store,
    picked: Store,
    words: Vec<u32>,
}

impl Picker {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// The GPU rejects it.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let kernel = gpu.kernel("pick", &[include_str!("pick.wgsl")])?;
        let (call, chosen, picked) = Default::default();
        Ok(Self { gpu, kernel, call, chosen, picked, words: Vec::new() })
    }

    /// Reads grids of an image of `pixel_bytes` per pixel, all together. Rows of the result have no padding but up to
    /// whole words; each grid begins where the one before ends.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn pick(&mut self, image: DeviceImage, pixel_bytes: usize, grids: &[Grid]) -> Result<&[u32]> {
        let total = grids.iter().map(|grid| grid.words(pixel_bytes).1).sum();
        self.words.clear();
        self.words.resize(total, 0);
        if total == 0 {
            return Ok(&self.words);
        }
        let numbers: Vec<u32> = grids.iter().flat_map(|grid| grid.columns.iter().chain(&grid.rows)).copied().collect();
        let (mut first, mut start) = (0, 0);
        let calls = grids.iter().map(|grid| {
            let (row, all) = grid.words(pixel_bytes);
            let (columns, rows) = (grid.columns.len(), grid.rows.len());
            let words = [row, rows, image.stride_bytes, pixel_bytes, columns, first, start];
            (first, start) = (first + columns + rows, start + all);
            bytes_of_words(&words.map(|word| word as u32))
        });
        let calls: Vec<_> = calls.collect();
        let call = self.call.reserve(self.gpu, CALL_BYTES)?;
        let chosen = self.chosen.reserve(self.gpu, 4 * numbers.len())?;
        let picked = self.picked.reserve(self.gpu, 4 * total)?;
        let mut steps = Steps::default();
        steps.write_plain(chosen, 0, &numbers);
        for (grid, words) in grids.iter().zip(&calls).filter(|(grid, _)| !grid.is_empty()) {
            // Steps run in their order: each reads its own call.
            steps.write(call, 0, words);
            let threads = [grid.words(pixel_bytes).0, grid.rows.len()];
            steps.run(&self.kernel, &[call, chosen, image.buffer, picked], threads);
        }
        self.gpu.submit(&steps)?;
        self.gpu.read_plain(picked, &mut self.words)?;
        Ok(&self.words)
    }
}

/// An image of which only what was picked is known.
///
/// For a frame of the host's memory it is the frame itself. Of one on the GPU it has the picked pixels at their
/// positions, and at all others unspecified ones, such as those of earlier frames.
#[derive(Debug)]
pub struct Parts<T> {
    /// The pixels. Fresh memory takes no room where nothing is written.
    memory: Vec<u64>,
    element: PhantomData<T>,
    picker: Option<Picker>,
    /// Whether the GPU failed: frames are copied whole from then on.
    has_failed: bool,
}

impl<T> Default for Parts<T> {
    fn default() -> Self {
        Self { memory: Vec::new(), element: PhantomData, picker: None, has_failed: false }
    }
}

impl<T: Plain> Parts<T> {
    /// The image with these parts, see [`Parts`]. All of it where the GPU fails.
    pub fn view<'a, 'f: 'a, P: Pixels<'f, Element = T>>(&'a mut self, image: P, grids: &[Grid]) -> View<'a, T> {
        let frame = image.frame();
        if frame.buffer.home == crate::abi::HOME_HOST || self.has_failed {
            return image.whole();
        }
        if self.pick::<P>(frame, grids).is_err() {
            self.has_failed = true;
            return image.whole();
        }
        let (width, height) = (frame.width as usize, frame.height as usize);
        View::new(&self.pixels()[..width * height * P::CHANNELS], width, height, P::CHANNELS)
    }

    /// As [`Self::view`] to draw on, for a frame on the GPU or one that is copied there.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn canvas<'f, P: Pixels<'f, Element = T>>(&mut self, image: P, grids: &[Grid]) -> Result<ViewMut<'_, T>> {
        let frame = image.frame();
        self.pick::<P>(frame, grids)?;
        let (width, height) = (frame.width as usize, frame.height as usize);
        let pixels = &mut self.pixels_mut()[..width * height * P::CHANNELS];
        Ok(ViewMut::new(pixels, width, height, P::CHANNELS))
    }

    fn pick<'f, P: Pixels<'f, Element = T>>(&mut self, frame: &Frame, grids: &[Grid]) -> Result<()> {
        let (width, height) = (frame.width as usize, frame.height as usize);
        let words = (width * height * P::CHANNELS * size_of::<T>()).div_ceil(size_of::<u64>());
        if self.memory.len() != words {
            self.memory = vec![0; words];
        }
        let picker = match &mut self.picker {
            Some(picker) => picker,
            none => none.insert(Picker::new(Gpu::open()?)?),
        };
        let pixel_bytes = P::CHANNELS * size_of::<T>();
        let mut words = picker.pick(DeviceImage::of(frame)?, pixel_bytes, grids)?;
        for grid in grids.iter().filter(|grid| !grid.is_empty()) {
            let (row, all) = grid.words(pixel_bytes);
            for (y, words) in grid.rows.iter().zip(words.chunks_exact(row)) {
                let line = &mut bytes_of_mut(&mut self.memory)[*y as usize * width * pixel_bytes..];
                scatter(bytes_of(words), &grid.columns, pixel_bytes, line);
            }
            words = &words[all..];
        }
        Ok(())
    }

    fn pixels(&self) -> &[T] {
        const { assert!(align_of::<T>() <= align_of::<u64>()) }
        let count = size_of_val(&self.memory[..]) / size_of::<T>();
        // SAFETY: plain data, whose bytes the memory has, as aligned as this type at least.
        unsafe { std::slice::from_raw_parts(self.memory.as_ptr().cast(), count) }
    }

    fn pixels_mut(&mut self) -> &mut [T] {
        let count = self.pixels().len();
        // SAFETY: as in `pixels`; every bit pattern of plain data is valid.
        unsafe { std::slice::from_raw_parts_mut(self.memory.as_mut_ptr().cast(), count) }
    }
}

/// Writes the pixels of a packed row to their columns: in one piece where these are neighbours.
fn scatter(packed: &[u8], columns: &[u32], pixel_bytes: usize, line: &mut [u8]) {
    let (Some(first), Some(last)) = (columns.first(), columns.last()) else { return };
    if (last - first) as usize + 1 == columns.len() {
        let length = columns.len() * pixel_bytes;
        line[*first as usize * pixel_bytes..][..length].copy_from_slice(&packed[..length]);
        return;
    }
    for (pixel, x) in packed.chunks_exact(pixel_bytes).zip(columns) {
        line[*x as usize * pixel_bytes..][..pixel_bytes].copy_from_slice(pixel);
    }
}
