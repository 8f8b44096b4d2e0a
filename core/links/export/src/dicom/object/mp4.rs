//! Content of an MP4 file with H.264, read from its index (ISO/IEC 14496-12 and 14496-15).
//!
//! A clip goes into an object as it is, so the object has to say truthfully what is in it, and only what the standard
//! allows may get in.

use std::io::{Read, Seek, SeekFrom};

/// Maximum number of bytes of the index: hours of video.
const MAX_INDEX_BYTES: u64 = 64 << 20;
/// Maximum number of boxes at one level.
const MAX_BOXES: usize = 1000;

/// A video.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Film {
    /// Width and height, px.
    pub size: (u16, u16),
    /// Number of images.
    pub frames: u32,
    /// Length, s.
    pub seconds: f64,
    /// H.264 profile, `profile_idc`: 66 baseline, 77 main, 100 high.
    pub profile: u8,
    /// H.264 level, `level_idc`: 41 is level 4.1.
    pub level: u8,
    /// Chroma format; 1: 4:2:0, the only one in profiles up to main.
    pub chroma_format: u8,
    /// Bits of luma and chroma.
    pub bits: (u8, u8),
}

/// A file that is not an MP4 file with one H.264 track.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Mp4Error {
    /// The operating system's error.
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// A box inside the index is longer than its container.
    #[error("a box `{kind}` has {size} bytes, but only {left} follow")]
    LongBox { kind: String, size: usize, left: usize },
    /// A box of the file is longer than the file.
    #[error("at byte {at}: a box has {size} bytes, but only {left} follow")]
    LongBoxAt { at: u64, size: u64, left: u64 },
    /// Too many boxes at one level.
    #[error("more than {MAX_BOXES} boxes")]
    ManyBoxes,
    /// A box is missing.
    #[error("there is no box `{kind}`")]
    NoBox { kind: String },
    /// A box ends before its fields do.
    #[error("{what} is truncated")]
    Cut { what: &'static str },
    /// A track of sound, for example.
    #[error("it has a track other than video")]
    OtherTrack,
    /// No video track, or several.
    #[error("it has {count} video tracks, not one")]
    Tracks { count: usize },
    /// The index is too long.
    #[error("its index of {size} bytes exceeds the limit of {MAX_INDEX_BYTES}")]
    LongIndex { size: u64 },
    /// The box `moov` is missing.
    #[error("it has no index: it is not an MP4 file, or was not completed")]
    NoIndex,
    /// Neither version 0 nor 1.
    #[error("the version of `mdhd` is unknown")]
    Version,
    /// Several descriptions.
    #[error("its images have more than one encoding")]
    Codings,
    /// No description.
    #[error("its images have no description")]
    NoCoding,
    /// Another codec.
    #[error("its images are `{kind}`, not H.264 (`avc1`)")]
    OtherCoding { kind: String },
    /// No images, or images without pixels or duration.
    #[error("it has no images")]
    Empty,
    /// More than 2^31 images.
    #[error("it has too many images")]
    TooMany,
    /// More than 2^64 ticks.
    #[error("it is too long")]
    TooLong,
}

/// A box: its type and its content.
type Box_<'a> = ([u8; 4], &'a [u8]);

/// The boxes in some bytes.
fn boxes(bytes: &[u8]) -> Result<Vec<Box_<'_>>, Mp4Error> {
    let mut found = Vec::new();
    let mut rest = bytes;
    while rest.len() >= 8 {
        let (size, kind) = (be32(rest, 0)? as usize, [rest[4], rest[5], rest[6], rest[7]]);
        let size = if size == 0 { rest.len() } else { size };
        if size < 8 || size > rest.len() {
            return Err(Mp4Error::LongBox { kind: kind.escape_ascii().to_string(), size, left: rest.len() });
        }
        found.push((kind, &rest[8..size]));
        if found.len() > MAX_BOXES {
            return Err(Mp4Error::ManyBoxes);
        }
        rest = &rest[size..];
    }
    Ok(found)
}

fn inner<'a>(bytes: &'a [u8], kind: &[u8; 4]) -> Result<&'a [u8], Mp4Error> {
    let found = boxes(bytes)?.into_iter().find(|(own, _)| own == kind);
    found.map(|(_, content)| content).ok_or_else(|| Mp4Error::NoBox { kind: kind.escape_ascii().to_string() })
}

fn be32(bytes: &[u8], at: usize) -> Result<u32, Mp4Error> {
    let four = bytes.get(at..at + 4).and_then(|four| <[u8; 4]>::try_from(four).ok());
    four.map(u32::from_be_bytes).ok_or(Mp4Error::Cut { what: "a box" })
}

fn be16(bytes: &[u8], at: usize) -> Result<u16, Mp4Error> {
    let two = bytes.get(at..at + 2).and_then(|two| <[u8; 2]>::try_from(two).ok());
    two.map(u16::from_be_bytes).ok_or(Mp4Error::Cut { what: "a box" })
}

