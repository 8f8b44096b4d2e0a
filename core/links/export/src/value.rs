//! Packets of a recording as values.

use panoscope_abi as abi;
use panoscope_base::packet::{Cloud, Detections, Table, decode};
use panoscope_base::{View, format};
use panoscope_data::formats::Pixels;
use panoscope_record::format::PacketHead;

use crate::error::ValueError;

/// Layout of the bytes of a packet.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    /// One of the contract's `FORMAT_` constants.
    pub format: u32,
    /// Columns; 0 for plain data.
    pub width: u32,
    /// Rows; 0 for plain data.
    pub height: u32,
    /// Bytes from one row to the next.
    pub stride_bytes: u32,
}

impl From<&PacketHead> for Layout {
    fn from(head: &PacketHead) -> Self {
        let PacketHead { format, width, height, stride_bytes, .. } = *head;
        Self { format, width, height, stride_bytes }
    }
}

impl From<&abi::Frame> for Layout {
    fn from(frame: &abi::Frame) -> Self {
        let abi::Frame { format, width, height, stride_bytes, .. } = *frame;
        Self { format, width, height, stride_bytes }
    }
}

/// Kind of the packets of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Pixels: images, masks, disparity, depth, confidence.
    Picture,
    /// A grid of points.
    Cloud,
    /// Registration of the views.
    Homography,
    /// A rectangle.
    Roi,
    /// Two cameras.
    Calibration,
    /// Boxes.
    Detections,
    /// Boxes with masks.
    Instances,
    /// Tip of a tool.
    Tip,
    /// Pose of a frame in another one.
    Pose,
    /// Joints of an arm.
    Joints,
    /// A number.
    Scalar,
    /// Named columns of numbers.
    Table,
    /// A text.
    Text,
}

impl Kind {
    /// The kind of a packet of this format; plain bytes need the name of their type. `None` for types that are not of
    /// the contract.
    pub fn of(format: u32, packet: Option<&str>) -> Option<Self> {
        match (format, packet) {
            (abi::FORMAT_CLOUD, _) => Some(Self::Cloud),
            (abi::FORMAT_BYTES, packet) => Some(match packet? {
                "homography" => Self::Homography,
                "roi" => Self::Roi,
                "calibration" => Self::Calibration,
                "detections" => Self::Detections,
                "instances" => Self::Instances,
                "tip" => Self::Tip,
                "pose" => Self::Pose,
                "joints" => Self::Joints,
                "scalar" => Self::Scalar,
                "table" => Self::Table,
                "text" => Self::Text,
                _ => return None,
            }),
            (format, _) => format::of(format).filter(|format| format.is_image).map(|_| Self::Picture),
        }
    }

    /// The kind of the packets of a port whose type has this name. `None` for types that are not of the contract.
    pub fn of_packet(name: &str) -> Option<Self> {
        match name {
            "image" | "mask" | "disparity" | "depth" | "confidence" => Some(Self::Picture),
            "cloud" => Some(Self::Cloud),
            plain => Self::of(abi::FORMAT_BYTES, Some(plain)),
        }
    }
}

