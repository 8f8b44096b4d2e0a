//! Images as inputs of a network, as its table describes them.

use std::path::Path;

use panoscope_base::gray::bgr_to_gray;
use panoscope_imaging::SharedMut;
use panoscope_node::{Parallel, View, ViewMut};

use super::mismatch::{Mismatch, size_text};
use super::table::{FitRule, InputPort, InputRule, Order};
use crate::image_input::{Element, ImageInput, Layout, Packed};
use crate::letterbox::{Fit, Letterbox, PixelForm, Placement};
use crate::session::{Declared, RunInput};

/// Side of the first trial input of a network of variable size, px: a multiple of most networks' strides.
const TRIAL_SIDE: usize = 256;
/// Default multiple to which sides are padded, px.
const DEFAULT_MULTIPLE: usize = 32;

/// An input of a network that takes an image.
pub struct NetworkInput {
    /// The node's port.
    pub port: InputPort,
    /// Width and height of the input, px: fixed, or as of the last image.
    pub size: (usize, usize),
    input: ImageInput,
    form: PixelForm,
    /// Multiple to which sides are padded, px, if the size follows the image.
    multiple: Option<usize>,
    letterbox: Letterbox,
    normalization: Normalization,
    normalized: Vec<f32>,
    packed: Packed,
    gray: Vec<u8>,
}

fn order_name(order: Option<Order>) -> &'static str {
    match order {
        None => "an image",
        Some(Order::Rgb) => "an image in rgb",
        Some(Order::Bgr) => "an image in bgr",
        Some(Order::Gray) => "an image in gray",
    }
}

/// The input that a rule expects, with valid shapes, as text.
fn expected(rule: &InputRule, size: &str) -> String {
    let planar = |c: usize| format!("1x{c}x{size}");
    let interleaved = |c: usize| format!("1x{size}x{c}");
    let channels: &[usize] = match rule.order {
        None => &[3, 1],
        Some(Order::Gray) => &[1],
        Some(_) => &[3],
    };
    let all: Vec<String> = match rule.axes {
        Some(Layout::Planar) => channels.iter().map(|&c| planar(c)).collect(),
        Some(Layout::Interleaved) => channels.iter().map(|&c| interleaved(c)).collect(),
        None => channels.iter().flat_map(|&c| [planar(c), interleaved(c)]).collect(),
    };
    format!("{} for `{}`: f32, f16, u8 or i8, {}", order_name(rule.order), rule.port.name(), all.join(" or "))
}

impl NetworkInput {
    /// Interprets the declaration of an input of the model at `path` by its rule.
    ///
    /// # Errors
    /// The input is not an image as the rule describes it; its size is fixed and the rule has another one; or its size is variable and the rule has
    /// none.
    pub fn new(path: &Path, declared: &Declared, rule: &InputRule) -> Result<Self, Mismatch> {
        let wrong = |expected: String| Mismatch::Input { path: path.to_owned(), found: declared.to_string(), expected };
        let channels = rule.order.map(|order| if order == Order::Gray { 1 } else { 3 });
        let input = ImageInput::of(declared, rule.axes, channels).ok_or_else(|| wrong(expected(rule, "HxW")))?;
        let multiple = (rule.fit == FitRule::Multiple).then(|| rule.multiple.unwrap_or(DEFAULT_MULTIPLE));
        let size = match (input.width, input.height, rule.size, multiple) {
            (None, None, _, Some(multiple)) => [TRIAL_SIDE.next_multiple_of(multiple); 2],
            (_, _, _, Some(multiple)) => {
                let sides = format!("sides that follow the image as a multiple of {multiple} px");
                return Err(wrong(format!("{sides}: {}", expected(rule, "?x?"))));
            }
            (Some(width), Some(height), None, None) => [width, height],
            (width, height, Some([w, h]), None) if width.unwrap_or(w) == w && height.unwrap_or(h) == h => [w, h],
            (_, _, Some([w, h]), None) => return Err(wrong(expected(rule, &format!("{h}x{w}")))),
            (_, _, None, None) => {
                let how = "set `size = [WIDTH, HEIGHT]`, or `fit = \"multiple\"`";
                return Err(wrong(format!("no size; {how}: {}", expected(rule, "HxW"))));
            }
        };
        if input.channels == 1 && (rule.mean.len() > 1 || rule.std.len() > 1) {
            let count = rule.mean.len().max(rule.std.len());
            return Err(wrong(format!("{count} numbers of `mean` or `std`, one for each channel: 1x3xHxW or 1xHxWx3")));
        }
        Ok(Self {
            port: rule.port,
            size: size.into(),
            normalization: Normalization::new(rule, input.element),
            normalized: Vec::new(),
            input,
            form: pixel_form(rule),
            multiple,
            letterbox: Letterbox::default(),
            packed: Packed::default(),
            gray: Vec::new(),
        })
    }

