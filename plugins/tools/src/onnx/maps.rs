//! Outputs of a network that are maps: checked against the table, converted to the pixels of the image and its units.

use std::path::Path;

use panoscope_imaging::SharedMut;
use panoscope_node::Parallel;

use super::mismatch::Mismatch;
use super::table::{OutputPort, OutputRule, Unit};
use crate::finite::BrokenNetwork;
use crate::image_input::Layout;
use crate::letterbox::Placement;
use crate::session::{Tensor, Values};

/// Rows of the image per task.
const ROWS_PER_CHUNK: usize = 32;

/// Position of a pixel among the cells of one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Tap {
    near: usize,
    far: usize,
    share: f32,
}

/// Memory layout of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Number of channels.
    pub channels: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    layout: Layout,
}

impl Grid {
    fn index(&self, channel: usize, cell: usize) -> usize {
        match self.layout {
            Layout::Planar => channel * self.width * self.height + cell,
            Layout::Interleaved => cell * self.channels + channel,
        }
    }
}

/// Placement of the image in the network's input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Width and height of the image, px.
    pub image: (usize, usize),
    /// Width and height of the input, px.
    pub input: (usize, usize),
    /// Transform from image to input.
    pub placement: Placement,
}

/// An output of a network that is a map.
pub struct MapOutput {
    /// Name in the model.
    pub name: String,
    /// Rule of the table for this output.
    pub rule: OutputRule,
    key: Option<(Frame, Grid)>,
    columns: Vec<Tap>,
    rows: Vec<Tap>,
}

/// Numbers of channels that an output of a kind may have, and its shape in messages.
fn channels_of(rule: &OutputRule) -> (&'static [usize], &'static str) {
    match rule.port {
        _ if rule.channel.is_some() => (&[], "1xCxHxW or 1xHxWxC"),
        OutputPort::Mask => (&[], "1xCxHxW, 1xHxWxC, 1xHxW or HxW"),
        OutputPort::Flow => (&[2], "1x2xHxW or 1xHxWx2"),
        OutputPort::Image => (&[3, 1], "1x3xHxW, 1xHxWx3 or 1x1xHxW"),
        _ => (&[1], "1x1xHxW, 1xHxWx1, 1xHxW or HxW"),
    }
}

impl MapOutput {
    /// An output by its rule.
    pub fn new(name: &str, rule: &OutputRule) -> Self {
        let rule = rule.clone();
        Self { name: name.to_owned(), rule, key: None, columns: Vec::new(), rows: Vec::new() }
    }

    /// Finds channels, rows and columns of an output, and checks that it has usable values.
    ///
    /// # Errors
    /// The shape does not fit the rule, is not in proportion to the input, or no value is finite.
    pub fn grid(&self, path: &Path, tensor: &Tensor<'_>, (width, height): (usize, usize)) -> Result<Grid, Mismatch> {
        let (counts, shape) = channels_of(&self.rule);
        let wrong = |about: &str| Mismatch::Output {
            path: path.to_owned(),
            found: tensor.to_string(),
            expected: format!("`{}`: {shape}{about}", self.rule.port.name()),
            width,
            height,
        };
        // Whole numbers are classes of pixels, one for each.
        let is_classes = matches!(tensor.data, Values::Int(_));
        let fits = |count: usize| match self.rule.channel {
            _ if is_classes => count == 1,
            Some(channel) => count > channel,
            None if counts.is_empty() => count > 0,
            None => counts.contains(&count),
        };
        let planar = |c: usize, h: usize, w: usize| Grid { channels: c, width: w, height: h, layout: Layout::Planar };
        let interleaved = |h: usize, w: usize, c: usize| Grid { layout: Layout::Interleaved, ..planar(c, h, w) };
        let candidates = match tensor.shape[..] {
            [1, a, b, c] => vec![planar(a, b, c), interleaved(a, b, c)],
            [a, b, c] if a == 1 => vec![planar(1, b, c), interleaved(a, b, c)],
            [a, b, c] => vec![planar(a, b, c), interleaved(a, b, c)],
            [h, w] => vec![planar(1, h, w)],
            _ => Vec::new(),
        };
        let is_wanted = |grid: &Grid| fits(grid.channels) && self.rule.axes.is_none_or(|axes| axes == grid.layout);
        let mut wanted = candidates.into_iter().filter(is_wanted).peekable();
        if wanted.peek().is_none() {
            return Err(wrong(&self.rule.channel.map_or(String::new(), |channel| format!(" with channel {channel}"))));
        }
        let grid = wanted.find(|grid| is_in_proportion(grid, (width, height)));
        let grid = grid.ok_or_else(|| wrong(&format!(" with HxW in proportion to {height}x{width}")))?;
        let values = tensor.data.floats().unwrap_or(&[0.0]);
        if !values.iter().any(|value| value.is_finite()) {
            let (output, bad) = (tensor.name.to_owned(), values.len());
            let extent = "that is all of them";
            return Err(BrokenNetwork { path: path.to_owned(), output, bad, values: bad, extent }.into());
        }
        match tensor.data {
            Values::Other => Err(wrong(", of numbers")),
            Values::Int(_) if self.rule.port != OutputPort::Mask => Err(wrong(", of floats or bytes")),
            _ => Ok(grid),
        }
    }

