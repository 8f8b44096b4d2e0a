//! Messages between link and server as bytes: a head of little-endian numbers and texts, then the bytes of frames.

use std::io::{self, Read};

use panoscope_engine::isolation::Pixels;

/// Maximum length of a message's head, bytes.
const MAX_HEAD_BYTES: usize = 4 << 20;
/// Maximum number of frames in one message.
const MAX_FRAMES: usize = 4096;
/// Maximum length of a frame, bytes: the largest buffer of a pool.
pub const MAX_FRAME_BYTES: u64 = 1 << 30;
/// Maximum number of files in one message.
const MAX_FILES: usize = 256;
/// Maximum length of a text, bytes.
const MAX_TEXT_BYTES: usize = 64 << 10;

/// Encoding of a frame's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coding {
    /// Uncompressed.
    Raw,
    /// A block of LZ4.
    Lz4,
    /// The next image of an H.264 stream.
    H264(Picture),
}

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

impl Picture {
    /// Whether its rows fit into `len` bytes.
    pub fn fits(&self, len: u64) -> bool {
        let (width, height, stride) = (u64::from(self.width), u64::from(self.height), u64::from(self.stride_bytes));
        width > 0 && height > 0 && 3 * width <= stride && stride * (height - 1) + 3 * width <= len
    }
}

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

/// A file on the host that a node reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileHash {
    /// Path on the host.
    pub path: String,
    /// SHA-256 as a hexadecimal text.
    pub sha256: String,
}

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

/// A message between link and server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Message {
    /// From the link, first message.
    Hello {
        /// Version that both sides must share.
        version: String,
        /// Name of the group.
        group: String,
        /// Threads of its parallel loops.
        threads: u32,
        /// Maximum number of bytes of private memory.
        memory_bytes: u64,
        /// Whether sockets are denied, and new files.
        deny: (bool, bool),
        /// Encoding of pixels.
        pixels: Pixels,
        /// Silence after which the other side counts as lost, ms.
        timeout_ms: u32,
    },
    /// From the link: a pool of frames.
    Pool {
        /// Its number.
        number: u32,
        /// Its size in bytes.
        len: u64,
        /// Whether the group writes it.
        is_own: bool,
    },
    /// From the link: a plugin of the graph.
    Plugin {
        /// Its number.
        id: u32,
        /// Path of its file on the host.
        path: String,
        /// SHA-256 as a hexadecimal text.
        sha256: String,
    },
    /// From the link: a lane of a new instance.
    Lane {
        /// Its number.
        id: u32,
    },
    /// From either side: a message of a lane.
    Turn(Turn),
    /// From the link: the group is no longer needed.
    Bye,
    /// From the server: it accepts the group.
    Ready,
    /// From the server: the group is lost or was refused.
    Lost {
        /// The reason, as text.
        words: String,
    },
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

const HELLO: u8 = 1;
const POOL: u8 = 2;
const PLUGIN: u8 = 3;
const LANE: u8 = 4;
const TURN: u8 = 5;
const BYE: u8 = 6;
const READY: u8 = 7;
const LOST: u8 = 8;

/// Number of an encoding in a frame's head.
const RAW: u8 = 0;
const LZ4: u8 = 1;
const H264: u8 = 2;

fn code(pixels: Pixels) -> u8 {
    match pixels {
        Pixels::Raw => RAW,
        Pixels::Lz4 => LZ4,
        Pixels::H264 => H264,
    }
}

fn pixels(code: u8) -> Result<Pixels, BadMessage> {
    match code {
        RAW => Ok(Pixels::Raw),
        LZ4 => Ok(Pixels::Lz4),
        H264 => Ok(Pixels::H264),
        _ => Err(BadMessage),
    }
}

struct Writer(Vec<u8>);

impl Writer {
    fn u8(&mut self, value: u8) -> &mut Self {
        self.0.push(value);
        self
    }

    fn u32(&mut self, value: u32) -> &mut Self {
        self.0.extend_from_slice(&value.to_le_bytes());
        self
    }

    fn u64(&mut self, value: u64) -> &mut Self {
        self.0.extend_from_slice(&value.to_le_bytes());
        self
    }

    fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.u32(bytes.len() as u32);
        self.0.extend_from_slice(bytes);
        self
    }

    fn text(&mut self, text: &str) -> &mut Self {
        let mut len = text.len().min(MAX_TEXT_BYTES);
        while !text.is_char_boundary(len) {
            len -= 1;
        }
        self.bytes(&text.as_bytes()[..len])
    }
}

struct Reader<'b>(&'b [u8]);

impl<'b> Reader<'b> {
    fn array<const N: usize>(&mut self) -> Result<[u8; N], BadMessage> {
        let (head, rest) = self.0.split_first_chunk::<N>().ok_or(BadMessage)?;
        self.0 = rest;
        Ok(*head)
    }

    fn u8(&mut self) -> Result<u8, BadMessage> {
        self.array::<1>().map(|[byte]| byte)
    }

