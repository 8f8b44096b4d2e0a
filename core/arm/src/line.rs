//! The line protocol between a driver and an arm's controller.
//!
//! Lines of ASCII end with a line feed. Each ends with `*` and two hexadecimal digits: all bytes before the `*`, exclusive-ored. Angles are whole
//! microradians, speeds whole microradians per second, in the order of the joints from the base; `SEQ` counts from 0 to 999999 and begins anew.
//!
//! | line | from | means |
//! |---|---|---|
//! | `H SEQ*CC` | driver | say where you are; moves nothing |
//! | `S SEQ P1 P2 P3 P4 P5 P6 V1 V2 V3 V4 V5 V6*CC` | driver | be at these angles now, at these speeds; every 10 ms while anything moves |
//! | `C SEQ*CC` | driver | let your own stop go |
//! | `A SEQ STATE P1 P2 P3 P4 P5 P6*CC` | arm | answer to each line with its `SEQ`: where the encoders are; STATE is `R` (ready) or `W` (stopped by itself) |
//!
//! The arm keeps a watchdog of its own: while it moves and no sound `S` line came for 30 ms, it brakes, holds, and answers `W` until `C`. It takes no
//! line whose sum is wrong. So the arm stops when the driver, the program or the cable is gone.

use crate::chain::{JOINTS, JointVector};

/// Longest line, bytes; more bytes without a line feed are garbage.
pub const LONGEST: usize = 256;
/// Numbers of lines start again at 0 here.
pub const SEQ_END: u32 = 1_000_000;

/// One line of the protocol.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Line {
    /// `H`.
    Hello {
        /// Number of the line.
        seq: u32,
    },
    /// `S`.
    Set {
        /// Number of the line.
        seq: u32,
        /// Joint angles, rad.
        position: JointVector,
        /// Joint velocities, rad/s.
        velocity: JointVector,
    },
    /// `C`.
    Clear {
        /// Number of the line.
        seq: u32,
    },
    /// `A`.
    Answer {
        /// Number of the line that this one answers.
        seq: u32,
        /// Whether the arm follows set-points.
        ready: bool,
        /// Joint angles, rad.
        position: JointVector,
    },
}

fn sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum ^ byte)
}

/// A number in whole millionths, clamped to the type's range.
fn micro(value: f64) -> i64 {
    (value * 1e6).round().clamp(-9e9, 9e9) as i64
}

impl Line {
    /// Appends the line, with its sum and line feed.
    pub fn write(&self, out: &mut Vec<u8>) {
        use std::io::Write;
        let start = out.len();
        // Writing to memory does not fail.
        let numbers = |out: &mut Vec<u8>, values: &JointVector| {
            values.iter().for_each(|v| {
                let _ = write!(out, " {}", micro(*v));
            });
        };
        match self {
            Self::Hello { seq } => {
                let _ = write!(out, "H {seq}");
            }
            Self::Clear { seq } => {
                let _ = write!(out, "C {seq}");
            }
            Self::Set { seq, position, velocity } => {
                let _ = write!(out, "S {seq}");
                numbers(out, position);
                numbers(out, velocity);
            }
            Self::Answer { seq, ready, position } => {
                let _ = write!(out, "A {seq} {}", if *ready { 'R' } else { 'W' });
                numbers(out, position);
            }
        }
        let sum = sum(&out[start..]);
        let _ = writeln!(out, "*{sum:02X}");
    }

    /// Reads a line without its line feed; none when anything about it is wrong.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let bytes = bytes.strip_suffix(b"\r").unwrap_or(bytes);
        let star = bytes.len().checked_sub(3)?;
        let (body, tail) = bytes.split_at(star);
        let digits = std::str::from_utf8(tail.strip_prefix(b"*")?).ok()?;
        if u8::from_str_radix(digits, 16).ok()? != sum(body) {
            return None;
        }
        let mut words = std::str::from_utf8(body).ok()?.split(' ');
        let kind = words.next()?;
        let seq = words.next()?.parse::<u32>().ok().filter(|seq| *seq < SEQ_END)?;
        let vector = |words: &mut std::str::Split<'_, char>| -> Option<JointVector> {
            let mut out = JointVector::zeros();
            for k in 0..JOINTS {
                out[k] = words.next()?.parse::<i64>().ok().filter(|v| v.unsigned_abs() <= 9_000_000_000)? as f64 * 1e-6;
            }
            Some(out)
        };
        let line = match kind {
            "H" => Self::Hello { seq },
            "C" => Self::Clear { seq },
            "S" => Self::Set { seq, position: vector(&mut words)?, velocity: vector(&mut words)? },
            "A" => {
                let ready = match words.next()? {
                    "R" => true,
                    "W" => false,
                    _ => return None,
                };
                Self::Answer { seq, ready, position: vector(&mut words)? }
            }
            _ => return None,
        };
        words.next().is_none().then_some(line)
    }
}

