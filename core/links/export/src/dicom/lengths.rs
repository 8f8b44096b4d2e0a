//! Lengths in encoded data sets, checked before they are used.
//!
//! The decoder allocates the length that an element states. Here each length is compared with the available bytes, and
//! the depth of sequences is limited.

/// Maximum nesting of sequences.
const MAX_DEPTH: usize = 16;
/// An unspecified length: the element ends at a delimiter.
const UNDEFINED: u32 = u32::MAX;
/// VRs of explicit syntaxes whose length has four bytes, after two of padding.
const LONG_VRS: [&[u8; 2]; 13] =
    [b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV"];
const ITEM: (u16, u16) = (0xFFFE, 0xE000);
const ITEM_END: (u16, u16) = (0xFFFE, 0xE00D);
const SEQUENCE_END: (u16, u16) = (0xFFFE, 0xE0DD);

/// Encoding of a data set, little endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Without value representations.
    Implicit,
    /// With value representations.
    Explicit,
}

/// A length or a head that exceeds the enclosing bytes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum LengthError {
    /// A value is longer than the rest of the bytes.
    #[error("at byte {at}: {announced} bytes are announced, but only {left} follow")]
    Announced { at: usize, announced: usize, left: usize },
    /// The head of an element begins inside an item and ends after it.
    #[error("at byte {at}: an element reaches beyond its item")]
    BeyondItem { at: usize },
    /// More than [`MAX_DEPTH`] sequences inside each other.
    #[error("at byte {at}: sequences are nested more than {MAX_DEPTH} deep")]
    TooDeep { at: usize },
    /// An item in place of an element.
    #[error("at byte {at}: an item outside a sequence")]
    LoneItem { at: usize },
    /// Two bytes that are not capital letters.
    #[error("at byte {at}: {vr:02x?} is not a value representation")]
    Representation { at: usize, vr: [u8; 2] },
    /// An item of undefined length without a delimiter.
    #[error("at byte {at}: an item does not end")]
    OpenItem { at: usize },
    /// An item is longer than the rest of its sequence.
    #[error("at byte {at}: an item has {length} bytes, but only {left} follow")]
    LongItem { at: usize, length: u32, left: usize },
    /// An element in place of an item.
    #[error("at byte {at}: an item was expected")]
    NoItem { at: usize },
    /// A sequence of undefined length without a delimiter.
    #[error("at byte {at}: a sequence does not end")]
    OpenSequence { at: usize },
}

struct Walk<'a> {
    bytes: &'a [u8],
    at: usize,
    encoding: Encoding,
}

/// Checks that all lengths of a data set are inside it.
///
/// # Errors
///
/// The mistake and its offset.
pub fn check(bytes: &[u8], encoding: Encoding) -> Result<(), LengthError> {
    let mut walk = Walk { bytes, at: 0, encoding };
    walk.elements(bytes.len(), false, 0)
}

