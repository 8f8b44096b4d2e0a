//! The serial line to an arm: numbered lines, their answers, and how old the newest answer is.

use std::path::{Path, PathBuf};
use std::time::Duration;

use panoscope_arm_core::line::{DeviceState, HELLO_VERSION_1, Line, Reader, Received, SEQ_END, VERSION};
use panoscope_arm_core::{Cause, JointVector};

use crate::arm_port::{Answer, ArmPort, Identity};
use crate::clock;
use crate::port::{Port, PortError};

/// Time between two lines to the arm.
pub const PERIOD: Duration = Duration::from_millis(10);
/// Time limit of the arm's first answer.
const FIRST_ANSWER: Duration = Duration::from_millis(600);
/// Time without an answer after which a version 1 question checks for older firmware.
const ASK_OLDER: Duration = Duration::from_millis(300);
/// Maximum number of lines without an answer.
const OUTSTANDING: usize = 64;

/// Connection to the arm.
#[derive(Clone, Debug)]
pub struct Connection {
    /// The device's file.
    pub path: PathBuf,
    /// Bits per second.
    pub baud: u32,
    /// Time without an answer after which the arm is stopped.
    pub answer_within: Duration,
}

/// A line that was sent and not answered yet.
#[derive(Clone, Copy, Default)]
struct Sent {
    seq: u32,
    at_ns: i64,
    is_open: bool,
}

/// The open line and the newest answer.
pub struct ArmLink {
    port: Port,
    reader: Reader,
    seq: u32,
    sent: [Sent; OUTSTANDING],
    identity: Option<Identity>,
    other_version: Option<u32>,
    answer: Answer,
    out: Vec<u8>,
}

impl ArmLink {
    /// Opens the line and asks the arm for its identity and its angles. Moves nothing and clears no stop of the arm.
    ///
    /// # Errors
    /// The line cannot be opened or is in use, no arm answers on it, or its protocol has another version.
    pub fn open(connection: &Connection) -> Result<(Self, Identity), PortError> {
        let mut link = Self {
            port: Port::open(&connection.path, connection.baud)?,
            reader: Reader::default(),
            seq: 0,
            sent: [Sent::default(); OUTSTANDING],
            identity: None,
            other_version: None,
            answer: Answer::default(),
            out: Vec::with_capacity(256),
        };
        let identity = link.handshake(&connection.path)?;
        Ok((link, identity))
    }

    fn handshake(&mut self, path: &Path) -> Result<Identity, PortError> {
        let start_ns = clock::now_ns();
        let passed = || Duration::from_nanos((clock::now_ns() - start_ns).unsigned_abs());
        let (mut garbage, mut has_asked_older) = (0, false);
        while passed() < FIRST_ANSWER {
            self.send(|seq| Line::Hello { seq, version: VERSION })?;
            self.send(|seq| Line::Query { seq })?;
            if passed() > ASK_OLDER && !has_asked_older {
                has_asked_older = true;
                self.port.write(HELLO_VERSION_1)?;
            }
            std::thread::sleep(PERIOD);
            self.listen()?;
            if let Some(theirs) = self.other_version {
                return Err(PortError::OtherProtocol { path: path.to_owned(), theirs, ours: VERSION });
            }
            if let Some(identity) = self.identity
                && self.answer.answered_ns >= start_ns
            {
                self.answer.damaged = 0;
                return Ok(identity);
            }
            garbage = self.answer.damaged;
        }
        Err(PortError::NoArm { path: path.to_owned(), wait_ms: FIRST_ANSWER.as_millis(), garbage })
    }

    /// Sends a line under the next number.
    fn send(&mut self, line: impl FnOnce(u32) -> Line) -> Result<(), PortError> {
        self.seq = (self.seq + 1) % SEQ_END;
        self.sent[self.seq as usize % OUTSTANDING] = Sent { seq: self.seq, at_ns: clock::now_ns(), is_open: true };
        self.out.clear();
        line(self.seq).write(&mut self.out);
        self.port.write(&self.out)
    }

    fn receive(&mut self, received: Received) {
        match received {
            Received::Line(Line::Answer { seq, state, position }) => {
                let Some(at_ns) = self.close(seq) else {
                    return self.answer.damaged = self.answer.damaged.saturating_add(1);
                };
                // An answer that was overtaken says nothing new.
                if at_ns >= self.answer.answered_ns {
                    self.answer = Answer {
                        encoders: position,
                        stop: stop_of(state),
                        answered_ns: at_ns,
                        measured_ns: at_ns,
                        damaged: 0,
                    };
                }
            }
            Received::Line(Line::Identity { seq, version, serial, watchdog_ms }) => {
                if self.close(seq).is_none() {
                    self.answer.damaged = self.answer.damaged.saturating_add(1);
                } else if version == VERSION {
                    self.identity = Some(Identity { serial, watchdog_ms });
                } else {
                    self.other_version = Some(version);
                }
            }
            Received::OlderProtocol => self.other_version = Some(1),
            Received::Line(_) | Received::Damaged => self.answer.damaged = self.answer.damaged.saturating_add(1),
        }
    }

    /// Closes the line `seq`; returns when it was sent, `None` for a number that no open line has.
    fn close(&mut self, seq: u32) -> Option<i64> {
        let sent = &mut self.sent[seq as usize % OUTSTANDING];
        if sent.seq != seq || !sent.is_open {
            return None;
        }
        sent.is_open = false;
        Some(sent.at_ns)
    }
}

/// Cause for which an arm in this state does not follow.
fn stop_of(state: DeviceState) -> Option<Cause> {
    match state {
        DeviceState::Ready => None,
        DeviceState::Watchdog => Some(Cause::DeviceStopped),
        DeviceState::HardwareStop => Some(Cause::HardwareStop),
        DeviceState::Fault => Some(Cause::HardwareFault),
    }
}

impl ArmPort for ArmLink {
    fn listen(&mut self) -> Result<(), PortError> {
        let mut buffer = [0; 512];
        // Bounded, so that a device that sends without pause cannot hold this thread.
        for _ in 0..16 {
            let count = self.port.read(&mut buffer)?;
            if count == 0 {
                break;
            }
            let mut reader = std::mem::take(&mut self.reader);
            reader.take(&buffer[..count], |line| self.receive(line));
            self.reader = reader;
        }
        Ok(())
    }

    fn query(&mut self) -> Result<(), PortError> {
        self.send(|seq| Line::Query { seq })
    }

    fn set(&mut self, position: &JointVector, velocity: &JointVector) -> Result<(), PortError> {
        self.send(|seq| Line::Set { seq, position: *position, velocity: *velocity })
    }

    fn clear(&mut self) -> Result<(), PortError> {
        self.send(|seq| Line::Clear { seq })
    }

    fn answer(&self) -> &Answer {
        &self.answer
    }

    fn forgive(&mut self) {
        self.answer.damaged = 0;
    }

    fn identity(&self) -> Option<Identity> {
        self.identity
    }

    fn period(&self) -> Duration {
        PERIOD
    }
}
