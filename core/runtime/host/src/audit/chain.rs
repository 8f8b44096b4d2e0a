//! The lines of the log and the hashes that chain them.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::audit::event::Event;

/// Text in front of a line's own hash.
const HASH_FIELD: &str = ",\"hash\":\"";
const HASH_LEN: usize = 64;

pub(crate) fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// The end of a chain: number and hash of its last line. The default is that of an empty log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct End {
    pub number: u64,
    pub hash: String,
}

impl Default for End {
    fn default() -> Self {
        Self { number: 0, hash: "0".repeat(HASH_LEN) }
    }
}

/// A line without its own hash.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Line {
    /// From 1, over all files of the log.
    #[serde(rename = "line")]
    pub number: u64,
    pub unix_ms: i64,
    /// Hash of the line before it.
    pub before: String,
    #[serde(flatten)]
    pub event: Event,
}

impl Line {
    /// The line that follows `end`.
    pub fn after(end: &End, unix_ms: i64, event: Event) -> Self {
        Self { number: end.number.saturating_add(1), unix_ms, before: end.hash.clone(), event }
    }

    /// The line's text with its hash and a line feed, and the new end of the chain.
    pub fn text(&self) -> Result<(String, End), serde_json::Error> {
        let body = serde_json::to_string(self)?;
        let hash = sha256(body.as_bytes());
        let text = format!("{}{HASH_FIELD}{hash}\"}}\n", &body[..body.len() - 1]);
        Ok((text, End { number: self.number, hash }))
    }

    /// Parses a line without its line feed. `None` if it is damaged: not JSON of this form, or with a wrong hash.
    pub fn parse(text: &[u8]) -> Option<(Self, End)> {
        let text = std::str::from_utf8(text).ok()?;
        let at = text.len().checked_sub(HASH_FIELD.len() + HASH_LEN + 2)?;
        let (body, rest) = (text.get(..at)?, text.get(at..)?);
        let hash = rest.strip_prefix(HASH_FIELD)?.strip_suffix("\"}")?;
        let body = format!("{body}}}");
        if sha256(body.as_bytes()) != hash {
            return None;
        }
        let line: Self = serde_json::from_str(&body).ok()?;
        let end = End { number: line.number, hash: hash.to_owned() };
        Some((line, end))
    }

    /// Whether the line follows `end`.
    pub fn follows(&self, end: &End) -> bool {
        self.before == end.hash && end.number.checked_add(1) == Some(self.number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_changed_byte_of_a_line_is_found() {
        let event = Event::Setting { node: "wide".to_owned(), param: "blend_px".to_owned(), value: "12".to_owned() };
        let (text, end) = Line::after(&End::default(), 1_772_323_200_250, event).text().unwrap();
        let line = text.trim_end().as_bytes();
        let (parsed, found) = Line::parse(line).unwrap();
        assert_eq!((parsed.number, &found), (1, &end));
        assert!(parsed.follows(&End::default()) && !parsed.follows(&end));
        for at in 0..line.len() {
            let mut changed = line.to_vec();
            changed[at] ^= 1;
            assert_eq!(Line::parse(&changed), None, "byte {at}");
            assert_eq!(Line::parse(&line[..at]), None, "cut at {at}");
        }
    }
}
