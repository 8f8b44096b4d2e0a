//! What holds for every message: it survives being written and read, no part of it is taken for the whole, and a stream
//! reads the same however it is cut.

use crate::common;
use std::io::Read;

use crate::common::{all, golden};
use panoscope_base::random::SplitMix64;
use panoscope_igtl::message::{Transform, Verb};
use panoscope_igtl::{Content, HEADER_BYTES, Header, IgtlError, Message, Reader, Timestamp};

#[test]
fn written_and_read_messages_are_the_same_in_every_version() {
    for (name, _) in golden(common::LIBRARY) {
        for version in 1..=3 {
            let mut message = common::of_library(name);
            message.version = version;
            if version > 1 {
                message.message_id = 0xDEAD_BEEF;
                message.metadata = vec![("key".into(), "ü".into()), ("".into(), "".into())];
            }
            let mut bytes = b"before".to_vec();
            message.encode(&mut bytes).expect("it fits");
            assert_eq!(Message::decode(&bytes[6..]).expect("it was written"), message, "{name} in version {version}");
        }
    }
}

#[test]
fn no_beginning_of_a_message_is_a_message() {
    for bytes in all() {
        for len in 0..bytes.len() {
            assert!(Message::decode(&bytes[..len]).is_err(), "{len} of {} bytes", bytes.len());
            let mut reader = Reader::default();
            reader.fill(&mut &bytes[..len]).expect("bytes in memory");
            assert!(matches!(reader.next_message(), Ok(None)), "{len} of {} bytes", bytes.len());
        }
    }
}

/// A body that was cut and got a header that says so is an error or another message, never a panic.
#[test]
fn shortened_bodies_are_refused_or_read() {
    let (mut refused, mut read) = (0, 0);
    for bytes in all() {
        for len in HEADER_BYTES..bytes.len() {
            let mut cut = bytes[..len].to_vec();
            cut[42..50].copy_from_slice(&((len - HEADER_BYTES) as u64).to_be_bytes());
            match Message::decode(&cut) {
                Ok(_) => read += 1,
                Err(error) => {
                    refused += 1;
                    assert!(!error.to_string().is_empty());
                }
            }
        }
    }
    assert!(refused > 3000 && read > 0, "{refused} refused, {read} read");
}

/// Gives bytes in pieces of random length.
struct Pieces<'a>(&'a [u8], SplitMix64);

impl Read for Pieces<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let len = (1 + self.1.below(90)).min(self.0.len()).min(buffer.len());
        buffer[..len].copy_from_slice(&self.0[..len]);
        self.0 = &self.0[len..];
        Ok(len)
    }
}

#[test]
fn a_stream_reads_the_same_however_it_is_cut() {
    let messages = all();
    let mut stream = messages.concat();
    // A damaged message in the middle costs that one only.
    let damaged = messages[..6].concat().len() - 1;
    stream[damaged] ^= 1;
    for seed in 0..50 {
        let mut pieces = Pieces(&stream, SplitMix64(seed));
        let (mut reader, mut found, mut errors) = (Reader::default(), Vec::new(), Vec::new());
        while reader.fill(&mut pieces).expect("bytes in memory") > 0 {
            loop {
                match reader.next_message() {
                    Ok(Some(raw)) => found.push(raw.bytes.to_vec()),
                    Ok(None) => break,
                    Err(error) => errors.push(error),
                }
            }
        }
        let expected: Vec<&Vec<u8>> = messages[..5].iter().chain(&messages[6..]).collect();
        assert!(found.iter().eq(expected), "seed {seed}");
        assert!(matches!(errors.as_slice(), [IgtlError::Crc { .. }]) && !reader.is_broken(), "{errors:?}");
    }
}