    /// Computes the position of each pixel of the image among the cells of the map, if sizes changed.
    fn update(&mut self, frame: &Frame, grid: &Grid) {
        if self.key == Some((*frame, *grid)) {
            return;
        }
        let Placement { scale, offset, .. } = frame.placement;
        self.columns = taps(frame.image.0, scale[0], offset[0], frame.input.0, grid.width);
        self.rows = taps(frame.image.1, scale[1], offset[1], frame.input.1, grid.height);
        self.key = Some((*frame, *grid));
    }

    /// Factor from the network's unit to px of the image or mm.
    fn unit_factor(&self, frame: &Frame, grid: &Grid, axis: usize) -> f32 {
        let (side, cells) = if axis == 0 { (frame.input.0, grid.width) } else { (frame.input.1, grid.height) };
        let scale = frame.placement.scale[axis];
        match self.rule.unit {
            Some(Unit::Cells) => side as f32 / cells as f32 / scale,
            Some(Unit::Share) => side as f32 / scale,
            Some(Unit::Px) => 1.0 / scale,
            Some(Unit::Cm) => 10.0,
            Some(Unit::M) => 1000.0,
            None if matches!(self.rule.port, OutputPort::Disparity | OutputPort::Flow) => 1.0 / scale,
            _ => 1.0,
        }
    }

    /// Writes a channel as a map of the image's size, interpolated between cells: `out` has as many values as the image has pixels, and each is
    /// passed through `finish` with its index, after scale, offset, activation and unit. `axis` is 1 for vertical motion.
    pub fn fill<T: Send>(
        &mut self,
        tensor: &Tensor<'_>,
        (frame, grid): (&Frame, &Grid),
        (channel, axis): (usize, usize),
        (out, step, at): (&mut [T], usize, usize),
        pool: &dyn Parallel,
        finish: impl Fn(f32, usize) -> T + Sync,
    ) {
        self.update(frame, grid);
        let factor = self.unit_factor(frame, grid, axis);
        let OutputRule { scale, offset, activation, .. } = self.rule;
        let Some(values) = tensor.data.floats() else { return };
        let (columns, rows, width) = (&self.columns, &self.rows, frame.image.0);
        let shared = SharedMut::new(out);
        pool.run(rows.len().div_ceil(ROWS_PER_CHUNK), &|chunk| {
            for y in chunk * ROWS_PER_CHUNK..((chunk + 1) * ROWS_PER_CHUNK).min(rows.len()) {
                let row = rows[y];
                // SAFETY: one row of the image, written by this chunk alone.
                let line = unsafe { shared.part(y * width * step, width * step) };
                for (x, column) in columns.iter().enumerate() {
                    let value = |row: usize, column: usize| values[grid.index(channel, row * grid.width + column)];
                    let mix = |row: usize| {
                        let (near, far) = (value(row, column.near), value(row, column.far));
                        if column.share == 0.0 { near } else { near + column.share * (far - near) }
                    };
                    let near = mix(row.near);
                    let mixed = if row.share == 0.0 { near } else { near + row.share * (mix(row.far) - near) };
                    line[x * step + at] = finish(activation.of(scale * mixed + offset) * factor, y * width + x);
                }
            }
        });
    }

    /// Writes 255 where the most probable class of the nearest cell is wanted: the rule's channel, or any but class 0.
    pub fn fill_classes(&mut self, tensor: &Tensor<'_>, frame: &Frame, grid: &Grid, out: &mut [u8]) {
        self.update(frame, grid);
        let wanted = self.rule.channel;
        let is_set = |class: i64| wanted.map_or(class != 0, |wanted| class == wanted as i64);
        for (line, row) in out.chunks_exact_mut(frame.image.0).zip(&self.rows) {
            for (pixel, column) in line.iter_mut().zip(&self.columns) {
                let cell = nearest(row) * grid.width + nearest(column);
                let class = match tensor.data {
                    Values::Int(values) => values[grid.index(0, cell)],
                    Values::Float(values) => likeliest(grid.channels, |channel| values[grid.index(channel, cell)]),
                    Values::Other => 0,
                };
                *pixel = if is_set(class) { 255 } else { 0 };
            }
        }
    }
}

fn nearest(tap: &Tap) -> usize {
    if tap.share < 0.5 { tap.near } else { tap.far }
}

fn likeliest(channels: usize, score: impl Fn(usize) -> f32) -> i64 {
    let better = |best: (usize, f32), channel: usize| {
        let own = score(channel);
        if own > best.1 { (channel, own) } else { best }
    };
    (0..channels).fold((0, f32::NEG_INFINITY), better).0 as i64
}

/// Whether a map has the proportions of the input, up to one cell.
fn is_in_proportion(grid: &Grid, (width, height): (usize, usize)) -> bool {
    let [w, h, gw, gh] = [width, height, grid.width, grid.height].map(|n| n as f64);
    gw > 0.0 && gh > 0.0 && ((gw * h / w - gh).abs() <= 1.0 || (gh * w / h - gw).abs() <= 1.0)
}

