//! Storage of the bytes of a packet: uncompressed, compressed, or as a reference to equal bytes earlier in the file.
//!
//! Compression is designed for images and maps: numbers of 1, 2 or 4 bytes become differences to the number one pixel
//! before, which are small where neighbours are alike; then come the lowest bytes of all differences, the second
//! lowest, and so on; zstd compresses the result. Its XXH3 precedes it, because some bits of a zstd frame have no
//! effect and no damage may go unnoticed.

use std::collections::{HashMap, VecDeque};
use std::io;

use panoscope_base::format;
use xxhash_rust::xxh3::xxh3_64;
use zstd::bulk::{Compressor, Decompressor};

use crate::format::PacketHead;

/// zstd's level: higher ones gain a few percent on camera images and take several times as long.
const LEVEL: i32 = 1;
/// Shorter packets are stored uncompressed.
const MIN_BYTES: usize = 256;
/// Number of packets whose offset in the file is kept.
const REMEMBERED: usize = 256;
/// Bytes of the checksum before packed bytes.
const SUM_BYTES: usize = 8;
/// Bytes of a reference: the offset of the stored bytes.
pub(crate) const REFERENCE_BYTES: u64 = 8;

/// Bytes per number and numbers per pixel of a format. Packets without pixels count as bytes.
fn numbers(format: u32) -> (usize, usize) {
    match format::of(format) {
        Some(known) if known.id == panoscope_abi::FORMAT_CLOUD => (4, known.pixel_bytes() / 4),
        Some(known) if known.pixel_bytes() > 0 => (known.element_bytes, known.channels),
        _ => (1, 1),
    }
}

/// Differences of little-endian numbers of `N` bytes to those `lag` before, by planes of bytes.
fn spread<const N: usize>(bytes: &[u8], lag: usize, out: &mut Vec<u8>) {
    let numbers = bytes.as_chunks::<N>().0;
    let count = numbers.len();
    out.clear();
    out.resize(bytes.len(), 0);
    let rest = N * count;
    out[rest..].copy_from_slice(&bytes[rest..]);
    let value = |number: &[u8; N]| number.iter().rev().fold(0u32, |n, b| n << 8 | u32::from(*b));
    for (plane, out) in out[..rest].chunks_exact_mut(count.max(1)).enumerate() {
        let shift = 8 * plane as u32;
        for (out, number) in out.iter_mut().zip(numbers).take(lag) {
            *out = (value(number) >> shift) as u8;
        }
        for ((out, number), before) in out.iter_mut().skip(lag).zip(numbers.iter().skip(lag)).zip(numbers) {
            *out = (value(number).wrapping_sub(value(before)) >> shift) as u8;
        }
    }
}

/// The inverse of [`spread`].
fn gather<const N: usize>(planes: &[u8], lag: usize, out: &mut [u8]) {
    let count = out.len() / N;
    let rest = N * count;
    out[rest..].copy_from_slice(&planes[rest..]);
    let mut before = [0u32; 4];
    let lag = lag.clamp(1, before.len());
    for index in 0..count {
        let difference = (0..N).fold(0u32, |n, plane| n | u32::from(planes[plane * count + index]) << (8 * plane));
        let value = before[index % lag].wrapping_add(difference);
        before[index % lag] = value;
        out[N * index..N * (index + 1)].copy_from_slice(&value.to_le_bytes()[..N]);
    }
}

/// Stores the bytes of packets.
pub(crate) struct Packer {
    compressor: Compressor<'static>,
    planes: Vec<u8>,
    packed: Vec<u8>,
    /// Offsets of earlier packets by fingerprint, hash of padded rows and length.
    places: HashMap<(u64, u64, u64), u64>,
    order: VecDeque<(u64, u64, u64)>,
}

impl Packer {
    pub fn new() -> io::Result<Self> {
        let compressor = Compressor::new(LEVEL)?;
        let (planes, packed) = (Vec::new(), Vec::new());
        Ok(Self { compressor, planes, packed, places: HashMap::new(), order: VecDeque::new() })
    }

    /// Offset of an earlier packet with the same bytes.
    pub fn place_of(&self, head: &PacketHead) -> Option<u64> {
        (head.len > REFERENCE_BYTES).then(|| self.places.get(&(head.hash, head.padded, head.len)).copied()).flatten()
    }

    /// Keeps the offset of a packet's bytes.
    pub fn remember(&mut self, head: &PacketHead, at: u64) {
        let key = (head.hash, head.padded, head.len);
        if self.places.insert(key, at).is_none() {
            self.order.push_back(key);
        }
        if self.order.len() > REMEMBERED
            && let Some(oldest) = self.order.pop_front()
        {
            self.places.remove(&oldest);
        }
    }

