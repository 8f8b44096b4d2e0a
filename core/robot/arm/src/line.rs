//! The line protocol between a driver and an arm's controller, version 2.
//!
//! Lines of ASCII end with a line feed. Each ends with `*` and eight upper-case hexadecimal digits: the CRC-32 (IEEE
//! 802.3, as in zlib) of all bytes before the `*`. Angles are whole microradians, speeds whole microradians per second,
//! in the order of the joints from the base. `SEQ` counts the driver's lines from 0 to 999999 and wraps to 0.
//!
//! | line | from | meaning |
//! |---|---|---|
//! | `H SEQ VERSION*CRC` | driver | asks for version and serial number; moves nothing, clears nothing |
//! | `I SEQ VERSION SERIAL WATCHDOG_MS*CRC` | arm | answer to `H`; SERIAL: 1 to 32 letters, digits, `-` |
//! | `Q SEQ*CRC` | driver | asks for the state; moves nothing, clears nothing |
//! | `S SEQ P1 P2 P3 P4 P5 P6 V1 V2 V3 V4 V5 V6*CRC` | driver | set-point: angles and speeds; every 10 ms while anything moves |
//! | `C SEQ*CRC` | driver | clears the arm's own stop, after a person's reset |
//! | `A SEQ STATE P1 P2 P3 P4 P5 P6*CRC` | arm | answer to `Q`, `S` and `C` with their `SEQ`: state and encoder angles |
//!
//! STATE is `R` (ready), `W` (stopped by its watchdog), `E` (hardware stop pressed) or `F` (fault of the hardware). The
//! arm has its own watchdog: while it moves and no valid `S` line arrives for 30 ms, it brakes, holds, and answers `W`
//! until `C`. It ignores lines with a wrong CRC and lines that it does not know. So the arm stops when the driver, the
//! program or the cable fails.
//!
//! Version 1 had an exclusive-or of 8 bits, which accepts every 15th line that lost two bytes.
//! [`Received::OlderProtocol`] detects it.

use crate::chain::{JOINTS, JointVector};

/// Version of the protocol.
pub const VERSION: u32 = 2;
/// Longest line, bytes; more bytes without a line feed are garbage.
pub const MAX_LEN: usize = 256;
/// Line numbers wrap to 0 at this value.
pub const SEQ_END: u32 = 1_000_000;
/// Length of a CRC in a line: `*` and its digits.
const TAIL: usize = 9;
/// Maximum angle or speed of a line, in millionths.
const MAX_MICRO: i64 = 9_000_000_000;

/// Serial number of a device: 1 to 32 letters, digits and `-`.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
pub struct Serial {
    bytes: [u8; Self::MAX_LEN],
    len: u8,
}

impl Serial {
    /// Longest serial number, bytes.
    pub const MAX_LEN: usize = 32;

    /// Reads a serial number; `None` for an empty or longer text, or other characters.
    pub fn new(text: &str) -> Option<Self> {
        let ok = |b: u8| b.is_ascii_alphanumeric() || b == b'-';
        if text.is_empty() || text.len() > Self::MAX_LEN || !text.bytes().all(ok) {
            return None;
        }
        let mut bytes = [0; Self::MAX_LEN];
        bytes[..text.len()].copy_from_slice(text.as_bytes());
        Some(Self { bytes, len: text.len() as u8 })
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        std::str::from_utf8(&self.bytes[..usize::from(self.len)]).unwrap_or_default()
    }
}

impl std::fmt::Debug for Serial {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// State of the arm's controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceState {
    /// Follows set-points.
    Ready,
    /// Stopped by its own watchdog.
    Watchdog,
    /// The hardware stop is pressed.
    HardwareStop,
    /// The hardware reports a fault.
    Fault,
}

impl DeviceState {
    /// All states with their letters.
    const LETTERS: [(Self, char); 4] =
        [(Self::Ready, 'R'), (Self::Watchdog, 'W'), (Self::HardwareStop, 'E'), (Self::Fault, 'F')];

    fn letter(self) -> char {
        Self::LETTERS.iter().find(|(state, _)| *state == self).map_or('F', |(_, letter)| *letter)
    }

