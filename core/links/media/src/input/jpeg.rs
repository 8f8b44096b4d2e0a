//! Checks that a JPEG is complete.
//!
//!
//!
//! Decoders fill missing parts of a damaged file with gray, or leave the memory unchanged, which holds the previous
//! image. So the file is read marker by marker first, and a file without its end marker is refused. [`check`] reads
//! the coded data, too.

use std::borrow::Cow;

use super::jpeg_scan;

pub use super::jpeg_error::JpegError;

const SOI: u8 = 0xD8;
const EOI: u8 = 0xD9;
const SOS: u8 = 0xDA;
const DHT: u8 = 0xC4;

/// Positions of a JPEG's markers, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Markers {
    /// Offset after the end marker.
    end: usize,
    /// Offset of the first scan.
    first_scan: usize,
    /// Whether the file has Huffman tables.
    has_tables: bool,
}

/// Reads the markers.
///
/// # Errors
/// The JPEG is incomplete.
fn markers(bytes: &[u8]) -> Result<Markers, JpegError> {
    let cut = |bytes: usize| JpegError::CutOff { bytes };
    if bytes.get(..2) != Some(&[0xFF, SOI]) {
        return Err(JpegError::NotJpeg);
    }
    let (mut at, mut first_scan, mut has_tables) = (2, None, false);
    loop {
        // The next marker; bytes of a scan are skipped.
        let marker = loop {
            let Some(found) = bytes[at..].iter().position(|byte| *byte == 0xFF) else { return Err(cut(bytes.len())) };
            at += found + 1;
            match bytes.get(at) {
                None => return Err(cut(bytes.len())),
                // A stuffed byte, a restart, a fill byte.
                Some(0x00 | 0xD0..=0xD7) => at += 1,
                Some(0xFF) => {}
                Some(marker) => {
                    at += 1;
                    break *marker;
                }
            }
        };
        match marker {
            EOI => {
                let Some(first_scan) = first_scan else { return Err(JpegError::NoPicture) };
                return Ok(Markers { end: at, first_scan, has_tables });
            }
            SOI | 0x01 => continue,
            SOS if first_scan.is_none() => first_scan = Some(at - 2),
            DHT => has_tables = true,
            _ => {}
        }
        let Some(&[high, low]) = bytes.get(at..at + 2) else { return Err(cut(bytes.len())) };
        at += usize::from(u16::from_be_bytes([high, low]));
        if at > bytes.len() {
            return Err(cut(bytes.len()));
        }
    }
}

/// The bytes of one complete JPEG: without bytes after its end, and with the standard Huffman tables if it has none, as
/// in Motion JPEG.
///
/// # Errors
/// The JPEG is incomplete.
pub fn whole(bytes: &[u8]) -> Result<Cow<'_, [u8]>, JpegError> {
    let found = markers(bytes)?;
    if found.has_tables {
        return Ok(Cow::Borrowed(&bytes[..found.end]));
    }
    let (head, rest) = bytes[..found.end].split_at(found.first_scan);
    Ok(Cow::Owned([head, &standard_tables(), rest].concat()))
}

/// Reads markers and coded data without decoding an image.
///
/// # Errors
/// The JPEG is incomplete, or its coded data are damaged.
pub fn check(bytes: &[u8]) -> Result<(), JpegError> {
    let bytes = whole(bytes)?;
    let (mut at, mut segments) = (2, Vec::new());
    // `whole` has seen that all of this is there; fill bytes may stand before a marker.
    while let Some(&[0xFF, marker]) = bytes.get(at..at + 2) {
        if marker == 0xFF {
            at += 1;
            continue;
        }
        let Some(&[high, low]) = bytes.get(at + 2..at + 4) else { break };
        let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
        let Some(content) = bytes.get(at + 4..end) else { break };
        segments.push((marker, content));
        at = end;
        if marker == SOS {
            let end = scan_end(&bytes, at);
            // Several scans: not baseline.
            return if bytes.get(end + 1) == Some(&EOI) {
                jpeg_scan::check(&segments, &bytes[at..end])
            } else {
                Ok(())
            };
        }
    }
    Err(JpegError::NoPicture)
}

