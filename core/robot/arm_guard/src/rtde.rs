//! Packages of Universal Robots' Real-Time Data Exchange (RTDE), protocol version 2, as its guide documents them.
//!
//! A package is its size (16 bits, these three bytes included), its type (a letter), and a payload. All numbers are
//! big-endian. The client asks for a protocol version, names the fields it wants to read ([`OUTPUTS`]) and to write
//! ([`INPUTS`]), and starts the exchange. Data packages then go both ways without request and response: [`crate::ur`]
//! matches them by a heartbeat.

use panoscope_arm_core::{JOINTS, JointVector};

/// Version of the protocol.
pub const VERSION: u16 = 2;
/// Length of size and type, bytes.
const HEADER: usize = 3;
/// Longest package that is accepted, bytes; RTDE's longest is a list of names, 2048 bytes.
pub const MAX_LEN: usize = 4096;

/// Outputs of the controller: names and types.
pub const OUTPUTS: [(&str, &str); 11] = [
    ("timestamp", "DOUBLE"),
    ("actual_q", "VECTOR6D"),
    ("actual_qd", "VECTOR6D"),
    ("robot_mode", "INT32"),
    ("safety_status_bits", "UINT32"),
    ("runtime_state", "UINT32"),
    ("output_int_register_24", "INT32"),
    ("output_int_register_25", "INT32"),
    ("output_int_register_26", "INT32"),
    ("output_int_register_27", "INT32"),
    ("output_int_register_28", "INT32"),
];
/// Inputs written by the guard: names and types. Registers from 24 are for external clients.
pub const INPUTS: [(&str, &str); 9] = [
    ("input_double_register_24", "DOUBLE"),
    ("input_double_register_25", "DOUBLE"),
    ("input_double_register_26", "DOUBLE"),
    ("input_double_register_27", "DOUBLE"),
    ("input_double_register_28", "DOUBLE"),
    ("input_double_register_29", "DOUBLE"),
    ("input_int_register_24", "INT32"),
    ("input_int_register_25", "INT32"),
    ("input_int_register_26", "INT32"),
];

/// Types of packages that this client sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// Requests a protocol version.
    ProtocolVersion = b'V',
    /// Requests the version of the controller's software.
    ControllerVersion = b'v',
    /// Names outputs.
    Outputs = b'O',
    /// Names inputs.
    Inputs = b'I',
    /// Starts the exchange.
    Start = b'S',
    /// Values of the inputs.
    Data = b'U',
}