    fn of(word: &str) -> Option<Self> {
        Self::LETTERS.iter().find(|(_, letter)| word.len() == 1 && word.starts_with(*letter)).map(|(state, _)| *state)
    }
}

/// One line of the protocol. `seq` is the number of the driver's line; an answer carries the number of the line that it
/// answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Line {
    /// `H`.
    Hello {
        /// Number of the line.
        seq: u32,
        /// Version that the driver speaks.
        version: u32,
    },
    /// `I`.
    Identity {
        /// Number of the answered line.
        seq: u32,
        /// Version that the arm speaks.
        version: u32,
        /// Serial number.
        serial: Serial,
        /// Time limit of the arm's own watchdog, ms.
        watchdog_ms: u32,
    },
    /// `Q`.
    Query {
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
        /// Number of the answered line.
        seq: u32,
        /// State of the controller.
        state: DeviceState,
        /// Joint angles, rad.
        position: JointVector,
    },
}

/// A number in whole millionths, clamped to the range of the protocol; NaN becomes 0.
fn micro(value: f64) -> i64 {
    (value * 1e6).round().clamp(-(MAX_MICRO as f64), MAX_MICRO as f64) as i64
}

impl Line {
    /// Appends the line, with its CRC and line feed.
    pub fn write(&self, out: &mut Vec<u8>) {
        use std::io::Write;
        let start = out.len();
        // Writing to memory does not fail.
        let numbers = |out: &mut Vec<u8>, values: &JointVector| {
            values.iter().for_each(|v| {
                let _ = write!(out, " {}", micro(*v));
            });
        };
        let _ = match self {
            Self::Hello { seq, version } => write!(out, "H {seq} {version}"),
            Self::Identity { seq, version, serial, watchdog_ms } => {
                write!(out, "I {seq} {version} {} {watchdog_ms}", serial.as_str())
            }
            Self::Query { seq } => write!(out, "Q {seq}"),
            Self::Clear { seq } => write!(out, "C {seq}"),
            Self::Set { seq, .. } => write!(out, "S {seq}"),
            Self::Answer { seq, state, .. } => write!(out, "A {seq} {}", state.letter()),
        };
        match self {
            Self::Set { position, velocity, .. } => {
                numbers(out, position);
                numbers(out, velocity);
            }
            Self::Answer { position, .. } => numbers(out, position),
            _ => {}
        }
        let crc = crc32fast::hash(&out[start..]);
        let _ = writeln!(out, "*{crc:08X}");
    }

    /// Reads a line without its line feed; `None` when anything in it is wrong.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let bytes = bytes.strip_suffix(b"\r").unwrap_or(bytes);
        let (body, tail) = bytes.split_at(bytes.len().checked_sub(TAIL)?);
        let digits = std::str::from_utf8(tail.strip_prefix(b"*")?).ok()?;
        let is_hex = digits.bytes().all(|b| b.is_ascii_digit() || (b'A'..=b'F').contains(&b));
        if !is_hex || u32::from_str_radix(digits, 16).ok()? != crc32fast::hash(body) {
            return None;
        }
        let mut words = std::str::from_utf8(body).ok()?.split(' ');
        let kind = words.next()?;
        let seq = number(words.next()?, SEQ_END - 1)?;
        let line = match kind {
            "H" => Self::Hello { seq, version: number(words.next()?, u32::MAX)? },
            "I" => Self::Identity {
                seq,
                version: number(words.next()?, u32::MAX)?,
                serial: Serial::new(words.next()?)?,
                watchdog_ms: number(words.next()?, u32::MAX)?,
            },
            "Q" => Self::Query { seq },
            "C" => Self::Clear { seq },
            "S" => Self::Set { seq, position: vector(&mut words)?, velocity: vector(&mut words)? },
            "A" => Self::Answer { seq, state: DeviceState::of(words.next()?)?, position: vector(&mut words)? },
            _ => return None,
        };
        words.next().is_none().then_some(line)
    }
}

/// A whole number without sign, spaces or superfluous zeros.
fn number(word: &str, largest: u32) -> Option<u32> {
    let is_plain = word.bytes().all(|b| b.is_ascii_digit()) && (word == "0" || !word.starts_with('0'));
    word.parse().ok().filter(|n| is_plain && *n <= largest)
}

