//! A clip as Video Endoscopic Image (PS3.3, A.32.5): the unchanged H.264 of an MP4 file.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::Mutex;

use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::tags;
use sha2::{Digest, Sha256};

use super::mp4::{self, Film};
use super::still::{encapsulated_end, encapsulated_head, lossy, pixel_description};
use super::{Identity, Study, number_in_name};
use crate::dicom::element::{decimal, sequence, text};
use crate::dicom::error::{DicomError, Result};
use crate::dicom::part10::{Pending, write};
use crate::dicom::time::Moment;

/// SOP class UID of Video Endoscopic Image Storage.
pub const CLASS: &str = "1.2.840.10008.5.1.4.1.1.77.1.1.1";
/// MPEG-4 AVC/H.264 High Profile / Level 4.1, and Level 4.2 for 2D video (PS3.5, 8.2.7 and 8.2.8).
const LEVELS: [(u8, &str); 2] = [(41, "1.2.840.10008.1.2.4.102"), (42, "1.2.840.10008.1.2.4.104")];
/// `profile_idc` of the high profile.
const HIGH: u8 = 100;
/// Number of the series of clips.
const SERIES: (u32, &str) = (2, "Clips");
/// Maximum number of bytes of a video, because the length of a fragment has 32 bits.
const MAX_BYTES: u64 = u32::MAX as u64 - 16;

/// An MP4 file that fits the standard.
pub struct Clip {
    file: Mutex<File>,
    bytes: u64,
    film: Film,
    transfer_syntax: &'static str,
    sha256: [u8; 32],
    moment: Moment,
    number: Option<u32>,
}

impl Clip {
    /// Opens the MP4 form of a clip. `original` is the clip's own file; its name and time give the number and time of
    /// the clip.
    ///
    /// # Errors
    /// It cannot be read, or is not H.264 in the high profile of level 4.1 or 4.2.
    pub fn open(mp4: &Path, original: &Path) -> Result<Self> {
        let failed = |cause| DicomError::Read { file: mp4.to_owned(), cause };
        let wrong = |problem: String| DicomError::Input { file: original.to_owned(), problem };
        let mut file = File::open(mp4).map_err(failed)?;
        let bytes = file.metadata().map_err(failed)?.len();
        if bytes > MAX_BYTES {
            return Err(wrong(format!("{bytes} bytes of video; the limit is 4 GiB: record shorter clips")));
        }
        let film = mp4::parse(&mut file).map_err(|error| wrong(error.to_string()))?;
        let transfer_syntax = transfer_syntax(&film).map_err(|error| wrong(error.to_string()))?;
        let original_file =
            File::open(original).map_err(|cause| DicomError::Read { file: original.to_owned(), cause })?;
        let moment = original_file.metadata().and_then(|about| about.modified());
        let moment = Moment::of(moment.map_err(|cause| DicomError::Read { file: original.to_owned(), cause })?);
        // Of the original, so that the object is the same however its video was made.
        let sha256 = digest(original_file).map_err(|cause| DicomError::Read { file: original.to_owned(), cause })?;
        Ok(Self {
            file: Mutex::new(file),
            bytes,
            film,
            transfer_syntax,
            sha256,
            moment,
            number: number_in_name(original),
        })
    }

    /// Properties of the video.
    pub fn film(&self) -> &Film {
        &self.film
    }

