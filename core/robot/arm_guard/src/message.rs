//! Messages between the program and the guard: fixed-size records over a socket pair that keeps their boundaries.
//!
//! Every record ends with a CRC-32 of the bytes before it. All numbers are little-endian. A record that is not valid is
//! ignored and counted: its contents cannot be trusted, and without valid ones the arm stops.

use panoscope_arm_core::interlock::{Event, Evidence, Settings};
use panoscope_arm_core::line::Serial;
use panoscope_arm_core::{Cause, JOINTS, JointVector};

/// First bytes of a record: name and version of the format.
const MAGIC: [u8; 6] = *b"PARM\x01\x00";
/// Longest record, bytes.
pub const MAX_LEN: usize = 512;
/// Maximum number of values of a demand; a demand with another number of values than joints is refused by the
/// interlock.
pub const MAX_DEMAND: usize = 8;
/// Longest text of a failure, bytes.
const MAX_TEXT: usize = 400;

/// A request of the node, sent once per call. Times are on the system's monotonic clock, ns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Time of the node's call.
    pub sent_ns: i64,
    /// Arrival time of the light of the followed tip, and the tip's properties.
    pub tip: Option<(i64, Evidence)>,
    /// Requested joint velocities: arrival time of the light behind them, values in rad/s, and their number.
    pub demand: Option<(i64, [f64; MAX_DEMAND], u32)>,
    /// Settings of the interlock.
    pub settings: Settings,
    /// Whether the emergency stop is on.
    pub emergency_stop: bool,
    /// The operator's reset; a change releases a latched stop.
    pub reset: u64,
}

/// State of the guard and the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Status {
    /// Time of this report, ns.
    pub at_ns: i64,
    /// Joint angles by the encoders, rad.
    pub encoders: JointVector,
    /// Newest set-point: rad and rad/s.
    pub set_point: (JointVector, JointVector),
    /// Cause of the present stop.
    pub stop: Option<Cause>,
    /// Whether the stop is latched.
    pub latched: bool,
    /// Stops since the guard started.
    pub stops: u64,
    /// Age of the newest answer of the arm, ms.
    pub answer_age_ms: f64,
    /// Distance of the tube from the trocar at the set-points, mm.
    pub pivot_mm: f64,
    /// Depth of the tube behind the trocar at the set-points, mm.
    pub depth_mm: f64,
    /// Invalid requests so far.
    pub refused: u64,
}

/// A record of the guard.
#[derive(Clone, Debug, PartialEq)]
pub enum Report {
    /// The arm was found; the guard runs.
    Ready {
        /// Serial number of the arm.
        serial: Serial,
        /// Time limit of the arm's own watchdog, ms.
        watchdog_ms: u32,
        /// Whether memory is locked, and whether the loop has real-time priority.
        granted: (bool, bool),
    },
    /// The guard cannot start; the reason.
    Failed(String),
    /// The newest state.
    Status(Box<Status>),
    /// A stop, or its end.
    Event(Event),
}

/// Writes a record into a buffer.
struct Writer<'a> {
    out: &'a mut [u8; MAX_LEN],
    len: usize,
}

impl<'a> Writer<'a> {
    fn new(out: &'a mut [u8; MAX_LEN], kind: u8) -> Self {
        let mut writer = Self { out, len: 0 };
        writer.bytes(&MAGIC);
        writer.bytes(&[kind]);
        writer
    }

    fn bytes(&mut self, bytes: &[u8]) {
        // All records are shorter than the buffer; `every_record_fits` checks the longest ones.
        if let Some(out) = self.out.get_mut(self.len..self.len + bytes.len()) {
            out.copy_from_slice(bytes);
            self.len += bytes.len();
        }
    }

    fn u32(&mut self, value: u32) {
        self.bytes(&value.to_le_bytes());
    }

    fn u64(&mut self, value: u64) {
        self.bytes(&value.to_le_bytes());
    }

    fn i64(&mut self, value: i64) {
        self.bytes(&value.to_le_bytes());
    }

    fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
    }

    fn flag(&mut self, value: bool) {
        self.bytes(&[u8::from(value)]);
    }

    fn vector(&mut self, values: &JointVector) {
        values.iter().for_each(|value| self.f64(*value));
    }

    fn finish(mut self) -> &'a [u8] {
        let crc = crc32fast::hash(&self.out[..self.len]);
        self.u32(crc);
        &self.out[..self.len]
    }
}