/// Splits a stream of bytes into lines.
#[derive(Debug, Default)]
pub struct Reader {
    held: Vec<u8>,
    overflown: bool,
}

impl Reader {
    /// Takes bytes and calls `each` with every line, none for an invalid one.
    pub fn take(&mut self, bytes: &[u8], mut each: impl FnMut(Option<Line>)) {
        for &byte in bytes {
            if byte == b'\n' {
                let line = if self.overflown { None } else { Line::read(&self.held) };
                self.held.clear();
                self.overflown = false;
                each(line);
            } else if self.held.len() < LONGEST {
                self.held.push(byte);
            } else if !self.overflown {
                // Reported once, as soon as this cannot be a line.
                self.overflown = true;
                each(None);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::Dice;

    fn vector(dice: &mut Dice) -> JointVector {
        JointVector::from_fn(|_, _| ((dice.unit() - 0.5) * 6e6).round() * 1e-6)
    }

    #[test]
    fn lines_come_back_as_they_were_sent() {
        let mut dice = Dice::new(3);
        for seq in 0..200 {
            let (position, velocity) = (vector(&mut dice), vector(&mut dice));
            for line in [
                Line::Hello { seq },
                Line::Clear { seq },
                Line::Set { seq, position, velocity },
                Line::Answer { seq, ready: seq % 2 == 0, position },
            ] {
                let mut bytes = Vec::new();
                line.write(&mut bytes);
                assert!(bytes.len() <= LONGEST && bytes.is_ascii());
                let (mut reader, mut seen) = (Reader::default(), Vec::new());
                // In two pieces, as serial lines deliver them.
                let (a, b) = bytes.split_at(dice.of(bytes.len() as u64) as usize);
                reader.take(a, |line| seen.push(line));
                reader.take(b, |line| seen.push(line));
                let [Some(back)] = seen.as_slice() else { panic!("{seen:?}") };
                let text = |line: &Line| {
                    let mut bytes = Vec::new();
                    line.write(&mut bytes);
                    bytes
                };
                assert_eq!(text(back), bytes);
            }
        }
    }

    #[test]
    fn numbers_beyond_the_range_are_no_line() {
        let line = |number: i64| {
            let body = format!("A 7 R {number} 0 0 0 0 0");
            Line::read(format!("{body}*{:02X}", sum(body.as_bytes())).as_bytes())
        };
        for number in [i64::MIN, i64::MIN + 1, -9_000_000_001, 9_000_000_001, i64::MAX] {
            assert!(line(number).is_none(), "{number}");
        }
        assert!(line(-9_000_000_000).is_some());
    }

    #[test]
    fn a_flipped_bit_is_seen_and_garbage_is_no_line() {
        let mut bytes = Vec::new();
        Line::Answer { seq: 7, ready: true, position: JointVector::from_element(0.25) }.write(&mut bytes);
        bytes.pop();
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut bad = bytes.clone();
                bad[at] ^= 1 << bit;
                // A digit of the sum may change its case.
                let same = bad.eq_ignore_ascii_case(&bytes) && at >= bytes.len() - 2;
                assert_eq!(Line::read(&bad).is_some(), same, "{}", String::from_utf8_lossy(&bad));
            }
        }
        let mut dice = Dice::new(9);
        let mut reader = Reader::default();
        let mut sound = 0;
        for _ in 0..2000 {
            let noise: Vec<u8> = (0..dice.of(400)).map(|_| dice.bits() as u8).collect();
            reader.take(&noise, |line| sound += u32::from(line.is_some()));
        }
        assert_eq!(sound, 0);
        assert!(reader.held.len() <= LONGEST);
    }
}