    /// The compressed bytes; `None` if they are not shorter.
    pub fn pack(&mut self, format: u32, bytes: &[u8]) -> Option<&[u8]> {
        if bytes.len() < MIN_BYTES {
            return None;
        }
        let (size, lag) = numbers(format);
        match size {
            2 => spread::<2>(bytes, lag, &mut self.planes),
            4 => spread::<4>(bytes, lag, &mut self.planes),
            _ => spread::<1>(bytes, lag, &mut self.planes),
        }
        self.packed.resize(SUM_BYTES + zstd::zstd_safe::compress_bound(bytes.len()), 0);
        let len = SUM_BYTES + self.compressor.compress_to_buffer(&self.planes, &mut self.packed[SUM_BYTES..]).ok()?;
        let sum = xxh3_64(self.packed.get(SUM_BYTES..len)?);
        self.packed[..SUM_BYTES].copy_from_slice(&sum.to_le_bytes());
        (len < bytes.len()).then(|| &self.packed[..len])
    }
}

/// Unpacks the bytes of a packet into `out`, which has their length. `None` if they are damaged.
pub(crate) fn unpack(format: u32, packed: &[u8], out: &mut [u8]) -> Option<()> {
    let (sum, packed) = packed.split_first_chunk::<SUM_BYTES>()?;
    if xxh3_64(packed) != u64::from_le_bytes(*sum) {
        return None;
    }
    let mut planes = vec![0; out.len()];
    let len = Decompressor::new().ok()?.decompress_to_buffer(packed, &mut planes).ok()?;
    if len != out.len() {
        return None;
    }
    let (size, lag) = numbers(format);
    match size {
        2 => gather::<2>(&planes, lag, out),
        4 => gather::<4>(&planes, lag, out),
        _ => gather::<1>(&planes, lag, out),
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use panoscope_abi as abi;
    use panoscope_base::random::SplitMix64;

    use super::*;
    use crate::format::Coding;

    #[test]
    fn packed_bytes_come_back_and_smooth_pictures_are_short() {
        let mut dice = SplitMix64(3);
        for format in [
            abi::FORMAT_BYTES,
            abi::FORMAT_GRAY8,
            abi::FORMAT_BGR8,
            abi::FORMAT_RGBA8,
            abi::FORMAT_GRAY16,
            abi::FORMAT_F32,
            abi::FORMAT_CLOUD,
        ] {
            for len in [256, 257, 4099, 30_000] {
                let noise = (0..len).map(|_| dice.below(256) as u8).collect::<Vec<u8>>();
                let smooth = (0..len).map(|at| (at / 64) as u8).collect::<Vec<u8>>();
                let mut packer = Packer::new().expect("zstd");
                assert!(packer.pack(format, &noise).is_none(), "noise is not shorter");
                let packed = packer.pack(format, &smooth).expect("shorter").to_vec();
                let mut out = vec![0; len];
                unpack(format, &packed, &mut out).expect("whole");
                assert!(out == smooth, "format {format}, {len} bytes");
                // Any damage is seen, or the fingerprint of the packet sees it.
                assert!(unpack(format, &packed[..packed.len() - 1], &mut out).is_none());
                assert!(unpack(format, &packed, &mut vec![0; len - 1]).is_none());
                assert!(unpack(format, &packed, &mut vec![0; len + 1]).is_none());
            }
        }
        // All values of numbers, by the inverse alone.
        for (size, bytes) in [(2, 2 * 5000), (4, 4 * 5000)] {
            let noise = (0..bytes).map(|_| dice.below(256) as u8).collect::<Vec<u8>>();
            let (mut planes, mut out) = (Vec::new(), vec![0; bytes]);
            match size {
                2 => {
                    spread::<2>(&noise, 1, &mut planes);
                    gather::<2>(&planes, 1, &mut out);
                }
                _ => {
                    spread::<4>(&noise, 4, &mut planes);
                    gather::<4>(&planes, 4, &mut out);
                }
            }
            assert!(out == noise && planes != noise);
        }
    }

    #[test]
    fn the_oldest_place_is_forgotten() {
        let mut packer = Packer::new().expect("zstd");
        let head = |hash| PacketHead {
            tick: abi::Tick::default(),
            format: 0,
            width: 0,
            height: 0,
            stride_bytes: 0,
            len: 100,
            hash,
            padded: 0,
            coding: Coding::Plain,
        };
        for hash in 0..=REMEMBERED as u64 {
            packer.remember(&head(hash), 1000 + hash);
        }
        assert_eq!((packer.place_of(&head(0)), packer.place_of(&head(1))), (None, Some(1001)));
        assert_eq!(packer.places.len(), REMEMBERED);
        assert_eq!(packer.place_of(&PacketHead { len: 8, ..head(1) }), None);
    }
}
