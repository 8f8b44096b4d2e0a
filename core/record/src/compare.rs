//! Where two runs differ.

use std::collections::{BTreeSet, HashMap};

use panoscope_abi::{self as abi, Tick};
use panoscope_base::packet::{Cloud, PacketError};

pub use crate::content::FirstCell;
use crate::content::{self, Apart};
use crate::digest::{Digests, PacketDigest, PortDigest, row_bytes};
use crate::format::PacketHead;
use crate::recording::{Packet, Recording, RecordingError};

/// How far a port is from its other self.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PortDifference {
    /// `node.port`.
    pub port: String,
    /// Packets in the first and second run.
    pub packets: (usize, usize),
    /// Packets of ticks that both have and that differ.
    pub differing: usize,
    /// Ticks that only one of them has.
    pub missing: usize,
    /// First tick that differs: source slot and number.
    pub first: Option<(u32, u64)>,
    /// How far apart the differing packets are, where both recordings hold them.
    pub amount: Option<Amount>,
    /// First tick that only one of them has.
    lonely: Option<(u32, u64)>,
}

/// How far apart pictures or bytes are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Amount {
    /// Largest absolute difference of two values; distance of two points in mm; of bytes where the packet's type is not known.
    pub largest: f64,
    /// Mean absolute difference over all values of the differing packets.
    pub mean: f64,
    /// Share of pixels (cells, points, bytes) that differ in them.
    pub share: f64,
    /// Packets of another size or format, which cannot be laid over each other.
    pub other_shape: usize,
    /// What the numbers above are of.
    pub content: Content,
}

/// What packets hold, and what differs in them.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Content {
    /// Pictures, or bytes of a type that is not known here.
    #[default]
    Pixels,
    /// Tables: number of the tick that differs first, and what differs there first.
    Table(u64, FirstCell),
    /// Clouds, in mm.
    Cloud {
        /// Where the farthest two points are: number of the tick, column, row.
        farthest: Option<(u64, usize, usize)>,
        /// Points that only one recording knows, all packets together.
        only_in_one: u64,
        /// Points with another colour.
        recoloured: u64,
    },
}

impl PortDifference {
    /// Whether both are the same.
    pub fn is_nothing(&self) -> bool {
        self.differing == 0 && self.missing == 0
    }
}

/// Source slot and number of a tick.
type Key = (u32, u64);

fn key(packet: &PacketDigest) -> Key {
    (packet.source, packet.seq)
}

/// Ticks with how often each came before: a node that is rewired may meet one again.
fn numbered(ticks: impl Iterator<Item = (u32, u64)>) -> Vec<((u32, u64), u32)> {
    let mut seen: HashMap<(u32, u64), u32> = HashMap::new();
    let number = |tick| {
        let count = seen.entry(tick).or_default();
        *count += 1;
        (tick, *count)
    };
    ticks.map(number).collect()
}

/// Places of the same tick in two lists.
fn places(a: &[((u32, u64), u32)], b: &[((u32, u64), u32)]) -> Vec<(usize, usize)> {
    let known: HashMap<_, usize> = b.iter().enumerate().map(|(at, key)| (*key, at)).collect();
    a.iter().enumerate().filter_map(|(at, key)| Some((at, *known.get(key)?))).collect()
}

/// Pairs of the same tick in two lists, how many have no partner, and the first without one.
fn pairs(a: &PortDigest, b: &PortDigest) -> (Vec<(usize, usize)>, usize, Option<Key>) {
    let (left, right) = (numbered(a.packets.iter().map(key)), numbered(b.packets.iter().map(key)));
    let pairs = places(&left, &right);
    let (mut alone_left, mut alone_right) = (vec![true; left.len()], vec![true; right.len()]);
    for (l, r) in &pairs {
        (alone_left[*l], alone_right[*r]) = (false, false);
    }
    let lonely = left.iter().zip(&alone_left).chain(right.iter().zip(&alone_right)).filter(|(_, alone)| **alone);
    let lonely: Vec<(u32, u64)> = lonely.map(|((tick, _), _)| *tick).collect();
    let first = lonely.iter().copied().min_by_key(|(source, seq)| (*seq, *source));
    (pairs, lonely.len(), first)
}