impl Walk<'_> {
    fn take(&mut self, count: usize) -> Result<&[u8], LengthError> {
        let at = self.at;
        let end = at.checked_add(count).filter(|end| *end <= self.bytes.len());
        let end = end.ok_or_else(|| LengthError::Announced { at, announced: count, left: self.bytes.len() - at })?;
        self.at = end;
        Ok(&self.bytes[at..end])
    }

    /// Checks that a head does not extend beyond the enclosing item.
    fn inside(&self, end: usize) -> Result<(), LengthError> {
        if self.at <= end { Ok(()) } else { Err(LengthError::BeyondItem { at: end }) }
    }

    fn u16(&mut self) -> Result<u16, LengthError> {
        self.take(2).map(|b| u16::from_le_bytes([b[0], b[1]]))
    }

    fn u32(&mut self) -> Result<u32, LengthError> {
        self.take(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    }

    /// Elements up to `end`, or up to the delimiter of an item.
    fn elements(&mut self, end: usize, delimited: bool, depth: usize) -> Result<(), LengthError> {
        if depth > MAX_DEPTH {
            return Err(LengthError::TooDeep { at: self.at });
        }
        while self.at < end {
            let start = self.at;
            let tag = (self.u16()?, self.u16()?);
            if tag == ITEM_END && delimited {
                self.u32()?;
                return self.inside(end);
            }
            if tag.0 == 0xFFFE {
                return Err(LengthError::LoneItem { at: start });
            }
            let (is_sequence, length) = match self.encoding {
                Encoding::Implicit => (None, self.u32()?),
                Encoding::Explicit => {
                    let vr: [u8; 2] = self.take(2)?.try_into().unwrap_or_default();
                    if !vr.iter().all(u8::is_ascii_uppercase) {
                        return Err(LengthError::Representation { at: start, vr });
                    }
                    let length = if LONG_VRS.contains(&&vr) {
                        self.take(2)?;
                        self.u32()?
                    } else {
                        u32::from(self.u16()?)
                    };
                    (Some(&vr == b"SQ"), length)
                }
            };
            self.inside(end)?;
            if length == UNDEFINED {
                self.items(end, true, depth)?;
                continue;
            }
            let value_end = self.at.saturating_add(length as usize);
            if value_end > end {
                return Err(LengthError::Announced { at: start, announced: length as usize, left: end - self.at });
            }
            // Without value representations the dictionary says what is a sequence; one looks like an item.
            let looks_like_item = length >= 8 && self.bytes[self.at..].starts_with(&[0xFE, 0xFF, 0x00, 0xE0]);
            if is_sequence.unwrap_or(looks_like_item) {
                self.items(value_end, false, depth)?;
            }
            self.at = value_end;
        }
        if delimited {
            return Err(LengthError::OpenItem { at: self.at });
        }
        Ok(())
    }

    /// Items up to `end`, or up to the delimiter of a sequence.
    fn items(&mut self, end: usize, delimited: bool, depth: usize) -> Result<(), LengthError> {
        while self.at < end {
            let start = self.at;
            let tag = (self.u16()?, self.u16()?);
            let length = self.u32()?;
            self.inside(end)?;
            match tag {
                SEQUENCE_END if delimited => return Ok(()),
                ITEM if length == UNDEFINED => self.elements(end, true, depth + 1)?,
                ITEM => {
                    let item_end = self.at.saturating_add(length as usize);
                    if item_end > end {
                        return Err(LengthError::LongItem { at: start, length, left: end - self.at });
                    }
                    self.elements(item_end, false, depth + 1)?;
                }
                _ => return Err(LengthError::NoItem { at: start }),
            }
        }
        if delimited { Err(LengthError::OpenSequence { at: self.at }) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn implicit(tag: (u16, u16), length: u32, value: &[u8]) -> Vec<u8> {
        [&tag.0.to_le_bytes()[..], &tag.1.to_le_bytes(), &length.to_le_bytes(), value].concat()
    }

    #[test]
    fn lengths_inside_the_bytes_are_accepted() {
        let name = implicit((0x10, 0x10), 4, b"A^B ");
        let item = implicit(ITEM, name.len() as u32, &name);
        let open = implicit(ITEM, UNDEFINED, &[name.clone(), implicit(ITEM_END, 0, b"")].concat());
        let sequence = implicit((0x40, 0x100), item.len() as u32, &item);
        let open_sequence = implicit((0x40, 0x100), UNDEFINED, &[item, open, implicit(SEQUENCE_END, 0, b"")].concat());
        assert_eq!(check(&[name, sequence, open_sequence].concat(), Encoding::Implicit), Ok(()));
        assert_eq!(check(b"\x10\x00\x10\x00PN\x04\x00A^B ", Encoding::Explicit), Ok(()));
        assert_eq!(check(&[], Encoding::Explicit), Ok(()));
    }

    #[test]
    fn lengths_beyond_the_bytes_are_errors() {
        for (bytes, words) in [
            (implicit((0x10, 0x10), 0xFFFF_FFF0, b"A"), "announced"),
            (implicit((0x40, 0x100), UNDEFINED, b""), "does not end"),
            (implicit((0x40, 0x100), 8, &implicit(ITEM, 100, b"")), "an item has 100 bytes"),
            (implicit(ITEM, 0, b""), "outside a sequence"),
            (vec![1, 2, 3], "announced"),
            // An element whose head reaches beyond its item, and one that does not end inside it.
            (
                [implicit((0x40, 0x100), 12, &implicit(ITEM, 4, b"\x10\0\x10\0")), vec![0; 8]].concat(),
                "beyond its item",
            ),
            (implicit((0x40, 0x100), 16, &implicit(ITEM, 8, &implicit((8, 0x96), UNDEFINED, b""))), "does not end"),
        ] {
            let error = check(&bytes, Encoding::Implicit).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("at byte"), "{error}");
        }
        assert!(check(b"\x10\x00\x10\x00OB\x00\x00\xF0\xFF\xFF\xFF", Encoding::Explicit).is_err());
        assert!(check(b"\x10\x00\x10\x00\x01\x02\x00\x00", Encoding::Explicit).is_err());
    }

    #[test]
    fn nesting_is_limited() {
        let mut bytes = Vec::new();
        for _ in 0..1000 {
            bytes.extend(implicit((0x40, 0x100), UNDEFINED, &implicit(ITEM, UNDEFINED, b"")));
        }
        assert!(check(&bytes, Encoding::Implicit).unwrap_err().to_string().contains("nested"));
    }
}