/// Reads a record.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    /// The kind and the fields of a record with a valid magic number and CRC.
    fn of(record: &'a [u8]) -> Option<(u8, Self)> {
        let (body, crc) = record.split_at(record.len().checked_sub(4)?);
        if u32::from_le_bytes(crc.try_into().ok()?) != crc32fast::hash(body) {
            return None;
        }
        let (kind, fields) = body.strip_prefix(&MAGIC)?.split_first()?;
        Some((*kind, Self(fields)))
    }

    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_at_checked(N)?;
        self.0 = rest;
        head.try_into().ok()
    }

    fn u32(&mut self) -> Option<u32> {
        self.bytes().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.bytes().map(u64::from_le_bytes)
    }

    fn i64(&mut self) -> Option<i64> {
        self.bytes().map(i64::from_le_bytes)
    }

    fn f64(&mut self) -> Option<f64> {
        self.u64().map(f64::from_bits)
    }

    fn flag(&mut self) -> Option<bool> {
        let [byte] = self.bytes()?;
        (byte <= 1).then_some(byte == 1)
    }

    fn cause(&mut self) -> Option<Option<Cause>> {
        match self.u32()? {
            0 => Some(None),
            number => Some(Some(Cause::from_number(number as usize)?)),
        }
    }

    fn vector(&mut self) -> Option<JointVector> {
        let mut out = JointVector::zeros();
        for k in 0..JOINTS {
            out[k] = self.f64()?;
        }
        Some(out)
    }

    fn end(&self) -> Option<()> {
        self.0.is_empty().then_some(())
    }
}

const REQUEST: u8 = 1;
const READY: u8 = 2;
const FAILED: u8 = 3;
const STATUS: u8 = 4;
const EVENT: u8 = 5;

impl Request {
    /// Writes the record.
    pub fn encode<'a>(&self, out: &'a mut [u8; MAX_LEN]) -> &'a [u8] {
        let mut w = Writer::new(out, REQUEST);
        w.i64(self.sent_ns);
        w.flag(self.tip.is_some());
        let (light_ns, tip) = self.tip.unwrap_or((0, Evidence { score: 0.0, in_space: false }));
        w.i64(light_ns);
        w.f64(tip.score);
        w.flag(tip.in_space);
        w.flag(self.demand.is_some());
        let (light_ns, values, count) = self.demand.unwrap_or_default();
        w.i64(light_ns);
        w.u32(count);
        values.iter().for_each(|value| w.f64(*value));
        w.f64(self.settings.max_age_ms);
        w.f64(self.settings.min_score);
        w.flag(self.emergency_stop);
        w.u64(self.reset);
        w.finish()
    }

    /// Reads a record; `None` for anything else.
    pub fn decode(record: &[u8]) -> Option<Self> {
        let (REQUEST, mut f) = Fields::of(record)? else { return None };
        let sent_ns = f.i64()?;
        let has_tip = f.flag()?;
        let tip = (f.i64()?, Evidence { score: f.f64()?, in_space: f.flag()? });
        let has_demand = f.flag()?;
        let (light_ns, count) = (f.i64()?, f.u32()?);
        let mut values = [0.0; MAX_DEMAND];
        for value in &mut values {
            *value = f.f64()?;
        }
        let settings = Settings { max_age_ms: f.f64()?, min_score: f.f64()? };
        let (emergency_stop, reset) = (f.flag()?, f.u64()?);
        f.end()?;
        Some(Self {
            sent_ns,
            tip: has_tip.then_some(tip),
            demand: has_demand.then_some((light_ns, values, count)),
            settings,
            emergency_stop,
            reset,
        })
    }
}