/// A package of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Package<'a> {
    /// Whether it speaks the requested version of the protocol.
    ProtocolVersion(bool),
    /// Version of its software: major, minor, bug fix, build.
    ControllerVersion([u32; 4]),
    /// A message for the user.
    Text(&'a [u8]),
    /// Number of the outputs' recipe, and their types, separated by commas.
    Outputs(u8, &'a str),
    /// Number of the inputs' recipe, and their types, separated by commas.
    Inputs(u8, &'a str),
    /// Whether the exchange started.
    Started(bool),
    /// Whether the exchange pauses.
    Paused(bool),
    /// Number of a recipe, and its values.
    Data(u8, &'a [u8]),
}

/// Result of splitting the received bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Received<'a> {
    /// A valid package.
    Package(Package<'a>),
    /// A package of an unknown type, or with a wrong length.
    Damaged,
    /// No package starts here; the rest of the stream cannot be parsed.
    Broken,
}

/// Takes numbers from the front of a payload.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    fn u8(&mut self) -> Option<u8> {
        Some(u8::from_be_bytes(self.bytes()?))
    }

    fn u32(&mut self) -> Option<u32> {
        Some(u32::from_be_bytes(self.bytes()?))
    }

    fn i32(&mut self) -> Option<i32> {
        Some(i32::from_be_bytes(self.bytes()?))
    }

    fn f64(&mut self) -> Option<f64> {
        Some(f64::from_be_bytes(self.bytes()?))
    }

    fn flag(&mut self) -> Option<bool> {
        match self.u8()? {
            0 => Some(false),
            1 => Some(true),
            _ => None,
        }
    }

    fn vector(&mut self) -> Option<JointVector> {
        let mut out = JointVector::zeros();
        for k in 0..JOINTS {
            out[k] = self.f64()?;
        }
        Some(out)
    }

    /// Bytes after a length of one byte.
    fn counted(&mut self) -> Option<&'a [u8]> {
        let length = usize::from(self.u8()?);
        let (text, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(text)
    }

    fn end(&self) -> Option<()> {
        self.0.is_empty().then_some(())
    }
}

impl<'a> Package<'a> {
    /// Reads a package without size and type; `None` when its type is unknown or its length is wrong.
    pub fn read(kind: u8, payload: &'a [u8]) -> Option<Self> {
        let mut f = Fields(payload);
        let package = match kind {
            b'V' => Self::ProtocolVersion(f.flag()?),
            b'v' => Self::ControllerVersion([f.u32()?, f.u32()?, f.u32()?, f.u32()?]),
            b'M' => {
                let text = f.counted()?;
                let _source = f.counted()?;
                let _level = f.u8()?;
                Self::Text(text)
            }
            b'O' | b'I' => {
                let recipe = f.u8()?;
                let types = std::str::from_utf8(std::mem::take(&mut f.0)).ok()?;
                if kind == b'O' { Self::Outputs(recipe, types) } else { Self::Inputs(recipe, types) }
            }
            b'S' => Self::Started(f.flag()?),
            b'P' => Self::Paused(f.flag()?),
            b'U' => {
                let recipe = f.u8()?;
                Self::Data(recipe, std::mem::take(&mut f.0))
            }
            _ => return None,
        };
        f.end()?;
        Some(package)
    }
}

/// Appends a package.
pub fn write(out: &mut Vec<u8>, kind: Kind, payload: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    out.extend([0, 0, kind as u8]);
    payload(out);
    // Payloads are far shorter: `packages_fit` checks the longest.
    let size = u16::try_from(out.len() - start).unwrap_or(u16::MAX);
    out[start..start + 2].copy_from_slice(&size.to_be_bytes());
}

/// Names of a recipe, separated by commas.
pub fn names(fields: &[(&str, &str)]) -> String {
    fields.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(",")
}

/// Splits a stream of bytes into packages.
#[derive(Debug, Default)]
pub struct Reader {
    held: Vec<u8>,
    is_broken: bool,
}

impl Reader {
    /// A reader with room for the longest package, so that nothing is allocated later.
    pub fn new() -> Self {
        Self { held: Vec::with_capacity(MAX_LEN), is_broken: false }
    }

    /// Adds bytes and calls `each` with every complete package.
    pub fn take(&mut self, mut bytes: &[u8], mut each: impl FnMut(Received<'_>)) {
        while !self.is_broken && !bytes.is_empty() {
            let wanted = self.size().unwrap_or(HEADER).max(HEADER) - self.held.len();
            let (part, rest) = bytes.split_at(wanted.min(bytes.len()));
            self.held.extend_from_slice(part);
            bytes = rest;
            match self.size() {
                Some(size) if !(HEADER..=MAX_LEN).contains(&size) => {
                    self.is_broken = true;
                    each(Received::Broken);
                }
                Some(size) if size == self.held.len() => {
                    let package = Package::read(self.held[2], &self.held[HEADER..]);
                    each(package.map_or(Received::Damaged, Received::Package));
                    self.held.clear();
                }
                _ => {}
            }
        }
    }

    /// Size of the package whose first bytes are held, as soon as its header is complete.
    fn size(&self) -> Option<usize> {
        let header = self.held.get(..HEADER)?;
        Some(usize::from(u16::from_be_bytes([header[0], header[1]])))
    }
}

/// The arm as a data package reports it; the fields of [`OUTPUTS`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Time since the controller started, s.
    pub timestamp_s: f64,
    /// Encoder angles, rad.
    pub angles: JointVector,
    /// Measured speeds, rad/s.
    pub speeds: JointVector,
    /// Mode of the robot; 7: switched on, brakes released.
    pub robot_mode: i32,
    /// Safety status bits. Bit 0: normal; bit 1: reduced; the others are stops and faults.
    pub safety_bits: u32,
    /// State of the controller; 2: a program runs.
    pub runtime_state: u32,
    /// The newest heartbeat that the robot's program accepted.
    pub beat: i32,
    /// State of the robot's program.
    pub program_state: i32,
    /// Reason for which the robot's program stopped.
    pub reason: i32,
    /// Version of the robot's program.
    pub program_version: i32,
    /// Time limit of its heartbeat, ms.
    pub watchdog_ms: i32,
}

impl State {
    /// Reads the values of a data package; `None` for another length.
    pub fn read(values: &[u8]) -> Option<Self> {
        let mut f = Fields(values);
        let state = Self {
            timestamp_s: f.f64()?,
            angles: f.vector()?,
            speeds: f.vector()?,
            robot_mode: f.i32()?,
            safety_bits: f.u32()?,
            runtime_state: f.u32()?,
            beat: f.i32()?,
            program_state: f.i32()?,
            reason: f.i32()?,
            program_version: f.i32()?,
            watchdog_ms: f.i32()?,
        };
        f.end()?;
        Some(state)
    }
}

/// Command to the robot's program in a data package.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum Command {
    /// Stay where it is.
    Hold = 0,
    /// Follow the targets.
    Follow = 1,
    /// Clear the program's own stop, after a person's reset.
    Release = 2,
}

