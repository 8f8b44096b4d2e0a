//! IMAGE: pixels or voxels with their position in space.

use crate::error::{IgtlError, Result};
use crate::fields::{Fields, put_floats};

const KIND: &str = "IMAGE";
/// Length of the image's header; the pixels follow.
pub const IMAGE_BYTES: usize = 72;
/// Version of the image's header.
const VERSION: u16 = 1;

/// Type of a number of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    /// 8 bits, signed.
    Int8,
    /// 8 bits.
    Uint8,
    /// 16 bits, signed.
    Int16,
    /// 16 bits.
    Uint16,
    /// 32 bits, signed.
    Int32,
    /// 32 bits.
    Uint32,
    /// 32-bit float.
    Float32,
    /// 64-bit float.
    Float64,
}

impl Scalar {
    const ALL: [(u8, Self); 8] = [
        (2, Self::Int8),
        (3, Self::Uint8),
        (4, Self::Int16),
        (5, Self::Uint16),
        (6, Self::Int32),
        (7, Self::Uint32),
        (10, Self::Float32),
        (11, Self::Float64),
    ];

    /// Length in bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::Int8 | Self::Uint8 => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 => 4,
            Self::Float64 => 8,
        }
    }

    fn number(self) -> u8 {
        Self::ALL.iter().find(|(_, scalar)| *scalar == self).map_or(0, |(number, _)| *number)
    }
}

/// Byte order of the pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endian {
    /// Most significant byte first.
    Big,
    /// Least significant byte first.
    Little,
}

/// Coordinate system of the image's position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coordinates {
    /// Right, anterior, superior are positive.
    Ras,
    /// Left, posterior, superior are positive.
    Lps,
}

/// Pixels or voxels, the first index fastest, components interleaved.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<'a> {
    /// Numbers per pixel: 1 gray, 3 red, green, blue, 4 with alpha.
    pub components: u8,
    /// Type of each number.
    pub scalar: Scalar,
    /// Byte order of `pixels`.
    pub endian: Endian,
    /// Coordinate system of steps and centre.
    pub coordinates: Coordinates,
    /// Columns, rows, slices of the whole image.
    pub size: [u16; 3],
    /// Steps from a pixel to the next along columns, rows, slices; mm.
    pub steps_mm: [[f32; 3]; 3],
    /// Centre of the image, mm.
    pub centre_mm: [f32; 3],
    /// First column, row, slice of the part that `pixels` holds.
    pub part_start: [u16; 3],
    /// Columns, rows, slices of that part.
    pub part_size: [u16; 3],
    /// The part: columns x rows x slices x components.
    pub pixels: &'a [u8],
}

impl<'a> Image<'a> {
    /// A complete image of one slice with square pixels of `pixel_mm`, whose first pixel is at the origin, x along
    /// columns, y along rows.
    ///
    /// # Errors
    /// A side of more than 65,535 px.
    pub fn picture(
        width: usize,
        height: usize,
        components: u8,
        scalar: Scalar,
        pixel_mm: f32,
        pixels: &'a [u8],
    ) -> Result<Self> {
        let side = |count: usize| {
            let limit = usize::from(u16::MAX);
            u16::try_from(count).map_err(|_| IgtlError::TooMany { what: "pixels along a side", count, limit })
        };
        let size = [side(width)?, side(height)?, 1];
        let centre = |count: usize| (count as f32 - 1.0) / 2.0 * pixel_mm;
        Ok(Self {
            components,
            scalar,
            endian: Endian::Little,
            coordinates: Coordinates::Ras,
            size,
            steps_mm: [[pixel_mm, 0.0, 0.0], [0.0, pixel_mm, 0.0], [0.0, 0.0, pixel_mm]],
            centre_mm: [centre(width), centre(height), 0.0],
            part_start: [0; 3],
            part_size: size,
            pixels,
        })
    }

    /// Whether `pixels` is the whole image.
    pub fn is_whole(&self) -> bool {
        self.part_size == self.size
    }

