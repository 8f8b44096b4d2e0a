//! The arm: its line protocol, records of the guard, its latch file, its URDF.

use panoscope_arm_core::interlock::{Cause, Event, Evidence, Settings};
use panoscope_arm_core::line::Serial;
use panoscope_arm_core::line::{Line, MAX_LEN, Reader, Received};
use panoscope_arm_core::{Chain, JointVector};
use panoscope_arm_guard::latch::{LatchStore, Record};
use panoscope_arm_guard::message::{self, Report, Request, Status};
use panoscope_arm_guard::rtde;

use crate::scratch;

/// Lines of a serial port: as they are, and with a corrected CRC, which the fuzzer cannot guess.
pub fn line(bytes: &[u8]) {
    for part in bytes.split(|byte| *byte == b'\n') {
        one_line(part);
        let body = part.split(|byte| *byte == b'*').next().unwrap_or(part);
        let sealed = [body, format!("*{:08X}", crc32fast::hash(body)).as_bytes()].concat();
        one_line(&sealed);
    }
    // The lines of a stream do not depend on how its bytes were delivered.
    let mut whole = Vec::new();
    Reader::default().take(bytes, |received| whole.push(format!("{received:?}")));
    for pieces in [1, 7, 64] {
        let (mut reader, mut parts) = (Reader::default(), Vec::new());
        bytes.chunks(pieces).for_each(|piece| reader.take(piece, |received| parts.push(format!("{received:?}"))));
        assert_eq!(parts, whole, "in pieces of {pieces}");
    }
}

fn one_line(bytes: &[u8]) {
    let Some(line) = Line::read(bytes) else { return };
    let mut written = Vec::new();
    line.write(&mut written);
    assert!(written.len() <= MAX_LEN, "{line:?}");
    let mut back = Vec::new();
    Reader::default().take(&written, |received| back.push(received));
    let [Received::Line(again)] = back.as_slice() else { panic!("{line:?} came back as {back:?}") };
    let mut twice = Vec::new();
    again.write(&mut twice);
    assert_eq!(twice, written, "{line:?}");
}

fn joints(start: f64) -> JointVector {
    JointVector::from_fn(|k, _| start + 0.1 * k as f64)
}

pub fn line_seeds() -> Vec<Vec<u8>> {
    let serial = Serial::new("CAM6-0042").expect("a serial number");
    let lines = [
        Line::Hello { seq: 0, version: 2 },
        Line::Identity { seq: 1, version: 2, serial, watchdog_ms: 30 },
        Line::Query { seq: 2 },
        Line::Clear { seq: 3 },
        Line::Set { seq: 999_999, position: joints(-0.2), velocity: joints(1e-6) },
    ];
    let mut all: Vec<Vec<u8>> = lines
        .iter()
        .map(|line| {
            let mut bytes = Vec::new();
            line.write(&mut bytes);
            bytes
        })
        .collect();
    all.push(all.concat());
    all.push(b"A 1 R 0 0 0 0 0 0*6B\n".to_vec());
    all.push(vec![b'S'; 600]);
    all
}

/// A record as it is, and with a corrected CRC.
pub fn message(bytes: &[u8]) {
    one_message(bytes);
    let sealed = [bytes, &crc32fast::hash(bytes).to_le_bytes()].concat();
    one_message(&sealed);
}

fn one_message(bytes: &[u8]) {
    let mut out = [0; message::MAX_LEN];
    if let Some(request) = Request::decode(bytes) {
        let written = request.encode(&mut out).to_vec();
        let again = Request::decode(&written).expect("a request that was written");
        assert_eq!(again.encode(&mut out), written);
    }
    if let Some(report) = Report::decode(bytes) {
        let written = report.encode(&mut out).to_vec();
        let again = Report::decode(&written).expect("a report that was written");
        assert_eq!(again.encode(&mut out), written);
    }
}

