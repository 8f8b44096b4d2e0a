//! Float images as bytes: PFM and NPY, read and written.

use crate::stereo::StereoError;

/// A plane of f32 values, row after row, top row first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FloatImage {
    /// Columns, in pixels.
    pub width: usize,
    /// Rows, in pixels.
    pub height: usize,
    /// `width * height` values.
    pub data: Vec<f32>,
}

/// Largest side accepted; headers beyond it are taken for damage.
const MAX_SIDE: usize = 1 << 16;

fn area(format: &'static str, width: usize, height: usize) -> Result<usize, StereoError> {
    if width > MAX_SIDE || height > MAX_SIDE {
        let reason = format!("{width}x{height} is larger than {MAX_SIDE} a side");
        return Err(StereoError::Format { format, reason });
    }
    Ok(width * height)
}

/// Reads a one-channel PFM (`Pf`) of either byte order.
///
/// # Errors
/// [`StereoError::Format`] when the header is none or values are missing.
pub fn read_pfm(bytes: &[u8]) -> Result<FloatImage, StereoError> {
    let refuse = |reason: String| Err(StereoError::Format { format: "PFM", reason });
    let mut rest = bytes;
    let mut words = [""; 4];
    for word in &mut words {
        let start = rest.iter().position(|byte| !byte.is_ascii_whitespace()).unwrap_or(rest.len());
        let length = rest[start..].iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len() - start);
        *word = std::str::from_utf8(&rest[start..start + length]).unwrap_or("");
        rest = &rest[(start + length).min(rest.len())..];
    }
    if words[0] == "PF" {
        return refuse("it has three channels, one is expected".into());
    }
    if words[0] != "Pf" {
        return refuse("it does not begin with Pf".into());
    }
    let (Ok(width), Ok(height), Ok(scale)) = (words[1].parse(), words[2].parse(), words[3].parse::<f64>()) else {
        return refuse("width, height and scale are not numbers".into());
    };
    let count = area("PFM", width, height)?;
    // One white space ends the header, or the line break that the first line has.
    let is_crlf = bytes.get(2..4) == Some(b"\r\n") && rest.starts_with(b"\r\n");
    let body = rest.get(if is_crlf { 2 } else { 1 }..).unwrap_or(&[]);
    if body.len() < 4 * count {
        return refuse(format!("{} bytes of values, {} expected", body.len(), 4 * count));
    }
    let little = scale < 0.0;
    let mut data = vec![0.0; count];
    for (row, bytes) in body[..4 * count].chunks_exact((4 * width).max(4)).enumerate() {
        // PFM keeps its bottom row first.
        let at = (height - 1 - row) * width;
        for (value, bytes) in data[at..at + width].iter_mut().zip(bytes.chunks_exact(4)) {
            let bytes = [bytes[0], bytes[1], bytes[2], bytes[3]];
            *value = if little { f32::from_le_bytes(bytes) } else { f32::from_be_bytes(bytes) };
        }
    }
    Ok(FloatImage { width, height, data })
}

/// Writes a one-channel little-endian PFM.
pub fn write_pfm(image: &FloatImage) -> Vec<u8> {
    let mut bytes = format!("Pf\n{} {}\n-1.0\n", image.width, image.height).into_bytes();
    for y in (0..image.height).rev() {
        let row = &image.data[y * image.width..(y + 1) * image.width];
        bytes.extend(row.iter().flat_map(|value| value.to_le_bytes()));
    }
    bytes
}

/// Reads a two-dimensional NPY array of f4 or f8, of either byte order and storage order.
///
/// # Errors
/// [`StereoError::Format`] when the header is none, the array is of another kind, or values are missing.
pub fn read_npy(bytes: &[u8]) -> Result<FloatImage, StereoError> {
    let refuse = |reason: String| Err(StereoError::Format { format: "NPY", reason });
    if bytes.len() < 12 || !bytes.starts_with(b"\x93NUMPY") {
        return refuse("it does not begin with the NPY signature".into());
    }
    let (start, length): (usize, usize) = match bytes[6] {
        1 => (10, usize::from(u16::from_le_bytes([bytes[8], bytes[9]]))),
        2 | 3 => (12, u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]) as usize),
        version => return refuse(format!("version {version} is unknown")),
    };
    let Some(header) = start.checked_add(length).and_then(|end| bytes.get(start..end)) else {
        return refuse("its header is cut off".into());
    };
    let header = String::from_utf8_lossy(header);
    let after = |key: &str| header.find(key).map(|at| header[at + key.len()..].trim_start_matches([' ', ':']));
    let Some(kind) = after("'descr'").and_then(|text| text.split('\'').nth(1)) else {
        return refuse("it names no element type".into());
    };
    let (little, size) = match kind {
        "<f4" | "=f4" => (true, 4),
        ">f4" => (false, 4),
        "<f8" | "=f8" => (true, 8),
        ">f8" => (false, 8),
        other => return refuse(format!("elements are {other}, f4 or f8 are expected")),
    };
    let by_column = after("'fortran_order'").is_some_and(|text| text.starts_with("True"));
    let shape = after("'shape'").and_then(|text| text.strip_prefix('(')).and_then(|text| text.split(')').next());
    let shape: Option<Vec<usize>> = shape.map(|text| {
        text.split(',')
            .map(str::trim)
            .filter(|word| !word.is_empty())
            .map(|word| word.parse().unwrap_or(usize::MAX))
            .collect()
    });
    let Some([height, width]) = shape.as_deref().and_then(|shape| <[usize; 2]>::try_from(shape).ok()) else {
        return refuse("it is not two-dimensional".into());
    };
    let count = area("NPY", width, height)?;
    let body = &bytes[start + length..];
    if body.len() < count * size {
        return refuse(format!("{} bytes of values, {} expected", body.len(), count * size));
    }
    let value = |index: usize| -> f32 {
        let at = &body[index * size..(index + 1) * size];
        let mut raw = [0u8; 8];
        raw[..size].copy_from_slice(at);
        if !little {
            raw[..size].reverse();
        }
        if size == 4 { f32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]]) } else { f64::from_le_bytes(raw) as f32 }
    };
    let data = (0..count)
        .map(|index| if by_column { value(index % width * height + index / width) } else { value(index) })
        .collect();
    Ok(FloatImage { width, height, data })
}

/// Writes a little-endian f4 NPY array of shape (rows, columns).
pub fn write_npy(image: &FloatImage) -> Vec<u8> {
    let mut header =
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}), }}", image.height, image.width);
    // Signature and header together end at a multiple of 64, with a line feed.
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.into_bytes());
    bytes.extend(image.data.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}
