//! The servers of the simulated controller: RTDE (protocol version 2) and the dashboard server's serial number.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use panoscope_arm_core::JointVector;
use panoscope_arm_core::campaign::Random;

use crate::ur_behaviour::UrBehaviour;

/// Registers of each kind.
const REGISTERS: usize = 48;
/// Maximum number of bytes that wait for a client; further packages are skipped, as by a real controller.
const MAX_WAITING: usize = 65_536;
/// Maximum length of a client's package, bytes.
const MAX_LEN: usize = 4096;

/// The registers that clients and the program share. Inputs keep their last value.
#[derive(Debug)]
pub(crate) struct Registers {
    pub input_ints: [i32; REGISTERS],
    pub input_floats: [f64; REGISTERS],
    pub output_ints: [i32; REGISTERS],
}

impl Default for Registers {
    fn default() -> Self {
        Self { input_ints: [0; REGISTERS], input_floats: [0.0; REGISTERS], output_ints: [0; REGISTERS] }
    }
}

/// State of robot, safety system and program.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Status {
    pub robot_mode: i32,
    pub safety_bits: u32,
    pub runtime_state: u32,
}

/// Data that arrived in a cycle.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Arrived {
    /// Number of data packages.
    pub data: u64,
    /// Number of connections that were closed because of invalid data.
    pub refused: u32,
}

/// A register that a client writes.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Input {
    Int(usize),
    Float(usize),
}

impl Input {
    fn of(name: &str) -> Option<Self> {
        let number = |prefix: &str| {
            let number: usize = name.strip_prefix(prefix)?.parse().ok()?;
            (number < REGISTERS).then_some(number)
        };
        number("input_int_register_").map(Self::Int).or_else(|| number("input_double_register_").map(Self::Float))
    }

    fn kind(self) -> &'static str {
        match self {
            Self::Int(_) => "INT32",
            Self::Float(_) => "DOUBLE",
        }
    }
}

/// A field that a client reads.
#[derive(Clone, Copy, Debug)]
enum Output {
    Timestamp,
    Angles,
    Speeds,
    RobotMode,
    SafetyBits,
    RuntimeState,
    Int(usize),
}

impl Output {
    fn of(name: &str) -> Option<(Self, &'static str)> {
        Some(match name {
            "timestamp" => (Self::Timestamp, "DOUBLE"),
            "actual_q" => (Self::Angles, "VECTOR6D"),
            "actual_qd" => (Self::Speeds, "VECTOR6D"),
            "robot_mode" => (Self::RobotMode, "INT32"),
            "safety_status_bits" => (Self::SafetyBits, "UINT32"),
            "runtime_state" => (Self::RuntimeState, "UINT32"),
            _ => {
                let number: usize = name.strip_prefix("output_int_register_")?.parse().ok()?;
                (number < REGISTERS).then_some((Self::Int(number), "INT32"))?
            }
        })
    }
}

struct Client {
    stream: TcpStream,
    received: Vec<u8>,
    /// Delayed bytes, with the time at which they are sent.
    waiting: VecDeque<(Instant, Vec<u8>)>,
    has_version: bool,
    outputs: Option<(f64, Vec<Output>)>,
    inputs: Vec<Vec<Input>>,
    is_started: bool,
    /// Time since the last data package, s.
    since_s: f64,
    is_closed: bool,
}

struct Dashboard {
    stream: TcpStream,
    received: Vec<u8>,
    is_closed: bool,
}

/// Both servers.
pub(crate) struct Servers {
    rtde: TcpListener,
    dashboard: TcpListener,
    serial: String,
    clients: Vec<Client>,
    dashboards: Vec<Dashboard>,
    last_s: f64,
}

fn package(kind: u8, payload: &[u8]) -> Vec<u8> {
    let size = (payload.len() + 3) as u16;
    [&size.to_be_bytes()[..], &[kind], payload].concat()
}

/// A text message of level `error`.
fn message(text: &str) -> Vec<u8> {
    let source = b"RTDE";
    let payload = [&[text.len() as u8][..], text.as_bytes(), &[source.len() as u8], source, &[1]].concat();
    package(b'M', &payload)
}

/// Flips bits of some bytes.
fn damage(bytes: &mut [u8], share: f64, random: &mut Random) {
    if share > 0.0 {
        for byte in bytes {
            if random.unit() < share {
                *byte ^= 1 << random.of(8);
            }
        }
    }
}

/// Reads received bytes; `None` when the connection has ended.
fn read(stream: &mut TcpStream, out: &mut Vec<u8>) -> Option<usize> {
    let mut buffer = [0; 4096];
    match stream.read(&mut buffer) {
        Ok(0) => None,
        Ok(count) => {
            out.extend_from_slice(&buffer[..count]);
            Some(count)
        }
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Some(0),
        Err(_) => None,
    }
}

fn accept(listener: &TcpListener) -> Option<TcpStream> {
    let (stream, _) = listener.accept().ok()?;
    stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true)).ok()?;
    Some(stream)
}

