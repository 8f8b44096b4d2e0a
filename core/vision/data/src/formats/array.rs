//! Writes planes in common formats: PFM, NPY, TIFF, PGM/PPM and bare bytes.

use std::io::{self, Write};

use crate::formats::Pixels;

/// A format of [`write()`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArrayFormat {
    /// Portable float map, little-endian, rows from the bottom up, as for Middlebury's disparity maps. Only f32.
    Pfm,
    /// NumPy's array format 1.0: H x W or H x W x channels.
    Npy,
    /// Uncompressed baseline TIFF 6.0 in one strip; f32, 8 and 16 bit gray, RGB, RGBA.
    Tiff,
    /// Binary PGM (gray) or PPM (colour).
    Pnm,
    /// Rows without padding and without any header, in the byte order of the format's name.
    Bare,
}

impl ArrayFormat {
    /// Extensions that [`ArrayFormat::from_ending`] knows.
    pub const ENDINGS: &'static str = "pfm, npy, tif, tiff, pgm, ppm, raw, bin";

    /// The format of a file extension.
    pub fn from_ending(ending: &str) -> Option<Self> {
        Some(match ending {
            "pfm" => Self::Pfm,
            "npy" => Self::Npy,
            "tif" | "tiff" => Self::Tiff,
            "pgm" | "ppm" => Self::Pnm,
            "raw" | "bin" => Self::Bare,
            _ => return None,
        })
    }

    /// Advice if the format cannot hold `pixels`; `None` if it can.
    pub fn refuses(self, pixels: &Pixels<'_>) -> Option<&'static str> {
        match (self, pixels) {
            (Self::Pfm, Pixels::F32(_)) => None,
            (Self::Pfm, _) => Some("PFM holds floats: use .npy, .tif, .pgm or .ppm"),
            (Self::Pnm, Pixels::F32(_)) => Some("PGM and PPM hold whole numbers: use .pfm, .npy or .tif"),
            _ => None,
        }
    }
}

/// Writes rows in the format's order: samples little-endian unless `big_endian`, colours unchanged or as RGB.
fn rows(out: &mut dyn Write, pixels: &Pixels<'_>, rgb: bool, big_endian: bool, bottom_up: bool) -> io::Result<()> {
    let (width, height) = pixels.size();
    let mut line = Vec::with_capacity(width * 4);
    for row in 0..height {
        let y = if bottom_up { height - 1 - row } else { row };
        line.clear();
        match pixels {
            Pixels::Bgr8(v) if rgb => line.extend(v.row(y).chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]])),
            Pixels::Gray8(v) | Pixels::Bgr8(v) | Pixels::Rgba8(v) => line.extend_from_slice(v.row(y)),
            Pixels::Gray16(v) if big_endian => line.extend(v.row(y).iter().flat_map(|p| p.to_be_bytes())),
            Pixels::Gray16(v) => line.extend(v.row(y).iter().flat_map(|p| p.to_le_bytes())),
            Pixels::F32(v) => line.extend(v.row(y).iter().flat_map(|p| p.to_le_bytes())),
        }
        out.write_all(&line)?;
    }
    Ok(())
}

/// Writes `pixels` in a format that does not [refuse](ArrayFormat::refuses) them.
///
/// # Errors
/// Errors of `out`, and `InvalidInput` for pixels that the format refuses.
pub fn write(out: &mut dyn Write, format: ArrayFormat, pixels: &Pixels<'_>) -> io::Result<()> {
    if let Some(why) = format.refuses(pixels) {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, why));
    }
    let (width, height) = pixels.size();
    match format {
        ArrayFormat::Pfm => {
            // A negative scale says little-endian.
            write!(out, "Pf\n{width} {height}\n-1.0\n")?;
            rows(out, pixels, false, false, true)
        }
        ArrayFormat::Npy => {
            npy_header(out, pixels)?;
            rows(out, pixels, false, false, false)
        }
        ArrayFormat::Tiff => tiff(out, pixels),
        ArrayFormat::Pnm => {
            let (magic, max) = match pixels {
                Pixels::Gray16(_) => ("P5", 65535),
                Pixels::Gray8(_) => ("P5", 255),
                _ => ("P6", 255),
            };
            write!(out, "{magic}\n{width} {height}\n{max}\n")?;
            if let Pixels::Rgba8(v) = pixels {
                for y in 0..height {
                    v.row(y).chunks_exact(4).try_for_each(|p| out.write_all(&p[..3]))?;
                }
                return Ok(());
            }
            rows(out, pixels, true, true, false)
        }
        ArrayFormat::Bare => rows(out, pixels, false, false, false),
    }
}

/// Header of NPY version 1.0: magic, length, a Python dictionary padded with blanks so that the data starts on a
/// multiple of 64.
fn npy_header(out: &mut dyn Write, pixels: &Pixels<'_>) -> io::Result<()> {
    let (width, height) = pixels.size();
    let (kind, channels) = match pixels {
        Pixels::Gray8(_) => ("|u1", 1),
        Pixels::Bgr8(_) => ("|u1", 3),
        Pixels::Rgba8(_) => ("|u1", 4),
        Pixels::Gray16(_) => ("<u2", 1),
        Pixels::F32(_) => ("<f4", 1),
    };
    let shape = if channels == 1 { format!("({height}, {width})") } else { format!("({height}, {width}, {channels})") };
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    out.write_all(b"\x93NUMPY\x01\x00")?;
    out.write_all(&(header.len() as u16).to_le_bytes())?;
    out.write_all(header.as_bytes())
}

