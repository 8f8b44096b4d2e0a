//! Messages as bytes. Little-endian numbers in sequence; texts and lists are preceded by their length.
//!
//! [`message!`] declares a message once and derives both directions from its fields. The messages of a lane and of the socket are in [`lane`], those
//! between machines in [`super::relay::messages`].

pub(crate) mod lane;

use panoscope_abi::{self as abi, BufferId, Frame, ParamValue, PortRange, Str, Tick};

/// Maximum number of problems of one node that are passed on.
pub(crate) const MAX_PROBLEMS: usize = 64;
/// Maximum length of a problem's text, bytes.
pub(crate) const MAX_PROBLEM_BYTES: usize = 4096;
/// Maximum length of a log line, fault or path that is passed on, bytes.
pub(crate) const MAX_TEXT_BYTES: usize = 64 << 10;

/// A message that is truncated or has an impossible value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a message between the processes is malformed")]
pub(crate) struct BadMessage;

/// A value with one encoding in messages.
pub(crate) trait Wire: Sized {
    /// Minimum number of bytes of a value. Limits the memory of a list by the length of its message.
    const MIN_BYTES: usize;

    /// Appends the value.
    fn put(&self, out: &mut Vec<u8>);

    /// Reads a value.
    fn take(reader: &mut Reader<'_>) -> Result<Self, BadMessage>;

    /// Reads a value in place of this one, whose memory is used again.
    #[inline]
    fn refill(&mut self, reader: &mut Reader<'_>) -> Result<(), BadMessage> {
        *self = Self::take(reader)?;
        Ok(())
    }

    /// Appends the values of a list.
    #[inline]
    fn put_all(values: &[Self], out: &mut Vec<u8>) {
        values.iter().for_each(|value| value.put(out));
    }

    /// Reads the values of a list, of `count` times [`Self::MIN_BYTES`] at least.
    #[inline]
    fn take_all(count: usize, reader: &mut Reader<'_>, values: &mut Vec<Self>) -> Result<(), BadMessage> {
        values.reserve(count);
        for _ in 0..count {
            values.push(reader.take()?);
        }
        Ok(())
    }
}

/// Reads a message from a private copy.
pub(crate) struct Reader<'b>(pub &'b [u8]);

impl<'b> Reader<'b> {
    /// The next value.
    #[inline]
    pub fn take<T: Wire>(&mut self) -> Result<T, BadMessage> {
        T::take(self)
    }

    #[inline]
    fn array<const N: usize>(&mut self) -> Result<[u8; N], BadMessage> {
        let (head, rest) = self.0.split_first_chunk::<N>().ok_or(BadMessage)?;
        self.0 = rest;
        Ok(*head)
    }

    /// A count of values that take at least `least` bytes each.
    pub fn count(&mut self, least: usize) -> Result<usize, BadMessage> {
        let count = usize::try_from(self.take::<u64>()?).map_err(|_| BadMessage)?;
        if count.checked_mul(least.max(1)).is_none_or(|bytes| bytes > self.0.len()) {
            return Err(BadMessage);
        }
        Ok(count)
    }

    /// The next `len` bytes.
    fn head(&mut self, len: usize) -> Result<&'b [u8], BadMessage> {
        let (head, rest) = self.0.split_at_checked(len).ok_or(BadMessage)?;
        self.0 = rest;
        Ok(head)
    }

    /// A list of bytes, which stays in the message.
    pub fn bytes(&mut self) -> Result<&'b [u8], BadMessage> {
        let len = self.count(1)?;
        self.head(len)
    }
}

/// Appends a list of bytes, as [`Reader::bytes`] reads it.
pub(crate) fn put_bytes(bytes: &[u8], out: &mut Vec<u8>) {
    (bytes.len() as u64).put(out);
    out.extend_from_slice(bytes);
}

/// A value as a message.
pub(crate) fn encoded(value: &impl Wire) -> Vec<u8> {
    let mut out = Vec::new();
    value.put(&mut out);
    out
}

/// Reads a value that takes a whole message.
pub(crate) fn whole<T: Wire>(message: &[u8]) -> Result<T, BadMessage> {
    let mut reader = Reader(message);
    let value = reader.take()?;
    if reader.0.is_empty() { Ok(value) } else { Err(BadMessage) }
}

macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl Wire for $number {
            const MIN_BYTES: usize = size_of::<$number>();

            #[inline]
            fn put(&self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }

            #[inline]
            fn take(reader: &mut Reader<'_>) -> Result<Self, BadMessage> {
                reader.array().map(Self::from_le_bytes)
            }
        }
    )*};
}

