//! Messages as bytes. Little-endian numbers in sequence; texts and lists are preceded by their length.

use panoscope_abi::{self as abi, BufferId, Frame, ParamValue, Str, Tick};

/// Maximum number of problems of one node that are passed on.
pub(crate) const MAX_PROBLEMS: usize = 64;
/// Maximum length of a problem's text, bytes.
pub(crate) const MAX_PROBLEM_BYTES: usize = 4096;
/// Maximum length of a log line, fault or path that is passed on, bytes.
pub(crate) const MAX_TEXT_BYTES: usize = 64 << 10;

/// Kind of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum Kind {
    // From the host.
    Open = 1,
    Process,
    Close,
    SaveState,
    LoadPart,
    LoadState,
    Finish,
    Describe,
    Validate,
    /// The result of a host function.
    Answer,
    // From the child.
    Done = 100,
    Alloc,
    Forward,
    MakeMut,
    Retain,
    Release,
    Log,
    Fail,
    Metric,
    ClaimFile,
    Clock,
    SetArrived,
    Arrived,
    Age,
    SetLag,
    Save,
    /// An output in a buffer of the stock.
    Placed,
    /// A copy of an output in a buffer of the stock.
    Copied,
    /// Only the deferred functions that precede every message.
    Flush,
}

impl Kind {
    const ALL: [Kind; 29] = [
        Kind::Open,
        Kind::Process,
        Kind::Close,
        Kind::SaveState,
        Kind::LoadPart,
        Kind::LoadState,
        Kind::Finish,
        Kind::Describe,
        Kind::Validate,
        Kind::Answer,
        Kind::Done,
        Kind::Alloc,
        Kind::Forward,
        Kind::MakeMut,
        Kind::Retain,
        Kind::Release,
        Kind::Log,
        Kind::Fail,
        Kind::Metric,
        Kind::ClaimFile,
        Kind::Clock,
        Kind::SetArrived,
        Kind::Arrived,
        Kind::Age,
        Kind::SetLag,
        Kind::Save,
        Kind::Placed,
        Kind::Copied,
        Kind::Flush,
    ];

    /// Whether the child may defer it instead of asking, because its result is not needed.
    pub fn is_deferred(self) -> bool {
        use Kind::{Copied, Forward, Metric, Placed, Release, Retain, SetArrived, SetLag};
        matches!(self, Placed | Copied | Forward | Retain | Release | Metric | SetArrived | SetLag)
    }

    pub fn of(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u32 == number)
    }
}

/// A message that is truncated or has an impossible value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a message between the processes is malformed")]
pub(crate) struct BadMessage;

/// Writes a message into a reusable buffer.
pub(crate) struct Writer<'b>(pub &'b mut Vec<u8>);

impl Writer<'_> {
    pub fn u32(&mut self, value: u32) -> &mut Self {
        self.0.extend_from_slice(&value.to_le_bytes());
        self
    }

    pub fn i32(&mut self, value: i32) -> &mut Self {
        self.0.extend_from_slice(&value.to_le_bytes());
        self
    }

    pub fn u64(&mut self, value: u64) -> &mut Self {
        self.0.extend_from_slice(&value.to_le_bytes());
        self
    }

    pub fn i64(&mut self, value: i64) -> &mut Self {
        self.u64(value as u64)
    }

    pub fn f64(&mut self, value: f64) -> &mut Self {
        self.u64(value.to_bits())
    }

    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.u64(bytes.len() as u64);
        self.0.extend_from_slice(bytes);
        self
    }

    pub fn buffer(&mut self, id: BufferId) -> &mut Self {
        self.u32(id.pool).u64(id.offset)
    }

    pub fn tick(&mut self, tick: &Tick) -> &mut Self {
        self.u32(tick.source).u32(tick.flags).u64(tick.seq).i64(tick.capture_ns)
    }

    /// A frame without its address, which differs between the processes.
    pub fn frame(&mut self, frame: &Frame) -> &mut Self {
        self.buffer(frame.buffer).u64(frame.len as u64);
        self.u32(frame.format).u32(frame.width).u32(frame.height).u32(frame.stride_bytes).tick(&frame.tick)
    }

    /// Values of parameters.
    ///
    /// # Safety
    /// `params` holds `len` values whose texts and numbers are readable.
    pub unsafe fn params(&mut self, params: *const ParamValue, len: usize) -> &mut Self {
        // SAFETY: the caller's promise.
        let params = if len == 0 { &[] } else { unsafe { std::slice::from_raw_parts(params, len) } };
        self.u64(params.len() as u64);
        for value in params {
            self.u32(value.kind).u32(value.index).i64(value.int_value).f64(value.float_value);
            // SAFETY: the caller's promise.
            self.bytes(unsafe { value.text.bytes() });
            self.u64(value.floats_len as u64);
            for at in 0..value.floats_len {
                // SAFETY: the caller's promise.
                self.f64(unsafe { *value.floats.add(at) });
            }
        }
        self
    }
}

