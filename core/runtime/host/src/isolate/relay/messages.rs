//! Messages between link and server as bytes: a head of little-endian numbers and texts, then the bytes of frames.

use std::io::{self, Read};

use panoscope_engine::isolation::{Deny, Pixels};

use crate::isolate::wire::{self, Reader, Wire, message, whole};

/// Maximum length of a message's head, bytes.
const MAX_HEAD_BYTES: usize = 4 << 20;
/// Maximum number of frames in one message.
const MAX_FRAMES: usize = 4096;
/// Maximum length of a frame, bytes: the largest buffer of a pool.
pub const MAX_FRAME_BYTES: u64 = 1 << 30;
/// Maximum number of files in one message.
const MAX_FILES: usize = 256;

message! {
    /// Encoding of a frame's bytes.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Coding {
        /// Uncompressed.
        0 => Raw,
        /// A block of LZ4.
        1 => Lz4,
        /// The next image of an H.264 stream.
        2 => H264(picture: Picture),
    }
}

message! {
    /// An image of an H.264 stream: rows of blue, green and red.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct Picture {
        /// Number of the lane's stream.
        pub stream: u32,
        /// Columns, px.
        pub width: u32,
        /// Rows.
        pub height: u32,
        /// Bytes from row to row.
        pub stride_bytes: u32,
        /// Whether it begins the stream.
        pub begins: bool,
    }
}

impl Picture {
    /// Whether its rows fit into `len` bytes.
    pub fn fits(&self, len: u64) -> bool {
        let (width, height, stride) = (u64::from(self.width), u64::from(self.height), u64::from(self.stride_bytes));
        width > 0 && height > 0 && 3 * width <= stride && stride * (height - 1) + 3 * width <= len
    }
}

message! {
    /// A frame whose bytes follow the head.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct FrameHead {
        /// Number of its pool.
        pub pool: u32,
        /// Offset of its buffer in the pool.
        pub offset: u64,
        /// Its length.
        pub len: u64,
        /// Encoding of its bytes.
        pub coding: Coding,
        /// Encoded length in bytes.
        pub coded_len: u64,
    }
}

message! {
    /// A file on the host that a node reads.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub struct FileHash {
        /// Path on the host.
        pub path: String,
        /// SHA-256 as a hexadecimal text.
        pub sha256: String,
    }
}

message! {
    /// A message of a lane.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    pub struct Turn {
        /// Number of the lane.
        pub lane: u32,
        /// Kind of the message, see [`super::kind`].
        pub kind: u32,
        /// When it was sent or made, ns of the monotonic clock of the server's machine; 0 while that clock is unknown.
        pub at_ns: i64,
        /// The message in the processes' encoding.
        pub message: Vec<u8>,
        /// Files that its node reads.
        pub files: Vec<FileHash>,
        /// The frames that follow.
        pub frames: Vec<FrameHead>,
    }
}

message! {
    /// A message between link and server.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub enum Message {
        /// From the link, first message.
        1 => Hello {
            /// Version that both sides must share.
            version: String,
            /// Name of the group.
            group: String,
            /// Threads of its parallel loops.
            threads: u32,
            /// Maximum number of bytes of private memory.
            memory_bytes: u64,
            /// Operations denied to its nodes.
            deny: Deny,
            /// Encoding of pixels.
            pixels: Pixels,
            /// Silence after which the other side counts as lost, ms.
            timeout_ms: u32,
        },
        /// From the link: a pool of frames.
        2 => Pool {
            /// Its number.
            number: u32,
            /// Its size in bytes.
            len: u64,
            /// Whether the group writes it.
            is_own: bool,
        },
        /// From the link: a plugin of the graph.
        3 => Plugin {
            /// Its number.
            id: u32,
            /// Path of its file on the host.
            path: String,
            /// SHA-256 as a hexadecimal text.
            sha256: String,
        },
        /// From the link: a lane of a new instance.
        4 => Lane {
            /// Its number.
            id: u32,
        },
        /// From either side: a message of a lane.
        5 => Turn(turn: Turn),
        /// From the link: the group is no longer needed.
        6 => Bye,
        /// From the server: it accepts the group.
        7 => Ready,
        /// From the server: the group is lost or was refused.
        8 => Lost {
            /// The reason, as text.
            words: String,
        },
    }
}

/// A malformed message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a message of another machine is malformed; install the same version on both")]
pub struct BadMessage;

impl From<BadMessage> for io::Error {
    fn from(bad: BadMessage) -> Self {
        Self::other(bad)
    }
}

/// Writes a message without the bytes of its frames, which follow in their order.
pub fn write(message: &Message) -> Vec<u8> {
    let mut out = vec![0; 4];
    message.put(&mut out);
    let len = (out.len() - 4) as u32;
    out[..4].copy_from_slice(&len.to_le_bytes());
    out
}

