//! Kinds of video files that must be known before GStreamer opens them, identified by their first bytes.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Kind of a video file, as far as opening depends on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// GIF. GStreamer finds neither all its frames nor its end.
    Gif,
    /// An MPEG transport stream, with packets of 188 or 192 bytes, or a program stream. Its length is not stated: GStreamer computes it from the
    /// clocks in it, which may jump.
    Clocked,
    /// JPEGs without a container. GStreamer shows only the first of them.
    Jpegs,
    /// Any other file.
    Other,
}

impl FileKind {
    /// Identifies a file by its first bytes. A file that cannot be read is [`Self::Other`].
    pub fn of(path: &Path) -> Self {
        let mut bytes = Vec::new();
        let read = File::open(path).and_then(|file| file.take(200).read_to_end(&mut bytes));
        if read.is_ok() { Self::of_bytes(&bytes) } else { Self::Other }
    }

    fn of_bytes(bytes: &[u8]) -> Self {
        let is_packet = |at: usize| bytes.get(at) == Some(&0x47);
        if bytes.starts_with(b"GIF8") {
            return Self::Gif;
        }
        if bytes.starts_with(&[0xFF, 0xD8, 0xFF]) {
            return Self::Jpegs;
        }
        let is_transport = is_packet(0) && is_packet(188) || is_packet(4) && is_packet(196);
        if is_transport || bytes.starts_with(&[0, 0, 1, 0xBA]) { Self::Clocked } else { Self::Other }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_are_told_by_their_first_bytes() {
        let with = |places: &[usize]| {
            let mut bytes = vec![0; 200];
            places.iter().for_each(|at| bytes[*at] = 0x47);
            FileKind::of_bytes(&bytes)
        };
        assert_eq!([with(&[0, 188]), with(&[4, 196])], [FileKind::Clocked; 2]);
        assert_eq!(FileKind::of_bytes(&[0, 0, 1, 0xBA, 0x44]), FileKind::Clocked);
        assert_eq!(FileKind::of_bytes(b"GIF89a"), FileKind::Gif);
        assert_eq!(FileKind::of_bytes(&[0xFF, 0xD8, 0xFF, 0xE0]), FileKind::Jpegs);
        assert_eq!([with(&[0]), FileKind::of_bytes(&[]), FileKind::of_bytes(&[0x1A, 0x45])], [FileKind::Other; 3]);
    }
}