/// Reads a message from a private copy.
pub(crate) struct Reader<'b>(pub &'b [u8]);

impl<'b> Reader<'b> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], BadMessage> {
        let (head, rest) = self.0.split_first_chunk::<N>().ok_or(BadMessage)?;
        self.0 = rest;
        Ok(*head)
    }

    pub fn u32(&mut self) -> Result<u32, BadMessage> {
        self.take().map(u32::from_le_bytes)
    }

    pub fn i32(&mut self) -> Result<i32, BadMessage> {
        self.take().map(i32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Result<u64, BadMessage> {
        self.take().map(u64::from_le_bytes)
    }

    pub fn i64(&mut self) -> Result<i64, BadMessage> {
        self.take().map(i64::from_le_bytes)
    }

    pub fn f64(&mut self) -> Result<f64, BadMessage> {
        self.take().map(f64::from_le_bytes)
    }

    /// A count of things that take at least `least` bytes each.
    pub fn count(&mut self, least: usize) -> Result<usize, BadMessage> {
        let count = usize::try_from(self.u64()?).map_err(|_| BadMessage)?;
        if count.checked_mul(least.max(1)).is_none_or(|bytes| bytes > self.0.len()) {
            return Err(BadMessage);
        }
        Ok(count)
    }

    pub fn bytes(&mut self) -> Result<&'b [u8], BadMessage> {
        let len = self.count(1)?;
        let (head, rest) = self.0.split_at_checked(len).ok_or(BadMessage)?;
        self.0 = rest;
        Ok(head)
    }

    pub fn text(&mut self) -> Result<&'b str, BadMessage> {
        std::str::from_utf8(self.bytes()?).map_err(|_| BadMessage)
    }

    pub fn buffer(&mut self) -> Result<BufferId, BadMessage> {
        Ok(BufferId { pool: self.u32()?, reserved: 0, offset: self.u64()? })
    }

    pub fn tick(&mut self) -> Result<Tick, BadMessage> {
        Ok(Tick { source: self.u32()?, flags: self.u32()?, seq: self.u64()?, capture_ns: self.i64()? })
    }

    /// A frame; its address is null.
    pub fn frame(&mut self) -> Result<Frame, BadMessage> {
        let buffer = self.buffer()?;
        let len = usize::try_from(self.u64()?).map_err(|_| BadMessage)?;
        let (format, width, height, stride_bytes) = (self.u32()?, self.u32()?, self.u32()?, self.u32()?);
        let tick = self.tick()?;
        Ok(Frame { buffer, data: std::ptr::null_mut(), len, format, width, height, stride_bytes, tick })
    }

    pub fn params(&mut self) -> Result<Params, BadMessage> {
        let count = self.count(40)?;
        let mut params = Params::default();
        let mut parts = Vec::with_capacity(count);
        for _ in 0..count {
            let value = ParamValue {
                kind: self.u32()?,
                index: self.u32()?,
                int_value: self.i64()?,
                float_value: self.f64()?,
                text: Str::EMPTY,
                floats: std::ptr::null(),
                floats_len: 0,
            };
            let text: Box<[u8]> = self.bytes()?.into();
            let floats = (0..self.count(8)?).map(|_| self.f64()).collect::<Result<Box<[f64]>, _>>()?;
            parts.push((value, text, floats));
        }
        for (mut value, text, floats) in parts {
            value.text = Str { ptr: text.as_ptr(), len: text.len() };
            (value.floats, value.floats_len) = (floats.as_ptr(), floats.len());
            params.values.push(value);
            params.texts.push(text);
            params.floats.push(floats);
        }
        Ok(params)
    }
}

