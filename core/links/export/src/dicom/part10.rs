//! Files of DICOM objects (PS3.10): reads heads, and writes files atomically.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use dicom_dictionary_std::tags;
use dicom_object::{FileMetaTable, FileMetaTableBuilder};
use dicom_transfer_syntax_registry::entries::EXPLICIT_VR_LITTLE_ENDIAN;

use crate::dicom::element::{Set, read};
use crate::dicom::error::{DicomError, Result, chain};
use crate::dicom::lengths::{self, Encoding, LengthError};
use crate::dicom::uid;

/// Transfer syntax UID of explicit VR little endian, uncompressed.
pub const EXPLICIT: &str = "1.2.840.10008.1.2.1";
/// Transfer syntax UID of implicit VR little endian, uncompressed.
pub const IMPLICIT: &str = "1.2.840.10008.1.2";
/// Maximum number of bytes of a worklist entry.
pub const MAX_ENTRY_BYTES: usize = 1 << 20;
/// Maximum number of bytes of a file's head.
const MAX_HEAD_BYTES: usize = 64 << 10;
/// Bytes before the head: 128 unused ones and `DICM`.
const PREAMBLE: usize = 132;
/// The element that holds the length of the head: tag, UL, 4, and the length.
const GROUP_LENGTH: [u8; 8] = [0x02, 0x00, 0x00, 0x00, b'U', b'L', 0x04, 0x00];

/// Head of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Head {
    /// SOP class UID.
    pub class: String,
    /// SOP instance UID.
    pub instance: String,
    /// Transfer syntax UID.
    pub transfer_syntax: String,
    /// Bytes before the data set.
    pub length: usize,
}

/// A file without a usable head.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum HeadError {
    /// The file is not a DICOM file.
    #[error("it is not a DICOM file: `DICM` is not at byte 128")]
    NotDicom,
    /// The file is truncated.
    #[error("it ends within its header")]
    Cut,
    /// The head does not begin with its length.
    #[error("its header does not begin with its length")]
    NoLength,
    /// The head is too long.
    #[error("its header of {length} bytes exceeds the limit of {MAX_HEAD_BYTES}")]
    TooLong { length: usize },
    /// A length inside it is wrong.
    #[error(transparent)]
    Length(#[from] LengthError),
    /// The head cannot be decoded.
    #[error("{reason}")]
    Decode { reason: String },
    /// An identifier is missing or malformed.
    #[error("its header has no valid {what}")]
    NoUid { what: &'static str },
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] io::Error),
}

impl Head {
    /// Parses the head at the start of a file's bytes.
    ///
    /// # Errors
    ///
    /// The head is missing or malformed.
    pub fn parse(bytes: &[u8]) -> Result<Self, HeadError> {
        if bytes.get(PREAMBLE - 4..PREAMBLE) != Some(b"DICM") {
            return Err(HeadError::NotDicom);
        }
        let start = PREAMBLE + GROUP_LENGTH.len() + 4;
        let group = bytes.get(PREAMBLE..start).ok_or(HeadError::Cut)?;
        let length = group.strip_prefix(&GROUP_LENGTH[..]).ok_or(HeadError::NoLength)?;
        let length = u32::from_le_bytes(length.try_into().unwrap_or_default()) as usize;
        if length > MAX_HEAD_BYTES {
            return Err(HeadError::TooLong { length });
        }
        let end = start + length;
        let head = bytes.get(start..end).ok_or(HeadError::Cut)?;
        lengths::check(head, Encoding::Explicit)?;
        let syntax = EXPLICIT_VR_LITTLE_ENDIAN.erased();
        let head =
            Set::read_dataset_with_ts(head, &syntax).map_err(|error| HeadError::Decode { reason: chain(&error) })?;
        let uid_of = |tag, what| {
            let text = read(&head, tag);
            if uid::is_valid(&text) { Ok(text) } else { Err(HeadError::NoUid { what }) }
        };
        Ok(Self {
            class: uid_of(tags::MEDIA_STORAGE_SOP_CLASS_UID, "SOP class")?,
            instance: uid_of(tags::MEDIA_STORAGE_SOP_INSTANCE_UID, "SOP instance")?,
            transfer_syntax: uid_of(tags::TRANSFER_SYNTAX_UID, "transfer syntax")?,
            length: end,
        })
    }

    /// Reads the head of a file and leaves `file` at its data set.
    ///
    /// # Errors
    /// The head is missing or malformed, or the file cannot be read.
    pub fn read(file: &mut File) -> Result<Self, HeadError> {
        let mut bytes = Vec::new();
        Read::by_ref(file).take((PREAMBLE + MAX_HEAD_BYTES) as u64).read_to_end(&mut bytes)?;
        let head = Self::parse(&bytes)?;
        io::Seek::seek(file, io::SeekFrom::Start(head.length as u64))?;
        Ok(head)
    }

    /// Encoding of data sets in its transfer syntax; `None` for those that are neither plain nor encapsulated.
    pub fn encoding(&self) -> Option<Encoding> {
        match self.transfer_syntax.as_str() {
            IMPLICIT => Some(Encoding::Implicit),
            EXPLICIT => Some(Encoding::Explicit),
            _ => None,
        }
    }
}

