//! What a frame of the simulator says of itself.

use panoscope_sim::content::{Content, MIN_BYTES, Step};
use panoscope_sim::engine::POISON;

#[test]
fn every_byte_counts() {
    let content = Content { seq: 7, steps: vec![Step { node: 1, values: 2 }, Step { node: 3, values: 4 }] };
    let mut bytes = vec![0; MIN_BYTES + 100];
    content.write(&mut bytes);
    assert_eq!(Content::read(&bytes), Ok(content.clone()));
    for at in 0..bytes.len() {
        bytes[at] ^= 0x10;
        assert!(Content::read(&bytes).is_err(), "byte {at}");
        bytes[at] ^= 0x10;
    }
    let mut other = vec![0; bytes.len()];
    Content { seq: 8, ..content.clone() }.write(&mut other);
    let half = bytes.len() / 2;
    bytes[half..].copy_from_slice(&other[half..]);
    assert!(Content::read(&bytes).is_err(), "half of another tick");
    assert!(Content::read(&[POISON; 300]).unwrap_err().contains("nobody wrote"));
}

#[test]
fn parts_make_the_whole() {
    let content = Content { seq: 1 << 40, steps: vec![Step { node: 1, values: 2 }] };
    let whole = content.part(1000, 0, 1000);
    let parts: Vec<u8> = (0..10).flat_map(|n| content.part(1000, n * 100, (n + 1) * 100)).collect();
    assert_eq!(parts, whole);
    assert_eq!(Content::read(&whole), Ok(content));
}
