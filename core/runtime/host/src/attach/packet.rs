//! Packets of outputs on their way to a window: reduced to the size at which they are shown, compressed with LZ4.

use panoscope_abi::{FORMAT_BGR8, FORMAT_GRAY8, FORMAT_RGBA8, Frame, Tick};
use panoscope_base::format;
use panoscope_engine::memory::{FrameRef, memory};
use serde::{Deserialize, Serialize};

/// Maximum length of a packet, bytes; a larger image is reduced further.
const MAX_BYTES: usize = 48 << 20;
/// Maximum length of a packet's head, bytes.
const MAX_HEAD_BYTES: usize = 64 << 10;
/// Packets below this size are not compressed.
const MIN_COMPRESSED_BYTES: usize = 1 << 10;

/// A packet that is refused.
#[derive(Debug, thiserror::Error)]
pub enum PacketError {
    /// Its head does not fit its bytes.
    #[error("a packet of another machine is damaged; install the same version on both")]
    Damaged,
    /// No memory for it.
    #[error("a packet of {len} bytes does not fit into memory: {words}")]
    Memory {
        /// Its length.
        len: usize,
        /// The error of the frame memory.
        words: String,
    },
}

/// Header of a packet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Head {
    node: String,
    port: String,
    format: u32,
    width: u32,
    height: u32,
    /// Uncompressed length of the packet in bytes.
    len: u64,
    is_compressed: bool,
    /// Width and height before the reduction, px.
    size_px: (u32, u32),
    /// Source, flags, number and capture time of its tick.
    tick: (u32, u32, u64, i64),
    /// Age of its light when the head was made, ns.
    age_ns: Option<i64>,
    /// Time when the head was made, ns of the sender's monotonic clock.
    made_ns: i64,
    /// Whether the next packet is that of the compared output, of the same tick.
    is_first: bool,
}

/// A packet to be sent.
pub struct Outgoing {
    head: Head,
    bytes: Vec<u8>,
}

impl Outgoing {
    /// The packet `frame` of an output for a window that shows it at most `max_width` px wide. `None` for one that is
    /// damaged or too long.
    pub fn of(
        output: (&str, &str),
        frame: &FrameRef,
        max_width: u32,
        age_ns: Option<i64>,
        made_ns: i64,
    ) -> Option<Self> {
        let f = frame.frame();
        let (bytes, width, height) = thinned(f, frame.bytes(), max_width as usize)?;
        let len = bytes.len();
        let coded = (len >= MIN_COMPRESSED_BYTES).then(|| lz4_flex::block::compress(&bytes)).filter(|c| c.len() < len);
        let head = Head {
            node: output.0.to_owned(),
            port: output.1.to_owned(),
            format: f.format,
            width: width as u32,
            height: height as u32,
            len: len as u64,
            is_compressed: coded.is_some(),
            size_px: (f.width, f.height),
            tick: (f.tick.source, f.tick.flags, f.tick.seq, f.tick.capture_ns),
            age_ns,
            made_ns,
            is_first: false,
        };
        Some(Self { head, bytes: coded.unwrap_or(bytes) })
    }

    /// As the first of two packets of one tick, which arrive together.
    pub fn first(mut self, is_first: bool) -> Self {
        self.head.is_first = is_first;
        self
    }

    /// Appends it to a message.
    pub(crate) fn write(&self, to: &mut Vec<u8>) {
        let head = serde_json::to_vec(&self.head).unwrap_or_default();
        to.extend_from_slice(&(head.len() as u32).to_le_bytes());
        to.extend_from_slice(&head);
        to.extend_from_slice(&self.bytes);
    }
}