/// Values of parameters and the data they point to, which does not move.
#[derive(Default)]
pub(crate) struct Params {
    pub values: Vec<ParamValue>,
    texts: Vec<Box<[u8]>>,
    floats: Vec<Box<[f64]>>,
}

/// Text of another process as a message: of limited length, without terminal control characters.
pub(crate) fn plain_words(bytes: &[u8]) -> String {
    let words = String::from_utf8_lossy(&bytes[..bytes.len().min(MAX_PROBLEM_BYTES)]);
    words.chars().map(|c| if c.is_control() && c != '\n' { ' ' } else { c }).collect()
}

/// Whether a status is one that a plugin may return. Others would be mistaken for the host's own.
pub(crate) fn plain_status(status: abi::Status) -> abi::Status {
    if (abi::STATUS_STOPPED..=abi::STATUS_END).contains(&status) { status } else { abi::STATUS_ERROR }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let text = "points";
        let floats = [1.5, -2.5];
        let value = ParamValue {
            kind: abi::PARAM_FLOATS,
            index: 3,
            int_value: -4,
            float_value: 0.25,
            text: Str::new(text),
            floats: floats.as_ptr(),
            floats_len: 2,
        };
        let frame = Frame {
            buffer: BufferId { pool: 7, reserved: 0, offset: 1 << 40 },
            len: 12,
            format: 2,
            width: 2,
            height: 2,
            stride_bytes: 6,
            tick: Tick { source: 1, flags: 2, seq: 3, capture_ns: -4 },
            ..Frame::EMPTY
        };
        let mut bytes = Vec::new();
        // SAFETY: one value whose text and numbers live.
        unsafe { Writer(&mut bytes).u32(5).frame(&frame).bytes(b"abc").params(&raw const value, 1) };
        let mut reader = Reader(&bytes);
        assert_eq!(reader.u32(), Ok(5));
        let read = reader.frame().expect("a frame");
        assert_eq!((read.buffer, read.len, read.tick), (frame.buffer, frame.len, frame.tick));
        assert_eq!(reader.text(), Ok("abc"));
        let params = reader.params().expect("values");
        let first = params.values[0];
        assert_eq!((first.kind, first.index, first.int_value), (abi::PARAM_FLOATS, 3, -4));
        // SAFETY: the text and the numbers live in `params`.
        let (words, numbers) = unsafe { (first.text.text(), std::slice::from_raw_parts(first.floats, 2)) };
        assert_eq!((words, numbers), (Some(text), &floats[..]));
        assert!(reader.0.is_empty());
    }

    #[test]
    fn no_message_reads_past_its_end() {
        let mut bytes = Vec::new();
        Writer(&mut bytes).u64(u64::MAX).u64(3);
        assert_eq!(Reader(&bytes).bytes(), Err(BadMessage));
        assert!(Reader(&bytes).params().is_err());
        assert!(Reader(&bytes[..7]).u64().is_err() && Reader(&bytes).frame().is_err());
        assert!(Kind::of(99).is_none() && Kind::of(103) == Some(Kind::MakeMut));
        assert_eq!(plain_status(abi::Status::MIN), abi::STATUS_ERROR);
        assert_eq!(plain_words(b"a\x1b[31m\xff\nb\0"), "a [31m\u{fffd}\nb ");
        assert_eq!(plain_words(&[b'x'; 2 * MAX_PROBLEM_BYTES]).len(), MAX_PROBLEM_BYTES);
    }
}