impl Report {
    /// Writes the record.
    pub fn encode<'a>(&self, out: &'a mut [u8; MAX_LEN]) -> &'a [u8] {
        match self {
            Self::Ready { serial, watchdog_ms, granted } => {
                let mut w = Writer::new(out, READY);
                w.u32(*watchdog_ms);
                w.flag(granted.0);
                w.flag(granted.1);
                w.bytes(serial.as_str().as_bytes());
                w.finish()
            }
            Self::Failed(text) => {
                let mut w = Writer::new(out, FAILED);
                let mut end = text.len().min(MAX_TEXT);
                while !text.is_char_boundary(end) {
                    end -= 1;
                }
                w.bytes(&text.as_bytes()[..end]);
                w.finish()
            }
            Self::Status(status) => status.encode(out),
            Self::Event(event) => {
                let mut w = Writer::new(out, EVENT);
                w.i64(event.at_ns);
                w.u32(event.stop.map_or(0, |cause| cause.number() as u32));
                w.f64(event.speed_rad_s);
                w.finish()
            }
        }
    }

    /// Reads a record; `None` for anything else.
    pub fn decode(record: &[u8]) -> Option<Self> {
        let (kind, mut f) = Fields::of(record)?;
        match kind {
            READY => {
                let (watchdog_ms, granted) = (f.u32()?, (f.flag()?, f.flag()?));
                let serial = Serial::new(std::str::from_utf8(f.0).ok()?)?;
                Some(Self::Ready { serial, watchdog_ms, granted })
            }
            FAILED => Some(Self::Failed(String::from_utf8(f.0.to_vec()).ok()?)),
            STATUS => {
                let status = Status {
                    at_ns: f.i64()?,
                    encoders: f.vector()?,
                    set_point: (f.vector()?, f.vector()?),
                    stop: f.cause()?,
                    latched: f.flag()?,
                    stops: f.u64()?,
                    answer_age_ms: f.f64()?,
                    pivot_mm: f.f64()?,
                    depth_mm: f.f64()?,
                    refused: f.u64()?,
                };
                f.end()?;
                Some(Self::Status(Box::new(status)))
            }
            EVENT => {
                let event = Event { at_ns: f.i64()?, stop: f.cause()?, speed_rad_s: f.f64()? };
                f.end()?;
                Some(Self::Event(event))
            }
            _ => None,
        }
    }
}

impl Status {
    /// Writes the record.
    pub fn encode<'a>(&self, out: &'a mut [u8; MAX_LEN]) -> &'a [u8] {
        let mut w = Writer::new(out, STATUS);
        w.i64(self.at_ns);
        w.vector(&self.encoders);
        w.vector(&self.set_point.0);
        w.vector(&self.set_point.1);
        w.u32(self.stop.map_or(0, |cause| cause.number() as u32));
        w.flag(self.latched);
        w.u64(self.stops);
        w.f64(self.answer_age_ms);
        w.f64(self.pivot_mm);
        w.f64(self.depth_mm);
        w.u64(self.refused);
        w.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> Request {
        Request {
            sent_ns: 123_456_789,
            tip: Some((-5, Evidence { score: 0.75, in_space: true })),
            demand: Some((99, [0.1, -0.2, 0.3, 0.0, 1e-9, -0.4, 0.0, 0.0], 6)),
            settings: Settings { max_age_ms: 150.0, min_score: 0.3 },
            emergency_stop: false,
            reset: 7,
        }
    }

    fn status() -> Status {
        let v = |x: f64| JointVector::from_fn(|k, _| x + k as f64);
        Status {
            at_ns: i64::MAX,
            encoders: v(0.1),
            set_point: (v(0.2), v(0.3)),
            stop: Some(Cause::OldTip),
            latched: false,
            stops: 3,
            answer_age_ms: 4.5,
            pivot_mm: 0.01,
            depth_mm: 80.0,
            refused: 2,
        }
    }

    #[test]
    fn every_record_fits_and_comes_back() {
        let mut out = [0; MAX_LEN];
        let asked = request();
        assert_eq!(Request::decode(asked.encode(&mut out)), Some(asked));
        let empty = Request { tip: None, demand: None, ..asked };
        assert_eq!(Request::decode(empty.encode(&mut out)), Some(empty));
        let serial = Serial::new(&"X".repeat(Serial::MAX_LEN)).expect("a serial number");
        let event = Event { at_ns: 5, stop: None, speed_rad_s: 0.4 };
        for report in [
            Report::Ready { serial, watchdog_ms: 30, granted: (true, false) },
            Report::Failed("the arm is not there: ä".to_owned()),
            Report::Status(Box::new(status())),
            Report::Event(event),
            Report::Event(Event { stop: Some(Cause::MeasuredWorkspace), ..event }),
        ] {
            assert_eq!(Report::decode(report.encode(&mut out)), Some(report));
        }
        let long = Report::Failed("ä".repeat(1000));
        let Some(Report::Failed(text)) = Report::decode(long.encode(&mut out)) else { panic!("not read") };
        assert_eq!(text, "ä".repeat(MAX_TEXT / 2));
    }

    #[test]
    fn damaged_records_are_refused() {
        let mut out = [0; MAX_LEN];
        let sound = request().encode(&mut out).to_vec();
        for at in 0..sound.len() {
            for bit in 0..8 {
                let mut bad = sound.clone();
                bad[at] ^= 1 << bit;
                assert_eq!(Request::decode(&bad), None);
            }
            assert_eq!(Request::decode(&sound[..at]), None);
        }
        let mut longer = sound.clone();
        longer.push(0);
        assert_eq!(Request::decode(&longer), None);
        assert_eq!(Report::decode(&sound), None, "a request is no report");
    }
}
