//! Position of a source, serialised for the instance that replaces it.

use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::PathBuf;

use crate::timing::Played;

const MAGIC: &[u8; 8] = b"capture2";

/// Position of one view.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ViewPosition {
    /// The source of the view, as the parameters name it.
    pub text: String,
    /// Frames grabbed so far.
    pub grabbed: u64,
    /// The next file, if every frame has a separate file.
    pub next_file: Option<PathBuf>,
}

/// Position of the whole node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Position {
    /// Number of ticks made.
    pub frame: u64,
    /// Capture time of the newest tick; -1 before the first.
    pub capture_ns: i64,
    /// How media time became capture time.
    pub played: Played,
    /// Media time at which the present round of a loop began, in s.
    pub round_s: f64,
    /// One position per view.
    pub views: Vec<ViewPosition>,
}

fn put(bytes: &mut Vec<u8>, text: &[u8]) {
    bytes.extend((text.len() as u32).to_le_bytes());
    bytes.extend(text);
}

/// Reads values from the front of a byte slice.
struct Reader<'b>(&'b [u8]);

impl<'b> Reader<'b> {
    fn word(&mut self) -> Option<[u8; 8]> {
        let (word, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*word)
    }

    fn number(&mut self) -> Option<f64> {
        self.word().map(f64::from_le_bytes)
    }

    fn text(&mut self) -> Option<&'b [u8]> {
        let (length, rest) = self.0.split_first_chunk()?;
        let (text, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        self.0 = rest;
        Some(text)
    }
}

impl Position {
    /// Serialises the position.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(self.frame.to_le_bytes());
        bytes.extend(self.capture_ns.to_le_bytes());
        let Played { media_ns, from_media_ns, from_capture_ns, speed } = self.played;
        for number in [media_ns, from_media_ns, from_capture_ns, speed] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(self.round_s.to_le_bytes());
        for view in &self.views {
            put(&mut bytes, view.text.as_bytes());
            bytes.extend(view.grabbed.to_le_bytes());
            put(&mut bytes, view.next_file.as_ref().map_or(&[][..], |path| path.as_os_str().as_bytes()));
        }
        bytes
    }

    /// Parses a position; `None` when the bytes are malformed.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let mut rest = Reader(bytes);
        if rest.word()? != *MAGIC {
            return None;
        }
        let mut position = Self {
            frame: u64::from_le_bytes(rest.word()?),
            capture_ns: i64::from_le_bytes(rest.word()?),
            played: Played {
                media_ns: rest.number()?,
                from_media_ns: rest.number()?,
                from_capture_ns: rest.number()?,
                speed: rest.number()?,
            },
            round_s: f64::from_le_bytes(rest.word()?),
            views: Vec::new(),
        };
        while !rest.0.is_empty() {
            let text = String::from_utf8(rest.text()?.to_vec()).ok()?;
            let grabbed = u64::from_le_bytes(rest.word()?);
            let file = rest.text()?;
            let next_file = (!file.is_empty()).then(|| PathBuf::from(std::ffi::OsString::from_vec(file.to_vec())));
            position.views.push(ViewPosition { text, grabbed, next_file });
        }
        Some(position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_come_back_and_nonsense_does_not() {
        let view = |text: &str, file: Option<&str>| ViewPosition {
            text: text.to_owned(),
            grabbed: 7,
            next_file: file.map(PathBuf::from),
        };
        let views = vec![view("l/*.png", Some("/l/8.png")), view("r.mkv", None)];
        let played = Played { media_ns: 4e9, from_media_ns: 3e9, from_capture_ns: 2e9, speed: 0.5 };
        let position = Position { frame: 9, capture_ns: -1, played, round_s: 1.5, views };
        let bytes = position.to_bytes();
        assert_eq!(Position::from_bytes(&bytes), Some(position));
        for length in [0, 7, 20, 33, bytes.len() - 1] {
            assert_eq!(Position::from_bytes(&bytes[..length]), None, "{length}");
        }
    }
}