/// The bytes of a small file.
///
/// # Errors
/// It cannot be read, or is too large.
pub(crate) fn read_small(path: &Path) -> Result<Vec<u8>> {
    let failed = |cause| DicomError::Read { file: path.to_owned(), cause };
    let mut bytes = Vec::new();
    let limit = (MAX_ENTRY_BYTES + MAX_HEAD_BYTES) as u64;
    let size = File::open(path).and_then(|file| file.take(limit + 1).read_to_end(&mut bytes)).map_err(failed)?;
    if size as u64 > limit {
        return Err(failed(io::Error::new(io::ErrorKind::FileTooLarge, format!("more than {limit} bytes"))));
    }
    Ok(bytes)
}

/// An object that is complete on the disk and not yet visible under its name.
#[derive(Debug)]
pub(crate) struct Pending {
    part: PathBuf,
    file: PathBuf,
    is_kept: bool,
}

impl Pending {
    /// Makes the object visible and returns its path.
    pub fn keep(mut self) -> Result<PathBuf> {
        let failed = |cause| DicomError::Write { file: self.file.clone(), cause };
        fs::rename(&self.part, &self.file).map_err(failed)?;
        self.is_kept = true;
        Ok(self.file.clone())
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        if !self.is_kept {
            let _ = fs::remove_file(&self.part);
        }
    }
}

/// Writes an object into `folder`, under the name of its SOP instance UID, which says nothing about the patient. `rest`
/// writes the data after the elements of `object`, such as pixels that are not held in memory.
///
/// Only the owner may read the file.
///
/// # Errors
/// The disk is full, or the folder cannot be written to; nothing of the object is left.
pub(crate) fn write(
    folder: &Path,
    object: &Set,
    transfer_syntax: &str,
    rest: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<Pending> {
    let instance = read(object, tags::SOP_INSTANCE_UID);
    let file = folder.join(format!("{instance}.dcm"));
    let part = folder.join(format!(".{instance}.{}.part", std::process::id()));
    let failed = |cause| DicomError::Write { file: file.clone(), cause };
    let head = head(object, transfer_syntax).map_err(failed)?;
    let created = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(&part).map_err(failed)?;
    // Removed again unless it is kept.
    let pending = Pending { part, file: file.clone(), is_kept: false };
    let mut out = io::BufWriter::with_capacity(1 << 18, created);
    let write_all = || -> io::Result<()> {
        out.write_all(&[0; PREAMBLE - 4])?;
        out.write_all(b"DICM")?;
        let other = |error: &dyn std::error::Error| io::Error::other(chain(error));
        let mut bytes = Vec::new();
        head.write(&mut bytes).map_err(|error| other(&error))?;
        // All transfer syntaxes that are written here encode elements alike.
        object.write_dataset_with_ts(&mut bytes, &EXPLICIT_VR_LITTLE_ENDIAN.erased()).map_err(|error| other(&error))?;
        out.write_all(&bytes)?;
        rest(&mut out)?;
        out.flush()?;
        out.get_ref().sync_all()
    };
    write_all().map_err(failed)?;
    Ok(pending)
}

fn head(object: &Set, transfer_syntax: &str) -> io::Result<FileMetaTable> {
    FileMetaTableBuilder::new()
        .media_storage_sop_class_uid(read(object, tags::SOP_CLASS_UID))
        .media_storage_sop_instance_uid(read(object, tags::SOP_INSTANCE_UID))
        .transfer_syntax(transfer_syntax)
        .implementation_class_uid(uid::IMPLEMENTATION)
        .implementation_version_name(uid::IMPLEMENTATION_NAME)
        .build()
        .map_err(|error| io::Error::other(chain(&error)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dicom::element::{set, text};
    use dicom_core::VR;
    use panoscope_testing::Folder;

    fn object() -> Set {
        set([
            text(tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.5.1.4.1.1.7"),
            text(tags::SOP_INSTANCE_UID, VR::UI, "2.25.77"),
            text(tags::PATIENT_ID, VR::LO, "P-7"),
        ])
    }

    #[test]
    fn a_file_is_there_whole_or_not_at_all() {
        let folder = Folder::new("dicom-part10", &[]);
        let names = || fs::read_dir(folder.path()).unwrap().map(|f| f.unwrap().file_name().into_string().unwrap());
        let full = |_: &mut dyn Write| Err(io::Error::from(io::ErrorKind::StorageFull));
        let error = write(folder.path(), &object(), EXPLICIT, full).unwrap_err().to_string();
        assert!(error.contains("2.25.77.dcm cannot be written") && error.contains("originals"), "{error}");
        assert_eq!(names().count(), 0);
        let pending = write(folder.path(), &object(), EXPLICIT, |_| Ok(())).unwrap();
        let file = pending.keep().unwrap();
        assert_eq!(names().collect::<Vec<_>>(), ["2.25.77.dcm"]);
        let bytes = fs::read(file).unwrap();
        let head = Head::parse(&bytes).unwrap();
        assert_eq!((head.instance.as_str(), head.encoding()), ("2.25.77", Some(Encoding::Explicit)));
        for end in 0..bytes.len() {
            let cut = Head::parse(&bytes[..end]);
            assert!(cut.is_err() || end >= head.length, "cut at {end}");
        }
        let error = Head::parse(&[&[0; 128][..], b"DICM", &GROUP_LENGTH, &[0xFF; 4]].concat()).unwrap_err().to_string();
        assert!(error.contains("exceeds the limit"), "{error}");
    }
}