/// Reads the properties of the only video track of a file.
///
/// # Errors
///
/// The file cannot be read, is damaged, or is not an MP4 file with one H.264 track.
pub fn parse(file: &mut (impl Read + Seek)) -> Result<Film, Mp4Error> {
    let index = index(file)?;
    let mut films = Vec::new();
    for (_, track) in boxes(&index)?.into_iter().filter(|(kind, _)| kind == b"trak") {
        let media = inner(track, b"mdia")?;
        if inner(media, b"hdlr")?.get(8..12) == Some(b"vide") {
            films.push(film(media)?);
        } else {
            return Err(Mp4Error::OtherTrack);
        }
    }
    match films[..] {
        [film] => Ok(film),
        _ => Err(Mp4Error::Tracks { count: films.len() }),
    }
}

/// The content of the box `moov`.
fn index(file: &mut (impl Read + Seek)) -> Result<Vec<u8>, Mp4Error> {
    let end = file.seek(SeekFrom::End(0))?;
    let mut at = 0;
    for _ in 0..MAX_BOXES {
        if at + 8 > end {
            break;
        }
        file.seek(SeekFrom::Start(at))?;
        let mut head = [0; 16];
        file.read_exact(&mut head[..8])?;
        let (mut size, mut head_bytes) = (u64::from(be32(&head, 0)?), 8);
        if size == 1 {
            file.read_exact(&mut head[8..])?;
            (size, head_bytes) = (u64::from(be32(&head, 8)?) << 32 | u64::from(be32(&head, 12)?), 16);
        } else if size == 0 {
            size = end - at;
        }
        let next = at.checked_add(size).filter(|next| *next <= end && size >= head_bytes);
        let next = next.ok_or(Mp4Error::LongBoxAt { at, size, left: end - at })?;
        if &head[4..8] == b"moov" {
            if size > MAX_INDEX_BYTES {
                return Err(Mp4Error::LongIndex { size });
            }
            let mut index = vec![0; (size - head_bytes) as usize];
            file.read_exact(&mut index)?;
            return Ok(index);
        }
        at = next;
    }
    Err(Mp4Error::NoIndex)
}

fn film(media: &[u8]) -> Result<Film, Mp4Error> {
    let header = inner(media, b"mdhd")?;
    let scale = match header.first() {
        Some(0) => be32(header, 12)?,
        Some(1) => be32(header, 20)?,
        _ => return Err(Mp4Error::Version),
    };
    let table = inner(inner(media, b"minf")?, b"stbl")?;
    let (frames, ticks) = times(inner(table, b"stts")?)?;
    let descriptions = inner(table, b"stsd")?;
    if be32(descriptions, 4)? != 1 {
        return Err(Mp4Error::Codings);
    }
    let entries = boxes(descriptions.get(8..).unwrap_or_default())?;
    let [(kind, entry)] = entries[..] else { return Err(Mp4Error::NoCoding) };
    if &kind != b"avc1" {
        return Err(Mp4Error::OtherCoding { kind: kind.escape_ascii().to_string() });
    }
    // A sample entry, then the fields of a visual one, then boxes.
    let size = (be16(entry, 24)?, be16(entry, 26)?);
    let coding = inner(entry.get(78..).unwrap_or_default(), b"avcC")?;
    let &[1, profile, _, level, ..] = coding else { return Err(Mp4Error::Cut { what: "`avcC`" }) };
    let (chroma_format, bits) = colours(coding, profile)?;
    if size.0 == 0 || size.1 == 0 || frames == 0 || scale == 0 || ticks == 0 {
        return Err(Mp4Error::Empty);
    }
    let seconds = ticks as f64 / f64::from(scale);
    Ok(Film { size, frames, seconds, profile, level, chroma_format, bits })
}

/// Number of images and their time in ticks.
fn times(stts: &[u8]) -> Result<(u32, u64), Mp4Error> {
    let runs = be32(stts, 4)? as usize;
    let body = stts.get(8..).unwrap_or_default();
    if body.len() / 8 < runs {
        return Err(Mp4Error::Cut { what: "`stts`" });
    }
    let (mut frames, mut ticks) = (0u32, 0u64);
    for run in body.chunks_exact(8).take(runs) {
        let (count, each) = (be32(run, 0)?, be32(run, 4)?);
        frames = frames.checked_add(count).filter(|n| *n <= i32::MAX as u32).ok_or(Mp4Error::TooMany)?;
        ticks = ticks.checked_add(u64::from(count) * u64::from(each)).ok_or(Mp4Error::TooLong)?;
    }
    Ok((frames, ticks))
}

/// Chroma format and bits; for profiles up to main they are 4:2:0 and 8.
fn colours(coding: &[u8], profile: u8) -> Result<(u8, (u8, u8)), Mp4Error> {
    if [66, 77, 88].contains(&profile) {
        return Ok((1, (8, 8)));
    }
    let cut = || Mp4Error::Cut { what: "`avcC`" };
    let mut at = 5;
    // Parameter sets of sequences (the count has 5 bits), then of pictures.
    for mask in [0x1F, 0xFF] {
        let count = coding.get(at).ok_or_else(cut)? & mask;
        at += 1;
        for _ in 0..count {
            at += 2 + usize::from(be16(coding, at)?);
        }
    }
    match coding.get(at..at + 3) {
        Some(&[chroma, luma_bits, chroma_bits]) => Ok((chroma & 3, (8 + (luma_bits & 7), 8 + (chroma_bits & 7)))),
        // Muxers that leave the extension out write 4:2:0 of 8 bits.
        _ if at <= coding.len() => Ok((1, (8, 8))),
        _ => Err(cut()),
    }
}
