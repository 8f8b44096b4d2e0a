//! Maps of numbers shown in colours on the GPU, where they are; the processor reads a sample of them.

use panoscope_imaging::draw::{self, Colormap};
use panoscope_imaging::{View, ViewMut};
use panoscope_node::Result;
use panoscope_node::device::{DeviceImage, Gpu, Kernel, MARGIN_BYTES, PIXELS, Steps, Store, bytes_of_words};
use panoscope_node::pick::{Grid, Picker};

/// Size of what a shader reads about a call, bytes.
const SIZES_BYTES: usize = 32;
/// Colours of a scale, those below and above it, and that of unknown numbers.
const COLORS: usize = 259;

/// Paints maps of numbers.
#[derive(Debug)]
pub struct MapPainter {
    gpu: Gpu,
    picker: Picker,
    paint: Kernel,
    sizes: Store,
    colors: Store,
    strip: Store,
    numbers: Vec<f32>,
    /// The colours and the strip that are on the GPU.
    held: Option<Colormap>,
    drawn: Vec<u8>,
}

/// Colours of a scale as the shader reads them.
fn colors_of(map: Colormap) -> Vec<u8> {
    let numbers: Vec<f32> = (0..256).map(|k| k as f32).chain([-9.0, 999.0, f32::NAN]).collect();
    let mut colors = [0; 3 * COLORS];
    let all = View::new(&numbers, COLORS, 1, 1);
    draw::colorize(&all, 0.0, 255.0, map, &mut ViewMut::new(&mut colors, COLORS, 1, 3));
    colors.as_chunks::<3>().0.iter().flat_map(|[b, g, r]| [*b, *g, *r, 0]).collect()
}

impl MapPainter {
    /// Compiles the kernels.
    ///
    /// # Errors
    /// The GPU rejects one.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let picker = Picker::new(gpu)?;
        let paint = gpu.kernel("colors", &[include_str!("colors.wgsl"), PIXELS])?;
        let (sizes, colors, strip) = Default::default();
        Ok(Self { gpu, picker, paint, sizes, colors, strip, numbers: Vec::new(), held: None, drawn: Vec::new() })
    }

    /// Reads every n-th number of every n-th row of a map, for two n.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn sample(&mut self, map: DeviceImage, steps: [usize; 2]) -> Result<[View<'_, f32>; 2]> {
        let grids = steps.map(|step| Grid::of_steps((map.width, map.height), [step; 2]));
        let words = self.picker.pick(map, size_of::<f32>(), &grids)?;
        self.numbers.clear();
        self.numbers.extend(words.iter().map(|word| f32::from_bits(*word)));
        let [first, second] = grids.map(|grid| (grid.columns.len(), grid.rows.len()));
        let (coarse, fine) = self.numbers.split_at(first.0 * first.1);
        Ok([(coarse, first), (fine, second)].map(|(all, (width, height))| View::new(all, width, height, 1)))
    }

    /// Paints a map into the left part of `out`, with the colours that `draw::colorize` gives it between `low` and
    /// `high`, and `strip`, rows of BGR pixels, into the rest. Does not wait for the GPU.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn paint(
        &mut self,
        map: DeviceImage,
        (low, high): (f32, f32),
        colors: Colormap,
        strip: &[u8],
        out: DeviceImage,
    ) -> Result<()> {
        let scale = if high == low || !(high - low).is_finite() { 0.0 } else { 255.0 / (high - low) };
        let [map_row, row, strip_row] = [map.stride_bytes / 4, out.stride_bytes / 4, 3 * (out.width - map.width)];
        let words = [map.width, out.width, map.height, map_row, row, strip_row].map(|word| word as u32);
        let words = bytes_of_words(&[&words[..], &[low.to_bits(), scale.to_bits()]].concat());
        let table = if self.held.replace(colors) == Some(colors) { Vec::new() } else { colors_of(colors) };
        let gpu = self.gpu;
        let buffers = [
            self.sizes.reserve(gpu, SIZES_BYTES)?,
            map.buffer,
            self.colors.reserve(gpu, 4 * COLORS)?,
            self.strip.reserve(gpu, strip.len() + MARGIN_BYTES)?,
            out.buffer,
        ];
        let mut steps = Steps::default();
        steps.write(buffers[0], 0, &words);
        steps.write(buffers[2], 0, &table);
        if strip != self.drawn {
            self.drawn.clear();
            self.drawn.extend_from_slice(strip);
            steps.write(buffers[3], 0, &self.drawn);
        }
        steps.run(&self.paint, &buffers, [out.width.div_ceil(4), out.height]);
        gpu.submit(&steps)
    }
}
