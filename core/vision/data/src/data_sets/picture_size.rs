//! Sizes of images, from their headers.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes of a PNM's header that are read.
const HEADER: u64 = 512;

/// Columns and rows; `None` for a file without a known image header.
pub(crate) fn of(path: &Path) -> Option<(u32, u32)> {
    image::image_dimensions(path).ok().or_else(|| pnm(path))
}

/// Columns and rows of a PGM or PPM.
fn pnm(path: &Path) -> Option<(u32, u32)> {
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(HEADER).read_to_end(&mut bytes).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    let mut words = text.lines().map(|line| line.split('#').next().unwrap_or("")).flat_map(str::split_whitespace);
    if !matches!(words.next(), Some("P5" | "P6")) {
        return None;
    }
    Some((words.next()?.parse().ok()?, words.next()?.parse().ok()?))
}