    fn flag(&mut self) -> Result<bool, BadMessage> {
        match self.u8()? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(BadMessage),
        }
    }

    fn u32(&mut self) -> Result<u32, BadMessage> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, BadMessage> {
        self.array().map(u64::from_le_bytes)
    }

    fn bytes(&mut self) -> Result<&'b [u8], BadMessage> {
        let len = self.u32()? as usize;
        let (head, rest) = self.0.split_at_checked(len).ok_or(BadMessage)?;
        self.0 = rest;
        Ok(head)
    }

    fn text(&mut self) -> Result<String, BadMessage> {
        let bytes = self.bytes()?;
        let is_short = bytes.len() <= MAX_TEXT_BYTES;
        std::str::from_utf8(bytes).ok().filter(|_| is_short).map(str::to_owned).ok_or(BadMessage)
    }

    fn count(&mut self, most: usize) -> Result<usize, BadMessage> {
        let count = self.u32()? as usize;
        if count <= most { Ok(count) } else { Err(BadMessage) }
    }
}

/// Writes a message without the bytes of its frames, which follow in their order.
pub fn write(message: &Message) -> Vec<u8> {
    let mut out = Writer(vec![0; 4]);
    match message {
        Message::Hello { version, group, threads, memory_bytes, deny, pixels, timeout_ms } => {
            out.u8(HELLO).text(version).text(group).u32(*threads).u64(*memory_bytes);
            out.u8(u8::from(deny.0)).u8(u8::from(deny.1)).u8(code(*pixels)).u32(*timeout_ms);
        }
        Message::Pool { number, len, is_own } => _ = out.u8(POOL).u32(*number).u64(*len).u8(u8::from(*is_own)),
        Message::Plugin { id, path, sha256 } => _ = out.u8(PLUGIN).u32(*id).text(path).text(sha256),
        Message::Lane { id } => _ = out.u8(LANE).u32(*id),
        Message::Turn(Turn { lane, kind, at_ns, message, files, frames }) => {
            out.u8(TURN).u32(*lane).u32(*kind).u64(*at_ns as u64).bytes(message);
            out.u32(files.len() as u32);
            files.iter().for_each(|file| _ = out.text(&file.path).text(&file.sha256));
            out.u32(frames.len() as u32);
            for FrameHead { pool, offset, len, coding, coded_len } in frames {
                out.u32(*pool).u64(*offset).u64(*len);
                match coding {
                    Coding::Raw => _ = out.u8(RAW),
                    Coding::Lz4 => _ = out.u8(LZ4),
                    Coding::H264(Picture { stream, width, height, stride_bytes, begins }) => {
                        out.u8(H264).u32(*stream).u32(*width).u32(*height).u32(*stride_bytes).u8(u8::from(*begins));
                    }
                }
                out.u64(*coded_len);
            }
        }
        Message::Bye => _ = out.u8(BYE),
        Message::Ready => _ = out.u8(READY),
        Message::Lost { words } => _ = out.u8(LOST).text(words),
    }
    let len = (out.0.len() - 4) as u32;
    out.0[..4].copy_from_slice(&len.to_le_bytes());
    out.0
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
    Ok(parse(&head)?)
}

fn parse(head: &[u8]) -> Result<Message, BadMessage> {
    let mut reader = Reader(head);
    let message = match reader.u8()? {
        HELLO => Message::Hello {
            version: reader.text()?,
            group: reader.text()?,
            threads: reader.u32()?,
            memory_bytes: reader.u64()?,
            deny: (reader.flag()?, reader.flag()?),
            pixels: pixels(reader.u8()?)?,
            timeout_ms: reader.u32()?,
        },
        POOL => Message::Pool { number: reader.u32()?, len: reader.u64()?, is_own: reader.flag()? },
        PLUGIN => Message::Plugin { id: reader.u32()?, path: reader.text()?, sha256: reader.text()? },
        LANE => Message::Lane { id: reader.u32()? },
        TURN => {
            let (lane, kind, at_ns) = (reader.u32()?, reader.u32()?, reader.u64()? as i64);
            let message = reader.bytes()?.to_vec();
            let files = (0..reader.count(MAX_FILES)?)
                .map(|_| Ok(FileHash { path: reader.text()?, sha256: reader.text()? }))
                .collect::<Result<_, BadMessage>>()?;
            let frames = (0..reader.count(MAX_FRAMES)?).map(|_| frame(&mut reader)).collect::<Result<_, _>>()?;
            Message::Turn(Turn { lane, kind, at_ns, message, files, frames })
        }
        BYE => Message::Bye,
        READY => Message::Ready,
        LOST => Message::Lost { words: reader.text()? },
        _ => return Err(BadMessage),
    };
    if reader.0.is_empty() { Ok(message) } else { Err(BadMessage) }
}

fn frame(reader: &mut Reader<'_>) -> Result<FrameHead, BadMessage> {
    let (pool, offset, len) = (reader.u32()?, reader.u64()?, reader.u64()?);
    let coding = match reader.u8()? {
        RAW => Coding::Raw,
        LZ4 => Coding::Lz4,
        H264 => Coding::H264(Picture {
            stream: reader.u32()?,
            width: reader.u32()?,
            height: reader.u32()?,
            stride_bytes: reader.u32()?,
            begins: reader.flag()?,
        }),
        _ => return Err(BadMessage),
    };
    let coded_len = reader.u64()?;
    let fits = match coding {
        Coding::Raw => coded_len == len,
        // What does not become shorter is sent as it is.
        Coding::Lz4 => coded_len < len,
        Coding::H264(picture) => coded_len < len && picture.fits(len),
    };
    let frame = FrameHead { pool, offset, len, coding, coded_len };
    if fits && len <= MAX_FRAME_BYTES { Ok(frame) } else { Err(BadMessage) }
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
                deny: (true, false),
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
