//! POLYDATA: points, the cells between them, and numbers for points or cells.

use std::borrow::Cow;

use crate::error::{IgtlError, Result};
use crate::fields::{Fields, floats3, put_floats};

const KIND: &str = "POLYDATA";
/// Longest name of an attribute.
const NAME_MOST: usize = 255;

/// Cells of one kind: for each cell the number of its points, then their indices.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cells {
    words: Vec<u32>,
    count: u32,
}

impl Cells {
    /// One single-point cell for each of `points` points.
    pub fn vertices(points: u32) -> Self {
        Self { words: (0..points).flat_map(|index| [1, index]).collect(), count: points }
    }

    /// Adds a cell.
    pub fn push(&mut self, cell: &[u32]) {
        self.words.push(cell.len() as u32);
        self.words.extend_from_slice(cell);
        self.count += 1;
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.count as usize
    }

    /// Whether there are no cells.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The indices of each cell.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let mut rest = &self.words[..];
        std::iter::from_fn(move || {
            let (count, behind) = rest.split_first()?;
            let (cell, behind) = behind.split_at_checked(*count as usize)?;
            rest = behind;
            Some(cell)
        })
    }

    /// Reads `bytes` bytes that hold `count` cells of indices below `points`.
    fn decode(fields: &mut Fields<'_>, count: u32, bytes: u32, points: u32) -> Result<Self> {
        let words: Vec<u32> = fields
            .take("cells", bytes as usize)?
            .chunks_exact(4)
            .map(|word| u32::from_be_bytes([word[0], word[1], word[2], word[3]]))
            .collect();
        let cells = Self { words, count };
        let (mut found, mut length) = (0, 0);
        for cell in cells.iter() {
            (found, length) = (found + 1_u32, length + 1 + cell.len());
            if let Some(index) = cell.iter().find(|index| **index >= points) {
                let (field, value) = ("an index", u64::from(*index));
                return Err(IgtlError::Value {
                    kind: KIND,
                    field,
                    value,
                    expected: "it is less than the number of points",
                });
            }
        }
        if found != count || length * 4 != bytes as usize {
            let (field, value) = ("number of cells", u64::from(count));
            return Err(IgtlError::Value {
                kind: KIND,
                field,
                value,
                expected: "the bytes of the cells hold another number",
            });
        }
        Ok(cells)
    }
}

/// Numbers for each point or each cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Attribute<'a> {
    /// Kind: 0 scalars, 1 vectors, 2 normals, 3 tensors, 4 colours (red, green, blue, alpha from 0 to 1), of points; 16
    /// more of cells.
    pub kind: u8,
    /// Numbers for one point or cell.
    pub components: u8,
    /// Name, at most 255 bytes without a zero.
    pub name: Cow<'a, str>,
    /// All numbers, point by point or cell by cell.
    pub values: Vec<f32>,
}

impl Attribute<'_> {
    /// Scalars of points.
    pub const POINT_SCALARS: u8 = 0x00;
    /// Colours of points.
    pub const POINT_COLOURS: u8 = 0x04;
}

/// Points, cells and attributes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolyData<'a> {
    /// Points, mm.
    pub points_mm: Vec<[f32; 3]>,
    /// Cells of single points.
    pub vertices: Cells,
    /// Lines.
    pub lines: Cells,
    /// Polygons.
    pub polygons: Cells,
    /// Strips of triangles.
    pub strips: Cells,
    /// Numbers for points or cells.
    pub attributes: Vec<Attribute<'a>>,
}

