//! Truth that the user brings: disparity, depth or points, in whatever file it comes.

use std::path::Path;

use crate::error::{Context, FileAction, OnFile, Result, bail, ensure};
use panoscope_data::truth::maps;
use panoscope_imaging::stereo::FloatImage;

/// What a file of truth holds.
pub enum Loaded {
    /// A plane of numbers, unknown places NaN.
    Plane(FloatImage),
    /// Points, mm.
    Points(Vec<[f32; 3]>),
}

/// Reads what [`maps::read`] takes, values of PNG files divided by `png_scale`, and XYZ and PLY. Numbers that are not positive are unknown.
pub fn read(path: &Path, png_scale: f32) -> Result<Loaded> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let named = || format!("{}", path.display());
    let bytes = || std::fs::read(path).on_file(FileAction::Read, path);
    match ending.as_str() {
        "xyz" | "txt" => return Ok(Loaded::Points(xyz(&bytes()?).with_context(named)?)),
        "ply" => return Ok(Loaded::Points(ply(&bytes()?).with_context(named)?)),
        ending if !maps::ENDINGS.contains(&ending) => {
            bail!("{}: truth is read from .{}, .xyz and .ply", path.display(), maps::ENDINGS.join(", ."))
        }
        _ => {}
    }
    ensure!(png_scale > 0.0, "--truth-scale must be positive");
    let map = maps::read(path)?;
    Ok(Loaded::Plane(map.divided(if ending == "png" { png_scale } else { 1.0 })))
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
