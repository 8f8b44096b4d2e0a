//! Checks a plugin's ELF file before it is loaded, and reads its Panoscope note.
//!
//! Mapping a truncated shared object ends in SIGBUS, and constructors run as soon as it is loaded. Completeness and ABI
//! version are therefore checked by reading the file. Only 64-bit ELF is supported.

use std::borrow::Cow;
use std::fs::File;
use std::os::unix::fs::FileExt;

use panoscope_abi as abi;

/// The contents of a plugin's note.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// ABI major number that the plugin was built with.
    pub abi_major: u32,
    /// ABI minor number that the plugin was built with.
    pub abi_minor: u32,
    /// Name of the plugin in graph files.
    pub name: String,
    /// Version of the plugin's package.
    pub version: String,
    /// Names of its node types.
    pub node_types: Vec<String>,
}

/// A file that cannot be used as a plugin.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ElfError {
    /// Not an ELF shared object of this machine.
    #[error("it is not a shared library for this machine ({what})")]
    NotElf {
        /// Actual type of the file.
        what: String,
    },
    /// Shorter than its tables require.
    #[error("it is truncated: {what} ends at byte {end}, the file has {len}")]
    CutOff {
        /// The missing part.
        what: &'static str,
        /// End of that part in the file.
        end: u64,
        /// Length of the file in bytes.
        len: u64,
    },
    /// A part of it could not be read.
    #[error("bytes {at} to {end} cannot be read: {reason}")]
    Unreadable {
        /// First byte.
        at: u64,
        /// One past the last byte.
        end: u64,
        /// The operating system's message.
        reason: String,
    },
    /// A shared library without the note.
    #[error("it has no Panoscope note, so it is not a Panoscope plugin")]
    NoNote,
    /// The note cannot be parsed.
    #[error("its Panoscope note is damaged: {what}")]
    BadNote {
        /// Mistake in the note.
        what: String,
    },
}

const PT_LOAD: u32 = 1;
const SHT_NOBITS: u32 = 8;
const SHT_NOTE: u32 = 7;
/// Bytes per entry of the tables of segments and sections in a 64-bit ELF file.
const ENTRY_BYTES: (u64, u64) = (56, 64);
/// Maximum number of bytes of all notes: compilers' notes have a few hundred, the plugin note two thousand.
const MAX_NOTE_BYTES: u64 = 1 << 20;

/// A file that is read in parts: plugins are large, and only a small part is needed before loading.
pub trait Parts {
    /// Length of the file in bytes.
    fn size(&self) -> u64;

    /// `len` bytes from offset `at` on; the caller ensures that they are inside the file.
    ///
    /// # Errors
    /// The bytes cannot be read.
    fn part(&self, at: u64, len: u64) -> Result<Cow<'_, [u8]>, ElfError>;
}

impl Parts for [u8] {
    fn size(&self) -> u64 {
        self.len() as u64
    }

    fn part(&self, at: u64, len: u64) -> Result<Cow<'_, [u8]>, ElfError> {
        let end = at.saturating_add(len);
        let part = self.get(at as usize..end as usize);
        part.map(Cow::Borrowed).ok_or_else(|| ElfError::Unreadable { at, end, reason: "it ends before".to_owned() })
    }
}

/// A file on disk, with its length when it was opened.
pub struct OnDisk {
    file: File,
    len: u64,
}

impl OnDisk {
    /// Opens a file.
    ///
    /// # Errors
    /// The file cannot be opened.
    pub fn open(path: &std::path::Path) -> std::io::Result<Self> {
        Self::over(File::open(path)?)
    }

    /// Wraps an open file.
    ///
    /// # Errors
    /// The length of the file cannot be read.
    pub fn over(file: File) -> std::io::Result<Self> {
        let len = file.metadata()?.len();
        Ok(Self { file, len })
    }
}

impl Parts for OnDisk {
    fn size(&self) -> u64 {
        self.len
    }

    fn part(&self, at: u64, len: u64) -> Result<Cow<'_, [u8]>, ElfError> {
        let mut bytes = vec![0; len as usize];
        let read = self.file.read_exact_at(&mut bytes, at);
        let end = at.saturating_add(len);
        read.map(|()| Cow::Owned(bytes)).map_err(|e| ElfError::Unreadable { at, end, reason: e.to_string() })
    }
}

struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn bytes<const N: usize>(&self, at: u64) -> Option<[u8; N]> {
        let at = usize::try_from(at).ok()?;
        self.0.get(at..at.checked_add(N)?)?.try_into().ok()
    }

    fn u16(&self, at: u64) -> Option<u64> {
        self.bytes(at).map(|b| u64::from(u16::from_le_bytes(b)))
    }

    fn u32(&self, at: u64) -> Option<u32> {
        self.bytes(at).map(u32::from_le_bytes)
    }

    fn u64(&self, at: u64) -> Option<u64> {
        self.bytes(at).map(u64::from_le_bytes)
    }
}

