//! The head of a JPEG file.

/// Properties of a JPEG file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Jpeg {
    /// Width and height, px.
    pub size: (u16, u16),
    /// Whether it is baseline (8 bit, sequential, Huffman).
    pub is_baseline: bool,
    /// Components: 1 for gray, 3 for YCbCr.
    pub components: u8,
    /// Whether chroma is halved horizontally only (4:2:2), vertically too, or not: sampling factors of the first
    /// component.
    pub sampling: u8,
    /// Whether an Adobe marker says that three components are RGB.
    pub is_rgb: bool,
    /// Whether the file is complete.
    pub is_whole: bool,
}

/// Whether the marker of the end follows. In compressed data 0xFF is followed by 0 or by a marker; other segments have
/// a length.
fn has_end(mut bytes: &[u8]) -> bool {
    loop {
        let Some(start) = bytes.windows(2).position(|pair| pair[0] == 0xFF && ![0, 0xFF].contains(&pair[1])) else {
            return false;
        };
        let (marker, rest) = (bytes[start + 1], &bytes[start + 2..]);
        bytes = match marker {
            0xD9 => return true,
            // Restarts have no length; after the head of a scan its data follow.
            0xD0..=0xD7 => rest,
            _ => {
                let Some(length) = rest.first_chunk().map(|length| usize::from(u16::from_be_bytes(*length))) else {
                    return false;
                };
                rest.get(length..).unwrap_or_default()
            }
        };
    }
}

/// Reads the markers up to the frame's.
pub fn parse(bytes: &[u8]) -> Option<Jpeg> {
    if !bytes.starts_with(&[0xFF, 0xD8]) {
        return None;
    }
    let (mut at, mut is_rgb) = (2, false);
    loop {
        let marker = *bytes.get(at + 1).filter(|_| bytes.get(at) == Some(&0xFF))?;
        if marker == 0xFF {
            at += 1;
            continue;
        }
        let length = usize::from(u16::from_be_bytes([*bytes.get(at + 2)?, *bytes.get(at + 3)?]));
        let segment = bytes.get(at + 4..(at + 2).checked_add(length)?)?;
        match marker {
            // APP14 of Adobe: the last byte says how colours are coded; 0 is RGB.
            0xEE if segment.starts_with(b"Adobe") => is_rgb = segment.get(11) == Some(&0),
            0xC0..=0xCF if ![0xC4, 0xC8, 0xCC].contains(&marker) => {
                let &[bits, h1, h0, w1, w0, components, ..] = segment else { return None };
                let size = (u16::from_be_bytes([w1, w0]), u16::from_be_bytes([h1, h0]));
                let sampling = *segment.get(7)?;
                let is_baseline = marker == 0xC0 && bits == 8;
                let is_whole = has_end(&bytes[at + 2 + length..]);
                return Some(Jpeg { size, is_baseline, components, sampling, is_rgb, is_whole });
            }
            0xD9 | 0xDA => return None,
            _ => {}
        }
        at += 2 + length;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::ImageEncoder;
    use image::codecs::jpeg::JpegEncoder;

    #[test]
    fn size_and_components_are_read() {
        let mut bytes = Vec::new();
        JpegEncoder::new(&mut bytes).write_image(&[9; 24 * 16 * 3], 24, 16, image::ExtendedColorType::Rgb8).unwrap();
        let jpeg = parse(&bytes).unwrap();
        assert_eq!((jpeg.size, jpeg.components, jpeg.is_baseline, jpeg.is_rgb), ((24, 16), 3, true, false));
        assert!(jpeg.is_whole);
        for end in 0..bytes.len() {
            assert!(parse(&bytes[..end]).is_none_or(|jpeg| !jpeg.is_whole), "{end} of {}", bytes.len());
        }
        assert_eq!(parse(&[0xFF, 0xD8, 0xFF, 0xE0, 0, 0]), None);
        assert_eq!(parse(b"\x89PNG"), None);
    }
}