/// Positions of `count` pixels of the image among `cells` cells that cover `side` px of the input.
fn taps(count: usize, scale: f32, offset: f32, side: usize, cells: usize) -> Vec<Tap> {
    let last = cells.saturating_sub(1);
    let tap = |pixel: usize| {
        let in_input = (pixel as f64 + 0.5) * f64::from(scale) + f64::from(offset);
        let at = (in_input * cells as f64 / side as f64 - 0.5).clamp(0.0, last as f64);
        let near = at.floor();
        Tap { near: near as usize, far: (near as usize + 1).min(last), share: (at - near) as f32 }
    };
    (0..count).map(tap).collect()
}

#[cfg(test)]
mod tests {
    use panoscope_imaging::Serial;

    use super::*;
    use crate::letterbox::Fit;
    use crate::onnx::table::PortTable;

    fn output(keys: &str) -> MapOutput {
        let text = format!("[inputs.a]\nport = \"image\"\n[outputs.m]\n{keys}");
        let table = PortTable::parse("t", &text).expect("a table");
        MapOutput::new("m", &table.outputs["m"])
    }

    fn frame(image: (usize, usize), input: (usize, usize), fit: Fit) -> Frame {
        Frame { image, input, placement: Placement::new(image.0, image.1, input, fit) }
    }

    fn filled(output: &mut MapOutput, tensor: &Tensor<'_>, frame: &Frame) -> Vec<f32> {
        let grid = output.grid(Path::new("m.onnx"), tensor, frame.input).expect("a map");
        let mut out = vec![0.0; frame.image.0 * frame.image.1];
        let at = (output.rule.channel.unwrap_or(0), 0);
        output.fill(tensor, (frame, &grid), at, (&mut out, 1, 0), &Serial, |value, _| value);
        out
    }

    #[test]
    fn a_map_of_the_image_s_size_stays_as_it_is() {
        let values: Vec<f32> = (0..24).map(|i| if i == 5 { f32::NAN } else { i as f32 + 0.25 }).collect();
        let tensor = Tensor { name: "m", shape: vec![1, 1, 4, 6], data: Values::Float(&values) };
        let out = filled(&mut output("port = \"disparity\""), &tensor, &frame((6, 4), (6, 4), Fit::Stretch));
        assert!(out.iter().zip(&values).all(|(a, b)| a.to_bits() == b.to_bits()), "{out:?}");
    }

    #[test]
    fn disparities_of_a_smaller_input_are_in_px_of_the_image() {
        // Cells of 2 px of an input of 8 x 4, which shows an image of 16 x 8.
        let tensor = Tensor { name: "m", shape: vec![1, 2, 4], data: Values::Float(&[3.0; 8]) };
        let frame = frame((16, 8), (8, 4), Fit::Stretch);
        for (unit, px) in [("px", 6.0), ("cells", 12.0), ("share", 48.0)] {
            let mut map = output(&format!("port = \"disparity\"\nunit = \"{unit}\""));
            assert_eq!(filled(&mut map, &tensor, &frame), vec![px; 128], "{unit}");
        }
        let mut depth = output("port = \"depth\"\nunit = \"m\"\nscale = 0.5\noffset = 0.5\nactivation = \"inverse\"");
        assert_eq!(filled(&mut depth, &tensor, &frame), vec![500.0; 128]);
    }

    #[test]
    fn cells_beside_the_image_are_left_out() {
        // An image of 4 x 2 in the middle of 4 x 4: its rows are 1 and 2 of the map.
        let values: Vec<f32> = (0..16).map(|i| (i / 4) as f32).collect();
        let tensor = Tensor { name: "m", shape: vec![4, 4], data: Values::Float(&values) };
        let out = filled(&mut output("port = \"confidence\""), &tensor, &frame((4, 2), (4, 4), Fit::Centre));
        assert_eq!(out, [1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0]);
    }

    #[test]
    fn masks_are_classes_or_one_of_them() {
        // Three classes of 2 x 2 cells, channels last: 0, 1, 2, 1.
        let scores = [9.0, 0.0, 0.0, 0.0, 5.0, 1.0, 0.0, 1.0, 2.0, 0.1, 0.2, 0.0];
        let tensor = Tensor { name: "m", shape: vec![1, 2, 2, 3], data: Values::Float(&scores) };
        let frame = frame((2, 2), (2, 2), Fit::Stretch);
        let classes = |keys: &str, tensor: &Tensor<'_>| {
            let mut map = output(&format!("port = \"mask\"\n{keys}"));
            let grid = map.grid(Path::new("m.onnx"), tensor, (2, 2)).expect("a map");
            let mut out = vec![7; 4];
            map.fill_classes(tensor, &frame, &grid, &mut out);
            out
        };
        assert_eq!(classes("axes = \"nhwc\"", &tensor), [0, 255, 255, 255]);
        let ints = Tensor { name: "m", shape: vec![1, 2, 2], data: Values::Int(&[0, 1, 2, 1]) };
        assert_eq!(classes("", &ints), [0, 255, 255, 255]);
    }
}
