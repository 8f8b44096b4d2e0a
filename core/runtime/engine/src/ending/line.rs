//! Text for signal handlers, built without the heap.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether lines are JSON objects.
static JSON_LINES: AtomicBool = AtomicBool::new(false);

/// Makes each further line a JSON object with `unix_ms`, `level`, `node` and `message`.
pub fn write_json_lines() {
    JSON_LINES.store(true, Ordering::Relaxed);
}

/// A line of limited length; longer text is truncated.
pub(super) struct Line {
    bytes: [u8; Self::MAX_COUNT],
    len: usize,
}

impl Line {
    /// Small, because an alternate signal stack may have no more than 8 KiB.
    const MAX_COUNT: usize = 700;

    pub fn new() -> Self {
        Self { bytes: [0; Self::MAX_COUNT], len: 0 }
    }

    pub fn text(&mut self, text: &str) -> &mut Self {
        let room = Self::MAX_COUNT - self.len;
        let bytes = &text.as_bytes()[..text.len().min(room)];
        self.bytes[self.len..self.len + bytes.len()].copy_from_slice(bytes);
        self.len += bytes.len();
        self
    }

    fn digits(&mut self, mut value: u64, base: u64) -> &mut Self {
        let mut digits = [0u8; 20];
        let mut at = digits.len();
        loop {
            at -= 1;
            digits[at] = b"0123456789abcdef"[(value % base) as usize];
            value /= base;
            if value == 0 {
                break;
            }
        }
        // Digits are ASCII.
        self.text(std::str::from_utf8(&digits[at..]).unwrap_or("?"))
    }

    pub fn number(&mut self, value: u64) -> &mut Self {
        self.digits(value, 10)
    }

    pub fn address(&mut self, value: usize) -> &mut Self {
        self.text("0x").digits(value as u64, 16)
    }

    /// Writes the line to standard error and empties it.
    pub fn print(&mut self) {
        if JSON_LINES.load(Ordering::Relaxed) {
            self.put_into_json();
        }
        self.text("\n");
        let mut rest = &self.bytes[..self.len];
        while !rest.is_empty() {
            // SAFETY: a plain system call that a signal handler may make, on bytes that are there.
            let wrote = unsafe { libc::write(2, rest.as_ptr().cast(), rest.len()) };
            if wrote <= 0 {
                break;
            }
            rest = &rest[wrote as usize..];
        }
        self.len = 0;
    }

    /// Makes the line the message of a JSON object, as `--log-format json` of the command writes them. Allocates
    /// nothing: characters that JSON escapes are replaced.
    fn put_into_json(&mut self) {
        let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: a plain system call that a signal handler may make; it fills a local value.
        unsafe { libc::clock_gettime(libc::CLOCK_REALTIME, &raw mut now) };
        let unix_ms = now.tv_sec.unsigned_abs() * 1000 + now.tv_nsec.unsigned_abs() / 1_000_000;
        let (mut message, tail) = (std::mem::replace(self, Self::new()), "\"}");
        self.text("{\"unix_ms\":").number(unix_ms).text(",\"level\":\"warning\",\"node\":\"\",\"message\":\"");
        // Room for the end and the line feed; a character may have been cut off.
        let room = (Self::MAX_COUNT - self.len - tail.len() - 1).min(message.len);
        for byte in &mut message.bytes[..room] {
            *byte = match *byte {
                b'"' => b'\'',
                b'\\' => b'/',
                byte if byte < b' ' => b' ',
                byte => byte,
            };
        }
        let words = match std::str::from_utf8(&message.bytes[..room]) {
            Ok(words) => words,
            Err(error) => std::str::from_utf8(&message.bytes[..error.valid_up_to()]).unwrap_or(""),
        };
        self.text(words).text(tail);
    }
}

#[cfg(test)]
mod tests {
    use super::Line;

    #[test]
    fn a_line_of_any_length_is_one_json_object() {
        for count in 0..100 {
            let mut words = Line::new();
            (0..count).for_each(|_| _ = words.text("\"ü\\\n"));
            words.put_into_json();
            let text = std::str::from_utf8(&words.bytes[..words.len]).unwrap();
            let value: serde_json::Value = serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"));
            assert_eq!(value["level"], "warning");
            assert!(
                count == 0 || value["message"].as_str().is_some_and(|message| message.starts_with("'ü/ ")),
                "{text}"
            );
            assert!(words.len < Line::MAX_COUNT, "room for the line feed");
        }
    }

    #[test]
    fn words_and_numbers_are_put_together_and_cut_off_at_the_end() {
        let mut words = Line::new();
        words.text("tick ").number(0).text(" of ").number(1_234_567).text(" at ").address(0xbeef);
        assert_eq!(&words.bytes[..words.len], b"tick 0 of 1234567 at 0xbeef");
        let mut words = Line::new();
        for _ in 0..200 {
            words.text("a long text").number(u64::MAX);
        }
        assert_eq!(words.len, Line::MAX_COUNT);
    }
}