impl Servers {
    pub fn new(rtde: TcpListener, dashboard: TcpListener, serial: String) -> io::Result<Self> {
        rtde.set_nonblocking(true)?;
        dashboard.set_nonblocking(true)?;
        Ok(Self { rtde, dashboard, serial, clients: Vec::new(), dashboards: Vec::new(), last_s: f64::NEG_INFINITY })
    }

    /// Accepts connections and packages.
    pub fn receive(&mut self, behaviour: &UrBehaviour, registers: &mut Registers, random: &mut Random) -> Arrived {
        let mut arrived = Arrived::default();
        while let Some(stream) = accept(&self.rtde) {
            self.clients.push(Client {
                stream,
                received: Vec::new(),
                waiting: VecDeque::new(),
                has_version: false,
                outputs: None,
                inputs: Vec::new(),
                is_started: false,
                since_s: 0.0,
                is_closed: false,
            });
        }
        while let Some(mut stream) = accept(&self.dashboard) {
            let _ = stream.write_all(b"Connected: Universal Robots Dashboard Server\n");
            self.dashboards.push(Dashboard { stream, received: Vec::new(), is_closed: false });
        }
        if behaviour.is_unplugged {
            self.clients.clear();
            self.dashboards.clear();
            return arrived;
        }
        for index in 0..self.clients.len() {
            let client = &mut self.clients[index];
            let from = client.received.len();
            client.is_closed |= read(&mut client.stream, &mut client.received).is_none();
            damage(&mut client.received[from..], behaviour.damaged_bytes, random);
            while let Some(size) = self.clients[index].size() {
                let client = &mut self.clients[index];
                if !(3..=MAX_LEN).contains(&size) {
                    client.is_closed = true;
                    arrived.refused += 1;
                    break;
                }
                if client.received.len() < size {
                    break;
                }
                let bytes: Vec<u8> = client.received.drain(..size).collect();
                arrived.data += u64::from(self.answer(index, bytes[2], &bytes[3..], behaviour, registers));
            }
        }
        self.clients.retain(|client| !client.is_closed);
        for dashboard in &mut self.dashboards {
            dashboard.is_closed |= read(&mut dashboard.stream, &mut dashboard.received).is_none();
            while let Some(end) = dashboard.received.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = dashboard.received.drain(..=end).collect();
                let answer = match line.trim_ascii() {
                    b"get serial number" if !behaviour.has_no_serial => self.serial.clone(),
                    line => format!("could not understand: '{}'", String::from_utf8_lossy(line)),
                };
                let _ = dashboard.stream.write_all(format!("{answer}\n").as_bytes());
            }
        }
        self.dashboards.retain(|dashboard| !dashboard.is_closed);
        arrived
    }

    /// Answers a package of a client. Returns true for a valid data package, whose values are then in the registers.
    fn answer(
        &mut self,
        index: usize,
        kind: u8,
        payload: &[u8],
        behaviour: &UrBehaviour,
        registers: &mut Registers,
    ) -> bool {
        let claimed: Vec<Input> = self
            .clients
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != index)
            .flat_map(|(_, client)| client.inputs.iter().flatten().copied())
            .collect();
        let client = &mut self.clients[index];
        let names = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        match kind {
            b'V' => {
                client.has_version = payload == behaviour.rtde_version.to_be_bytes();
                client.put(package(b'V', &[u8::from(client.has_version)]));
            }
            b'v' => {
                let numbers: Vec<u8> = behaviour.software.iter().flat_map(|number| number.to_be_bytes()).collect();
                client.put(package(b'v', &numbers));
            }
            b'O' if client.has_version && payload.len() > 8 => {
                let (hz, list) = payload.split_at(8);
                let hz = f64::from_be_bytes(hz.try_into().unwrap_or_default());
                let list = names(list);
                let mut fields = Vec::new();
                let types: Vec<&str> = list
                    .split(',')
                    .map(|name| match Output::of(name).filter(|_| name != behaviour.unknown_field) {
                        None => "NOT_FOUND",
                        Some((field, kind)) => {
                            fields.push(field);
                            if name == behaviour.other_type { "UINT64" } else { kind }
                        }
                    })
                    .collect();
                let is_whole = fields.len() == types.len();
                client.outputs = is_whole.then_some((hz, fields));
                client.put(package(b'O', &[&[u8::from(is_whole)][..], types.join(",").as_bytes()].concat()));
            }
            b'I' if client.has_version => {
                let list = names(payload);
                let mut fields = Vec::new();
                let types: Vec<&str> = list
                    .split(',')
                    .map(|name| match Input::of(name).filter(|_| name != behaviour.unknown_field) {
                        None => "NOT_FOUND",
                        Some(field) if claimed.contains(&field) => "IN_USE",
                        Some(field) => {
                            fields.push(field);
                            field.kind()
                        }
                    })
                    .collect();
                let mut recipe = 0;
                if fields.len() == types.len() {
                    client.inputs.push(fields);
                    recipe = client.inputs.len() as u8;
                } else {
                    client.put(message("the input recipe cannot be used"));
                }
                client.put(package(b'I', &[&[recipe][..], types.join(",").as_bytes()].concat()));
            }
            b'S' => {
                client.is_started = client.outputs.is_some() && !behaviour.refuses_start;
                client.put(package(b'S', &[u8::from(client.is_started)]));
            }
            b'P' => {
                client.is_started = false;
                client.put(package(b'P', &[1]));
            }
            b'U' if client.is_started => return client.write_registers(payload, registers),
            _ => client.put(message("this package cannot be used")),
        }
        false
    }

    /// Sends outputs to every client.
    pub fn send(
        &mut self,
        behaviour: &UrBehaviour,
        registers: &Registers,
        status: Status,
        time_s: f64,
        (angles, speeds): (JointVector, JointVector),
        random: &mut Random,
    ) {
        let passed_s = (time_s - std::mem::replace(&mut self.last_s, time_s)).min(1.0);
        let now = Instant::now();
        for client in &mut self.clients {
            client.since_s += passed_s;
            let Some((hz, fields)) = client.outputs.as_ref().filter(|_| client.is_started) else {
                client.flush(now);
                continue;
            };
            if client.since_s * hz > 0.99 && !behaviour.is_silent {
                client.since_s = 0.0;
                let mut payload = vec![1];
                for field in fields {
                    match *field {
                        Output::Timestamp => payload.extend(time_s.to_be_bytes()),
                        Output::Angles => angles.iter().for_each(|v| payload.extend(v.to_be_bytes())),
                        Output::Speeds => speeds.iter().for_each(|v| payload.extend(v.to_be_bytes())),
                        Output::RobotMode => payload.extend(status.robot_mode.to_be_bytes()),
                        Output::SafetyBits => payload.extend(status.safety_bits.to_be_bytes()),
                        Output::RuntimeState => payload.extend(status.runtime_state.to_be_bytes()),
                        Output::Int(n) => {
                            let is_echo = n == 24 && behaviour.has_wrong_echo;
                            let value = registers.output_ints[n];
                            payload.extend(if is_echo { value.wrapping_sub(500) } else { value }.to_be_bytes());
                        }
                    }
                }
                let mut bytes = package(b'U', &payload);
                damage(&mut bytes, behaviour.damaged_bytes, random);
                if behaviour.is_garbage {
                    bytes = b"HTTP/1.1 400 Bad Request\r\n\r\n".to_vec();
                }
                let later = if behaviour.is_cut { bytes.split_off(bytes.len() / 2) } else { Vec::new() };
                let due = now + behaviour.delay;
                if client.waiting.iter().map(|(_, bytes)| bytes.len()).sum::<usize>() < MAX_WAITING {
                    client.waiting.push_back((due, bytes));
                    client.waiting.push_back((due + Duration::from_millis(1), later));
                }
            }
            client.flush(now);
        }
    }
}