/// Header, directory, values that do not fit the directory, then one strip.
fn tiff(out: &mut dyn Write, pixels: &Pixels<'_>) -> io::Result<()> {
    const SHORT: u16 = 3;
    const LONG: u16 = 4;
    let (width, height) = pixels.size();
    let (bits, samples, float) = match pixels {
        Pixels::Gray8(_) => (8_u32, 1_u32, false),
        Pixels::Bgr8(_) => (8, 3, false),
        Pixels::Rgba8(_) => (8, 4, false),
        Pixels::Gray16(_) => (16, 1, false),
        Pixels::F32(_) => (32, 1, true),
    };
    let strip_len = width as u64 * height as u64 * u64::from(samples * bits / 8);
    let entries = 11 + u32::from(samples == 4);
    let extra_at = 8 + 2 + entries * 12 + 4;
    // Bits per sample of colour images stand outside the directory.
    let data_at = extra_at + 8;
    let strip_len = u32::try_from(strip_len)
        .ok()
        .filter(|n| n.checked_add(data_at).is_some())
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the limit of TIFF is 4 GiB"))?;
    out.write_all(b"II*\0\x08\0\0\0")?;
    out.write_all(&(entries as u16).to_le_bytes())?;
    let mut entry = |tag: u16, kind: u16, count: u32, value: u32| {
        out.write_all(&tag.to_le_bytes())?;
        out.write_all(&kind.to_le_bytes())?;
        out.write_all(&count.to_le_bytes())?;
        out.write_all(&value.to_le_bytes())
    };
    entry(256, LONG, 1, width as u32)?;
    entry(257, LONG, 1, height as u32)?;
    entry(258, SHORT, samples, if samples > 2 { extra_at } else { bits })?;
    entry(259, SHORT, 1, 1)?; // no compression
    entry(262, SHORT, 1, if samples == 1 { 1 } else { 2 })?; // zero is black, or RGB
    entry(273, LONG, 1, data_at)?;
    entry(277, SHORT, 1, samples)?;
    entry(278, LONG, 1, height as u32)?;
    entry(279, LONG, 1, strip_len)?;
    entry(284, SHORT, 1, 1)?; // samples interleaved
    if samples == 4 {
        entry(338, SHORT, 1, 2)?; // the fourth sample is alpha
    }
    // The sample format is given once for all samples: 1 unsigned, 3 float.
    entry(339, SHORT, 1, if float { 3 } else { 1 })?;
    out.write_all(&0_u32.to_le_bytes())?;
    for sample in 0..4 {
        let bits = if sample < samples { bits as u16 } else { 0 };
        out.write_all(&bits.to_le_bytes())?;
    }
    rows(out, pixels, true, false, false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_base::View;

    fn bytes(format: ArrayFormat, pixels: Pixels<'_>) -> Vec<u8> {
        let mut out = Vec::new();
        write(&mut out, format, &pixels).unwrap();
        out
    }

    #[test]
    fn pfm_rows_stand_bottom_up() {
        let out = bytes(ArrayFormat::Pfm, Pixels::F32(View::new(&[1.0, 2.0, 3.0, f32::NAN], 2, 2, 1)));
        let head = b"Pf\n2 2\n-1.0\n";
        assert_eq!(&out[..head.len()], head);
        let floats: Vec<f32> = out[head.len()..].as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        assert_eq!(floats[0], 3.0);
        assert!(floats[1].is_nan());
        assert_eq!(floats[2..], [1.0, 2.0]);
    }

    #[test]
    fn npy_data_starts_on_a_multiple_of_64() {
        let out = bytes(ArrayFormat::Npy, Pixels::Bgr8(View::new(&[1, 2, 3, 4, 5, 6], 2, 1, 3)));
        let header_len = usize::from(u16::from_le_bytes([out[8], out[9]]));
        assert_eq!((10 + header_len) % 64, 0);
        let header = std::str::from_utf8(&out[10..10 + header_len]).unwrap();
        assert!(header.contains("'shape': (1, 2, 3)") && header.ends_with('\n'), "{header}");
        assert_eq!(out[10 + header_len..], [1, 2, 3, 4, 5, 6]);
    }

    #[test]
    fn pnm_is_big_endian_and_rgb() {
        assert!(bytes(ArrayFormat::Pnm, Pixels::Gray16(View::new(&[0x0102], 1, 1, 1))).ends_with(b"65535\n\x01\x02"));
        assert!(bytes(ArrayFormat::Pnm, Pixels::Bgr8(View::new(&[1, 2, 3], 1, 1, 3))).ends_with(&[3, 2, 1]));
    }

    #[test]
    fn formats_refuse_what_they_cannot_hold() {
        let gray = Pixels::Gray8(View::new(&[1], 1, 1, 1));
        let float = Pixels::F32(View::new(&[1.0], 1, 1, 1));
        assert!(ArrayFormat::Pfm.refuses(&gray).is_some());
        assert!(ArrayFormat::Pnm.refuses(&float).is_some());
        assert!(write(&mut Vec::new(), ArrayFormat::Pfm, &gray).is_err());
        assert!(ArrayFormat::Tiff.refuses(&float).is_none());
    }
}
