//! Malformed messages: whatever arrives, the codec neither panics nor reads past an end, and what it accepts it can
//! write.
//!
//! `PANOSCOPE_IGTL_CASES` sets the number of messages, `PANOSCOPE_IGTL_SEED` picks other ones. Ten million take minutes
//! with `--release`.

use crate::common;
use panoscope_base::random::SplitMix64;
use panoscope_igtl::crc::crc64;
use panoscope_igtl::{HEADER_BYTES, Message, Reader};

/// Bodies above this are refused by the reader under test, so that announced lengths matter.
const LIMIT: u64 = 4096;

fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name)
        .map_or(otherwise, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number, not `{text}`")))
}

/// Changes a message: bits, bytes, 32-bit counts, pieces taken out or doubled.
fn damage(random: &mut SplitMix64, bytes: &mut Vec<u8>) {
    const COUNTS: [u32; 8] = [0, 1, 2, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF, 0x4000_0000, 0x0001_0000];
    for _ in 0..1 + random.below(4) {
        if bytes.is_empty() {
            return;
        }
        let at = random.below(bytes.len());
        match random.below(6) {
            0 => bytes[at] ^= 1 << random.below(8),
            1 => bytes[at] = random.below(256) as u8,
            2 if at + 4 <= bytes.len() => {
                bytes[at..at + 4].copy_from_slice(&COUNTS[random.below(COUNTS.len())].to_be_bytes());
            }
            3 => bytes.truncate(at),
            4 => {
                let end = (at + 1 + random.below(12)).min(bytes.len());
                drop(bytes.drain(at..end));
            }
            _ => {
                let piece = bytes[at..(at + 1 + random.below(12)).min(bytes.len())].to_vec();
                drop(bytes.splice(at..at, piece));
            }
        }
    }
}

/// Makes length and CRC of a message right, so that its content is read.
fn seal(bytes: &mut [u8]) {
    if let Some((header, body)) = bytes.split_at_mut_checked(HEADER_BYTES) {
        header[42..50].copy_from_slice(&(body.len() as u64).to_be_bytes());
        header[50..58].copy_from_slice(&crc64(body).to_be_bytes());
    }
}

/// Reads the bytes as a stream. Returns messages read and refused.
fn read(bytes: &[u8], random: &mut SplitMix64) -> (u64, u64) {
    let (mut read, mut refused) = (0, 0);
    let mut reader = Reader::new(LIMIT);
    let middle = random.below(bytes.len() + 1);
    for mut part in [&bytes[..middle], &bytes[middle..]] {
        while reader.fill(&mut part).expect("bytes in memory") > 0 {}
        loop {
            let message = match reader.next_message() {
                Ok(Some(raw)) => raw.message(),
                Ok(None) => break,
                Err(error) => Err(error),
            };
            match message {
                Ok(message) => {
                    read += 1;
                    check(&message);
                }
                Err(_) => refused += 1,
            }
        }
    }
    (read, refused)
}

/// What was accepted is written and read again as the same bytes. Names in other encodings may have grown too long.
fn check(message: &Message<'_>) {
    let mut once = Vec::new();
    if message.encode(&mut once).is_err() {
        return;
    }
    let again =
        Message::decode(&once).unwrap_or_else(|error| panic!("{message:?} was written and is refused: {error}"));
    let mut twice = Vec::new();
    again.encode(&mut twice).expect("it was written before");
    assert_eq!(once, twice, "{message:?}");
}

#[test]
fn malformed_messages_are_survived() {
    let (cases, seed) = (number("PANOSCOPE_IGTL_CASES", 100_000), number("PANOSCOPE_IGTL_SEED", 1));
    let seeds = common::all();
    let (mut accepted, mut refused) = (0, 0);
    for case in 0..cases {
        let mut random = SplitMix64(seed << 40 | case);
        let mut bytes = seeds[random.below(seeds.len())].clone();
        match random.below(4) {
            // Whole: header and body.
            0 => damage(&mut random, &mut bytes),
            // Noise behind a header.
            1 => {
                bytes.truncate(HEADER_BYTES);
                bytes.extend((0..random.below(400)).map(|_| 0).collect::<Vec<u8>>());
                bytes[HEADER_BYTES..].iter_mut().for_each(|byte| *byte = random.below(256) as u8);
                seal(&mut bytes);
            }
            // The body, with a length and a CRC that fit.
            _ => {
                let mut body = bytes.split_off(HEADER_BYTES);
                damage(&mut random, &mut body);
                bytes.extend(body);
                seal(&mut bytes);
            }
        }
        // Another message behind it shows whether the stream goes on.
        if random.below(4) == 0 {
            bytes.extend_from_slice(&seeds[random.below(seeds.len())]);
        }
        let (read, others) = read(&bytes, &mut random);
        accepted += read;
        refused += others;
    }
    println!("{cases} streams: {accepted} messages accepted, {refused} refused");
    assert!(accepted > cases / 20 && refused > cases / 20, "{accepted} accepted, {refused} refused");
}