pub fn message_seeds() -> Vec<Vec<u8>> {
    let request = Request {
        sent_ns: 123_456_789,
        tip: Some((-5, Evidence { score: 0.75, in_space: true })),
        demand: Some((99, [0.1; message::MAX_DEMAND], 6)),
        settings: Settings { max_age_ms: 150.0, min_score: 0.3 },
        emergency_stop: false,
        reset: 7,
    };
    let status = Status { encoders: joints(0.1), stop: Some(Cause::OldTip), ..Status::default() };
    let serial = Serial::new("CAM6-0042").expect("a serial number");
    let reports = [
        Report::Ready { serial, watchdog_ms: 30, granted: (true, false) },
        Report::Failed("the arm is not there: ä".to_owned()),
        Report::Status(Box::new(status)),
        Report::Event(Event { at_ns: 5, stop: None, speed_rad_s: 0.4 }),
    ];
    let mut out = [0; message::MAX_LEN];
    let mut all = vec![request.encode(&mut out).to_vec()];
    all.extend(reports.iter().map(|report| report.encode(&mut out).to_vec()));
    // Without the CRC, which the target adds.
    all.extend(all.clone().iter().map(|record| record[..record.len() - 4].to_vec()));
    all
}

/// The latch file: whatever it holds, the arm opens with a stop, or was at rest.
pub fn latch(bytes: &[u8]) {
    one_latch(bytes);
    let body = bytes.split(|byte| *byte == b'\n').next().unwrap_or(bytes);
    let sealed = [body, format!("\n{:08x}\n", crc32fast::hash(body)).as_bytes()].concat();
    one_latch(&sealed);
}

fn one_latch(bytes: &[u8]) {
    let serial = Serial::new("FUZZ").expect("a serial number");
    let file = scratch::file("latches/FUZZ.latch", bytes);
    let folder = file.parent().expect("it is in a folder");
    let (mut store, stop) = LatchStore::open(folder, &serial).expect("the folder can be written");
    assert!(stop.is_some() || bytes.starts_with(b"rest\n"), "{:?} is no rest", String::from_utf8_lossy(bytes));
    let Some(cause) = stop else { return };
    store.write(Record::Latched(cause)).expect("written");
    drop(store);
    let (_, again) = LatchStore::open(folder, &serial).expect("the folder can be written");
    assert_eq!(again, Some(cause));
}

pub fn latch_seeds() -> Vec<Vec<u8>> {
    let bodies = ["rest", "released", "latched 3 old tip", "latched 99999999999999999999", "latched -1", ""];
    let mut all: Vec<Vec<u8>> = bodies.iter().map(|body| body.as_bytes().to_vec()).collect();
    all.extend(bodies.iter().map(|body| format!("{body}\n{:08x}\n", crc32fast::hash(body.as_bytes())).into_bytes()));
    all
}

