//! The serial line to an arm: numbered lines, their answers, and how old the newest answer is.

use std::path::{Path, PathBuf};
use std::time::Duration;

use panoscope_arm_core::JointVector;
use panoscope_arm_core::line::{DeviceState, HELLO_VERSION_1, Line, Reader, Received, SEQ_END, Serial, VERSION};

use crate::clock;
use crate::port::{Port, PortError};

/// Time between two lines to the arm.
pub const PERIOD: Duration = Duration::from_millis(10);
/// Time limit of the arm's first answer.
const FIRST_ANSWER: Duration = Duration::from_millis(600);
/// Time without an answer after which a question in version 1 finds out whether the arm's firmware is older.
const ASK_OLDER: Duration = Duration::from_millis(300);
/// Lines whose answers may be outstanding.
const OUTSTANDING: usize = 64;

/// How to reach the arm.
#[derive(Clone, Debug)]
pub struct Connection {
    /// The device's file.
    pub path: PathBuf,
    /// Bits per second.
    pub baud: u32,
    /// Time without an answer after which the arm is stopped.
    pub answer_within: Duration,
}

/// What the arm reports about itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Identity {
    /// Serial number.
    pub serial: Serial,
    /// Time limit of the arm's own watchdog, ms.
    pub watchdog_ms: u32,
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
    /// Encoder angles of the newest answer, rad.
    pub encoders: JointVector,
    /// State in the newest answer.
    pub state: DeviceState,
    /// When the line was sent that the newest answer belongs to, ns: an answer that was held up on its way counts as old as its question.
    pub answered_ns: i64,
    /// Damaged lines, and answers to no question, since the last valid answer.
    pub damaged: u32,
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
            encoders: JointVector::zeros(),
            state: DeviceState::Ready,
            answered_ns: i64::MIN,
            damaged: 0,
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
                && self.answered_ns >= start_ns
            {
                self.damaged = 0;
                return Ok(identity);
            }
            garbage = self.damaged;
        }
        Err(PortError::NoArm { path: path.to_owned(), wait_ms: FIRST_ANSWER.as_millis(), garbage })
    }

    /// Sends a line under the next number.
    ///
    /// # Errors
    /// The connection was lost.
    pub fn send(&mut self, line: impl FnOnce(u32) -> Line) -> Result<(), PortError> {
        self.seq = (self.seq + 1) % SEQ_END;
        self.sent[self.seq as usize % OUTSTANDING] = Sent { seq: self.seq, at_ns: clock::now_ns(), is_open: true };
        self.out.clear();
        line(self.seq).write(&mut self.out);
        self.port.write(&self.out)
    }

    /// Reads all answers that have arrived.
    ///
    /// # Errors
    /// The connection was lost.
    pub fn listen(&mut self) -> Result<(), PortError> {
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

    fn receive(&mut self, received: Received) {
        match received {
            Received::Line(Line::Answer { seq, state, position }) => {
                let Some(at_ns) = self.close(seq) else { return self.damaged = self.damaged.saturating_add(1) };
                // An answer that was overtaken says nothing new.
                if at_ns >= self.answered_ns {
                    (self.encoders, self.state, self.answered_ns, self.damaged) = (position, state, at_ns, 0);
                }
            }
            Received::Line(Line::Identity { seq, version, serial, watchdog_ms }) => {
                if self.close(seq).is_none() {
                    self.damaged = self.damaged.saturating_add(1);
                } else if version == VERSION {
                    self.identity = Some(Identity { serial, watchdog_ms });
                } else {
                    self.other_version = Some(version);
                }
            }
            Received::OlderProtocol => self.other_version = Some(1),
            Received::Line(_) | Received::Damaged => self.damaged = self.damaged.saturating_add(1),
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

    /// The arm's identity as it was last reported.
    pub fn identity(&self) -> Option<Identity> {
        self.identity
    }
}