    /// Reads the content of a message.
    ///
    /// # Errors
    /// A field that is out of range, a part outside the image, pixels that do not fill the part.
    pub fn decode(bytes: &'a [u8]) -> Result<Self> {
        let mut fields = Fields::new(KIND, bytes);
        let wrong = |field, value: u64, expected| Err(IgtlError::Value { kind: KIND, field, value, expected });
        let version = fields.u16("version")?;
        let components = fields.u8("components")?;
        let number = fields.u8("scalar type")?;
        let endian = fields.u8("byte order")?;
        let coordinates = fields.u8("coordinate system")?;
        if !(1..=2).contains(&version) {
            return wrong("version", version.into(), "1 and 2 are known");
        }
        if components == 0 {
            return wrong("components", 0, "a pixel has at least one");
        }
        let Some((_, scalar)) = Scalar::ALL.iter().find(|(known, _)| *known == number) else {
            return wrong("scalar type", number.into(), "2 to 7, 10 and 11 are known");
        };
        let endian = match endian {
            1 => Endian::Big,
            2 => Endian::Little,
            other => return wrong("byte order", other.into(), "it is 1 (big) or 2 (little)"),
        };
        let coordinates = match coordinates {
            1 => Coordinates::Ras,
            2 => Coordinates::Lps,
            other => return wrong("coordinate system", other.into(), "it is 1 (RAS) or 2 (LPS)"),
        };
        let mut three =
            |field| -> Result<[u16; 3]> { Ok([fields.u16(field)?, fields.u16(field)?, fields.u16(field)?]) };
        let size = three("size")?;
        let steps_mm = [fields.floats("matrix")?, fields.floats("matrix")?, fields.floats("matrix")?];
        let centre_mm = fields.floats("centre")?;
        let mut three =
            |field| -> Result<[u16; 3]> { Ok([fields.u16(field)?, fields.u16(field)?, fields.u16(field)?]) };
        let (part_start, part_size) = (three("part")?, three("part")?);
        for axis in 0..3 {
            if u32::from(part_start[axis]) + u32::from(part_size[axis]) > u32::from(size[axis]) {
                return wrong("part", part_size[axis].into(), "it lies inside the image");
            }
        }
        let pixels = fields.rest();
        let image = Self {
            components,
            scalar: *scalar,
            endian,
            coordinates,
            size,
            steps_mm,
            centre_mm,
            part_start,
            part_size,
            pixels,
        };
        if image.part_bytes() != Some(pixels.len()) {
            let [width, height, depth] = part_size;
            let expected = format!("{IMAGE_BYTES} and those of {width} x {height} x {depth} pixels");
            return Err(IgtlError::Length { kind: KIND, bytes: bytes.len(), expected });
        }
        Ok(image)
    }

    /// Bytes that the part has.
    fn part_bytes(&self) -> Option<usize> {
        let [width, height, depth] = self.part_size.map(usize::from);
        let pixel = usize::from(self.components) * self.scalar.bytes();
        width.checked_mul(height)?.checked_mul(depth)?.checked_mul(pixel)
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        if self.part_bytes() != Some(self.pixels.len()) {
            let expected = format!("the part of {:?} pixels has {:?}", self.part_size, self.part_bytes());
            return Err(IgtlError::Length { kind: KIND, bytes: self.pixels.len(), expected });
        }
        self.encode_head(out);
        out.extend_from_slice(self.pixels);
        Ok(())
    }

    /// Appends the header of the pixels.
    fn encode_head(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&VERSION.to_be_bytes());
        let endian = if self.endian == Endian::Big { 1 } else { 2 };
        let coordinates = if self.coordinates == Coordinates::Ras { 1 } else { 2 };
        out.extend_from_slice(&[self.components, self.scalar.number(), endian, coordinates]);
        let three = |out: &mut Vec<u8>, values: [u16; 3]| {
            values.iter().for_each(|value| out.extend_from_slice(&value.to_be_bytes()));
        };
        three(out, self.size);
        self.steps_mm.iter().for_each(|step| put_floats(out, step));
        put_floats(out, &self.centre_mm);
        three(out, self.part_start);
        three(out, self.part_size);
    }
}
