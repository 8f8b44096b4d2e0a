//! Frames between a program and the `panoscope-machine` that it started: length (32 bits, little-endian), kind,
//! session, bytes.

use std::io::{self, Read, Write};

/// First argument of `panoscope-machine` that makes it listen for windows: `attachable NAME ADDRESS KEYS PLAINTEXT
/// HOST...`.
pub const ATTACHABLE: &str = "attachable";
/// First argument of `panoscope-machine` that makes it connect a window: `attach ADDRESS TIMEOUT_MS PLAINTEXT NAME`.
pub const ATTACH: &str = "attach";
/// Maximum length of a frame's content, bytes.
pub const MAX_BYTES: usize = 64 << 20;
/// Bytes between the length and the content of a frame.
const HEAD: usize = 5;

/// Kind of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// From `panoscope-machine`: it listens or is connected. The content is the name of this machine; for a window,
    /// that of the running side.
    Ready,
    /// From `panoscope-machine`: a window connected. The content is the name of its machine.
    Open,
    /// A message, either way.
    Data,
    /// A window closed or must close. The content is the reason.
    Close,
    /// From `panoscope-machine` to a window: the clocks, see [`ClockFrame`].
    Clock,
}

impl Kind {
    fn of(byte: u8) -> Option<Self> {
        Some(match byte {
            1 => Self::Ready,
            2 => Self::Open,
            3 => Self::Data,
            4 => Self::Close,
            5 => Self::Clock,
            _ => return None,
        })
    }

    fn byte(self) -> u8 {
        match self {
            Self::Ready => 1,
            Self::Open => 2,
            Self::Data => 3,
            Self::Close => 4,
            Self::Clock => 5,
        }
    }
}

/// A frame of the tunnel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Kind of the item.
    pub kind: Kind,
    /// The window that it belongs to; 0 on the window's side.
    pub session: u32,
    /// Its content.
    pub bytes: Vec<u8>,
}

impl Frame {
    /// A frame whose content is a text.
    pub fn words(kind: Kind, session: u32, words: &str) -> Self {
        Self { kind, session, bytes: words.as_bytes().to_vec() }
    }

    /// The content as a text.
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.bytes).into_owned()
    }
}

/// The clock of the other machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClockFrame {
    /// The other machine's monotonic clock minus this one's, ns.
    pub offset_ns: i64,
    /// Maximum error of the offset, ns.
    pub error_ns: u64,
    /// Round-trip time of the last probe, ns.
    pub round_trip_ns: u64,
}

impl ClockFrame {
    /// Encodes the content of a frame.
    pub fn bytes(self) -> Vec<u8> {
        let parts = [self.offset_ns.to_le_bytes(), self.error_ns.to_le_bytes(), self.round_trip_ns.to_le_bytes()];
        parts.concat()
    }

    /// Decodes the content of a frame; `None` if it has another length.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let (offset, rest) = bytes.split_first_chunk::<8>()?;
        let (error, rest) = rest.split_first_chunk::<8>()?;
        let round_trip: &[u8; 8] = rest.try_into().ok()?;
        Some(Self {
            offset_ns: i64::from_le_bytes(*offset),
            error_ns: u64::from_le_bytes(*error),
            round_trip_ns: u64::from_le_bytes(*round_trip),
        })
    }
}

/// Writes a frame.
///
/// # Errors
/// The connection is closed, or the content is too long.
pub fn send(to: &mut impl Write, frame: &Frame) -> io::Result<()> {
    if frame.bytes.len() > MAX_BYTES {
        return Err(io::Error::other("the message is too long"));
    }
    let mut head = [0; 4 + HEAD];
    head[..4].copy_from_slice(&((frame.bytes.len() + HEAD) as u32).to_le_bytes());
    head[4] = frame.kind.byte();
    head[5..].copy_from_slice(&frame.session.to_le_bytes());
    to.write_all(&head)?;
    to.write_all(&frame.bytes)?;
    to.flush()
}

/// Reads a frame; `None` at the end.
///
/// # Errors
/// The frame is cut off or too long, or has an unknown kind.
pub fn receive(from: &mut impl Read) -> io::Result<Option<Frame>> {
    let bad = |words: &str| io::Error::new(io::ErrorKind::InvalidData, words.to_owned());
    let mut len = [0; 4];
    match from.read_exact(&mut len) {
        Ok(()) => {}
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        Err(error) => return Err(error),
    }
    let len = (u32::from_le_bytes(len) as usize).checked_sub(HEAD).ok_or_else(|| bad("a frame is too short"))?;
    if len > MAX_BYTES {
        return Err(bad("a frame is too long"));
    }
    let mut head = [0; HEAD];
    from.read_exact(&mut head)?;
    let [kind, session @ ..] = head;
    let kind = Kind::of(kind).ok_or_else(|| bad("a frame has an unknown kind"))?;
    let mut bytes = Vec::new();
    from.take(len as u64).read_to_end(&mut bytes)?;
    if bytes.len() < len {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    Ok(Some(Frame { kind, session: u32::from_le_bytes(session), bytes }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_arrive_as_they_were_sent() {
        let clock = ClockFrame { offset_ns: -5, error_ns: 7, round_trip_ns: 9 };
        let frames = [
            Frame::words(Kind::Open, 3, "theatre"),
            Frame { kind: Kind::Clock, session: 0, bytes: clock.bytes() },
            Frame { kind: Kind::Data, session: u32::MAX, bytes: Vec::new() },
        ];
        let mut bytes = Vec::new();
        frames.iter().for_each(|frame| send(&mut bytes, frame).expect("memory takes it"));
        let mut from = &bytes[..];
        for frame in &frames {
            assert_eq!(receive(&mut from).expect("a frame").as_ref(), Some(frame));
        }
        assert_eq!(receive(&mut from).expect("the end"), None);
        assert_eq!(ClockFrame::read(&clock.bytes()), Some(clock));
        assert_eq!(ClockFrame::read(&[0; 23]), None);
    }

    #[test]
    fn bytes_that_are_no_frame_are_refused() {
        for bytes in
            [&[4, 0, 0, 0, 1, 0, 0, 0, 0][..], &[9, 0, 0, 0, 9, 0, 0, 0, 0], &[255; 9], &[9, 0, 0, 0, 3, 0, 0, 0, 0, 1]]
        {
            assert!(receive(&mut &bytes[..]).is_err(), "{bytes:?}");
        }
    }
}