/// Compares the fingerprints of two runs, port by port; ports that are the same are in the answer too.
pub fn compare(a: &Digests, b: &Digests) -> Vec<PortDifference> {
    let empty = PortDigest::default();
    let ports: BTreeSet<&String> = a.ports.keys().chain(b.ports.keys()).collect();
    let one = |port: &String| {
        let (left, right) = (a.ports.get(port).unwrap_or(&empty), b.ports.get(port).unwrap_or(&empty));
        let packets = (left.packets.len(), right.packets.len());
        let (pairs, missing, lonely) = pairs(left, right);
        let differing: Vec<(u32, u64)> = pairs
            .iter()
            .filter(|(l, r)| left.packets[*l].hash != right.packets[*r].hash)
            .map(|(l, _)| key(&left.packets[*l]))
            .collect();
        let first = differing.iter().copied().chain(lonely).min_by_key(|(source, seq)| (*seq, *source));
        PortDifference { port: port.clone(), packets, differing: differing.len(), missing, first, amount: None, lonely }
    };
    ports.into_iter().map(one).collect()
}

/// Compares two recordings; where both hold a port's packets, it is also said by how much they differ. Numbers of tables count as equal
/// up to `tolerance` of the larger one (of 1 at least), points of clouds up to `tolerance` mm.
///
/// # Errors
/// One of them is damaged.
pub fn compare_recordings(a: &Recording, b: &Recording, tolerance: f64) -> Result<Vec<PortDifference>, RecordingError> {
    // Fingerprints alone would call a damaged packet equal.
    a.verify()?;
    b.verify()?;
    let mut all = compare(&a.digests(), &b.digests());
    for port in all.iter_mut().filter(|p| p.differing > 0) {
        let (Some(left), Some(right)) = (a.ports.get(&port.port), b.ports.get(&port.port)) else { continue };
        let (amount, ticks) = amount(a, b, &port.port, left, right, tolerance)?;
        // What differs in bytes only does not differ; ticks that only one has stay.
        let ticks: Vec<Key> = ticks.iter().map(|tick| (tick.source, tick.seq)).collect();
        port.first = ticks.iter().copied().chain(port.lonely).min_by_key(|(source, seq)| (*seq, *source));
        port.differing = ticks.len();
        port.amount = (port.differing > 0).then_some(amount);
    }
    Ok(all)
}

#[derive(Default)]
struct Sums {
    largest: f64,
    sum: f64,
    values: f64,
    pixels: f64,
    differing: f64,
    other_shape: usize,
    content: Content,
}

fn amount(
    a: &Recording,
    b: &Recording,
    port: &str,
    left: &[Packet],
    right: &[Packet],
    tolerance: f64,
) -> Result<(Amount, Vec<Tick>), RecordingError> {
    let mut differing = Vec::new();
    let mut sums = Sums::default();
    let ticks = |list: &[Packet]| numbered(list.iter().map(|p| (p.head.tick.source, p.head.tick.seq)));
    for (one, two) in places(&ticks(left), &ticks(right)) {
        let (packet, other) = (&left[one], &right[two]);
        if other.head.hash == packet.head.hash {
            continue;
        }
        let tick = packet.head.tick;
        let plain = packet.head.format == abi::FORMAT_BYTES;
        if plain && other.head.format == abi::FORMAT_BYTES {
            let (bytes, others) = (a.bytes(port, packet)?, b.bytes(port, other)?);
            if let (Some(one), Some(two)) = (content::table(&bytes), content::table(&others)) {
                if sums.take(tick, &content::tables(&one, &two, tolerance)) {
                    differing.push(tick);
                }
                continue;
            }
        }
        let shape = |h: &PacketHead| (h.format, h.width, h.height);
        if packet.head.format == abi::FORMAT_CLOUD && shape(&packet.head) == shape(&other.head) {
            let (bytes, others) = (a.bytes(port, packet)?, b.bytes(port, other)?);
            if let (Ok(one), Ok(two)) = (cloud(&packet.head, &bytes), cloud(&other.head, &others)) {
                if sums.take(tick, &content::clouds(&one, &two, tolerance)) {
                    differing.push(tick);
                }
                continue;
            }
        }
        differing.push(tick);
        if shape(&packet.head) != shape(&other.head) || (plain && packet.head.len != other.head.len) {
            sums.other_shape += 1;
            continue;
        }
        sums.add(&packet.head, &a.bytes(port, packet)?, &other.head, &b.bytes(port, other)?);
    }
    let over = |sum: f64, count: f64| if count > 0.0 { sum / count } else { 0.0 };
    let amount = Amount {
        largest: sums.largest,
        mean: over(sums.sum, sums.values),
        share: over(sums.differing, sums.pixels),
        other_shape: sums.other_shape,
        content: sums.content,
    };
    Ok((amount, differing))
}