/// Checks that every segment and section lies inside the file, and reads the note.
pub fn read_note(file: &(impl Parts + ?Sized)) -> Result<Note, ElfError> {
    let file_len = file.size();
    let inside = |what: &'static str, start: u64, len: u64| {
        let end = start.saturating_add(len);
        if end > file_len { Err(ElfError::CutOff { what, end, len: file_len }) } else { Ok(()) }
    };
    let header = file.part(0, file_len.min(64))?;
    if !header.starts_with(b"\x7fELF") {
        let what = if file_len == 0 { "the file is empty" } else { "it does not begin with ELF" };
        return Err(ElfError::NotElf { what: what.to_owned() });
    }
    inside("the ELF header", 0, 64)?;
    let reader = Reader(&header);
    if header[4] != 2 || header[5] != 1 {
        return Err(ElfError::NotElf { what: "not 64-bit little-endian".to_owned() });
    }
    let machine = reader.u16(18).unwrap_or(0);
    let expected = if cfg!(target_arch = "x86_64") { 62 } else { 183 };
    if machine != expected {
        return Err(ElfError::NotElf { what: format!("built for processor type {machine}, this is {expected}") });
    }
    if reader.u16(16) != Some(3) {
        return Err(ElfError::NotElf { what: "not a shared library".to_owned() });
    }
    let unreadable = |what| ElfError::BadNote { what: format!("{what} cannot be read") };
    let (programs, sections) =
        (reader.u64(32).ok_or(unreadable("header"))?, reader.u64(40).ok_or(unreadable("header"))?);
    let program_size = reader.u16(54).ok_or(unreadable("header"))?;
    let program_count = reader.u16(56).ok_or(unreadable("header"))?;
    let section_size = reader.u16(58).ok_or(unreadable("header"))?;
    let section_count = reader.u16(60).ok_or(unreadable("header"))?;
    if (program_count > 0 && program_size != ENTRY_BYTES.0) || (section_count > 0 && section_size != ENTRY_BYTES.1) {
        let what = format!("its tables have entries of {program_size} and {section_size} bytes");
        return Err(ElfError::NotElf { what });
    }
    inside("the table of segments", programs, program_size * program_count)?;
    inside("the table of sections", sections, section_size * section_count)?;
    let mut notes = Vec::new();
    let table = file.part(programs, program_size * program_count)?;
    let reader = Reader(&table);
    for at in (0..program_count).map(|index| index * program_size) {
        let kind = reader.u32(at).ok_or(unreadable("segment"))?;
        let (offset, size) =
            (reader.u64(at + 8).ok_or(unreadable("segment"))?, reader.u64(at + 32).ok_or(unreadable("segment"))?);
        if kind == PT_LOAD {
            inside("a segment", offset, size)?;
        }
    }
    let table = file.part(sections, section_size * section_count)?;
    let reader = Reader(&table);
    for at in (0..section_count).map(|index| index * section_size) {
        let kind = reader.u32(at + 4).ok_or(unreadable("section"))?;
        let (offset, size) =
            (reader.u64(at + 24).ok_or(unreadable("section"))?, reader.u64(at + 32).ok_or(unreadable("section"))?);
        if kind != SHT_NOBITS {
            inside("a section", offset, size)?;
        }
        if kind == SHT_NOTE {
            notes.push((offset, size));
        }
    }
    // Sections may overlap, so the length of the file does not limit their sum.
    if notes.iter().fold(0u64, |sum, (_, size)| sum.saturating_add(*size)) > MAX_NOTE_BYTES {
        return Err(ElfError::BadNote { what: format!("the notes have more than {MAX_NOTE_BYTES} bytes") });
    }
    for (offset, size) in notes {
        if let Some(note) = find_note(&file.part(offset, size)?)? {
            return Ok(note);
        }
    }
    Err(ElfError::NoNote)
}

fn find_note(section: &[u8]) -> Result<Option<Note>, ElfError> {
    let reader = Reader(section);
    let mut at = 0u64;
    while let (Some(owner_len), Some(body_len), Some(kind)) = (reader.u32(at), reader.u32(at + 4), reader.u32(at + 8)) {
        let owner_at = at + 12;
        let body_at = owner_at + u64::from(owner_len).next_multiple_of(4);
        let owner = section.get(owner_at as usize..(owner_at + u64::from(owner_len)) as usize).unwrap_or(&[]);
        if owner == abi::NOTE_OWNER && kind == abi::NOTE_TYPE {
            let end = body_at + u64::from(body_len);
            let Some(body) = section.get(body_at as usize..end as usize) else {
                return Err(ElfError::BadNote { what: "it is truncated".to_owned() });
            };
            return parse_body(body).map(Some);
        }
        at = body_at + u64::from(body_len).next_multiple_of(4);
    }
    Ok(None)
}

fn parse_body(body: &[u8]) -> Result<Note, ElfError> {
    let reader = Reader(body);
    let need = 8 + abi::NOTE_NAME_LEN + abi::NOTE_VERSION_LEN;
    let (Some(abi_major), Some(abi_minor)) = (reader.u32(0), reader.u32(4)) else {
        return Err(ElfError::BadNote { what: format!("{} bytes instead of at least {need}", body.len()) });
    };
    // A note of another major version may have another layout after its first two numbers.
    let text = |start: usize, len: usize| -> Result<String, ElfError> {
        let bytes = body.get(start..(start + len).min(body.len())).unwrap_or(&[]);
        let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
        match std::str::from_utf8(&bytes[..end]) {
            Ok(text) => Ok(text.to_owned()),
            Err(_) => Err(ElfError::BadNote { what: "a text is not UTF-8".to_owned() }),
        }
    };
    let name = text(8, abi::NOTE_NAME_LEN)?;
    let version = text(8 + abi::NOTE_NAME_LEN, abi::NOTE_VERSION_LEN)?;
    let nodes = text(need, abi::NOTE_NODES_LEN)?;
    if abi_major == abi::ABI_MAJOR && (name.is_empty() || body.len() < size_of::<abi::NoteBody>()) {
        return Err(ElfError::BadNote { what: "it is too short or has no plugin name".to_owned() });
    }
    let node_types = nodes.split(',').filter(|n| !n.is_empty()).map(str::to_owned).collect();
    Ok(Note { abi_major, abi_minor, name, version, node_types })
}