/// Reduces a packet to at most `max_width` px in width. Returns its bytes without padding between rows, its width and
/// height.
fn thinned(frame: &Frame, bytes: &[u8], max_width: usize) -> Option<(Vec<u8>, usize, usize)> {
    let pixel = format::pixel_bytes(frame.format);
    let (columns, rows, stride) = (frame.width as usize, frame.height as usize, frame.stride_bytes as usize);
    if pixel == 0 || columns == 0 || rows == 0 {
        return (bytes.len() <= MAX_BYTES).then(|| (bytes.to_vec(), columns, rows));
    }
    if format::image_bytes(columns, rows, stride, pixel)? > bytes.len() {
        return None;
    }
    let mut step = columns.div_ceil(max_width.max(1)).max(1);
    let size = |step: usize| ((columns / step).max(1), (rows / step).max(1));
    while size(step).0 * size(step).1 * pixel > MAX_BYTES {
        step += 1;
    }
    let (width, height) = size(step);
    let averages = matches!(frame.format, FORMAT_GRAY8 | FORMAT_BGR8 | FORMAT_RGBA8) && step > 1;
    let mut out = Vec::with_capacity(width * height * pixel);
    for y in 0..height {
        let row = |y: usize| &bytes[y.min(rows - 1) * stride..][..columns * pixel];
        let (upper, lower) = (row(y * step), row(y * step + step / 2));
        if step == 1 {
            out.extend_from_slice(upper);
            continue;
        }
        for x in 0..width {
            let (left, right) = (x * step * pixel, (x * step + step / 2).min(columns - 1) * pixel);
            match averages {
                true => out.extend((0..pixel).map(|k| {
                    let four = [upper[left + k], upper[right + k], lower[left + k], lower[right + k]];
                    (four.iter().map(|byte| u16::from(*byte)).sum::<u16>() / 4) as u8
                })),
                // Means of distances across an edge, or of NaN, would be no distances.
                false => out.extend_from_slice(&upper[left..left + pixel]),
            }
        }
    }
    Some((out, width, height))
}

/// A packet that arrived.
pub struct Packet {
    /// The node.
    pub node: String,
    /// Its output.
    pub port: String,
    /// The packet in this process's memory.
    pub frame: FrameRef,
    /// Width and height before the reduction, px.
    pub size_px: (usize, usize),
    /// Age of its light at `made_ns`, ns; `None` where it is not known.
    pub age_ns: Option<i64>,
    /// Time when the message was made, ns of the other machine's monotonic clock.
    pub made_ns: i64,
    /// Whether the next packet is that of the compared output, of the same tick.
    pub(crate) is_first: bool,
}

impl Packet {
    /// Decodes a packet of [`Outgoing::write`].
    ///
    /// # Errors
    /// It is damaged, or there is no memory for it.
    pub(crate) fn read(bytes: &[u8]) -> Result<Self, PacketError> {
        use PacketError::Damaged;
        let (len, rest) = bytes.split_first_chunk::<4>().ok_or(Damaged)?;
        let len = u32::from_le_bytes(*len) as usize;
        let (head, content) = rest.split_at_checked(len).filter(|_| len <= MAX_HEAD_BYTES).ok_or(Damaged)?;
        let head: Head = serde_json::from_slice(head).map_err(|_| Damaged)?;
        let len = usize::try_from(head.len).ok().filter(|len| *len <= MAX_BYTES).ok_or(Damaged)?;
        let (width, height, pixel) = (head.width as usize, head.height as usize, format::pixel_bytes(head.format));
        let row = width.checked_mul(pixel).and_then(|row| u32::try_from(row).ok()).ok_or(Damaged)?;
        let is_picture = pixel > 0 && width > 0 && height > 0;
        if is_picture && format::image_bytes(width, height, row as usize, pixel) != Some(len) {
            return Err(Damaged);
        }
        // LZ4 makes at most 255 bytes of one.
        if head.is_compressed && len / 256 > content.len() || !head.is_compressed && len != content.len() {
            return Err(Damaged);
        }
        let decoded;
        let content = match head.is_compressed {
            true => {
                decoded = lz4_flex::block::decompress(content, len).map_err(|_| Damaged)?;
                &decoded[..]
            }
            false => content,
        };
        if content.len() != len {
            return Err(Damaged);
        }
        let (source, flags, seq, capture_ns) = head.tick;
        let described = Frame {
            format: head.format,
            width: head.width,
            height: head.height,
            stride_bytes: if is_picture { row } else { 0 },
            tick: Tick { source, flags, seq, capture_ns },
            ..Frame::EMPTY
        };
        Ok(Self {
            frame: frame_of(content, described)?,
            node: head.node,
            port: head.port,
            size_px: (head.size_px.0 as usize, head.size_px.1 as usize),
            age_ns: head.age_ns,
            made_ns: head.made_ns,
            is_first: head.is_first,
        })
    }
}