numbers!(u32, i32, u64, i64, f64);

impl Wire for u8 {
    const MIN_BYTES: usize = 1;

    #[inline]
    fn put(&self, out: &mut Vec<u8>) {
        out.push(*self);
    }

    #[inline]
    fn take(reader: &mut Reader<'_>) -> Result<Self, BadMessage> {
        reader.array().map(|[byte]| byte)
    }

    fn put_all(values: &[Self], out: &mut Vec<u8>) {
        out.extend_from_slice(values);
    }

    fn take_all(count: usize, reader: &mut Reader<'_>, values: &mut Vec<Self>) -> Result<(), BadMessage> {
        values.extend_from_slice(reader.head(count)?);
        Ok(())
    }
}

/// Declares a message: a struct with named fields, or an enum whose variants have a number each. Fields are encoded in their order.
macro_rules! message {
    ($(#[$about:meta])* $vis:vis struct $name:ident { $($(#[$doc:meta])* $field_vis:vis $field:ident: $type:ty),* $(,)? }) => {
        $(#[$about])*
        $vis struct $name { $($(#[$doc])* $field_vis $field: $type),* }

        $crate::isolate::wire::fields!($name { $($field: $type),* });
    };
    ($(#[$about:meta])* $vis:vis enum $name:ident {
        $($(#[$doc:meta])* $number:literal => $variant:ident $(($inner:ident: $inner_type:ty))? $({ $($(#[$field_doc:meta])* $field:ident: $type:ty),* $(,)? })?),* $(,)?
    }) => {
        $(#[$about])*
        $vis enum $name { $($(#[$doc])* $variant $(($inner_type))? $({ $($(#[$field_doc])* $field: $type),* })?),* }

        impl $crate::isolate::wire::Wire for $name {
            const MIN_BYTES: usize = 1;

            fn put(&self, out: &mut Vec<u8>) {
                match self {
                    $(Self::$variant $(($inner))? $({ $($field),* })? => {
                        out.push($number);
                        $($inner.put(out);)?
                        $($($field.put(out);)*)?
                    })*
                }
            }

            fn take(reader: &mut $crate::isolate::wire::Reader<'_>) -> Result<Self, $crate::isolate::wire::BadMessage> {
                match reader.take::<u8>()? {
                    $($number => Ok(Self::$variant $(({ let $inner: $inner_type = reader.take()?; $inner }))? $({ $($field: reader.take()?),* })?),)*
                    _ => Err($crate::isolate::wire::BadMessage),
                }
            }
        }
    };
}

/// Derives the encoding of a struct from its fields.
macro_rules! fields {
    ($name:ident { $($field:ident: $type:ty),* }) => {
        impl $crate::isolate::wire::Wire for $name {
            const MIN_BYTES: usize = 0 $(+ <$type as $crate::isolate::wire::Wire>::MIN_BYTES)*;

            #[inline]
            fn put(&self, out: &mut Vec<u8>) {
                $(self.$field.put(out);)*
            }

            #[inline]
            fn take(reader: &mut $crate::isolate::wire::Reader<'_>) -> Result<Self, $crate::isolate::wire::BadMessage> {
                Ok(Self { $($field: reader.take()?),* })
            }

            #[inline]
            fn refill(&mut self, reader: &mut $crate::isolate::wire::Reader<'_>) -> Result<(), $crate::isolate::wire::BadMessage> {
                $(self.$field.refill(reader)?;)*
                Ok(())
            }
        }
    };
}

pub(crate) use {fields, message};

fields!(Tick { source: u32, flags: u32, seq: u64, capture_ns: i64 });
fields!(PortRange { first: u32, count: u32 });

impl Wire for bool {
    const MIN_BYTES: usize = 1;

    #[inline]
    fn put(&self, out: &mut Vec<u8>) {
        out.push(u8::from(*self));
    }

    #[inline]
    fn take(reader: &mut Reader<'_>) -> Result<Self, BadMessage> {
        match reader.take::<u8>()? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(BadMessage),
        }
    }
}

impl<T: Wire> Wire for Option<T> {
    const MIN_BYTES: usize = 1;

    #[inline]
    fn put(&self, out: &mut Vec<u8>) {
        self.is_some().put(out);
        if let Some(value) = self {
            value.put(out);
        }
    }

    #[inline]
    fn take(reader: &mut Reader<'_>) -> Result<Self, BadMessage> {
        reader.take::<bool>()?.then(|| reader.take()).transpose()
    }
}

impl<T: Wire> Wire for Vec<T> {
    const MIN_BYTES: usize = u64::MIN_BYTES;

    #[inline]
    fn put(&self, out: &mut Vec<u8>) {
        (self.len() as u64).put(out);
        T::put_all(self, out);
    }

    fn take(reader: &mut Reader<'_>) -> Result<Self, BadMessage> {
        let mut values = Vec::new();
        values.refill(reader)?;
        Ok(values)
    }

    #[inline]
    fn refill(&mut self, reader: &mut Reader<'_>) -> Result<(), BadMessage> {
        self.clear();
        let count = reader.count(T::MIN_BYTES)?;
        T::take_all(count, reader, self)
    }
}

/// Texts have at most [`MAX_TEXT_BYTES`]; longer ones are cut.
impl Wire for String {
    const MIN_BYTES: usize = u64::MIN_BYTES;

    fn put(&self, out: &mut Vec<u8>) {
        put_bytes(&self.as_bytes()[..self.floor_char_boundary(MAX_TEXT_BYTES)], out);
    }

    fn take(reader: &mut Reader<'_>) -> Result<Self, BadMessage> {
        let text = std::str::from_utf8(reader.bytes()?).map_err(|_| BadMessage)?;
        if text.len() <= MAX_TEXT_BYTES { Ok(text.to_owned()) } else { Err(BadMessage) }
    }
}

impl Wire for BufferId {
    const MIN_BYTES: usize = 12;

    #[inline]
    fn put(&self, out: &mut Vec<u8>) {
        self.pool.put(out);
        self.offset.put(out);
    }

    #[inline]
    fn take(reader: &mut Reader<'_>) -> Result<Self, BadMessage> {
        Ok(Self { pool: reader.take()?, home: 0, offset: reader.take()? })
    }
}

/// A frame without its address, which differs between the processes: it is null after reading.
impl Wire for Frame {
    const MIN_BYTES: usize = BufferId::MIN_BYTES + 24 + Tick::MIN_BYTES;

    #[inline]
    fn put(&self, out: &mut Vec<u8>) {
        self.buffer.put(out);
        (self.len as u64).put(out);
        [self.format, self.width, self.height, self.stride_bytes].iter().for_each(|number| number.put(out));
        self.tick.put(out);
    }

    #[inline]
    fn take(reader: &mut Reader<'_>) -> Result<Self, BadMessage> {
        Ok(Self {
            buffer: reader.take()?,
            data: std::ptr::null_mut(),
            len: usize::try_from(reader.take::<u64>()?).map_err(|_| BadMessage)?,
            format: reader.take()?,
            width: reader.take()?,
            height: reader.take()?,
            stride_bytes: reader.take()?,
            tick: reader.take()?,
        })
    }
}

message! {
    /// A value of a parameter.
    #[derive(Clone, Debug, PartialEq)]
    struct Value {
        kind: u32,
        index: u32,
        int_value: i64,
        float_value: f64,
        text: Vec<u8>,
        floats: Vec<f64>,
    }
}

/// Values of parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Params(Vec<Value>);

impl Params {
    /// A copy of the values of a call.
    ///
    /// # Safety
    /// `params` holds `len` values whose texts and numbers are readable.
    pub unsafe fn copy(params: *const ParamValue, len: usize) -> Self {
        // SAFETY: the caller's promise.
        let params = if len == 0 { &[] } else { unsafe { std::slice::from_raw_parts(params, len) } };
        let copy = |value: &ParamValue| Value {
            kind: value.kind,
            index: value.index,
            int_value: value.int_value,
            float_value: value.float_value,
            // SAFETY: the caller's promise.
            text: unsafe { value.text.bytes() }.to_vec(),
            // SAFETY: the caller's promise.
            floats: (0..value.floats_len).map(|at| unsafe { *value.floats.add(at) }).collect(),
        };
        Self(params.iter().map(copy).collect())
    }

    /// The values as a plugin takes them. They point into these values, which must stay as they are while the result is used.
    pub fn lent(&self) -> Vec<ParamValue> {
        let lend = |value: &Value| ParamValue {
            kind: value.kind,
            index: value.index,
            int_value: value.int_value,
            float_value: value.float_value,
            text: Str { ptr: value.text.as_ptr(), len: value.text.len() },
            floats: value.floats.as_ptr(),
            floats_len: value.floats.len(),
        };
        self.0.iter().map(lend).collect()
    }

    /// The text of a value; `None` if there is no such value or its text is not UTF-8.
    pub fn text(&self, at: u32) -> Option<&str> {
        std::str::from_utf8(&self.0.get(at as usize)?.text).ok()
    }

    /// Replaces each path.
    pub fn replace_paths(&mut self, path: impl Fn(&str) -> String) -> Result<(), BadMessage> {
        for value in self.0.iter_mut().filter(|value| value.kind == abi::PARAM_PATH) {
            value.text = path(std::str::from_utf8(&value.text).map_err(|_| BadMessage)?).into_bytes();
        }
        Ok(())
    }
}

impl Wire for Params {
    const MIN_BYTES: usize = u64::MIN_BYTES;

    fn put(&self, out: &mut Vec<u8>) {
        self.0.put(out);
    }

    fn take(reader: &mut Reader<'_>) -> Result<Self, BadMessage> {
        reader.take().map(Self)
    }
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

    message! {
        #[derive(Debug, PartialEq)]
        enum Either {
            /// Without fields.
            1 => Nothing,
            2 => Inner(value: i32),
            7 => Named { name: String, list: Vec<u32>, some: Option<bool> },
        }
    }

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
            buffer: BufferId { pool: 7, home: 0, offset: 1 << 40 },
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
        let params = unsafe { Params::copy(&raw const value, 1) };
        5_u32.put(&mut bytes);
        frame.put(&mut bytes);
        assert_eq!(bytes.len(), 4 + Frame::MIN_BYTES);
        put_bytes(b"abc", &mut bytes);
        params.put(&mut bytes);
        let mut reader = Reader(&bytes);
        assert_eq!(reader.take::<u32>(), Ok(5));
        let read = reader.take::<Frame>().expect("a frame");
        assert_eq!((read.buffer, read.len, read.tick), (frame.buffer, frame.len, frame.tick));
        assert_eq!(reader.bytes(), Ok(&b"abc"[..]));
        let read = reader.take::<Params>().expect("values");
        assert!(reader.0.is_empty() && read == params);
        let first = read.lent()[0];
        assert_eq!((first.kind, first.index, first.int_value), (abi::PARAM_FLOATS, 3, -4));
        // SAFETY: the text and the numbers live in `read`.
        let (words, numbers) = unsafe { (first.text.text(), std::slice::from_raw_parts(first.floats, 2)) };
        assert_eq!((words, numbers), (Some(text), &floats[..]));
    }

    #[test]
    fn an_enum_is_read_by_its_number() {
        let named = Either::Named { name: "scope".to_owned(), list: vec![1, 2], some: Some(true) };
        for value in [Either::Nothing, Either::Inner(-5), named] {
            let mut bytes = Vec::new();
            value.put(&mut bytes);
            assert_eq!(whole::<Either>(&bytes).as_ref(), Ok(&value));
            (0..bytes.len()).for_each(|len| assert!(whole::<Either>(&bytes[..len]).is_err(), "{value:?} {len}"));
            bytes.push(0);
            assert!(whole::<Either>(&bytes).is_err(), "a byte too many");
        }
        assert_eq!(whole::<Either>(&[3]), Err(BadMessage));
        assert_eq!(whole::<Option<bool>>(&[1, 2]), Err(BadMessage), "neither 0 nor 1");
    }

    #[test]
    fn no_message_reads_past_its_end() {
        let mut bytes = Vec::new();
        u64::MAX.put(&mut bytes);
        3_u64.put(&mut bytes);
        assert_eq!(Reader(&bytes).bytes(), Err(BadMessage));
        assert!(Reader(&bytes).take::<Params>().is_err() && Reader(&bytes).take::<Vec<u8>>().is_err());
        assert!(Reader(&bytes[..7]).take::<u64>().is_err() && Reader(&bytes).take::<Frame>().is_err());
        let long = "\u{fc}".repeat(MAX_TEXT_BYTES);
        let mut bytes = Vec::new();
        long.put(&mut bytes);
        assert_eq!(whole::<String>(&bytes).expect("a text").len(), MAX_TEXT_BYTES);
        assert_eq!(plain_status(abi::Status::MIN), abi::STATUS_ERROR);
        assert_eq!(plain_words(b"a\x1b[31m\xff\nb\0"), "a [31m\u{fffd}\nb ");
        assert_eq!(plain_words(&[b'x'; 2 * MAX_PROBLEM_BYTES]).len(), MAX_PROBLEM_BYTES);
    }
}