/// The check sum that `panoscope_arm.script` compares.
pub fn check_sum(beat: i32, command: Command, targets: &JointVector) -> i32 {
    let micro = |k: usize| (targets[k] * 1e6 + 0.5).floor() as i32;
    let weighted = (0..JOINTS).fold(0_i32, |sum, k| sum.wrapping_add(micro(k).wrapping_mul(k as i32 + 1)));
    weighted.wrapping_add(100 * beat).wrapping_add(1000 * command as i32)
}

/// Appends a data package with the fields of [`INPUTS`].
pub fn write_inputs(out: &mut Vec<u8>, recipe: u8, beat: i32, command: Command, targets: &JointVector) {
    write(out, Kind::Data, |out| {
        out.push(recipe);
        targets.iter().for_each(|target| out.extend(target.to_be_bytes()));
        for value in [beat, command as i32, check_sum(beat, command, targets)] {
            out.extend(value.to_be_bytes());
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_arm_core::campaign::Random;

    fn package(kind: u8, payload: &[u8]) -> Vec<u8> {
        let size = (payload.len() + HEADER) as u16;
        [&size.to_be_bytes()[..], &[kind], payload].concat()
    }

    fn state_bytes() -> Vec<u8> {
        let mut bytes = Vec::new();
        (0..13).for_each(|k| bytes.extend((f64::from(k) * 0.5).to_be_bytes()));
        [7, 1, 2, 41, 3, 0, 1, 30].iter().for_each(|value: &i32| bytes.extend(value.to_be_bytes()));
        bytes
    }

    /// Every package of `bytes`, cut at random.
    fn received(bytes: &[u8], random: &mut Random) -> Vec<String> {
        let (mut reader, mut out, mut rest) = (Reader::new(), Vec::new(), bytes);
        while !rest.is_empty() {
            let (part, later) = rest.split_at(1 + random.of(rest.len() as u64) as usize);
            reader.take(part, |it| out.push(format!("{it:?}")));
            rest = later;
        }
        out
    }

    #[test]
    fn packages_are_found_however_they_are_cut() {
        let mut random = Random::new(5);
        let text = b"\x05hello\x03urc\x02";
        let data = [&[1_u8][..], &state_bytes()].concat();
        let packages = [
            (b'V', vec![1]),
            (b'v', [0, 0, 0, 5, 0, 0, 0, 12, 0, 0, 0, 0, 0, 1, 0, 0].to_vec()),
            (b'M', text.to_vec()),
            (b'O', b"\x01DOUBLE,INT32".to_vec()),
            (b'I', b"\x02IN_USE".to_vec()),
            (b'S', vec![1]),
            (b'P', vec![0]),
            (b'U', data),
        ];
        let stream: Vec<u8> = packages.iter().flat_map(|(kind, payload)| package(*kind, payload)).collect();
        let expected: Vec<String> = packages
            .iter()
            .map(|(kind, payload)| format!("{:?}", Received::Package(Package::read(*kind, payload).expect("valid"))))
            .collect();
        for _ in 0..200 {
            assert_eq!(received(&stream, &mut random), expected);
        }
        assert_eq!(Package::read(b'M', text), Some(Package::Text(b"hello")));
        assert_eq!(Package::read(b'I', b"\x02IN_USE"), Some(Package::Inputs(2, "IN_USE")));
    }

    #[test]
    fn wrong_lengths_and_types_are_damage() {
        for (kind, payload) in [
            (b'V', &b""[..]),
            (b'V', b"\x02"),
            (b'V', b"\x01\x01"),
            (b'v', b"\x00\x00\x00\x05"),
            (b'M', b"\xffhello\x01x\x01"),
            (b'M', b"\x01x\x01y\x01\x01"),
            (b'O', b""),
            (b'O', b"\x01\xff\xfe"),
            (b'U', b""),
            (b'X', b"\x01"),
        ] {
            assert_eq!(Package::read(kind, payload), None, "{} {payload:?}", kind as char);
            let mut random = Random::new(1);
            // The next package is read all the same.
            let stream = [package(kind, payload), package(b'S', &[1])].concat();
            assert_eq!(received(&stream, &mut random), ["Damaged", "Package(Started(true))"]);
        }
    }

    #[test]
    fn a_size_that_cannot_be_ends_the_stream() {
        for start in [[0, 0, b'U'], [0, 2, b'V'], [0x10, 0x01, b'U'], [0xff, 0xff, b'U']] {
            let stream = [&start[..], &package(b'S', &[1])].concat();
            assert_eq!(received(&stream, &mut Random::new(2)), ["Broken"], "{start:?}");
        }
    }

    #[test]
    fn noise_is_read_without_harm() {
        let mut random = Random::new(7);
        for _ in 0..3000 {
            let noise: Vec<u8> = (0..random.of(300)).map(|_| random.bits() as u8).collect();
            received(&noise, &mut random);
        }
    }

    #[test]
    fn a_state_has_its_length() {
        let bytes = state_bytes();
        let state = State::read(&bytes).expect("a state");
        assert_eq!((state.timestamp_s, state.angles[0], state.speeds[5]), (0.0, 0.5, 6.0));
        assert_eq!((state.robot_mode, state.safety_bits, state.runtime_state), (7, 1, 2));
        assert_eq!((state.beat, state.program_state, state.reason), (41, 3, 0));
        assert_eq!((state.program_version, state.watchdog_ms), (1, 30));
        assert_eq!(State::read(&bytes[1..]), None);
        assert_eq!(State::read(&[&bytes[..], &[0]].concat()), None);
        let size: usize = OUTPUTS
            .iter()
            .map(|(_, kind)| {
                if *kind == "VECTOR6D" {
                    48
                } else if *kind == "DOUBLE" {
                    8
                } else {
                    4
                }
            })
            .sum();
        assert_eq!(bytes.len(), size, "the names ask for what is read");
    }

    #[test]
    fn packages_fit() {
        for fields in [names(&OUTPUTS), names(&INPUTS)] {
            assert!(fields.len() < 2048, "RTDE's limit");
        }
        let mut out = Vec::new();
        let targets = JointVector::from_fn(|k, _| k as f64 - 2.5);
        write_inputs(&mut out, 3, 999_999, Command::Follow, &targets);
        assert_eq!(out.len(), HEADER + 1 + 6 * 8 + 3 * 4);
        assert_eq!(&out[..4], &[0, 64, b'U', 3]);
        assert_eq!(f64::from_be_bytes(out[4..12].try_into().expect("eight bytes")), -2.5);
    }

    #[test]
    fn every_change_of_a_package_changes_its_check_sum() {
        let mut random = Random::new(13);
        for _ in 0..2000 {
            let mut targets = JointVector::from_fn(|_, _| (random.unit() - 0.5) * 12.0);
            let beat = random.of(1_000_000) as i32;
            let sum = check_sum(beat, Command::Follow, &targets);
            assert!((sum - check_sum((beat + 1) % 1_000_000, Command::Follow, &targets)).abs() > 42);
            assert!((sum - check_sum(beat, Command::Hold, &targets)).abs() > 42);
            targets[random.of(6) as usize] += 5e-5 * if random.of(2) == 0 { 1.0 } else { -1.0 };
            assert!((sum - check_sum(beat, Command::Follow, &targets)).abs() > 42, "more than rounding explains");
        }
    }
}
