//! An input of a network that takes an image: its memory layout, size and element type.

use half::f16;
use ort::value::TensorElementType;
use serde::Deserialize;

use crate::session::{Declared, InputValues, RunInput};

/// Order of the axes of an image tensor.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
pub enum Layout {
    /// Channels before rows and columns (CHW).
    #[serde(rename = "nchw")]
    Planar,
    /// Channels after rows and columns (HWC).
    #[serde(rename = "nhwc")]
    Interleaved,
}

/// Element types of an image tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Element {
    /// 32-bit floats.
    F32,
    /// 16-bit floats.
    F16,
    /// Bytes, 0 to 255.
    U8,
    /// Signed bytes, -128 to 127.
    I8,
}

/// An input that takes an image.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageInput {
    /// Name in the model.
    pub name: String,
    /// Type of its numbers.
    pub element: Element,
    /// Order of its axes.
    pub layout: Layout,
    /// 1 (gray) or 3.
    pub channels: usize,
    /// Width, px; `None` if variable.
    pub width: Option<usize>,
    /// Height, px; `None` if variable.
    pub height: Option<usize>,
    /// Number of axes: 4 with a batch of 1, 3 without, 2 for gray alone.
    rank: usize,
}

/// Maximum side of an image, px.
const MAX_SIDE: i64 = 8192;

impl ImageInput {
    /// Interprets a declaration. `layout` and `channels` take precedence if given; otherwise the channels are the axis of length 3, or 1, and the
    /// first such axis if both are possible. `None` if the declaration is not that of an image.
    pub fn of(declared: &Declared, layout: Option<Layout>, channels: Option<usize>) -> Option<Self> {
        let element = match declared.element? {
            TensorElementType::Float32 => Element::F32,
            TensorElementType::Float16 => Element::F16,
            TensorElementType::Uint8 => Element::U8,
            TensorElementType::Int8 => Element::I8,
            _ => return None,
        };
        let dims = match declared.dims[..] {
            [batch, a, b, c] if batch == 1 || batch < 0 => vec![a, b, c],
            [a, b, c] => vec![a, b, c],
            [height, width] if channels != Some(3) => vec![1, height, width],
            _ => return None,
        };
        let rank = declared.dims.len();
        let wanted = |length: i64| match channels {
            Some(channels) => length == channels as i64,
            None => length == 3 || length == 1,
        };
        let is_planar = wanted(dims[0]) && layout != Some(Layout::Interleaved);
        let is_interleaved = wanted(dims[2]) && layout != Some(Layout::Planar) && rank > 2;
        let open = |length: i64| length < 0 && channels.is_none_or(|channels| channels == 3);
        let (layout, [count, height, width]) = if is_planar || (!is_interleaved && open(dims[0])) {
            (Layout::Planar, [dims[0], dims[1], dims[2]])
        } else if is_interleaved {
            (Layout::Interleaved, [dims[2], dims[0], dims[1]])
        } else {
            return None;
        };
        let side = |length: i64| (length > 0).then_some(length as usize);
        let is_side = |length: i64| length < 0 || (1..=MAX_SIDE).contains(&length);
        if !is_side(height) || !is_side(width) {
            return None;
        }
        let channels = if count < 0 { 3 } else { count as usize };
        let name = declared.name.clone();
        Some(Self { name, element, layout, channels, width: side(width), height: side(height), rank })
    }

    /// The input of one run from `planar`, the planes of an image of `width` x `height` px, each as long as the image. Converted in `packed` if the
    /// network expects another form.
    pub fn run_input<'a>(
        &'a self,
        planar: &'a [f32],
        (width, height): (usize, usize),
        packed: &'a mut Packed,
    ) -> RunInput<'a> {
        let (w, h, c) = (width as i64, height as i64, self.channels as i64);
        let mut dims = match (self.layout, self.rank) {
            (_, 2) => vec![h, w],
            (Layout::Planar, _) => vec![c, h, w],
            (Layout::Interleaved, _) => vec![h, w, c],
        };
        if self.rank == 4 {
            dims.insert(0, 1);
        }
        let planar = &planar[..self.channels * width * height];
        RunInput { name: &self.name, dims, values: self.values(planar, width * height, packed) }
    }

    fn values<'a>(&self, planar: &'a [f32], plane: usize, packed: &'a mut Packed) -> InputValues<'a> {
        let is_in_order = self.layout == Layout::Planar || self.channels == 1;
        let source = if is_in_order {
            planar
        } else {
            packed.interleaved.resize(planar.len(), 0.0);
            let planes: Vec<&[f32]> = planar.chunks_exact(plane.max(1)).collect();
            for (index, pixel) in packed.interleaved.chunks_exact_mut(self.channels).enumerate() {
                pixel.iter_mut().zip(&planes).for_each(|(value, plane)| *value = plane[index]);
            }
            &packed.interleaved
        };
        match self.element {
            Element::F32 => InputValues::F32(source),
            Element::F16 => InputValues::F16(convert(&mut packed.f16, source, f16::from_f32)),
            // Casts of floats saturate.
            Element::U8 => InputValues::U8(convert(&mut packed.u8, source, |v| v.round() as u8)),
            Element::I8 => InputValues::I8(convert(&mut packed.i8, source, |v| v.round() as i8)),
        }
    }
}

