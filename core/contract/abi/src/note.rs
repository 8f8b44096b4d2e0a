/// Owner name in the ELF note, zero-padded.
pub const NOTE_OWNER: [u8; 12] = *b"Panoscope\0\0\0";
/// Type number of the ELF note.
pub const NOTE_TYPE: u32 = 1;
/// ELF section that holds the note.
pub const NOTE_SECTION: &str = ".note.panoscope";
/// Bytes for the plugin's name.
pub const NOTE_NAME_LEN: usize = 64;
/// Bytes for the plugin's version.
pub const NOTE_VERSION_LEN: usize = 32;
/// Bytes for the node types' names, separated by commas.
pub const NOTE_NODES_LEN: usize = 2048;

/// Description of a plugin in its ELF file, readable before any of its code runs. Texts are zero-padded.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct NoteBody {
    /// [`crate::ABI_MAJOR`] that the plugin was built with.
    pub abi_major: u32,
    /// [`crate::ABI_MINOR`] that the plugin was built with.
    pub abi_minor: u32,
    /// Plugin name.
    pub name: [u8; NOTE_NAME_LEN],
    /// Plugin version.
    pub version: [u8; NOTE_VERSION_LEN],
    /// Names of the node types, separated by commas.
    pub nodes: [u8; NOTE_NODES_LEN],
}

/// An ELF note record.
#[repr(C, align(4))]
#[derive(Clone, Copy, Debug)]
pub struct Note {
    /// Length of `owner`.
    pub owner_len: u32,
    /// Length of `body`.
    pub body_len: u32,
    /// [`NOTE_TYPE`].
    pub note_type: u32,
    /// [`NOTE_OWNER`].
    pub owner: [u8; 12],
    /// Payload of the record.
    pub body: NoteBody,
}

const fn padded<const N: usize>(text: &str) -> [u8; N] {
    let bytes = text.as_bytes();
    assert!(bytes.len() < N, "text does not fit the plugin's ELF note");
    let mut out = [0; N];
    let mut i = 0;
    while i < bytes.len() {
        out[i] = bytes[i];
        i += 1;
    }
    out
}

impl Note {
    /// The note of a plugin with these node types. Does not compile when a text is too long for its field.
    pub const fn new(name: &str, version: &str, nodes: &[&str]) -> Note {
        let mut list = [0; NOTE_NODES_LEN];
        let mut at = 0;
        let mut n = 0;
        while n < nodes.len() {
            if n > 0 {
                list[at] = b',';
                at += 1;
            }
            let bytes = nodes[n].as_bytes();
            let mut i = 0;
            while i < bytes.len() {
                list[at] = bytes[i];
                at += 1;
                i += 1;
            }
            n += 1;
        }
        Note {
            owner_len: NOTE_OWNER.len() as u32,
            body_len: size_of::<NoteBody>() as u32,
            note_type: NOTE_TYPE,
            owner: NOTE_OWNER,
            body: NoteBody {
                abi_major: crate::ABI_MAJOR,
                abi_minor: crate::ABI_MINOR,
                name: padded(name),
                version: padded(version),
                nodes: list,
            },
        }
    }
}