impl<'a> PolyData<'a> {
    pub(super) fn decode(bytes: &'a [u8]) -> Result<Self> {
        let mut fields = Fields::new(KIND, bytes);
        let points = fields.u32("counts")?;
        let mut pair = || -> Result<(u32, u32)> { Ok((fields.u32("counts")?, fields.u32("counts")?)) };
        let lists = [pair()?, pair()?, pair()?, pair()?];
        let attributes = fields.u32("counts")?;
        let points_mm = floats3(fields.items("points", points as usize, 12)?).collect();
        let mut cells = |(count, bytes)| Cells::decode(&mut fields, count, bytes, points);
        let [vertices, lines, polygons, strips] =
            [cells(lists[0])?, cells(lists[1])?, cells(lists[2])?, cells(lists[3])?];
        let attributes = decode_attributes(&mut fields, attributes as usize)?;
        fields.end(|| "fewer".to_owned())?;
        Ok(Self { points_mm, vertices, lines, polygons, strips, attributes })
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        let most = u32::MAX as usize / 4;
        let count = |what, count: usize| match count <= most {
            true => Ok((count as u32).to_be_bytes()),
            false => Err(IgtlError::TooMany { what, count, limit: most }),
        };
        out.extend_from_slice(&count("points", self.points_mm.len())?);
        for cells in [&self.vertices, &self.lines, &self.polygons, &self.strips] {
            out.extend_from_slice(&cells.count.to_be_bytes());
            count("indices", cells.words.len())?;
            out.extend_from_slice(&(cells.words.len() as u32 * 4).to_be_bytes());
        }
        out.extend_from_slice(&count("attributes", self.attributes.len())?);
        self.points_mm.iter().for_each(|point| put_floats(out, point));
        for cells in [&self.vertices, &self.lines, &self.polygons, &self.strips] {
            cells.words.iter().for_each(|word| out.extend_from_slice(&word.to_be_bytes()));
        }
        let mut names = 0;
        for attribute in &self.attributes {
            let components = usize::from(attribute.components);
            if components == 0 || !attribute.values.len().is_multiple_of(components) {
                let expected = "the numbers of an attribute fill whole points";
                return Err(IgtlError::Value { kind: KIND, field: "components", value: components as u64, expected });
            }
            out.extend_from_slice(&[attribute.kind, attribute.components]);
            out.extend_from_slice(&count("numbers", attribute.values.len() / components)?);
            names += attribute.name.len() + 1;
        }
        for attribute in &self.attributes {
            let text = &attribute.name;
            if text.len() > NAME_MOST || text.contains('\0') {
                let field = "the name of an attribute";
                return Err(IgtlError::LongText { field, text: text.to_string(), bytes: text.len(), limit: NAME_MOST });
            }
            out.extend_from_slice(text.as_bytes());
            out.push(0);
        }
        if names % 2 == 1 {
            out.push(0);
        }
        self.attributes.iter().for_each(|attribute| put_floats(out, &attribute.values));
        Ok(())
    }
}

fn decode_attributes<'a>(fields: &mut Fields<'a>, count: usize) -> Result<Vec<Attribute<'a>>> {
    let mut heads = Fields::new(KIND, fields.items("attributes", count, 6)?);
    let mut attributes = Vec::with_capacity(count);
    let mut lengths = Vec::with_capacity(count);
    let mut names = 0;
    for _ in 0..count {
        let (kind, components, values) = (heads.u8("attributes")?, heads.u8("attributes")?, heads.u32("attributes")?);
        if components == 0 {
            let expected = "an attribute has at least one number per point";
            return Err(IgtlError::Value { kind: KIND, field: "components", value: 0, expected });
        }
        lengths.push((values as usize).saturating_mul(usize::from(components)));
        let rest = fields.rest();
        let Some(end) = rest.iter().take(NAME_MOST + 1).position(|byte| *byte == 0) else {
            let expected = "the name of an attribute ends with a zero after 255 bytes at most";
            return Err(IgtlError::Value { kind: KIND, field: "name", value: rest.len() as u64, expected });
        };
        let name = String::from_utf8_lossy(&fields.take("attributes", end + 1)?[..end]);
        names += end + 1;
        attributes.push(Attribute { kind, components, name, values: Vec::new() });
    }
    if names % 2 == 1 {
        fields.take("padding", 1)?;
    }
    for (attribute, length) in attributes.iter_mut().zip(lengths) {
        let bytes = fields.items("attributes", length, 4)?;
        attribute.values = bytes.chunks_exact(4).map(|b| f32::from_be_bytes([b[0], b[1], b[2], b[3]])).collect();
    }
    Ok(attributes)
}
