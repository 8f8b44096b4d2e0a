//! Truth that the user brings: disparity, depth or points, in whatever file it comes.

use std::path::Path;

use crate::error::{Context, EvalError, FileAction, OnFile, Result, bail, ensure};
use panoscope_imaging::stereo::{FloatImage, formats};

/// What a file of truth holds.
pub enum Loaded {
    /// A plane of numbers, unknown places NaN.
    Plane(FloatImage),
    /// Points, mm.
    Points(Vec<[f32; 3]>),
}

/// Reads PFM, NPY, f32 TIFF, 8- and 16-bit PNG (divided by `png_scale`, 0 is unknown), XYZ and PLY.
pub fn read(path: &Path, png_scale: f32) -> Result<Loaded> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let bytes = std::fs::read(path).on_file(FileAction::Read, path)?;
    let named = || format!("{}", path.display());
    let plane = match ending.as_str() {
        "pfm" => formats::read_pfm(&bytes).with_context(named)?,
        "npy" => formats::read_npy(&bytes).with_context(named)?,
        "tif" | "tiff" => tiff(&bytes).with_context(named)?,
        "png" => png(path, png_scale)?,
        "xyz" | "txt" => return Ok(Loaded::Points(xyz(&bytes).with_context(named)?)),
        "ply" => return Ok(Loaded::Points(ply(&bytes).with_context(named)?)),
        _ => bail!("{}: truth is read from .pfm, .npy, .tif, .png, .xyz and .ply", path.display()),
    };
    let known = |v: f32| if v.is_finite() && v > 0.0 { v } else { f32::NAN };
    Ok(Loaded::Plane(FloatImage { data: plane.data.into_iter().map(known).collect(), ..plane }))
}

fn png(path: &Path, scale: f32) -> Result<FloatImage> {
    ensure!(scale > 0.0, "--truth-scale must be positive");
    let image = image::open(path).on_file(FileAction::Read, path)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let data = image.to_luma16().into_raw();
    // An 8-bit value is spread over 16 bits by the reader: 257 steps each.
    let is_8_bit = matches!(image.color(), image::ColorType::L8 | image::ColorType::Rgb8 | image::ColorType::Rgba8);
    let step = if is_8_bit { 257.0 } else { 1.0 };
    Ok(FloatImage { width, height, data: data.into_iter().map(|v| f32::from(v) / step / scale).collect() })
}

/// One plane of uncompressed f32 samples in strips, of either byte order.
fn tiff(bytes: &[u8]) -> Result<FloatImage> {
    let is_little = match bytes.get(..4) {
        Some([b'I', b'I', 42, 0]) => true,
        Some([b'M', b'M', 0, 42]) => false,
        _ => bail!("it is no TIFF"),
    };
    let cut = || EvalError::Input { reason: "it is cut off".to_owned() };
    let number = |at: usize, len: usize| -> Result<usize> {
        let part = bytes.get(at..at.saturating_add(len)).ok_or_else(cut)?;
        let add = |sum: usize, byte: &u8| sum << 8 | usize::from(*byte);
        Ok(if is_little { part.iter().rev().fold(0, add) } else { part.iter().fold(0, add) })
    };
    let directory = number(4, 4)?;
    let entries = number(directory, 2)?;
    // Numbers of a tag; a short list stands in the entry itself.
    let values = |tag: usize| -> Result<Vec<usize>> {
        for index in 0..entries {
            let entry = directory + 2 + 12 * index;
            if number(entry, 2)? != tag {
                continue;
            }
            let len = match number(entry + 2, 2)? {
                3 => 2,
                4 => 4,
                other => bail!("tag {tag} has type {other}"),
            };
            let count = number(entry + 4, 4)?;
            ensure!(count <= bytes.len(), "it is cut off");
            let start = if count * len <= 4 { entry + 8 } else { number(entry + 8, 4)? };
            return (0..count).map(|k| number(start + k * len, len)).collect();
        }
        Ok(Vec::new())
    };
    let one = |tag: usize, default: usize| -> Result<usize> { Ok(values(tag)?.first().copied().unwrap_or(default)) };
    let (width, height) = (one(256, 0)?, one(257, 0)?);
    ensure!((1..=1 << 16).contains(&width) && (1..=1 << 16).contains(&height), "its size is {width}x{height}");
    ensure!(
        one(258, 1)? == 32 && one(339, 1)? == 3 && one(277, 1)? == 1 && one(259, 1)? == 1,
        "one channel of uncompressed 32-bit floats is expected"
    );
    let needed = width * height;
    ensure!(needed <= bytes.len() / 4, "its {} bytes hold no {needed} values", bytes.len());
    let mut data = Vec::with_capacity(needed);
    for (start, len) in values(273)?.into_iter().zip(values(279)?) {
        let part = bytes.get(start..start.saturating_add(len)).ok_or_else(cut)?;
        ensure!(data.len() + len / 4 <= bytes.len() / 4, "its strips overlap");
        data.extend(
            part.as_chunks::<4>()
                .0
                .iter()
                .map(|raw| if is_little { f32::from_le_bytes(*raw) } else { f32::from_be_bytes(*raw) }),
        );
    }
    ensure!(data.len() >= needed, "it holds {} values, {needed} are expected", data.len());
    data.truncate(needed);
    Ok(FloatImage { width, height, data })
}

