//! Fingerprints of a run's packets: one per packet and one per port.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::Path;

use panoscope_abi::Frame;
use panoscope_base::format::pixel_bytes;
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::{Xxh3, xxh3_64};

use panoscope_engine::memory::FrameRef;

/// Bytes of a row's pixels without padding; 0 for formats without rows.
pub(crate) fn row_bytes(format: u32, width: u32) -> usize {
    width as usize * pixel_bytes(format)
}

/// XXH3 of a packet's description and pixels. Row padding is not hashed, because its contents are unspecified.
pub fn packet_hash(frame: &Frame, bytes: &[u8]) -> u64 {
    let mut hash = Xxh3::new();
    hash.update(&[frame.format.to_le_bytes(), frame.width.to_le_bytes(), frame.height.to_le_bytes()].concat());
    let row = row_bytes(frame.format, frame.width);
    let stride = frame.stride_bytes as usize;
    if row == 0 || stride <= row {
        hash.update(bytes);
    } else {
        for line in bytes.chunks(stride).take(frame.height as usize) {
            hash.update(&line[..row.min(line.len())]);
        }
    }
    hash.digest()
}

/// XXH3 of all bytes of a packet whose rows are padded; 0 for others, whose bytes [`packet_hash`] covers completely.
pub(crate) fn padded_hash(frame: &Frame, bytes: &[u8]) -> u64 {
    let row = row_bytes(frame.format, frame.width);
    if row == 0 || frame.stride_bytes as usize <= row { 0 } else { xxh3_64(bytes) }
}

/// XXH3 of a file, as hexadecimal digits, and its length.
pub fn file_hash(path: &Path) -> std::io::Result<(String, u64)> {
    let mut file = File::open(path)?;
    let mut hash = Xxh3::new();
    let mut buffer = vec![0; 1 << 16];
    let mut total = 0;
    loop {
        match std::io::Read::read(&mut file, &mut buffer)? {
            0 => return Ok((format!("{:032x}", hash.digest128()), total)),
            n => {
                hash.update(&buffer[..n]);
                total += n as u64;
            }
        }
    }
}

/// A packet's tick and fingerprint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PacketDigest {
    /// Slot of the source.
    pub source: u32,
    /// Number of the tick.
    pub seq: u64,
    /// The fingerprint, see [`packet_hash`].
    pub hash: u64,
}

impl Serialize for PacketDigest {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // Numbers above 2^53 do not survive every JSON reader.
        (self.source, self.seq, format!("{:016x}", self.hash)).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for PacketDigest {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (source, seq, hash) = <(u32, u64, String)>::deserialize(deserializer)?;
        let hash = u64::from_str_radix(&hash, 16).map_err(serde::de::Error::custom)?;
        Ok(Self { source, seq, hash })
    }
}

/// The packets of one port, in order.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortDigest {
    /// Fingerprint of all packets and their ticks, as hexadecimal digits.
    pub digest: String,
    /// Source slot, tick and fingerprint of each packet.
    pub packets: Vec<PacketDigest>,
}

/// Fingerprints of all ports of a run, by `node.port`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Digests {
    /// Name of the graph.
    pub graph: String,
    /// The ports, by `node.port`.
    pub ports: BTreeMap<String, PortDigest>,
}

impl Digests {
    /// Appends a packet to a port.
    pub(crate) fn add(&mut self, port: &str, packet: PacketDigest) {
        if !self.ports.contains_key(port) {
            self.ports.insert(port.to_owned(), PortDigest::default());
        }
        if let Some(port) = self.ports.get_mut(port) {
            port.packets.push(packet);
        }
    }

    /// Computes the ports' fingerprints.
    pub(crate) fn finish(&mut self) {
        for port in self.ports.values_mut() {
            let mut all = Vec::with_capacity(port.packets.len() * 20);
            for packet in &port.packets {
                all.extend(packet.source.to_le_bytes());
                all.extend(packet.seq.to_le_bytes());
                all.extend(packet.hash.to_le_bytes());
            }
            port.digest = format!("{:016x}", xxh3_64(&all));
        }
    }

    /// Number of packets of all ports.
    pub fn packets(&self) -> usize {
        self.ports.values().map(|p| p.packets.len()).sum()
    }

    /// Writes the fingerprints as JSON.
    pub fn write(&self, path: &Path) -> std::io::Result<()> {
        let mut file = BufWriter::new(File::create(path)?);
        serde_json::to_writer(&mut file, self)?;
        file.write_all(b"\n")?;
        file.flush()
    }

    /// Reads a file that [`Self::write`] wrote.
    pub fn read(path: &Path) -> std::io::Result<Self> {
        Ok(serde_json::from_reader(BufReader::new(File::open(path)?))?)
    }
}

/// The fingerprint of a frame in the host's memory.
pub(crate) fn digest_of(frame: &FrameRef) -> PacketDigest {
    let tick = frame.tick();
    PacketDigest { source: tick.source, seq: tick.seq, hash: packet_hash(frame.frame(), frame.bytes()) }
}