/// Reads a message up to the bytes of its frames.
///
/// # Errors
/// It is truncated or malformed.
pub fn read(from: &mut impl Read) -> io::Result<Message> {
    let mut len = [0; 4];
    from.read_exact(&mut len)?;
    let len = u32::from_le_bytes(len) as usize;
    if len > MAX_HEAD_BYTES {
        return Err(BadMessage.into());
    }
    let mut head = Vec::new();
    if from.take(len as u64).read_to_end(&mut head)? != len {
        return Err(BadMessage.into());
    }
    match whole(&head) {
        Ok(message) if is_sound(&message) => Ok(message),
        _ => Err(BadMessage.into()),
    }
}

/// Whether the numbers of a message fit each other.
fn is_sound(message: &Message) -> bool {
    match message {
        Message::Turn(Turn { files, frames, .. }) => {
            files.len() <= MAX_FILES && frames.len() <= MAX_FRAMES && frames.iter().all(FrameHead::is_sound)
        }
        _ => true,
    }
}

impl FrameHead {
    fn is_sound(&self) -> bool {
        let Self { len, coded_len, .. } = *self;
        let fits = match self.coding {
            Coding::Raw => coded_len == len,
            // What does not become shorter is sent as it is.
            Coding::Lz4 => coded_len < len,
            Coding::H264(picture) => coded_len < len && picture.fits(len),
        };
        fits && len <= MAX_FRAME_BYTES
    }
}

impl Wire for Pixels {
    const MIN_BYTES: usize = 1;

    fn put(&self, out: &mut Vec<u8>) {
        out.push(match self {
            Pixels::Raw => 0,
            Pixels::Lz4 => 1,
            Pixels::H264 => 2,
        });
    }

    fn take(reader: &mut Reader<'_>) -> Result<Self, wire::BadMessage> {
        match reader.take::<u8>()? {
            0 => Ok(Pixels::Raw),
            1 => Ok(Pixels::Lz4),
            2 => Ok(Pixels::H264),
            _ => Err(wire::BadMessage),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn messages() -> Vec<Message> {
        let frame = FrameHead { pool: 3, offset: 1 << 20, len: 640, coding: Coding::Lz4, coded_len: 17 };
        let picture = Picture { stream: 1, width: 4, height: 4, stride_bytes: 16, begins: true };
        let coded = FrameHead { coding: Coding::H264(picture), ..frame };
        let file = FileHash { path: "models/a.onnx".to_owned(), sha256: "00ff".to_owned() };
        let turn =
            Turn { lane: 7, kind: 2, at_ns: -5, message: vec![1, 2, 3], files: vec![file], frames: vec![frame, coded] };
        vec![
            Message::Hello {
                version: "Panoscope 1".to_owned(),
                group: "rack".to_owned(),
                threads: 2,
                memory_bytes: 1 << 32,
                deny: Deny { network: true, new_files: false },
                pixels: Pixels::H264,
                timeout_ms: 1000,
            },
            Message::Pool { number: 9, len: 1 << 32, is_own: true },
            Message::Plugin { id: 4, path: "plugins/libtools.so".to_owned(), sha256: "ab".repeat(32) },
            Message::Lane { id: 1 },
            Message::Turn(turn),
            Message::Bye,
            Message::Ready,
            Message::Lost { words: "it crashed".to_owned() },
        ]
    }

    #[test]
    fn what_is_written_is_read() {
        for message in messages() {
            let mut bytes = write(&message);
            bytes.extend_from_slice(b"pixels");
            let mut rest = &bytes[..];
            assert_eq!(read(&mut rest).expect("a message"), message);
            assert_eq!(rest, b"pixels");
        }
    }

    #[test]
    fn no_message_that_is_cut_off_is_read() {
        for message in messages() {
            let bytes = write(&message);
            for len in 0..bytes.len() {
                assert!(read(&mut &bytes[..len]).is_err(), "{message:?} after {len} bytes");
            }
        }
        assert!(read(&mut &[0xff; 64][..]).is_err());
        let picture = Picture { stream: 1, width: 4, height: 4, stride_bytes: 16, begins: true };
        assert!(picture.fits(60) && !picture.fits(59) && !Picture { stride_bytes: 11, ..picture }.fits(640));
        assert!(!Picture { width: 0, ..picture }.fits(640) && !Picture { width: u32::MAX, ..picture }.fits(u64::MAX));
        let mut more = write(&Message::Bye);
        more[0] += 1;
        more.push(0);
        assert!(read(&mut &more[..]).is_err(), "a byte too many");
    }
}
