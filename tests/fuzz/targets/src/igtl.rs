//! OpenIGTLink: a stream of messages from another program.

use panoscope_igtl::crc::crc64;
use panoscope_igtl::{HEADER_BYTES, Message, Reader};

/// Limit of the reader under test.
const BODY_LIMIT: u64 = 1 << 20;
/// Bytes written by the OpenIGTLink library and pyigtl.
const GOLDEN: [&str; 2] = [
    include_str!("../../../../core/links/igtl/tests/golden/library.txt"),
    include_str!("../../../../core/links/igtl/tests/golden/pyigtl.txt"),
];

/// A stream as it is, and as one message with corrected length and CRC, which the fuzzer cannot guess.
pub fn run(bytes: &[u8]) {
    let whole = read(bytes, bytes.len().max(1));
    assert!(whole.len() <= bytes.len() / HEADER_BYTES + 1, "{} messages in {} bytes", whole.len(), bytes.len());
    for pieces in [1, 61, 500] {
        assert_eq!(read(bytes, pieces), whole, "in pieces of {pieces}");
    }
    if let Some((header, body)) = bytes.split_at_checked(HEADER_BYTES) {
        let mut sealed = header.to_vec();
        sealed[42..50].copy_from_slice(&(body.len() as u64).to_be_bytes());
        sealed[50..58].copy_from_slice(&crc64(body).to_be_bytes());
        sealed.extend_from_slice(body);
        read(&sealed, sealed.len());
    }
}

/// The messages of a stream that arrives in pieces, as text.
fn read(bytes: &[u8], pieces: usize) -> Vec<String> {
    let (mut reader, mut found) = (Reader::new(BODY_LIMIT), Vec::new());
    for mut piece in bytes.chunks(pieces) {
        while reader.fill(&mut piece).expect("bytes in memory") > 0 {}
        loop {
            match reader.next_message() {
                Ok(Some(raw)) => found.push(match raw.message() {
                    Ok(message) => {
                        rewrite(&message);
                        format!("{message:?}")
                    }
                    Err(error) => error.to_string(),
                }),
                Ok(None) => break,
                Err(error) => found.push(error.to_string()),
            }
        }
    }
    found
}

/// Accepted messages are written and read again as the same bytes; names in other encodings may have become too long.
fn rewrite(message: &Message<'_>) {
    let mut once = Vec::new();
    if message.encode(&mut once).is_err() {
        return;
    }
    let mut twice = Vec::new();
    Message::decode(&once).expect("it was written").encode(&mut twice).expect("it was written before");
    assert_eq!(once, twice);
}

pub fn seeds() -> Vec<Vec<u8>> {
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap_or("0"), 16).unwrap_or(0);
    let lines = GOLDEN.iter().flat_map(|text| text.lines()).filter_map(|line| line.split_once(' '));
    let mut all: Vec<Vec<u8>> = lines.map(|(_, hex)| hex.as_bytes().chunks_exact(2).map(byte).collect()).collect();
    let mut damaged = all[0].clone();
    damaged[HEADER_BYTES] ^= 1;
    all.push([damaged, all[1].clone()].concat());
    // The shorter forms of POSITION, other versions, wrong fields.
    let change = |from: usize, at: usize, bytes: &[u8]| {
        let mut message = all[from].clone();
        message[at..at + bytes.len()].copy_from_slice(bytes);
        message
    };
    let changed = [
        all[1][..HEADER_BYTES + 12].to_vec(),
        all[1][..HEADER_BYTES + 24].to_vec(),
        change(0, 0, &[0, 4]),
        change(0, 2, &[0; 12]),
        change(0, 42, &[0xFF; 8]),
        change(2, HEADER_BYTES, &[0, 9]),
        change(2, HEADER_BYTES + 2, &[0]),
        change(2, HEADER_BYTES + 3, &[9]),
        change(2, HEADER_BYTES + 4, &[3]),
        change(2, HEADER_BYTES + 5, &[3]),
        change(3, HEADER_BYTES + 60, &[0xFF, 0xFF]),
        change(5, HEADER_BYTES, &[0xFF; 4]),
        change(5, HEADER_BYTES + 36, &[0, 0, 0, 1]),
    ];
    all.extend(changed);
    all.push(all.concat());
    all
}
