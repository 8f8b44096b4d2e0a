//! Fits an image into the network's input, and maps positions back.

use panoscope_imaging::SharedMut;
use panoscope_node::{Parallel, View};

/// Pixel form that a network expects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelForm {
    /// Order of the channels: red first, or blue first.
    pub rgb: bool,
    /// Subtracted from 0..255, per channel in the network's order.
    pub mean: [f32; 3],
    /// Multiplied after the subtraction, per channel.
    pub gain: [f32; 3],
    /// Placement of the image in the input.
    pub fit: Fit,
    /// Gray level of the padding, 0..255.
    pub border: f32,
}

/// Placement of the image in the network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// Scaled in proportion, at the upper left corner (YOLOX).
    Corner,
    /// Scaled in proportion, centred (Ultralytics).
    Centre,
    /// Stretched; proportions are lost (DETR).
    Stretch,
    /// Not scaled, at the upper left corner; the input is at least as large.
    Keep,
}

/// Gray level of the padding with which detectors of the YOLO families are trained.
pub const BORDER: f32 = 114.0;

/// Transform from image to input: `input = picture * scale + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Scale along x and y.
    pub scale: [f32; 2],
    /// Offset along x and y, px of the input.
    pub offset: [f32; 2],
    /// Size of the image in px of the input.
    pub size: [usize; 2],
}

impl Placement {
    /// Placement of an image of `width` x `height` px in an input of `to` px.
    pub fn new(width: usize, height: usize, to: (usize, usize), fit: Fit) -> Self {
        let (w, h) = (width.max(1) as f32, height.max(1) as f32);
        let (tw, th) = (to.0 as f32, to.1 as f32);
        if fit == Fit::Stretch {
            return Self { scale: [tw / w, th / h], offset: [0.0; 2], size: [to.0, to.1] };
        }
        let scale = if fit == Fit::Keep { 1.0 } else { (tw / w).min(th / h) };
        let round = |v: f32, limit: usize| ((v * scale).round() as usize).clamp(1, limit.max(1));
        let size = [round(w, to.0), round(h, to.1)];
        let free = [(to.0 - size[0]) / 2, (to.1 - size[1]) / 2];
        let offset = if fit == Fit::Centre { [free[0] as f32, free[1] as f32] } else { [0.0; 2] };
        Self { scale: [size[0] as f32 / w, size[1] as f32 / h], offset, size }
    }

    /// Maps a position in the input to the image.
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

/// Rows of the input per task.
const LINES_PER_CHUNK: usize = 16;

/// Fits images into a planar f32 input; keeps its tables while the sizes do not change.
#[derive(Default)]
pub struct Letterbox {
    key: Option<(usize, usize, usize, usize, usize, Fit)>,
    placement: Option<Placement>,
    columns: Vec<Tap>,
    rows: Vec<Tap>,
    /// One mixed row of the image for each task, from which columns are sampled.
    lines: Vec<f32>,
    /// The input: planar, 3 x height x width.
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

/// Mixes two rows: contiguous, so that it is vectorised.
fn mix(upper: &[u8], lower: &[u8], share: f32, out: &mut [f32]) {
    for ((o, &a), &b) in out.iter_mut().zip(upper).zip(lower) {
        let (a, b) = (f32::from(a), f32::from(b));
        *o = a + share * (b - a);
    }
}

impl Letterbox {
    /// Fits a gray8 or bgr8 image into `to` (width, height); the result is in `input`.
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
                let order = |c: usize| (form.border - form.mean[c]) * form.gain[c];
                self.input.clear();
                (0..3).for_each(|c| self.input.resize((c + 1) * to.0 * to.1, order(c)));
                self.lines.clear();
                self.lines.resize(self.rows.len().div_ceil(LINES_PER_CHUNK) * w * channels, 0.0);
                (self.key, self.placement) = (Some(key), Some(placement));
                placement
            }
        };
        if w == 0 || h == 0 {
            return placement;
        }
        let (x0, y0) = (placement.offset[0] as usize, placement.offset[1] as usize);
        let plane = to.0 * to.1;
        let (columns, rows, row_len) = (&self.columns, &self.rows, w * channels);
        let out = SharedMut::new(&mut self.input);
        let lines = SharedMut::new(&mut self.lines);
        // Plane of the input that each channel of a colour picture goes to.
        let target = if form.rgb { [2, 1, 0] } else { [0, 1, 2] };
        pool.run(rows.len().div_ceil(LINES_PER_CHUNK), &|chunk| {
            // SAFETY: one line for each chunk.
            let line = unsafe { lines.part(chunk * row_len, row_len) };
            for y in chunk * LINES_PER_CHUNK..((chunk + 1) * LINES_PER_CHUNK).min(rows.len()) {
                let tap = rows[y];
                mix(picture.row(tap.near as usize), picture.row(tap.far as usize), tap.share, line);
                let at = |c: usize| c * plane + (y0 + y) * to.0 + x0;
                // SAFETY: one row of each of three planes, written by this chunk alone.
                let [first, second, third] = [0, 1, 2].map(|c| unsafe { out.part(at(c), columns.len()) });
                let scale = |c: usize, v: f32| (v - form.mean[c]) * form.gain[c];
                let pixels = columns.iter().zip(first).zip(second).zip(third);
                if channels < 3 {
                    for (((t, a), b), c) in pixels {
                        let (near, far) = (line[t.near as usize], line[t.far as usize]);
                        let v = near + t.share * (far - near);
                        (*a, *b, *c) = (scale(0, v), scale(1, v), scale(2, v));
                    }
                    continue;
                }
                for (((t, a), b), c) in pixels {
                    let (near, far) = (&line[t.near as usize..][..3], &line[t.far as usize..][..3]);
                    let v: [f32; 3] = std::array::from_fn(|k| near[k] + t.share * (far[k] - near[k]));
                    *a = scale(0, v[target[0]]);
                    *b = scale(1, v[target[1]]);
                    *c = scale(2, v[target[2]]);
                }
            }
        });
        placement
    }
}