/// End of the scan that begins at `start`: before the next marker, and before fill bytes in front of it.
fn scan_end(bytes: &[u8], start: usize) -> usize {
    let mut at = start;
    while let Some(found) = bytes[at..].iter().position(|byte| *byte == 0xFF) {
        at += found;
        match bytes.get(at + 1) {
            Some(0x00 | 0xD0..=0xD7) => at += 2,
            Some(0xFF) => at += 1,
            _ => return at,
        }
    }
    bytes.len()
}

/// The tables of the standard (ITU-T T.81, annex K.3), which Motion JPEG may leave out.
fn standard_tables() -> Vec<u8> {
    const DC: [[u8; 16]; 2] =
        [[0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0], [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0]];
    const AC_COUNTS: [[u8; 16]; 2] =
        [[0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7D], [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 0x77]];
    // Symbols up to the run of codes of 16 bits; these come in rising order of what is left.
    const AC_FIRST: [&[u8]; 2] = [
        &[
            0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07, 0x22, 0x71,
            0x14, 0x32, 0x81, 0x91, 0xA1, 0x08, 0x23, 0x42, 0xB1, 0xC1, 0x15, 0x52, 0xD1, 0xF0, 0x24, 0x33, 0x62, 0x72,
            0x82,
        ],
        &[
            0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07, 0x61, 0x71, 0x13, 0x22,
            0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xA1, 0xB1, 0xC1, 0x09, 0x23, 0x33, 0x52, 0xF0, 0x15, 0x62, 0x72, 0xD1,
            0x0A, 0x16, 0x24, 0x34, 0xE1, 0x25, 0xF1,
        ],
    ];
    let mut body = Vec::new();
    for (id, counts) in DC.into_iter().enumerate() {
        body.push(id as u8);
        body.extend(counts);
        body.extend(0..12);
    }
    for (id, (counts, first)) in AC_COUNTS.into_iter().zip(AC_FIRST).enumerate() {
        body.push(0x10 | id as u8);
        body.extend(counts);
        body.extend(first);
        let symbols = (0..=15u8).flat_map(|run| (1..=10u8).map(move |size| run << 4 | size));
        body.extend(symbols.filter(|symbol| !first.contains(symbol)));
    }
    let length = (body.len() + 2) as u16;
    [&[0xFF, DHT], &length.to_be_bytes()[..], &body].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_standard_tables_are_whole() {
        let tables = standard_tables();
        // Two tables of 12 symbols, two of 162, each with its 17 bytes in front.
        assert_eq!(tables.len(), 4 + 2 * (17 + 12) + 2 * (17 + 162));
        let symbols = &tables[4 + 2 * 29 + 17..][..162];
        assert_eq!(symbols.iter().collect::<std::collections::BTreeSet<_>>().len(), 162);
        assert_eq!(symbols[161], 0xFA);
    }

    #[test]
    fn only_whole_files_pass() {
        let scan = [0xFF, SOS, 0, 2, 1, 2, 0xFF, 0x00, 3, 0xFF, 0xD0, 4];
        let whole = [&[0xFF, SOI][..], &scan, &[0xFF, EOI], &[7; 5]].concat();
        assert_eq!(markers(&whole), Ok(Markers { end: 16, first_scan: 2, has_tables: false }));
        for length in 0..16 {
            assert!(markers(&whole[..length]).is_err(), "{length}");
        }
        // The end marker of a preview inside a segment is not the picture's.
        let preview = [0xFF, 0xE1, 0, 8, 0xFF, SOI, 0xFF, EOI, 0, 0];
        let cut = [&[0xFF, SOI][..], &preview, &scan].concat();
        assert_eq!(markers(&cut), Err(JpegError::CutOff { bytes: cut.len() }));
    }
}
