//! The binary contract between the Panoscope host and its plugins.
//!
//! Only `repr(C)` data crosses: no type whose layout Rust chooses, no trait object, no allocation that one side makes
//! and the other frees. Fields are only ever appended; every struct that may grow opens with its own size.
//! `panoscope.h` next to this crate is generated from these files.
//!
//! A plugin exports one C function, [`ENTRY_SYMBOL`], that returns a [`Plugin`] descriptor, and carries a [`Note`] in
//! its ELF file with the same name and version, readable without running any code.

#![no_std]

mod call;
mod descriptor;
mod device;
mod frame;
mod note;
mod packets;

pub use call::*;
pub use descriptor::*;
pub use device::*;
pub use frame::*;
pub use note::*;
pub use packets::*;

/// Opens every descriptor: the bytes `PANOSCOP`, little-endian.
pub const MAGIC: u64 = 0x504F_4353_4F4E_4150;
/// Plugins of another major version are refused.
pub const ABI_MAJOR: u32 = 1;
/// Grows when fields, flags or host functions are appended, or a reserved field gets a name.
pub const ABI_MINOR: u32 = 6;
/// The one symbol a plugin exports, an [`Entry`].
pub const ENTRY_SYMBOL: &str = "panoscope_plugin";

/// UTF-8 text owned by its creator; `ptr` may be null when `len` is 0.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Str {
    /// First byte.
    pub ptr: *const u8,
    /// Length in bytes.
    pub len: usize,
}

// SAFETY: a `Str` is a borrowed, immutable range of bytes.
unsafe impl Send for Str {}
// SAFETY: a `Str` gives no access without the unsafe `bytes` and `text`, whose caller promises that the bytes live and do not change.
unsafe impl Sync for Str {}

impl Str {
    /// No text.
    pub const EMPTY: Str = Str { ptr: core::ptr::null(), len: 0 };

    /// Borrows `text`.
    pub const fn new(text: &'static str) -> Str {
        Str { ptr: text.as_ptr(), len: text.len() }
    }

    /// Borrows `text` for the length of a call.
    pub const fn borrow(text: &str) -> Str {
        Str { ptr: text.as_ptr(), len: text.len() }
    }

    /// The bytes.
    ///
    /// # Safety
    /// `ptr` and `len` describe readable memory that outlives `'a`.
    pub const unsafe fn bytes<'a>(self) -> &'a [u8] {
        if self.ptr.is_null() || self.len == 0 {
            return &[];
        }
        // SAFETY: the caller's promise.
        unsafe { core::slice::from_raw_parts(self.ptr, self.len) }
    }

    /// The text, or `None` when it is not UTF-8.
    ///
    /// # Safety
    /// As [`Str::bytes`].
    pub unsafe fn text<'a>(self) -> Option<&'a str> {
        // SAFETY: the caller's promise.
        core::str::from_utf8(unsafe { self.bytes() }).ok()
    }
}

/// Result of a call into a plugin.
pub type Status = i32;
/// Done.
pub const STATUS_OK: Status = 0;
/// The source has ended.
pub const STATUS_END: Status = 1;
/// The node failed; its message was passed to [`Host::fail`].
pub const STATUS_ERROR: Status = -1;
/// The node panicked or threw; its message was passed to [`Host::fail`].
pub const STATUS_PANIC: Status = -2;
/// The host's frame memory is exhausted.
pub const STATUS_EXHAUSTED: Status = -3;
/// An argument is malformed (a wrong port number, a size of 0).
pub const STATUS_INVALID: Status = -4;
/// The node failed and opening it again would not help (the disk is full): it stays closed until its graph is edited.
pub const STATUS_STOPPED: Status = -5;

/// 64-bit FNV-1a, used for layout hashes.
pub const fn fnv1a(mut hash: u64, bytes: &[u8]) -> u64 {
    let mut i = 0;
    while i < bytes.len() {
        hash ^= bytes[i] as u64;
        hash = hash.wrapping_mul(0x0000_0100_0000_01B3);
        i += 1;
    }
    hash
}

/// Start value for [`fnv1a`].
pub const FNV_START: u64 = 0xCBF2_9CE4_8422_2325;