    /// Writes it as an object into `folder`; `number` is used if the file's name has none.
    pub(crate) fn write(&self, study: &Study<'_>, number: u32, folder: &Path) -> Result<Pending> {
        let film = &self.film;
        let mut object = study.image(&Identity {
            class: CLASS,
            instance: study.instance(CLASS, &self.sha256),
            modality: "ES",
            series: SERIES,
            number: self.number.unwrap_or(number),
            moment: self.moment.clone(),
        });
        object.put(text(tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY"));
        object.put(sequence(tags::ACQUISITION_CONTEXT_SEQUENCE, Vec::new()));
        pixel_description(&mut object, film.size, 3, "YBR_PARTIAL_420");
        let frame_ms = film.seconds * 1000.0 / f64::from(film.frames);
        object.put(text(tags::NUMBER_OF_FRAMES, VR::IS, film.frames.to_string()));
        object.put(text(tags::FRAME_TIME, VR::DS, decimal(frame_ms)));
        object.put(DataElement::new(tags::FRAME_INCREMENT_POINTER, VR::AT, PrimitiveValue::from(tags::FRAME_TIME)));
        object.put(text(tags::CINE_RATE, VR::IS, format!("{:.0}", (1000.0 / frame_ms).max(1.0))));
        object.put(text(tags::EFFECTIVE_DURATION, VR::DS, decimal(film.seconds)));
        let plain = f64::from(film.size.0) * f64::from(film.size.1) * 3.0 * f64::from(film.frames);
        lossy(&mut object, "ISO_14496_10", plain / self.bytes as f64);
        write(folder, &object, self.transfer_syntax, |out| self.video(out))
    }

    fn video(&self, out: &mut dyn Write) -> std::io::Result<()> {
        let mut file = self.file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        file.seek(SeekFrom::Start(0))?;
        // A file of an odd number of bytes gets an empty box of its own at its end, so that it stays an MP4 file.
        let free: &[u8] = if self.bytes % 2 == 1 { b"\0\0\0\x09free\0" } else { b"" };
        let length = self.bytes + free.len() as u64;
        encapsulated_head(out, length)?;
        let copied = std::io::copy(&mut Read::take(&mut *file, self.bytes), out)?;
        if copied != self.bytes {
            return Err(std::io::Error::new(std::io::ErrorKind::UnexpectedEof, "the video became shorter"));
        }
        out.write_all(free)?;
        encapsulated_end(out, length)
    }
}

fn digest(mut file: File) -> std::io::Result<[u8; 32]> {
    let mut hash = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(hash.finalize().into()),
            count => hash.update(&buffer[..count]),
        }
    }
}

/// A video that no transfer syntax allows.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
enum SyntaxError {
    /// Its H.264 is of another profile.
    #[error(
        "its H.264 has the profile {profile}, chroma format {chroma_format}, {bits} bits; DICOM allows the high profile (100), 4:2:0 (1), 8 bits"
    )]
    Profile { profile: u8, chroma_format: u8, bits: u8 },
    /// It has too many pixels a second.
    #[error(
        "{width} x {height} px at {per_s:.0} pictures a second need H.264 of level {level:.1}; DICOM allows 4.2, which is 1920 x 1088 px at 60 a second: record a smaller view"
    )]
    Level { width: u16, height: u16, per_s: f64, level: f64 },
}

/// The transfer syntax that allows a video.
fn transfer_syntax(film: &Film) -> Result<&'static str, SyntaxError> {
    let Film { profile, chroma_format, bits, size: (width, height), .. } = *film;
    if profile != HIGH || chroma_format != 1 || bits != (8, 8) {
        return Err(SyntaxError::Profile { profile, chroma_format, bits: bits.0 });
    }
    let syntax = LEVELS.iter().find(|(level, _)| film.level <= *level).map(|(_, syntax)| *syntax);
    let (per_s, level) = (f64::from(film.frames) / film.seconds, f64::from(film.level) / 10.0);
    syntax.ok_or(SyntaxError::Level { width, height, per_s, level })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_the_standard_allows_has_a_transfer_syntax() {
        let film = Film {
            size: (640, 480),
            frames: 30,
            seconds: 1.0,
            profile: HIGH,
            level: 30,
            chroma_format: 1,
            bits: (8, 8),
        };
        assert_eq!(transfer_syntax(&film), Ok(LEVELS[0].1));
        assert_eq!(transfer_syntax(&Film { level: 42, ..film }), Ok(LEVELS[1].1));
        for (film, words) in [
            (Film { level: 51, ..film }, "level 5.1"),
            (Film { profile: 66, ..film }, "high profile"),
            (Film { chroma_format: 3, ..film }, "4:2:0"),
            (Film { bits: (10, 10), ..film }, "8 bits"),
        ] {
            let error = transfer_syntax(&film).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