/// A frame of this process with these bytes.
fn frame_of(bytes: &[u8], described: Frame) -> Result<FrameRef, PacketError> {
    let len = bytes.len();
    let (buffer, data) =
        memory().allocate(len).map_err(|error| PacketError::Memory { len, words: error.to_string() })?;
    // SAFETY: `allocate` returned a buffer of at least `len` bytes with one reference, which nobody else has and which goes to the frame.
    unsafe {
        std::ptr::copy_nonoverlapping(bytes.as_ptr(), data, len);
        Ok(FrameRef::adopt(Frame { buffer, data, len, ..described }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(name: &str, width: usize, height: usize, stride: usize, bytes: &[u8]) -> FrameRef {
        let format = format::image_named(name).expect("a format").id;
        let described = Frame {
            format,
            width: width as u32,
            height: height as u32,
            stride_bytes: stride as u32,
            tick: Tick { source: 1, flags: 2, seq: 3, capture_ns: 4 },
            ..Frame::EMPTY
        };
        frame_of(bytes, described).expect("memory")
    }

    fn there_and_back(frame: &FrameRef, max_width: u32) -> Packet {
        let packet = Outgoing::of(("wide", "panorama"), frame, max_width, Some(5), 6).expect("it fits");
        let mut bytes = Vec::new();
        packet.write(&mut bytes);
        Packet::read(&bytes).expect("it was not damaged")
    }

    #[test]
    fn packets_arrive_as_they_were() {
        let noise: Vec<u8> = (0..64 * 48).map(|at: usize| (at * at / 7 % 251) as u8).collect();
        for bytes in [noise, vec![9; 64 * 48]] {
            let packet = there_and_back(&frame("gray8", 60, 48, 64, &bytes), 4096);
            let rows: Vec<u8> = bytes.chunks(64).flat_map(|row| &row[..60]).copied().collect();
            assert_eq!((packet.frame.bytes(), packet.size_px), (&rows[..], (60, 48)));
            assert_eq!((packet.node.as_str(), packet.port.as_str(), packet.age_ns), ("wide", "panorama", Some(5)));
            assert_eq!((packet.frame.tick().seq, packet.frame.frame().stride_bytes), (3, 60));
        }
    }

    #[test]
    fn pictures_are_thinned_to_the_size_at_which_they_are_shown() {
        let bytes: Vec<u8> = (0..8 * 4).map(|at| if at % 2 == 0 { 100 } else { 200 }).collect();
        let packet = there_and_back(&frame("gray8", 8, 4, 8, &bytes), 4);
        assert_eq!((packet.frame.frame().width, packet.frame.frame().height, packet.size_px), (4, 2, (8, 4)));
        assert_eq!(packet.frame.bytes(), [150; 8], "means of pixels");
        let numbers: Vec<u8> = [1f32, f32::NAN, 3.0, 5.0].iter().flat_map(|number| number.to_le_bytes()).collect();
        let packet = there_and_back(&frame("f32", 4, 1, 16, &numbers), 2);
        assert_eq!(packet.frame.bytes(), [1f32.to_le_bytes(), 3f32.to_le_bytes()].concat(), "single values of maps");
    }

    #[test]
    fn damaged_packets_are_refused() {
        let mut bytes = Vec::new();
        Outgoing::of(("a", "b"), &frame("gray8", 64, 64, 64, &[7; 4096]), 64, None, 0)
            .expect("it fits")
            .write(&mut bytes);
        for end in 0..bytes.len() {
            assert!(Packet::read(&bytes[..end]).is_err(), "{end}");
        }
        let text = String::from_utf8_lossy(&bytes).replace("\"len\":4096", "\"len\":9999");
        assert!(Packet::read(text.as_bytes()).is_err());
    }
}
