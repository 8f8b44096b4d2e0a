//! Unique identifiers below 2.25, which needs no registration (PS3.5, annex B.2).

use sha2::{Digest, Sha256};

/// Implementation class UID of Panoscope, in the head of each file and at each association.
pub const IMPLEMENTATION: &str = "2.25.196843317229904168829105853267812350437";
/// Implementation version name, at most 16 characters.
pub const IMPLEMENTATION_NAME: &str =
    concat!("PANOSCOPE_", env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR"));

/// The UID derived from these parts. It is always the same, so that a PACS keeps an object once that is exported twice.
///
/// It is 2.25 and a UUID of version 8 (RFC 9562) from the SHA-256 of the parts.
pub fn of(parts: &[&[u8]]) -> String {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    let mut uuid = [0; 16];
    uuid.copy_from_slice(&hash.finalize()[..16]);
    uuid[6] = uuid[6] & 0x0F | 0x80;
    uuid[8] = uuid[8] & 0x3F | 0x80;
    format!("2.25.{}", u128::from_be_bytes(uuid))
}

/// Whether a text is a UID: numbers without leading zeros between dots, at most 64 characters.
pub fn is_valid(text: &str) -> bool {
    let number = |part: &str| {
        !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit()) && (part == "0" || !part.starts_with('0'))
    };
    text.len() <= 64 && text.contains('.') && text.split('.').all(number)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_parts_have_one_uid_and_others_another() {
        let uid = of(&[b"1.2.3", b"still"]);
        assert!(is_valid(&uid) && uid.starts_with("2.25."), "{uid}");
        assert_eq!(uid, of(&[b"1.2.3", b"still"]));
        assert_ne!(uid, of(&[b"1.2.3s", b"till"]));
        assert!(is_valid(IMPLEMENTATION) && IMPLEMENTATION_NAME.len() <= 16);
    }

    #[test]
    fn texts_that_are_no_uid_are_refused() {
        for text in ["", "1", "1..2", "1.02", "1.2.a", ".1", "1.2.", &"1.2".repeat(40)] {
            assert!(!is_valid(text), "{text}");
        }
        assert!(is_valid("1.2.840.10008.1.1") && is_valid("1.0.3"));
    }
}