impl Client {
    fn size(&self) -> Option<usize> {
        let header = self.received.get(..3)?;
        Some(usize::from(u16::from_be_bytes([header[0], header[1]])))
    }

    fn put(&mut self, bytes: Vec<u8>) {
        self.waiting.push_back((Instant::now(), bytes));
    }

    /// Writes the values of a data package into the registers, all of them or none.
    fn write_registers(&self, payload: &[u8], registers: &mut Registers) -> bool {
        let Some((recipe, mut values)) = payload.split_first() else { return false };
        let fields = usize::from(*recipe).checked_sub(1).and_then(|index| self.inputs.get(index));
        let Some(fields) = fields else { return false };
        let size: usize = fields.iter().map(|field| if matches!(field, Input::Int(_)) { 4 } else { 8 }).sum();
        if values.len() != size {
            return false;
        }
        for field in fields {
            match *field {
                Input::Int(n) => {
                    let (first, rest) = values.split_at(4);
                    registers.input_ints[n] = i32::from_be_bytes(first.try_into().unwrap_or_default());
                    values = rest;
                }
                Input::Float(n) => {
                    let (first, rest) = values.split_at(8);
                    registers.input_floats[n] = f64::from_be_bytes(first.try_into().unwrap_or_default());
                    values = rest;
                }
            }
        }
        true
    }

    /// Sends the bytes that are due.
    fn flush(&mut self, now: Instant) {
        while let Some((due, bytes)) = self.waiting.front_mut() {
            if *due > now {
                return;
            }
            match self.stream.write(bytes) {
                Ok(count) if count < bytes.len() => {
                    bytes.drain(..count);
                    return;
                }
                Ok(_) => {
                    self.waiting.pop_front();
                }
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => return,
                Err(_) => {
                    self.is_closed = true;
                    return;
                }
            }
        }
    }
}
