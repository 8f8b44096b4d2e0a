//! Checksums of a recording's messages: a flipped bit is reported with its position and never read as valid data.

use mcap::records::MessageHeader;
use xxhash_rust::xxh3::Xxh3;

/// Bytes of a message's own header.
pub(crate) const MESSAGE_HEAD_BYTES: usize = 22;

/// The checksum at the end of an event's JSON: `,"xxh3":"0123456789abcdef"}`.
const MARK: &[u8] = b",\"xxh3\":\"";
const DIGITS: usize = 16;
const CLOSE: &[u8] = b"\"}";

/// A message's header as it is stored in the file.
pub(crate) fn head_bytes(header: &MessageHeader) -> [u8; MESSAGE_HEAD_BYTES] {
    let mut bytes = [0; MESSAGE_HEAD_BYTES];
    bytes[..2].copy_from_slice(&header.channel_id.to_le_bytes());
    bytes[2..6].copy_from_slice(&header.sequence.to_le_bytes());
    bytes[6..14].copy_from_slice(&header.log_time.to_le_bytes());
    bytes[14..].copy_from_slice(&header.publish_time.to_le_bytes());
    bytes
}

/// XXH3 of a message: the topic of its channel, its header, and its body up to the checksum.
pub(crate) fn sum(topic: &str, head: &[u8; MESSAGE_HEAD_BYTES], body: &[u8]) -> u64 {
    let mut hash = Xxh3::new();
    hash.update(topic.as_bytes());
    hash.update(head);
    hash.update(body);
    hash.digest()
}

/// Appends the checksum of an event to its JSON object.
pub(crate) fn seal(topic: &str, head: &[u8; MESSAGE_HEAD_BYTES], json: &mut Vec<u8>) {
    // Removes the closing brace; `CLOSE` adds it again.
    json.pop();
    let sum = sum(topic, head, json);
    json.extend_from_slice(MARK);
    json.extend_from_slice(format!("{sum:016x}").as_bytes());
    json.extend_from_slice(CLOSE);
}

/// Result of the check of an event's checksum.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Seal {
    /// The event has no checksum.
    None,
    /// The event differs from its checksum.
    Broken,
    /// The event matches its checksum.
    Whole,
}

/// Checks an event and removes the checksum from its JSON.
pub(crate) fn unseal(topic: &str, head: &[u8; MESSAGE_HEAD_BYTES], json: &mut Vec<u8>) -> Seal {
    let Some(len) = json.len().checked_sub(MARK.len() + DIGITS + CLOSE.len()) else { return Seal::None };
    let (body, tail) = json.split_at(len);
    let Some(digits) = tail.strip_prefix(MARK).and_then(|t| t.strip_suffix(CLOSE)) else { return Seal::None };
    if digits != format!("{:016x}", sum(topic, head, body)).as_bytes() {
        return Seal::Broken;
    }
    json.truncate(len);
    json.push(b'}');
    Seal::Whole
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sealed_event_opens_only_as_it_was_written() {
        let head = [7; MESSAGE_HEAD_BYTES];
        let json = br#"{"event":"dropped","node":"a","seq":3}"#.to_vec();
        let mut sealed = json.clone();
        seal("t", &head, &mut sealed);
        assert!(serde_json::from_slice::<serde_json::Value>(&sealed).is_ok(), "other readers still read it");
        let mut opened = sealed.clone();
        assert_eq!((unseal("t", &head, &mut opened), opened), (Seal::Whole, json.clone()));
        for at in 0..sealed.len() {
            let mut flipped = sealed.clone();
            flipped[at] ^= 1;
            assert_ne!(unseal("t", &head, &mut flipped), Seal::Whole, "byte {at}");
        }
        assert_eq!(unseal("other", &head, &mut sealed.clone()), Seal::Broken);
        assert_eq!(unseal("t", &[8; MESSAGE_HEAD_BYTES], &mut sealed.clone()), Seal::Broken);
        assert_eq!(unseal("t", &head, &mut json.clone()), Seal::None);
        assert_eq!(unseal("t", &head, &mut Vec::new()), Seal::None);
    }
}
