//! BMP and PNM: uncompressed pixels. A file that is shorter than its header says is refused.

use super::error::PictureError;
use super::picture::{Picture, Samples};

/// Maximum number of columns or rows.
const MAX_PX: usize = 1 << 16;

fn unsupported(format: String) -> PictureError {
    PictureError::Unsupported { format }
}

/// Decodes a Windows bitmap of 8 bits with a palette, or of 24 or 32 bits.
///
/// # Errors
/// Another kind of bitmap, or missing bytes.
pub fn bmp(bytes: &[u8]) -> Result<Picture, PictureError> {
    let word =
        |at: usize| bytes.get(at..at + 2).map(|b| u16::from_le_bytes([b[0], b[1]])).ok_or(PictureError::Incomplete);
    let long = |at: usize| {
        bytes.get(at..at + 4).map(|b| i32::from_le_bytes([b[0], b[1], b[2], b[3]])).ok_or(PictureError::Incomplete)
    };
    let (start, header) = (long(10)?, long(14)?);
    if header < 40 {
        return Err(unsupported("a bitmap of OS/2".to_owned()));
    }
    let (width, height, bits, compression) = (long(18)?, long(22)?, usize::from(word(28)?), long(30)?);
    // 3: channel masks, which are the usual ones for 32 bits.
    let is_plain = compression == 0 || (compression == 3 && bits == 32);
    if !is_plain || !matches!(bits, 8 | 24 | 32) {
        return Err(unsupported(format!("a bitmap of {bits} bits with compression {compression}")));
    }
    let (columns, rows) = (usize::try_from(width).unwrap_or(0), height.unsigned_abs() as usize);
    if columns == 0 || rows == 0 || columns > MAX_PX || rows > MAX_PX {
        return Err(PictureError::Incomplete);
    }
    let pixel = bits / 8;
    let stride = (columns * pixel).next_multiple_of(4);
    let start = usize::try_from(start).map_err(|_| PictureError::Incomplete)?;
    let pixels = bytes.get(start..).and_then(|rest| rest.get(..stride * rows)).ok_or(PictureError::Incomplete)?;
    let palette_start = 14 + usize::try_from(header).unwrap_or(40);
    let palette = bytes.get(palette_start..start).unwrap_or(&[]).as_chunks::<4>().0;
    let mut bgr = Vec::with_capacity(3 * columns * rows);
    for row in 0..rows {
        // The last row stands first, unless the height is negative.
        let row = if height > 0 { rows - 1 - row } else { row };
        for value in pixels[row * stride..][..columns * pixel].chunks_exact(pixel) {
            match value {
                &[index] => {
                    let [b, g, r, _] = palette.get(usize::from(index)).copied().ok_or(PictureError::Incomplete)?;
                    bgr.extend([b, g, r]);
                }
                value => bgr.extend_from_slice(&value[..3]),
            }
        }
    }
    Ok(Picture::new((columns, rows), Samples::Eight(bgr.into())))
}

/// Decodes a binary PGM or PPM of 8 or 16 bits.
///
/// # Errors
/// Another kind of PNM, or missing bytes.
pub fn pnm(bytes: &[u8]) -> Result<Picture, PictureError> {
    let channels = match bytes.get(..2) {
        Some(b"P5") => 1,
        Some(b"P6") => 3,
        other => return Err(unsupported(format!("PNM {}", String::from_utf8_lossy(other.unwrap_or(&[]))))),
    };
    let mut at = 2;
    let mut number = || -> Result<usize, PictureError> {
        loop {
            match bytes.get(at) {
                Some(b'#') => at += bytes[at..].iter().position(|b| *b == b'\n').ok_or(PictureError::Incomplete)?,
                Some(byte) if byte.is_ascii_whitespace() => at += 1,
                Some(_) => break,
                None => return Err(PictureError::Incomplete),
            }
        }
        let digits = bytes[at..].iter().take_while(|byte| byte.is_ascii_digit()).count();
        let text = std::str::from_utf8(&bytes[at..at + digits]).unwrap_or("");
        // Digits at the end of the file may be cut.
        if at + digits >= bytes.len() {
            return Err(PictureError::Incomplete);
        }
        at += digits;
        text.parse().map_err(|_| PictureError::Incomplete)
    };
    let (width, height, most) = (number()?, number()?, number()?);
    at += 1;
    if width == 0 || height == 0 || width > MAX_PX || height > MAX_PX || most == 0 || most > 0xFFFF {
        return Err(PictureError::Incomplete);
    }
    let values = width * height * channels;
    let wide = usize::from(most > 255) + 1;
    let data = bytes.get(at..).and_then(|rest| rest.get(..values * wide)).ok_or(PictureError::Incomplete)?;
    // White as the header has it. Writers of 16 bits mostly leave 65535 there, whatever the depth of their values.
    let scaled = |value: usize| ((value.min(most) * 255 + most / 2) / most) as u8;
    let samples = if most == 255 {
        Samples::Eight(bgr(data, channels).into())
    } else if wide == 1 {
        let values: Vec<u8> = data.iter().map(|value| scaled(usize::from(*value))).collect();
        Samples::Eight(bgr(&values, channels).into())
    } else if most < 0xFFFF {
        let pairs = data.as_chunks::<2>().0.iter();
        let values: Vec<u8> = pairs.map(|pair| scaled(usize::from(u16::from_be_bytes(*pair)))).collect();
        Samples::Eight(bgr(&values, channels).into())
    } else {
        let values: Vec<u16> = data.as_chunks::<2>().0.iter().map(|pair| u16::from_be_bytes(*pair)).collect();
        Samples::Sixteen(bgr(&values, channels))
    };
    Ok(Picture::new((width, height), samples))
}

