//! A picture fitted into the network's input, and places carried back.

use panoscope_imaging::SharedMut;
use panoscope_node::{Parallel, View};

/// How the network wants its pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelForm {
    /// Red first; else blue first.
    pub rgb: bool,
    /// Subtracted from 0..255, per channel in the network's order.
    pub mean: [f32; 3],
    /// Multiplied after that.
    pub gain: [f32; 3],
    /// Where the picture lies in the input.
    pub fit: Fit,
}

/// Where the picture lies in the network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// Sides kept in proportion, upper left corner, gray 114 beside it (YOLOX).
    Corner,
    /// Sides kept in proportion, in the middle, gray 114 around it (Ultralytics).
    Centre,
    /// Filled, proportions lost (DETR).
    Stretch,
}

/// The gray beside the picture.
const BORDER: f32 = 114.0;

/// From picture to input: `input = picture * scale + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Horizontal, vertical.
    pub scale: [f32; 2],
    /// Horizontal, vertical, in px of the input.
    pub offset: [f32; 2],
    /// Size of the picture in px of the input.
    pub size: [usize; 2],
}

impl Placement {
    /// Where a picture of `width` x `height` px lies in an input of `to` px.
    pub fn new(width: usize, height: usize, to: (usize, usize), fit: Fit) -> Self {
        let (w, h) = (width.max(1) as f32, height.max(1) as f32);
        let (tw, th) = (to.0 as f32, to.1 as f32);
        if fit == Fit::Stretch {
            return Self { scale: [tw / w, th / h], offset: [0.0; 2], size: [to.0, to.1] };
        }
        let scale = (tw / w).min(th / h);
        let round = |v: f32, limit: usize| ((v * scale).round() as usize).clamp(1, limit.max(1));
        let size = [round(w, to.0), round(h, to.1)];
        let free = [(to.0 - size[0]) / 2, (to.1 - size[1]) / 2];
        let offset = if fit == Fit::Centre { [free[0] as f32, free[1] as f32] } else { [0.0; 2] };
        Self { scale: [size[0] as f32 / w, size[1] as f32 / h], offset, size }
    }

    /// A place in the input as a place in the picture.
    pub fn back(&self, x: f32, y: f32) -> (f32, f32) {
        ((x - self.offset[0]) / self.scale[0], (y - self.offset[1]) / self.scale[1])
    }
}

#[derive(Clone, Copy, Default)]
struct Tap {
    near: u32,
    far: u32,
    share: f32,
}

/// Fits pictures into a planar f32 input; keeps its tables while sizes stay.
#[derive(Default)]
pub struct Letterbox {
    key: Option<(usize, usize, usize, usize, usize, Fit)>,
    placement: Option<Placement>,
    columns: Vec<Tap>,
    rows: Vec<Tap>,
    /// Planar, 3 x height x width.
    pub input: Vec<f32>,
}

/// Bilinear taps at pixel centres.
fn taps(out: usize, scale: f32, from: usize, channels: usize) -> Vec<Tap> {
    let tap = |i: usize| {
        let at = ((i as f32 + 0.5) / scale - 0.5).clamp(0.0, from.saturating_sub(1) as f32);
        let near = at.floor();
        let far = (near as usize + 1).min(from.saturating_sub(1));
        Tap { near: (near as usize * channels) as u32, far: (far * channels) as u32, share: at - near }
    };
    (0..out).map(tap).collect()
}

impl Letterbox {
    /// Fits a gray8 or bgr8 picture into `to` (width, height); the result stands in `input`.
    pub fn fit(
        &mut self,
        picture: View<'_, u8>,
        to: (usize, usize),
        form: &PixelForm,
        pool: &dyn Parallel,
    ) -> Placement {
        let (w, h, channels) = (picture.width, picture.height, picture.channels);
        let key = (w, h, channels, to.0, to.1, form.fit);
        let placement = match self.placement {
            Some(placement) if self.key == Some(key) => placement,
            _ => {
                let placement = Placement::new(w, h, to, form.fit);
                self.columns = taps(placement.size[0], placement.scale[0], w, channels);
                self.rows = taps(placement.size[1], placement.scale[1], h, 1);
                let order = |c: usize| (BORDER - form.mean[c]) * form.gain[c];
                self.input.clear();
                (0..3).for_each(|c| self.input.resize((c + 1) * to.0 * to.1, order(c)));
                (self.key, self.placement) = (Some(key), Some(placement));
                placement
            }
        };
        if w == 0 || h == 0 {
            return placement;
        }
        let (x0, y0) = (placement.offset[0] as usize, placement.offset[1] as usize);
        let plane = to.0 * to.1;
        let (columns, rows) = (&self.columns, &self.rows);
        let out = SharedMut::new(&mut self.input);
        let source = |c: usize| {
            if channels < 3 {
                0
            } else if form.rgb {
                2 - c
            } else {
                c
            }
        };
        let lines_per_chunk = 16;
        pool.run(rows.len().div_ceil(lines_per_chunk), &|chunk| {
            for y in chunk * lines_per_chunk..((chunk + 1) * lines_per_chunk).min(rows.len()) {
                let tap = rows[y];
                let (upper, lower, down) = (picture.row(tap.near as usize), picture.row(tap.far as usize), tap.share);
                for c in 0..3 {
                    // SAFETY: one row of one plane, written by this chunk alone.
                    let line = unsafe { out.part(c * plane + (y0 + y) * to.0 + x0, columns.len()) };
                    let (s, mean, gain) = (source(c), form.mean[c], form.gain[c]);
                    for (value, t) in line.iter_mut().zip(columns) {
                        let (near, far) = (t.near as usize + s, t.far as usize + s);
                        let a = f32::from(upper[near]) + t.share * (f32::from(upper[far]) - f32::from(upper[near]));
                        let b = f32::from(lower[near]) + t.share * (f32::from(lower[far]) - f32::from(lower[near]));
                        *value = (a + down * (b - a) - mean) * gain;
                    }
                }
            }
        });
        placement
    }
}