/// Lines that begin with three numbers.
fn xyz(bytes: &[u8]) -> Result<Vec<[f32; 3]>> {
    let text = String::from_utf8_lossy(bytes);
    let mut points = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let words: Vec<&str> = line.split([' ', '\t', ',', ';']).filter(|word| !word.is_empty()).collect();
        if words.is_empty() || line.trim_start().starts_with('#') {
            continue;
        }
        let numbers: Vec<f32> = words.iter().take(3).filter_map(|word| word.parse().ok()).collect();
        match numbers[..] {
            [x, y, z] => points.push([x, y, z]),
            _ => bail!("line {}: three numbers are expected", index + 1),
        }
    }
    ensure!(!points.is_empty(), "it holds no point");
    Ok(points)
}

/// Vertices of a PLY, in text or binary little-endian.
fn ply(bytes: &[u8]) -> Result<Vec<[f32; 3]>> {
    const END: &[u8] = b"end_header\n";
    let end = bytes.windows(END.len()).position(|w| w == END).context("it has no header of a PLY")? + END.len();
    let header = String::from_utf8_lossy(&bytes[..end]).into_owned();
    let (mut count, mut in_vertices, mut fields) = (0usize, false, Vec::new());
    let mut is_text = false;
    for line in header.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["format", "ascii", _] => is_text = true,
            ["format", "binary_little_endian", _] => {}
            ["format", other, _] => bail!("format {other} is not read"),
            ["element", "vertex", number] => {
                (count, in_vertices) = (number.parse().with_context(|| format!("element vertex {number}"))?, true)
            }
            ["element", ..] => in_vertices = false,
            ["property", kind, name] if in_vertices => fields.push((kind.to_owned(), name.to_owned())),
            _ => {}
        }
    }
    let body = &bytes[end..];
    let column = |name: &str| fields.iter().position(|(_, n)| n == name).with_context(|| format!("it has no {name}"));
    let columns = [column("x")?, column("y")?, column("z")?];
    if is_text {
        let text = String::from_utf8_lossy(body);
        let vertex = |line: &str| -> Option<[f32; 3]> {
            let words: Vec<&str> = line.split_whitespace().collect();
            let number = |column: usize| words.get(column)?.parse().ok();
            Some([number(columns[0])?, number(columns[1])?, number(columns[2])?])
        };
        let points: Vec<[f32; 3]> = text.lines().take(count).map_while(vertex).collect();
        ensure!(points.len() == count, "{} of {count} vertices can be read", points.len());
        return Ok(points);
    }
    let size = |kind: &str| match kind {
        "char" | "uchar" | "int8" | "uint8" => 1,
        "short" | "ushort" | "int16" | "uint16" => 2,
        "double" | "float64" => 8,
        _ => 4,
    };
    let start = |column: usize| fields[..column].iter().map(|(kind, _)| size(kind)).sum::<usize>();
    let stride = start(fields.len());
    ensure!(body.len() / stride.max(1) >= count, "it is cut off");
    let number = |row: &[u8], column: usize| -> f32 {
        let raw = &row[start(column)..][..size(&fields[column].0)];
        match raw {
            [a, b, c, d] => f32::from_le_bytes([*a, *b, *c, *d]),
            _ => raw.try_into().map_or(f32::NAN, |raw| f64::from_le_bytes(raw) as f32),
        }
    };
    Ok(body.chunks_exact(stride).take(count).map(|row| columns.map(|column| number(row, column))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A little-endian TIFF of 3 x 2 floats in two strips.
    fn small_tiff() -> Vec<u8> {
        let mut bytes = b"II\x2a\x00".to_vec();
        let values = [1.0f32, 2.0, 3.0, 4.5, 5.0, 6.0];
        let (data, offsets, counts, directory) = (8u32, 32u32, 40u32, 48u32);
        bytes.extend(directory.to_le_bytes());
        values.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        [data, data + 12, 12, 12].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        let entries: [(u16, u32, u32); 9] = [
            (256, 1, 3),
            (257, 1, 2),
            (258, 1, 32),
            (259, 1, 1),
            (273, 2, offsets),
            (277, 1, 1),
            (278, 1, 1),
            (279, 2, counts),
            (339, 1, 3),
        ];
        bytes.extend((entries.len() as u16).to_le_bytes());
        for (tag, count, value) in entries {
            bytes.extend(tag.to_le_bytes());
            bytes.extend(4u16.to_le_bytes());
            bytes.extend(count.to_le_bytes());
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend([0; 4]);
        bytes
    }

    #[test]
    fn tiffs_of_floats_are_read_and_cut_ones_refused() {
        let bytes = small_tiff();
        let image = tiff(&bytes).unwrap();
        assert_eq!((image.width, image.height, image.data[3]), (3, 2, 4.5));
        for at in 0..bytes.len() - 4 {
            assert!(tiff(&bytes[..at]).is_err(), "{at}");
        }
    }

    #[test]
    fn a_small_tiff_cannot_ask_for_much_memory_or_work() {
        let mut bytes = small_tiff();
        let at = 48 + 2 + 8;
        bytes[at..at + 4].copy_from_slice(&65536u32.to_le_bytes());
        bytes[at + 12..at + 16].copy_from_slice(&65536u32.to_le_bytes());
        let error = tiff(&bytes).unwrap_err().to_string();
        assert!(error.contains("hold no 4294967296 values"), "{error}");
        // Both strips are the whole file.
        let mut bytes = small_tiff();
        let len = bytes.len() as u32;
        bytes[32..48].copy_from_slice(&[0, 0, len, len].map(u32::to_le_bytes).concat());
        let error = tiff(&bytes).unwrap_err().to_string();
        assert!(error.contains("strips overlap"), "{error}");
    }

    #[test]
    fn clouds_are_read() {
        assert_eq!(xyz(b"# mm\n1 2 3 255 0 0\n4,5,6\n").unwrap(), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert!(xyz(b"1 2\n").is_err() && xyz(b"").is_err());
        let head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty uchar red\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
        assert_eq!(ply(format!("{head}9 1 2 3\n9 4 5 6\n").as_bytes()).unwrap()[1], [4.0, 5.0, 6.0]);
        assert!(ply(format!("{head}9 1 2 3\n").as_bytes()).is_err());
        let mut binary = head.replace("ascii", "binary_little_endian").into_bytes();
        for v in [1.0f32, 2.0, 3.0] {
            if v == 1.0 {
                binary.push(7);
            }
            binary.extend(v.to_le_bytes());
        }
        binary.push(7);
        [4.0f32, 5.0, 6.0].iter().for_each(|v| binary.extend(v.to_le_bytes()));
        assert_eq!(ply(&binary).unwrap(), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert!(ply(&binary[..binary.len() - 1]).is_err());
    }
}