    /// Makes the input from an image: bgr8 or gray8.
    pub fn prepare(&mut self, image: View<'_, u8>, pool: &dyn Parallel) -> Placement {
        if let Some(multiple) = self.multiple {
            self.size = (image.width.next_multiple_of(multiple), image.height.next_multiple_of(multiple));
        }
        let (mut image, plane) = (image, self.size.0 * self.size.1);
        if self.input.channels == 1 && image.channels > 1 {
            let (width, height) = (image.width, image.height);
            self.gray.resize(width * height, 0);
            bgr_to_gray(&image, &mut ViewMut::new(&mut self.gray, width, height, 1));
            image = View::new(&self.gray, width, height, 1);
        }
        let placement = self.letterbox.fit(image, self.size, &self.form, pool);
        let values = &self.letterbox.input[..self.input.channels * plane];
        self.normalization.apply(values, plane, &mut self.normalized, pool);
        placement
    }

    /// The input of a run, after [`Self::prepare`].
    pub fn run_input(&mut self) -> RunInput<'_> {
        self.input.run_input(&self.normalized, self.size, &mut self.packed)
    }

    /// Checks that another view has the size of this one.
    ///
    /// # Errors
    /// Both sizes.
    pub fn same_size(&self, own: (usize, usize), other: InputPort, size: (usize, usize)) -> Result<(), Mismatch> {
        if own == size {
            return Ok(());
        }
        Err(Mismatch::Views {
            first: self.port.name(),
            first_size: size_text(own),
            second: other.name(),
            second_size: size_text(size),
        })
    }
}

/// Normalisation of 0 to 255 to the network's values, computed in the order of the usual training code, so that the values are equal to the last bit.
/// A network with a wide range of outputs turns differences in the eighth digit of its input into visible ones.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Normalization {
    range: [f32; 2],
    mean: [f32; 3],
    std: [f32; 3],
}

/// Values of a plane per task.
const VALUES_PER_CHUNK: usize = 1 << 16;

impl Normalization {
    fn new(rule: &InputRule, element: Element) -> Self {
        let of = |numbers: &[f32], default: f32| match numbers {
            [] => [default; 3],
            [one] => [*one; 3],
            all => std::array::from_fn(|c| all.get(c).copied().unwrap_or(default)),
        };
        let range = rule.range.unwrap_or(match element {
            Element::F32 | Element::F16 => [0.0, 1.0],
            Element::U8 => [0.0, 255.0],
            Element::I8 => [-128.0, 127.0],
        });
        Self { range, mean: of(&rule.mean, 0.0), std: of(&rule.std, 1.0) }
    }

    /// Normalises `value`, 0 to 255, in `channel`.
    fn of(&self, value: f32, channel: usize) -> f32 {
        let [low, high] = self.range;
        (value / 255.0 * (high - low) + low - self.mean[channel]) / self.std[channel]
    }

    /// Normalises planes of `plane` values.
    fn apply(&self, values: &[f32], plane: usize, out: &mut Vec<f32>, pool: &dyn Parallel) {
        out.resize(values.len(), 0.0);
        let shared = SharedMut::new(out);
        let chunks = plane.div_ceil(VALUES_PER_CHUNK);
        pool.run(values.len() / plane.max(1) * chunks, &|index| {
            let (channel, chunk) = (index / chunks, index % chunks);
            let begin = channel * plane + chunk * VALUES_PER_CHUNK;
            let count = VALUES_PER_CHUNK.min(plane - chunk * VALUES_PER_CHUNK);
            // SAFETY: each chunk writes its own values.
            let out = unsafe { shared.part(begin, count) };
            out.iter_mut().zip(&values[begin..]).for_each(|(out, value)| *out = self.of(*value, channel));
        });
    }
}

/// Pixel form that leaves values at 0 to 255, in the network's order of colours.
fn pixel_form(rule: &InputRule) -> PixelForm {
    PixelForm {
        rgb: rule.order != Some(Order::Bgr),
        mean: [0.0; 3],
        gain: [1.0; 3],
        fit: match rule.fit {
            FitRule::Stretch => Fit::Stretch,
            FitRule::Letterbox => Fit::Corner,
            FitRule::LetterboxCentre => Fit::Centre,
            FitRule::Multiple => Fit::Keep,
        },
        border: rule.border,
    }
}

#[cfg(test)]
mod tests {
    use panoscope_imaging::Serial;

    use super::*;
    use crate::onnx::table::PortTable;

    #[test]
    fn range_mean_and_deviation_are_applied_in_this_order() {
        for (keys, element, bytes, values) in [
            ("", Element::F32, [0.0, 255.0], [0.0, 1.0]),
            ("", Element::F32, [1.0, 254.0], [1.0 / 255.0, 254.0 / 255.0]),
            ("", Element::U8, [0.0, 255.0], [0.0, 255.0]),
            ("", Element::I8, [0.0, 255.0], [-128.0, 127.0]),
            ("range = [-1, 1]", Element::F32, [0.0, 255.0], [-1.0, 1.0]),
            ("mean = [0.5]\nstd = [0.25]", Element::F32, [0.0, 255.0], [-2.0, 2.0]),
            ("mean = [100, 0, 0]\nrange = [0, 255]", Element::F32, [100.0, 101.0], [0.0, 1.0]),
        ] {
            let text = format!("[inputs.a]\nport = \"image\"\n{keys}\n[outputs.m]\nport = \"mask\"");
            let table = PortTable::parse("t", &text).expect("a table");
            let normalization = Normalization::new(&table.inputs["a"], element);
            let mut out = Vec::new();
            normalization.apply(&bytes, 2, &mut out, &Serial);
            assert_eq!(out, values, "{keys}");
        }
    }
}
