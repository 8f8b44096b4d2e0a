//! The number of frames in the header of an AVI file. GStreamer counts the frames that are present, which hides a truncated file.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Size of the part of the file that contains the header, bytes.
const HEADER_BYTES: u64 = 4096;

/// Number of frames that the header of an AVI file announces; `None` for other files.
pub fn frames(path: &Path) -> Option<u64> {
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(HEADER_BYTES).read_to_end(&mut bytes).ok()?;
    frames_in(&bytes)
}

fn frames_in(bytes: &[u8]) -> Option<u64> {
    if bytes.get(..4)? != b"RIFF" || bytes.get(8..12)? != b"AVI " {
        return None;
    }
    // The header of the first video stream: `strh`, length, `vids`, ..., length of the stream at byte 32.
    let at = bytes.windows(4).position(|word| word == b"strh")? + 8;
    let header = bytes.get(at..at + 36)?;
    let count = header.get(32..36).filter(|_| header.starts_with(b"vids"))?;
    Some(u64::from(u32::from_le_bytes(count.try_into().ok()?))).filter(|count| *count > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_avi_announces_frames() {
        let mut bytes = [&b"RIFF....AVI LIST....hdrlstrh"[..], &[56, 0, 0, 0], b"vids", &[0; 52]].concat();
        let at = bytes.windows(4).position(|word| word == b"vids").unwrap_or(0) + 32;
        bytes[at] = 100;
        assert_eq!(frames_in(&bytes), Some(100));
        bytes[at] = 0;
        assert_eq!(frames_in(&bytes), None);
        assert_eq!(frames_in(b"RIFF"), None);
        assert_eq!(frames_in(&[7; 100]), None);
    }
}