#[cfg(test)]
mod tests {
    use panoscope_imaging::Serial;

    use super::*;

    const PLAIN: PixelForm = PixelForm { rgb: false, mean: [0.0; 3], gain: [1.0; 3], fit: Fit::Corner, border: BORDER };

    /// Bilinear interpolation by the formula, pixel by pixel.
    fn expected(picture: &[u8], (w, h): (usize, usize), channel: usize, x: f32, y: f32) -> f32 {
        let (x, y) = (x.clamp(0.0, w as f32 - 1.0), y.clamp(0.0, h as f32 - 1.0));
        let at = |x: usize, y: usize| f32::from(picture[(y.min(h - 1) * w + x.min(w - 1)) * 3 + channel]);
        let (x0, y0) = (x as usize, y as usize);
        let (fx, fy) = (x.fract(), y.fract());
        let upper = at(x0, y0) * (1.0 - fx) + at(x0 + 1, y0) * fx;
        let lower = at(x0, y0 + 1) * (1.0 - fx) + at(x0 + 1, y0 + 1) * fx;
        upper * (1.0 - fy) + lower * fy
    }

    #[test]
    fn pixels_are_mixed_from_their_neighbours() {
        for (w, h, to, form) in [
            (37, 23, (64, 32), PLAIN),
            (
                120,
                90,
                (64, 64),
                PixelForm { rgb: true, mean: [10.0, 20.0, 30.0], gain: [0.5, 0.25, 2.0], fit: Fit::Centre, ..PLAIN },
            ),
            (1, 1, (32, 32), PixelForm { fit: Fit::Stretch, ..PLAIN }),
            (40, 30, (64, 32), PixelForm { fit: Fit::Keep, border: 7.0, ..PLAIN }),
        ] {
            let picture: Vec<u8> = (0..w * h * 3).map(|i| (i * 37 % 251) as u8).collect();
            let mut letterbox = Letterbox::default();
            let p = letterbox.fit(View::new(&picture, w, h, 3), to, &form, &Serial);
            for c in 0..3 {
                let from = if form.rgb { 2 - c } else { c };
                for (y, x) in (0..to.1).flat_map(|y| (0..to.0).map(move |x| (y, x))) {
                    let (u, v) = (x as f32 - p.offset[0], y as f32 - p.offset[1]);
                    let inside = u >= 0.0 && v >= 0.0 && u < p.size[0] as f32 && v < p.size[1] as f32;
                    let value = if inside {
                        expected(&picture, (w, h), from, (u + 0.5) / p.scale[0] - 0.5, (v + 0.5) / p.scale[1] - 0.5)
                    } else {
                        form.border
                    };
                    let want = (value - form.mean[c]) * form.gain[c];
                    let got = letterbox.input[c * to.0 * to.1 + y * to.0 + x];
                    assert!((got - want).abs() < 0.02, "{w}x{h} plane {c} at {x}, {y}: {got} instead of {want}");
                }
            }
        }
    }

    #[test]
    fn gray_pictures_fill_all_planes() {
        let picture: Vec<u8> = (0..40 * 20).map(|i| (i % 256) as u8).collect();
        let mut letterbox = Letterbox::default();
        letterbox.fit(View::new(&picture, 40, 20, 1), (64, 32), &PLAIN, &Serial);
        let (first, rest) = letterbox.input.split_at(64 * 32);
        assert_eq!(first, &rest[..64 * 32]);
        assert_eq!(first, &rest[64 * 32..]);
        assert!(first.iter().any(|v| *v != first[0]));
    }
}
