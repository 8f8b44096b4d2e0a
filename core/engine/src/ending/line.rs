//! Text for signal handlers, built without the heap.

/// A line of limited length; longer text is truncated.
pub(super) struct Line {
    bytes: [u8; Self::MOST],
    len: usize,
}

impl Line {
    /// Small, because an alternate signal stack may have no more than 8 KiB.
    const MOST: usize = 700;

    pub fn new() -> Self {
        Self { bytes: [0; Self::MOST], len: 0 }
    }

    pub fn text(&mut self, text: &str) -> &mut Self {
        let room = Self::MOST - self.len;
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
}

#[cfg(test)]
mod tests {
    use super::Line;

    #[test]
    fn words_and_numbers_are_put_together_and_cut_off_at_the_end() {
        let mut words = Line::new();
        words.text("tick ").number(0).text(" of ").number(1_234_567).text(" at ").address(0xbeef);
        assert_eq!(&words.bytes[..words.len], b"tick 0 of 1234567 at 0xbeef");
        let mut words = Line::new();
        for _ in 0..200 {
            words.text("a long text").number(u64::MAX);
        }
        assert_eq!(words.len, Line::MOST);
    }
}
