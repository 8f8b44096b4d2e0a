//! Reads fields one after the other.

use super::PacketError;

/// The rest of a packet's bytes.
#[derive(Clone, Copy, Debug)]
pub struct Fields<'b> {
    packet: &'static str,
    bytes: &'b [u8],
    at: usize,
}

impl<'b> Fields<'b> {
    pub(super) fn new(packet: &'static str, bytes: &'b [u8]) -> Self {
        Self { packet, bytes, at: 0 }
    }

    /// The next `len` bytes; `None` stands for a length that overflows.
    pub(super) fn take(&mut self, field: &'static str, len: Option<usize>) -> Result<&'b [u8], PacketError> {
        let end = len.and_then(|len| self.at.checked_add(len));
        match end.and_then(|end| self.bytes.get(self.at..end)) {
            Some(part) => {
                self.at += part.len();
                Ok(part)
            }
            None => Err(PacketError::Short {
                packet: self.packet,
                field,
                end: end.unwrap_or(usize::MAX),
                len: self.bytes.len(),
            }),
        }
    }

    /// The next `N` bytes.
    pub(super) fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], PacketError> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(field, Some(N))?);
        Ok(out)
    }

    /// The next `len` bytes as UTF-8.
    pub(super) fn text(&mut self, field: &'static str, len: usize) -> Result<&'b str, PacketError> {
        let packet = self.packet;
        std::str::from_utf8(self.take(field, Some(len))?).map_err(|_| PacketError::Text { packet, field })
    }

    /// Bytes read so far.
    pub(super) fn position(&self) -> usize {
        self.at
    }
}

/// A field that is read from unaligned bytes, in the byte order of the machine, as nodes write it.
pub trait Field: Sized {
    /// Reads the field called `name` and moves past it.
    #[doc(hidden)]
    fn read(fields: &mut Fields<'_>, name: &'static str) -> Result<Self, PacketError>;
}

macro_rules! numbers {
    ($($ty:ty),*) => {$(
        impl Field for $ty {
            #[inline]
            fn read(fields: &mut Fields<'_>, name: &'static str) -> Result<Self, PacketError> {
                fields.array(name).map(Self::from_ne_bytes)
            }
        }
    )*};
}
numbers!(u8, u32, i32, u64, i64, f32, f64);

impl<T: Field + Copy + Default, const N: usize> Field for [T; N] {
    fn read(fields: &mut Fields<'_>, name: &'static str) -> Result<Self, PacketError> {
        // The whole array at once, so that an error tells where the field ends.
        let mut items = Fields::new(fields.packet, fields.take(name, Some(size_of::<[T; N]>()))?);
        let mut out = [T::default(); N];
        for item in &mut out {
            *item = T::read(&mut items, name)?;
        }
        Ok(out)
    }
}