/// Six numbers in millionths.
fn vector(words: &mut std::str::Split<'_, char>) -> Option<JointVector> {
    let mut out = JointVector::zeros();
    for k in 0..JOINTS {
        let micro = words.next()?.parse::<i64>().ok()?;
        out[k] = (-MAX_MICRO..=MAX_MICRO).contains(&micro).then_some(micro as f64 * 1e-6)?;
    }
    Some(out)
}

/// Whether a line is an answer in version 1 of the protocol: `A SEQ STATE P1..P6*CC`.
fn is_version_1(bytes: &[u8]) -> bool {
    let bytes = bytes.strip_suffix(b"\r").unwrap_or(bytes);
    let Some((body, tail)) = bytes.len().checked_sub(3).map(|at| bytes.split_at(at)) else { return false };
    let sum = body.iter().fold(0_u8, |sum, byte| sum ^ byte);
    // Compared digit by digit: damaged lines arrive while the arm moves, where nothing may be allocated.
    let digit = |value: u8| b"0123456789ABCDEF"[usize::from(value & 15)];
    body.starts_with(b"A ")
        && body.iter().filter(|byte| **byte == b' ').count() == JOINTS + 2
        && tail == [b'*', digit(sum >> 4), digit(sum)]
}

/// The question of version 1 that moves nothing, to find out why an arm does not answer.
pub const HELLO_VERSION_1: &[u8] = b"H 1*59\n";

/// A line that has arrived.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Received {
    /// A valid line.
    Line(Line),
    /// A valid answer in version 1 of the protocol.
    OlderProtocol,
    /// Anything else: a damaged line, noise, or more than [`MAX_LEN`] bytes without a line feed.
    Damaged,
}

/// Splits a stream of bytes into lines.
#[derive(Debug, Default)]
pub struct Reader {
    held: Vec<u8>,
    overflown: bool,
}