fn convert<'a, T>(out: &'a mut Vec<T>, source: &[f32], to: impl Fn(f32) -> T) -> &'a [T] {
    out.clear();
    out.extend(source.iter().map(|&v| to(v)));
    out
}

/// Buffers of an input that does not take planes of f32.
#[derive(Debug, Default)]
pub struct Packed {
    interleaved: Vec<f32>,
    f16: Vec<f16>,
    u8: Vec<u8>,
    i8: Vec<i8>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn declared(element: TensorElementType, dims: &[i64]) -> Declared {
        Declared { name: "images".into(), element: Some(element), dims: dims.to_vec() }
    }

    #[test]
    fn layouts_are_recognised_by_their_channels() {
        let of = |dims: &[i64]| {
            let input = ImageInput::of(&declared(TensorElementType::Float32, dims), None, None)?;
            Some((input.layout, input.channels, input.width, input.height))
        };
        let (planar, interleaved) = (Layout::Planar, Layout::Interleaved);
        assert_eq!(of(&[1, 3, 48, 64]), Some((planar, 3, Some(64), Some(48))));
        assert_eq!(of(&[1, 48, 64, 3]), Some((interleaved, 3, Some(64), Some(48))));
        assert_eq!(of(&[-1, 3, -1, -1]), Some((planar, 3, None, None)));
        assert_eq!(of(&[1, -1, -1, 3]), Some((interleaved, 3, None, None)));
        assert_eq!(of(&[3, 48, 64]), Some((planar, 3, Some(64), Some(48))));
        assert_eq!(of(&[1, 1, 48, 64]), Some((planar, 1, Some(64), Some(48))));
        assert_eq!(of(&[48, 64]), Some((planar, 1, Some(64), Some(48))));
        assert_eq!(of(&[1, -1, -1, -1]), Some((planar, 3, None, None)));
        for dims in [&[1, 4, 64, 64][..], &[2, 3, 64, 64], &[7], &[], &[1, 3, 0, 64], &[1, 1, 3, 64, 64]] {
            assert_eq!(of(dims), None, "{dims:?}");
        }
        let double = declared(TensorElementType::Float64, &[1, 3, 48, 64]);
        assert_eq!(ImageInput::of(&double, None, None), None);
        // Both could be: the table decides.
        let both = declared(TensorElementType::Float32, &[1, 3, 64, 3]);
        let of = |layout| ImageInput::of(&both, layout, None).map(|input| input.layout);
        assert_eq!((of(None), of(Some(interleaved))), (Some(planar), Some(interleaved)));
        let gray = ImageInput::of(&declared(TensorElementType::Float32, &[1, 48, 64]), None, Some(3));
        assert_eq!(gray, None);
    }

    #[test]
    fn values_come_in_the_order_and_type_of_the_network() {
        let planar = [1.0, 2.0, 10.0, 20.0, 100.0, 200.4];
        let mut packed = Packed::default();
        let mut values = |element: TensorElementType, dims: &[i64]| {
            let input = ImageInput::of(&declared(element, dims), None, None).expect("an image");
            let run = input.run_input(&planar, (1, 2), &mut packed);
            assert_eq!(run.dims, dims);
            match run.values {
                InputValues::F32(v) => v.to_vec(),
                InputValues::F16(v) => v.iter().map(|v| v.to_f32()).collect(),
                InputValues::U8(v) => v.iter().map(|&v| f32::from(v)).collect(),
                InputValues::I8(v) => v.iter().map(|&v| f32::from(v)).collect(),
            }
        };
        assert_eq!(values(TensorElementType::Float32, &[1, 3, 2, 1]), planar);
        assert_eq!(values(TensorElementType::Float32, &[1, 2, 1, 3]), [1.0, 10.0, 100.0, 2.0, 20.0, 200.4]);
        assert_eq!(values(TensorElementType::Uint8, &[2, 1, 3]), [1.0, 10.0, 100.0, 2.0, 20.0, 200.0]);
        assert_eq!(values(TensorElementType::Int8, &[3, 2, 1]), [1.0, 2.0, 10.0, 20.0, 100.0, 127.0]);
        let half = values(TensorElementType::Float16, &[1, 3, 2, 1]);
        assert!(half.iter().zip(&planar).all(|(a, b)| (a - b).abs() < 0.1), "{half:?}");
    }
}