pub fn urdf(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match Chain::from_urdf(text) {
        Ok(chain) => {
            for joint in chain.joints() {
                assert!(joint.lower_rad < 0.0 && joint.upper_rad > 0.0 && joint.speed_rad_s > 0.0, "{joint:?}");
                assert!(joint.lower_rad.is_finite() && joint.upper_rad.is_finite() && joint.speed_rad_s.is_finite());
            }
            let stance = chain.stance(&JointVector::zeros());
            assert!(stance.links().iter().all(|point| point.iter().all(|mm| mm.is_finite())), "{stance:?}");
            assert!(chain.trocar_mm().iter().all(|mm| mm.is_finite()));
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

pub fn urdf_seeds() -> Vec<Vec<u8>> {
    let shipped = panoscope_arm_core::chain::SHIPPED_URDF;
    let texts = [
        shipped.to_owned(),
        shipped.replace("revolute", "continuous"),
        shipped.replace("trocar", "other"),
        shipped.replacen("xyz=\"", "xyz=\"1e308 ", 3),
        shipped[..shipped.len() / 2].to_owned(),
        format!("<robot name=\"a\">{}", "<link name=\"b\">".repeat(300)),
        "<!DOCTYPE a [<!ENTITY b \"&c;&c;\">]><robot name=\"&b;\"/>".to_owned(),
    ];
    let joint = |name: &str, kind: &str, from: &str, to: &str| {
        format!(
            "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{from}\"/><child link=\"{to}\"/><axis xyz=\"0 0 1\"/>\
             <limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>"
        )
    };
    let more = [
        ("name=\"left_camera\"", "name=\"other\""),
        ("name=\"scope_tip\"", "name=\"other\""),
        ("name=\"left_lens\" type=\"fixed\"", "name=\"left_lens\" type=\"revolute\""),
        ("name=\"wall\" type=\"fixed\"", "name=\"wall\" type=\"revolute\""),
        ("name=\"turn\" type=\"revolute\"", "name=\"turn\" type=\"fixed\""),
        ("parent link=\"scope_tip\"", "parent link=\"flange\""),
        ("parent link=\"base_link\"", "parent link=\"flange\""),
        ("xyz=\"0.42 0 0.21\"", "xyz=\"0.43 0 0.21\""),
        ("xyz=\"0 0 0.2\"", "xyz=\"nan 0 0.2\""),
        ("xyz=\"0 0 0.2\"", "xyz=\"inf 0 0.2\""),
        ("axis xyz=\"0 0 1\"", "axis xyz=\"0 0 0\""),
        ("lower=\"-2.6\"", "lower=\"0.1\""),
        ("upper=\"2.6\"", "upper=\"-0.1\""),
        ("upper=\"2.6\"", "upper=\"inf\""),
        ("velocity=\"0.4\"", "velocity=\"0\""),
        ("velocity=\"0.4\"", "velocity=\"nan\""),
    ];
    let changed = more.iter().map(|(old, new)| shipped.replacen(old, new, 1));
    let circle =
        shipped.replace("</robot>", &format!("{}</robot>", joint("back", "fixed", "left_camera", "base_link")));
    texts.into_iter().chain(changed).chain([circle]).map(String::into_bytes).collect()
}

/// The stream of a robot's controller.
pub fn rtde(bytes: &[u8]) {
    let mut whole = Vec::new();
    rtde::Reader::new().take(bytes, |received| {
        if let rtde::Received::Package(rtde::Package::Data(_, values)) = received {
            // Thirteen numbers of 8 bytes and eight of 4.
            assert!(rtde::State::read(values).is_none() || values.len() == 13 * 8 + 8 * 4, "{} bytes", values.len());
        }
        whole.push(format!("{received:?}"));
    });
    assert!(whole.len() <= bytes.len() / 3 + 1, "{} packages of {} bytes", whole.len(), bytes.len());
    // A stream that is broken stays so.
    let broken = whole.iter().position(|received| received == "Broken");
    assert!(broken.is_none_or(|at| at + 1 == whole.len()), "{whole:?}");
    for pieces in [1, 5, 100] {
        let (mut reader, mut parts) = (rtde::Reader::new(), Vec::new());
        bytes.chunks(pieces).for_each(|piece| reader.take(piece, |received| parts.push(format!("{received:?}"))));
        assert_eq!(parts, whole, "in pieces of {pieces}");
    }
}

pub fn rtde_seeds() -> Vec<Vec<u8>> {
    let package = |kind: u8, payload: &[u8]| {
        [&u16::try_from(payload.len() + 3).expect("short").to_be_bytes()[..], &[kind], payload].concat()
    };
    let mut values = vec![1];
    (0..13).for_each(|k| values.extend((f64::from(k) * 0.5).to_be_bytes()));
    [7, 1, 2, 41, 3, 0, 1, 30].iter().for_each(|value: &i32| values.extend(value.to_be_bytes()));
    let all = [
        package(b'V', &[1]),
        package(b'v', &[0, 0, 0, 5, 0, 0, 0, 12, 0, 0, 0, 0, 0, 1, 0, 0]),
        package(b'M', b"\x05hello\x03urc\x02"),
        package(b'O', b"\x01DOUBLE,INT32"),
        package(b'I', b"\x02IN_USE"),
        package(b'S', &[1]),
        package(b'P', &[0]),
        package(b'U', &values),
    ];
    let wrong = [
        package(b'V', &[2]),
        package(b'V', &[]),
        package(b'v', &[0; 15]),
        package(b'M', b"\x09hello"),
        package(b'M', b"\x01h\x09"),
        package(b'M', b"\x01h\x01u"),
        package(b'O', &[]),
        package(b'O', &[1, 0xff, 0xfe]),
        package(b'S', &[1, 1]),
        package(b'P', &[7]),
        package(b'U', &[]),
        package(b'X', &[1]),
    ];
    let mut all =
        vec![all.concat(), package(b'U', &values), all.concat()[..40].to_vec(), vec![0, 2, b'V'], vec![0xff; 8]];
    all.push(wrong.concat());
    // Values that end inside each field.
    all.push((1..values.len()).step_by(4).flat_map(|len| package(b'U', &values[..len])).collect());
    all
}