/// Converts interleaved gray or RGB values, with or without alpha, to BGR.
pub fn bgr<T: Copy>(values: &[T], channels: usize) -> Vec<T> {
    if channels == 3 {
        return bgr_of_rgb(values.to_vec());
    }
    let mut out = Vec::with_capacity(values.len() / channels * 3);
    for pixel in values.chunks_exact(channels) {
        let [blue, green, red] = if channels < 3 { [0; 3] } else { [2, 1, 0] };
        out.extend_from_slice(&[pixel[blue], pixel[green], pixel[red]]);
    }
    out
}

/// Converts interleaved RGB to BGR in place.
pub fn bgr_of_rgb<T>(mut values: Vec<T>) -> Vec<T> {
    for pixel in values.as_chunks_mut::<3>().0 {
        pixel.swap(0, 2);
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    fn eight(picture: &Picture) -> &[u8] {
        match &picture.samples {
            Samples::Eight(bgr) => bgr,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn pnm_is_read_whole_or_not_at_all() {
        let text = b"P6 # a note\n2 1\n255\n\x01\x02\x03\x04\x05\x06";
        assert_eq!(eight(&pnm(text).expect("a picture")), [3, 2, 1, 6, 5, 4]);
        for length in 0..text.len() {
            assert!(pnm(&text[..length]).is_err(), "{length}");
        }
        let deep = pnm(b"P5\n1 2\n65535\n\x0F\xFF\x00\x01").expect("a picture");
        assert!(matches!(&deep.samples, Samples::Sixteen(values) if *values == [4095, 4095, 4095, 1, 1, 1]));
        // A dark one of 12 bits, and one of 0 and 1.
        assert_eq!(eight(&pnm(b"P5\n1 2\n4095\n\x04\x00\x0F\xFF").expect("a picture")), [64, 64, 64, 255, 255, 255]);
        assert_eq!(eight(&pnm(b"P5\n2 1\n1\n\x01\x00").expect("a picture")), [255, 255, 255, 0, 0, 0]);
        assert!(pnm(b"P1\n1 1\n1").is_err());
    }

    #[test]
    fn bitmaps_are_read_from_below_and_by_their_palette() {
        let mut header = [0; 54];
        header[..2].copy_from_slice(b"BM");
        (header[10], header[14], header[18], header[22], header[28]) = (62, 40, 2, 2, 8);
        let palette = [9, 8, 7, 0, 1, 2, 3, 0];
        let bytes = [&header[..], &palette, &[1, 0, 0, 0, 0, 1, 0, 0]].concat();
        assert_eq!(eight(&bmp(&bytes).expect("a picture")), [9, 8, 7, 1, 2, 3, 1, 2, 3, 9, 8, 7]);
        for length in 0..bytes.len() {
            assert!(bmp(&bytes[..length]).is_err(), "{length}");
        }
        let outside = [&header[..], &palette, &[2, 0, 0, 0, 0, 1, 0, 0]].concat();
        assert!(bmp(&outside).is_err());
    }
}