impl Reader {
    /// Adds bytes and calls `each` with every line. Allocates nothing after the first [`MAX_LEN`] bytes.
    pub fn take(&mut self, bytes: &[u8], mut each: impl FnMut(Received)) {
        self.held.reserve(MAX_LEN.saturating_sub(self.held.len()));
        for &byte in bytes {
            if byte == b'\n' {
                if !self.overflown {
                    each(match Line::read(&self.held) {
                        Some(line) => Received::Line(line),
                        None if is_version_1(&self.held) => Received::OlderProtocol,
                        None => Received::Damaged,
                    });
                }
                self.held.clear();
                self.overflown = false;
            } else if self.held.len() < MAX_LEN {
                self.held.push(byte);
            } else if !self.overflown {
                // Reported once, as soon as this cannot be a line.
                self.overflown = true;
                each(Received::Damaged);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::Random;

    fn vector(random: &mut Random) -> JointVector {
        JointVector::from_fn(|_, _| ((random.unit() - 0.5) * 6e6).round() * 1e-6)
    }

    fn any(random: &mut Random, seq: u32) -> Line {
        let serial = Serial::new("CAM6-0042").expect("letters, digits and -");
        match random.of(6) {
            0 => Line::Hello { seq, version: VERSION },
            1 => Line::Identity { seq, version: VERSION, serial, watchdog_ms: 30 },
            2 => Line::Query { seq },
            3 => Line::Clear { seq },
            4 => Line::Set { seq, position: vector(random), velocity: vector(random) },
            _ => {
                let (state, _) = DeviceState::LETTERS[random.of(4) as usize];
                Line::Answer { seq, state, position: vector(random) }
            }
        }
    }

    fn text(line: &Line) -> Vec<u8> {
        let mut bytes = Vec::new();
        line.write(&mut bytes);
        bytes
    }

    #[test]
    fn lines_come_back_as_they_were_sent() {
        let mut random = Random::new(3);
        for seq in 0..600 {
            let line = any(&mut random, seq);
            let bytes = text(&line);
            assert!(bytes.len() <= MAX_LEN && bytes.is_ascii());
            let (mut reader, mut received) = (Reader::default(), Vec::new());
            // In two pieces, as serial lines deliver them.
            let (a, b) = bytes.split_at(random.of(bytes.len() as u64) as usize);
            reader.take(a, |line| received.push(line));
            reader.take(b, |line| received.push(line));
            let [Received::Line(back)] = received.as_slice() else { panic!("{received:?}") };
            assert_eq!(text(back), bytes);
        }
    }

    #[test]
    fn damaged_lines_are_not_accepted() {
        // Flipped, lost, doubled and inserted bytes, one to four of them, in all combinations. PANOSCOPE_LINE_CASES sets the number.
        let cases = std::env::var("PANOSCOPE_LINE_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(200_000_u64);
        let mut random = Random::new(11);
        let (mut undetected, mut unchanged) = (0, 0);
        for case in 0..cases {
            let line = any(&mut random, (case % u64::from(SEQ_END)) as u32);
            let sent = text(&line);
            let mut bytes = sent[..sent.len() - 1].to_vec();
            for _ in 0..=random.of(4) {
                let at = random.of(bytes.len() as u64) as usize;
                match random.of(5) {
                    0 => bytes[at] ^= 1 << random.of(8),
                    1 => bytes[at] = b"0123456789 -*ASHIQCRWEF"[random.of(23) as usize],
                    2 if bytes.len() > 1 => drop(bytes.remove(at)),
                    3 => bytes.insert(at, bytes[at]),
                    _ => bytes.insert(at, random.bits() as u8),
                }
            }
            if bytes == sent[..sent.len() - 1]
                || bytes.strip_suffix(b"\r").is_some_and(|b| *b == sent[..sent.len() - 1])
            {
                unchanged += 1;
            } else if Line::read(&bytes).is_some() {
                undetected += 1;
            }
        }
        println!("undetected_line_errors {undetected} of {} damaged lines", cases - unchanged);
        assert_eq!(undetected, 0, "of {} damaged lines", cases - unchanged);
        assert!(unchanged < cases / 20);
    }

    #[test]
    fn the_worst_line_of_version_1_is_refused() {
        // Two bytes lost: an exclusive-or of all bytes does not see it.
        let set = |p: &str| format!("S 41 {p} 0 0 0 0 0 0 0 0 0 0 0");
        let xor = |text: &str| text.bytes().fold(0, |sum, byte| sum ^ byte);
        assert_eq!(xor(&set("100000")), xor(&set("1000")), "version 1 takes one for the other");
        let whole = set("100000");
        let crc = crc32fast::hash(whole.as_bytes());
        assert!(Line::read(format!("{whole}*{crc:08X}").as_bytes()).is_some());
        assert!(Line::read(format!("{}*{crc:08X}", set("1000")).as_bytes()).is_none());
    }

    #[test]
    fn numbers_out_of_range_are_refused_and_break_nothing() {
        for number in ["-9223372036854775808", "9223372036854775807", "9000000001", "99999999999999999999", "1e3", ""] {
            let body = format!("A 1 R {number} 0 0 0 0 0");
            let line = format!("{body}*{:08X}", crc32fast::hash(body.as_bytes()));
            assert_eq!(Line::read(line.as_bytes()), None, "{number}");
        }
    }

    #[test]
    fn an_older_arm_is_recognized() {
        let xor = HELLO_VERSION_1[..3].iter().fold(0, |sum, byte| sum ^ byte);
        assert_eq!(HELLO_VERSION_1, format!("H 1*{xor:02X}\n").as_bytes());
        let body = "A 1 R 0 0 0 0 0 0";
        let xor = body.bytes().fold(0, |sum, byte| sum ^ byte);
        let mut received = Vec::new();
        Reader::default().take(format!("{body}*{xor:02X}\n").as_bytes(), |line| received.push(line));
        assert_eq!(received, [Received::OlderProtocol]);
    }

    #[test]
    fn garbage_is_no_line() {
        let mut random = Random::new(9);
        let mut reader = Reader::default();
        let mut valid = 0;
        for _ in 0..2000 {
            let noise: Vec<u8> = (0..random.of(400)).map(|_| random.bits() as u8).collect();
            reader.take(&noise, |line| valid += u32::from(line != Received::Damaged));
        }
        assert_eq!(valid, 0);
        assert!(reader.held.len() <= MAX_LEN);
    }
}