fn cloud<'b>(head: &PacketHead, bytes: &'b [u8]) -> Result<Cloud<'b>, PacketError> {
    Cloud::parse(bytes, head.width as usize, head.height as usize, head.stride_bytes as usize)
}

/// The numbers of a pixel or byte group.
fn values(format: u32, bytes: &[u8], out: &mut Vec<f64>) {
    out.clear();
    match format {
        abi::FORMAT_F32 => {
            out.extend(bytes.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))));
        }
        abi::FORMAT_GRAY16 => out.extend(bytes.chunks_exact(2).map(|b| f64::from(u16::from_le_bytes([b[0], b[1]])))),
        _ => out.extend(bytes.iter().map(|b| f64::from(*b))),
    }
}

impl Sums {
    /// Takes how two packets differ; answers whether they do.
    fn take(&mut self, tick: Tick, apart: &Apart) -> bool {
        if !apart.differs {
            return false;
        }
        let farther = apart.largest > self.largest;
        self.largest = self.largest.max(apart.largest);
        self.sum += apart.sum;
        self.values += apart.values;
        self.pixels += apart.values;
        self.differing += apart.differing;
        self.other_shape += usize::from(apart.other_shape);
        if let Some(first) = &apart.first_cell {
            if self.content == Content::Pixels {
                self.content = Content::Table(tick.seq, first.clone());
            }
            return true;
        }
        if self.content == Content::Pixels {
            self.content = Content::Cloud { farthest: None, only_in_one: 0, recoloured: 0 };
        }
        if let Content::Cloud { farthest, only_in_one, recoloured } = &mut self.content {
            *only_in_one += apart.only_in_one;
            *recoloured += apart.recoloured;
            if farther {
                *farthest = apart.farthest.map(|(x, y)| (tick.seq, x, y));
            }
        }
        true
    }

    fn add(&mut self, left: &PacketHead, a: &[u8], right: &PacketHead, b: &[u8]) {
        let row = row_bytes(left.format, left.width);
        let (mut one, mut two) = (Vec::new(), Vec::new());
        let per_pixel = match left.format {
            abi::FORMAT_BGR8 => 3,
            abi::FORMAT_RGBA8 => 4,
            abi::FORMAT_CLOUD => 16,
            _ => 1,
        };
        let line = |bytes: &[u8], stride: u32, y: usize| -> Vec<u8> {
            let begin = y * stride as usize;
            bytes.get(begin..begin + row).unwrap_or_default().to_vec()
        };
        let rows = if row == 0 { 1 } else { left.height as usize };
        for y in 0..rows {
            if row == 0 {
                values(abi::FORMAT_GRAY8, a, &mut one);
                values(abi::FORMAT_GRAY8, b, &mut two);
            } else {
                values(left.format, &line(a, left.stride_bytes, y), &mut one);
                values(right.format, &line(b, right.stride_bytes, y), &mut two);
            }
            for (one, two) in one.chunks(per_pixel).zip(two.chunks(per_pixel)) {
                let mut differs = false;
                for (x, y) in one.iter().zip(two) {
                    // Two unknowns are the same; a known and an unknown differ, by nothing that can be told.
                    let apart = (x - y).abs();
                    differs |= x.to_bits() != y.to_bits();
                    if apart.is_finite() {
                        self.largest = self.largest.max(apart);
                        self.sum += apart;
                    }
                    self.values += 1.0;
                }
                self.pixels += 1.0;
                self.differing += f64::from(u8::from(differs));
            }
        }
    }
}