/// The value of a packet.
#[derive(Debug)]
pub enum Value<'b> {
    /// Pixels.
    Picture(Picture),
    /// Points in rows, mm.
    Cloud(Vec<abi::CloudPoint>, usize),
    /// Registration of the views.
    Homography(abi::Homography),
    /// A rectangle in px.
    Roi(abi::Roi),
    /// Two cameras.
    Calibration(Box<abi::Calibration>),
    /// Boxes; with masks if the packet is `instances`.
    Detections(Detections<'b>),
    /// Tip of a tool.
    Tip(abi::Tip),
    /// Pose of a frame in another one.
    Pose(abi::Pose),
    /// Joints of an arm.
    Joints(abi::Joints),
    /// A number.
    Scalar(abi::Scalar),
    /// Named columns of numbers.
    Table(Table<'b>),
    /// A text.
    Text(&'b str),
}

impl<'b> Value<'b> {
    /// Decodes the value of a packet.
    ///
    /// # Errors The bytes are not a packet of that kind.
    pub fn read(kind: Kind, layout: impl Into<Layout>, bytes: &'b [u8]) -> Result<Self, ValueError> {
        let layout = layout.into();
        Ok(match kind {
            Kind::Picture => Self::Picture(Picture::read(layout, bytes)?),
            Kind::Cloud => {
                let width = layout.width as usize;
                let height = if width == 0 { 0 } else { layout.height as usize };
                let cloud = Cloud::parse(bytes, width, height, layout.stride_bytes as usize)?;
                let cells = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
                Self::Cloud(cells.filter_map(|(column, row)| cloud.point(column, row)).collect(), width)
            }
            Kind::Homography => Self::Homography(decode(bytes)?),
            Kind::Roi => Self::Roi(decode(bytes)?),
            Kind::Calibration => Self::Calibration(Box::new(decode(bytes)?)),
            Kind::Detections => Self::Detections(Detections::parse(bytes)?),
            Kind::Instances => Self::Detections(Detections::parse_instances(bytes)?),
            Kind::Tip => Self::Tip(decode(bytes)?),
            Kind::Pose => Self::Pose(decode(bytes)?),
            Kind::Joints => Self::Joints(decode(bytes)?),
            Kind::Scalar => Self::Scalar(decode(bytes)?),
            Kind::Table => Self::Table(Table::parse(bytes)?),
            Kind::Text => Self::Text(std::str::from_utf8(bytes).map_err(|_| ValueError::Text)?),
        })
    }
}

/// Pixels in rows without padding.
#[derive(Debug)]
pub struct Picture {
    format: u32,
    width: usize,
    height: usize,
    samples: Samples,
}

#[derive(Debug)]
enum Samples {
    Bytes(Vec<u8>),
    Words(Vec<u16>),
    Floats(Vec<f32>),
}

impl Picture {
    fn read(layout: Layout, bytes: &[u8]) -> Result<Self, ValueError> {
        let Layout { format: id, width, height, stride_bytes } = layout;
        let wrong = || ValueError::Picture { width, height, format: format::name(id), stride_bytes, len: bytes.len() };
        // Rows without pixels take no bytes, however many there are.
        let rows = if width == 0 { 0 } else { height as usize };
        let (columns, stride) = (width as usize, stride_bytes as usize);
        let pixel = format::pixel_bytes(id);
        let need = format::image_bytes(columns, rows, stride, pixel).ok_or_else(wrong)?;
        let bytes = bytes.get(..need).ok_or_else(wrong)?;
        let lines = || (0..rows).map(|row| &bytes[row * stride..row * stride + columns * pixel]);
        let samples = match id {
            abi::FORMAT_GRAY16 => Samples::Words(
                lines().flat_map(|line| line.as_chunks().0).map(|word| u16::from_ne_bytes(*word)).collect(),
            ),
            abi::FORMAT_F32 => Samples::Floats(
                lines().flat_map(|line| line.as_chunks().0).map(|float| f32::from_ne_bytes(*float)).collect(),
            ),
            _ => Samples::Bytes(lines().flatten().copied().collect()),
        };
        Ok(Self { format: id, width: columns, height: rows, samples })
    }

    /// An image with the number of the instance of each pixel: 0 for none, 1 for the first one. Later boxes cover
    /// earlier ones. `None` without masks.
    pub fn of_masks(instances: &Detections<'_>) -> Option<Self> {
        // Nothing but masks vouches for the size of the image.
        if instances.mask(0).is_empty() {
            return None;
        }
        let (width, height) = instances.image_size();
        let stride = width.div_ceil(8);
        let mut numbers = vec![0u16; width * height];
        for index in 0..instances.len() {
            let mask = instances.mask(index);
            let number = u16::try_from(index + 1).unwrap_or(u16::MAX);
            for (at, pixel) in numbers.iter_mut().enumerate() {
                let (x, y) = (at % width, at / width);
                if mask.get(y * stride + x / 8).is_some_and(|byte| byte >> (7 - x % 8) & 1 == 1) {
                    *pixel = number;
                }
            }
        }
        let (format, samples) = if instances.len() <= usize::from(u8::MAX) {
            (abi::FORMAT_GRAY8, Samples::Bytes(numbers.iter().map(|number| *number as u8).collect()))
        } else {
            (abi::FORMAT_GRAY16, Samples::Words(numbers))
        };
        Some(Self { format, width, height, samples })
    }

    /// The pixels for an encoder.
    pub fn pixels(&self) -> Pixels<'_> {
        let (width, height) = (self.width, self.height);
        match &self.samples {
            Samples::Words(words) => Pixels::Gray16(View::new(words, width, height, 1)),
            Samples::Floats(floats) => Pixels::F32(View::new(floats, width, height, 1)),
            Samples::Bytes(bytes) => match self.format {
                abi::FORMAT_BGR8 => Pixels::Bgr8(View::new(bytes, width, height, 3)),
                abi::FORMAT_RGBA8 => Pixels::Rgba8(View::new(bytes, width, height, 4)),
                _ => Pixels::Gray8(View::new(bytes, width, height, 1)),
            },
        }
    }

    /// Multiplies floats; other pixels stay.
    pub fn scale(&mut self, factor: f32) {
        if let Samples::Floats(floats) = &mut self.samples {
            floats.iter_mut().for_each(|value| *value *= factor);
        }
    }
}

#[cfg(test)]
mod tests {
    use panoscope_record::Coding;

    use super::*;

    fn head(format: u32, width: u32, height: u32, stride_bytes: u32) -> PacketHead {
        let tick = abi::Tick { source: 0, flags: 0, seq: 3, capture_ns: 5 };
        PacketHead { tick, format, width, height, stride_bytes, len: 0, hash: 0, padded: 0, coding: Coding::Plain }
    }

    #[test]
    fn padding_of_rows_is_dropped() {
        let bytes = [1, 2, 99, 3, 4];
        let Value::Picture(picture) = Value::read(Kind::Picture, &head(abi::FORMAT_GRAY8, 2, 2, 3), &bytes).unwrap()
        else {
            panic!("a picture");
        };
        assert!(matches!(picture.pixels(), Pixels::Gray8(view) if view.data == [1, 2, 3, 4]));
        let bytes = [0.5f32, f32::NAN].map(f32::to_ne_bytes).concat();
        let Value::Picture(mut picture) = Value::read(Kind::Picture, &head(abi::FORMAT_F32, 1, 2, 4), &bytes).unwrap()
        else {
            panic!("a picture");
        };
        picture.scale(4.0);
        assert!(matches!(picture.pixels(), Pixels::F32(view) if view.data[0] == 2.0 && view.data[1].is_nan()));
    }

    #[test]
    fn pictures_that_do_not_fit_their_bytes_are_errors() {
        for (head, len) in [
            (head(abi::FORMAT_GRAY8, 2, 2, 3), 4),
            (head(abi::FORMAT_BGR8, 2, 2, 5), 100),
            (head(abi::FORMAT_F32, u32::MAX, u32::MAX, u32::MAX), 8),
        ] {
            let error = Value::read(Kind::Picture, &head, &vec![0; len]).unwrap_err().to_string();
            assert!(error.contains("does not match"), "{error}");
        }
    }

    #[test]
    fn kinds_of_plain_data_need_the_name_of_their_type() {
        assert_eq!(Kind::of(abi::FORMAT_BGR8, None), Some(Kind::Picture));
        assert_eq!(Kind::of(abi::FORMAT_CLOUD, None), Some(Kind::Cloud));
        assert_eq!(Kind::of(abi::FORMAT_BYTES, Some("tip")), Some(Kind::Tip));
        assert_eq!((Kind::of(abi::FORMAT_BYTES, None), Kind::of(abi::FORMAT_BYTES, Some("own"))), (None, None));
        assert_eq!(Kind::of(77, Some("image")), None);
    }

    #[test]
    fn masks_become_numbers_of_boxes() {
        // Two boxes on 9 x 2 pixels; both have pixel (8, 0).
        let mut bytes = [2u32, 0, 9, 2].map(u32::to_ne_bytes).concat();
        bytes.extend(8u64.to_ne_bytes());
        bytes.extend([0; 64]);
        bytes.extend([0b1000_0000, 0b1000_0000, 0, 0, 0, 0b1000_0000, 0b0100_0000, 0]);
        let instances = Detections::parse_instances(&bytes).unwrap();
        let picture = Picture::of_masks(&instances).expect("masks");
        let Pixels::Gray8(view) = picture.pixels() else { panic!("8 bits") };
        assert_eq!(view.data, [1, 0, 0, 0, 0, 0, 0, 0, 2, 0, 2, 0, 0, 0, 0, 0, 0, 0]);
    }
}