#[test]
fn a_stream_that_is_out_of_step_or_announces_too_much_is_given_up() {
    let header = |version: u16, kind: &str, body_bytes: u64| {
        let mut bytes = Vec::new();
        let (kind, device) = (kind.into(), "".into());
        Header { version, kind, device, time: Timestamp::default(), body_bytes, crc: 0 }
            .encode(&mut bytes)
            .expect("short");
        bytes
    };
    let cases = [
        (header(0, "IMAGE", 5), "version 0"),
        (header(4, "IMAGE", 5), "version 4"),
        (header(1, "", 5), "no type"),
        (header(1, "IM\u{1}GE", 5), "a type that is not printable"),
        (header(1, "IMAGE", 1001), "a body above the limit"),
        (header(1, "IMAGE", u64::MAX), "the longest body there is"),
    ];
    for (bytes, what) in cases {
        let mut reader = Reader::new(1000);
        reader.fill(&mut bytes.as_slice()).expect("bytes in memory");
        assert!(reader.next_message().is_err() && reader.is_broken(), "{what}");
        assert!(matches!(reader.next_message(), Ok(None)), "{what}: it says so once");
    }
}

#[test]
fn counts_that_lie_cost_no_memory() {
    // 4 billion points in a message of 40 bytes.
    let mut bytes = Vec::new();
    let data = Content::Other(&[0xFF; 40]);
    let mut message = Message::new("", Timestamp::default(), data);
    message.kind = "POLYDATA".into();
    message.encode(&mut bytes).expect("short");
    assert!(matches!(Message::decode(&bytes), Err(IgtlError::Short { field: "points", .. })));
}

#[test]
fn names_that_do_not_fit_are_refused() {
    let content = || common::content("transform");
    let long = Message::new("a name of more than 20 bytes", Timestamp::default(), content());
    let mut out = b"kept".to_vec();
    let error = long.encode(&mut out).expect_err("too long").to_string();
    assert!(error.contains("the limit of a device name is 20") && out == b"kept", "{error}");
    let full = Message::new("exactly 20 bytes 123", Timestamp::default(), content());
    full.encode(&mut out).expect("it fits");
    assert_eq!(Message::decode(&out[4..]).expect("written").device, "exactly 20 bytes 123");
}

#[test]
fn requests_name_types_in_short() {
    for (kind, name) in [("TRANSFORM", "GET_TRANS"), ("CAPABILITY", "GET_CAPABIL"), ("POLYDATA", "GET_POLYDATA")] {
        let query = panoscope_igtl::message::Query::new(Verb::Get, kind);
        assert_eq!((query.name().as_str(), query.subject()), (name, Some(kind)));
        assert!(query.name().len() <= panoscope_igtl::TYPE_BYTES);
    }
}

#[test]
fn quaternions_and_matrices_are_the_same_rotation() {
    let mut random = SplitMix64(5);
    for _ in 0..1000 {
        let mut number = || random.below(2001) as f64 / 1000.0 - 1.0;
        let raw = [number(), number(), number(), number()];
        let norm = raw.iter().map(|v| v * v).sum::<f64>().sqrt();
        if norm < 0.1 {
            continue;
        }
        let sign = if raw[0] < 0.0 { -1.0 } else { 1.0 };
        let unit = raw.map(|v| sign * v / norm);
        let transform = Transform::from_quaternion(unit, [1.0, 2.0, 3.0]);
        let back = transform.quaternion().expect("a rotation");
        // Half turns have two quaternions.
        let dot: f64 = unit.iter().zip(back).map(|(a, b)| a * b).sum();
        assert!(dot.abs() > 1.0 - 1e-6, "{unit:?} became {back:?}");
    }
    let mirrored = Transform { columns: [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ..Transform::default() };
    let scaled = Transform { columns: [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]], ..Transform::default() };
    let unknown = Transform { columns: [[f32::NAN; 3]; 3], ..Transform::default() };
    for other in [mirrored, scaled, unknown] {
        assert_eq!(other.quaternion(), None, "{other:?}");
    }
}
