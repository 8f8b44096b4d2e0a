//! Counts the frames of a Matroska video of `write_video` without its own reader: each cluster contains one JPEG.

const CLUSTER: [u8; 4] = [0x1F, 0x43, 0xB6, 0x75];

/// Number of complete frames at the beginning of a video, and the position of their end. An unfinished video has nothing or a part of a frame after
/// it.
pub fn whole_frames(bytes: &[u8]) -> (usize, usize) {
    let mut at = bytes.windows(4).position(|four| four == CLUSTER).unwrap_or(bytes.len());
    let mut frames = 0;
    while let Some([a, b, c, d, size @ ..]) = bytes.get(at..).and_then(|rest| rest.first_chunk::<12>())
        && [*a, *b, *c, *d] == CLUSTER
    {
        let end = at + 12 + (u64::from_be_bytes(*size) & !(0xFF << 56)) as usize;
        if !bytes.get(at..end).is_some_and(|cluster| cluster.ends_with(&[0xFF, 0xD9])) {
            break;
        }
        (frames, at) = (frames + 1, end);
    }
    (frames, at)
}
