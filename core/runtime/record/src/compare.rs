//! Compares two runs, port by port.

use std::collections::{BTreeSet, HashMap};

use panoscope_abi::{self as abi, Tick};
use panoscope_base::packet::{Cloud, PacketError};

pub use crate::content::FirstCell;
use crate::content::{self, PacketDifference};
use crate::digest::{Digests, PacketDigest, PortDigest, row_bytes};
use crate::format::PacketHead;
use crate::recording::{Packet, Recording, RecordingError};

/// How the packets of one port differ between two runs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PortDifference {
    /// `node.port`.
    pub port: String,
    /// Number of packets in the first and second run.
    pub packets: (usize, usize),
    /// Number of ticks that both runs have and whose packets differ.
    pub differing: usize,
    /// Number of ticks that only one run has.
    pub missing: usize,
    /// First tick that differs or is missing in one run: source slot and number.
    pub first: Option<(u32, u64)>,
    /// Amount of the differences, if both recordings contain the packets.
    pub amount: Option<Amount>,
    /// First tick that only one run has.
    first_missing: Option<(u32, u64)>,
}

/// Amount of differences of images, tables, clouds or bytes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Amount {
    /// Largest absolute difference of two values; for clouds the largest distance of two points in mm. Unknown packet
    /// types are compared by bytes.
    pub largest: f64,
    /// Mean absolute difference over all values of the differing packets.
    pub mean: f64,
    /// Share of pixels (cells, points, bytes) that differ in the differing packets, 0 to 1.
    pub share: f64,
    /// Number of packets whose size or format differs, so that they cannot be compared value by value.
    pub other_shape: usize,
    /// The kind of content that the numbers above describe.
    pub content: Content,
}

/// Kind of the packets' content, and where it differs.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Content {
    /// Images, or bytes of an unknown packet type.
    #[default]
    Pixels,
    /// Tables: number of the first tick that differs, and the first difference in it.
    Table(u64, FirstCell),
    /// Point clouds, in mm.
    Cloud {
        /// The position with the largest distance: number of the tick, column, row.
        farthest: Option<(u64, usize, usize)>,
        /// Number of points that only one recording has, over all packets.
        only_in_one: u64,
        /// Number of points with another colour.
        recoloured: u64,
    },
}

impl PortDifference {
    /// Whether the port is the same in both runs.
    pub fn is_nothing(&self) -> bool {
        self.differing == 0 && self.missing == 0
    }
}

/// Source slot and number of a tick.
type Key = (u32, u64);

fn key(packet: &PacketDigest) -> Key {
    (packet.source, packet.seq)
}

/// Numbers the occurrences of each tick from 1, because a rewired node may process a tick a second time.
fn numbered(ticks: impl Iterator<Item = (u32, u64)>) -> Vec<((u32, u64), u32)> {
    let mut counts: HashMap<(u32, u64), u32> = HashMap::new();
    let number = |tick| {
        let count = counts.entry(tick).or_default();
        *count += 1;
        (tick, *count)
    };
    ticks.map(number).collect()
}

/// Index pairs of the same tick in two lists.
fn matches(a: &[((u32, u64), u32)], b: &[((u32, u64), u32)]) -> Vec<(usize, usize)> {
    let index_in_b: HashMap<_, usize> = b.iter().enumerate().map(|(at, key)| (*key, at)).collect();
    a.iter().enumerate().filter_map(|(at, key)| Some((at, *index_in_b.get(key)?))).collect()
}

/// Index pairs of the same tick in two lists, the number of unmatched ticks, and the first unmatched one.
fn pairs(a: &PortDigest, b: &PortDigest) -> (Vec<(usize, usize)>, usize, Option<Key>) {
    let (left, right) = (numbered(a.packets.iter().map(key)), numbered(b.packets.iter().map(key)));
    let pairs = matches(&left, &right);
    let (mut left_missing, mut right_missing) = (vec![true; left.len()], vec![true; right.len()]);
    for (l, r) in &pairs {
        (left_missing[*l], right_missing[*r]) = (false, false);
    }
    let missing =
        left.iter().zip(&left_missing).chain(right.iter().zip(&right_missing)).filter(|(_, missing)| **missing);
    let missing: Vec<(u32, u64)> = missing.map(|((tick, _), _)| *tick).collect();
    let first = missing.iter().copied().min_by_key(|(source, seq)| (*seq, *source));
    (pairs, missing.len(), first)
}

/// Compares the fingerprints of two runs. The result contains every port, also those that are the same.
pub fn compare(a: &Digests, b: &Digests) -> Vec<PortDifference> {
    let empty = PortDigest::default();
    let ports: BTreeSet<&String> = a.ports.keys().chain(b.ports.keys()).collect();
    let one = |port: &String| {
        let (left, right) = (a.ports.get(port).unwrap_or(&empty), b.ports.get(port).unwrap_or(&empty));
        let packets = (left.packets.len(), right.packets.len());
        let (pairs, missing, first_missing) = pairs(left, right);
        let differing: Vec<(u32, u64)> = pairs
            .iter()
            .filter(|(l, r)| left.packets[*l].hash != right.packets[*r].hash)
            .map(|(l, _)| key(&left.packets[*l]))
            .collect();
        let first = differing.iter().copied().chain(first_missing).min_by_key(|(source, seq)| (*seq, *source));
        let differing = differing.len();
        PortDifference { port: port.clone(), packets, differing, missing, first, amount: None, first_missing }
    };
    ports.into_iter().map(one).collect()
}

/// Compares two recordings. Where both contain a port's packets, the result also says by how much they differ. Numbers
/// of tables count as equal up to `tolerance` times the larger one (at least 1), points of clouds up to `tolerance` mm.
///
/// # Errors
/// One of them is damaged.
pub fn compare_recordings(a: &Recording, b: &Recording, tolerance: f64) -> Result<Vec<PortDifference>, RecordingError> {
    // A damaged packet may still have the fingerprint of the undamaged one.
    a.verify()?;
    b.verify()?;
    let mut all = compare(&a.digests(), &b.digests());
    for port in all.iter_mut().filter(|p| p.differing > 0) {
        let (Some(left), Some(right)) = (a.ports.get(&port.port), b.ports.get(&port.port)) else { continue };
        let (amount, ticks) = amount(a, b, &port.port, left, right, tolerance)?;
        // Packets that differ within the tolerance do not count; ticks that only one recording has still do.
        let ticks: Vec<Key> = ticks.iter().map(|tick| (tick.source, tick.seq)).collect();
        port.first = ticks.iter().copied().chain(port.first_missing).min_by_key(|(source, seq)| (*seq, *source));
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
    for (one, two) in matches(&ticks(left), &ticks(right)) {
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

/// Converts the bytes of a row to numbers.
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
    /// Adds the difference of two packets; returns whether they differ.
    fn take(&mut self, tick: Tick, difference: &PacketDifference) -> bool {
        if !difference.differs {
            return false;
        }
        let farther = difference.largest > self.largest;
        self.largest = self.largest.max(difference.largest);
        self.sum += difference.sum;
        self.values += difference.values;
        self.pixels += difference.values;
        self.differing += difference.differing;
        self.other_shape += usize::from(difference.other_shape);
        if let Some(first) = &difference.first_cell {
            if self.content == Content::Pixels {
                self.content = Content::Table(tick.seq, first.clone());
            }
            return true;
        }
        if self.content == Content::Pixels {
            self.content = Content::Cloud { farthest: None, only_in_one: 0, recoloured: 0 };
        }
        if let Content::Cloud { farthest, only_in_one, recoloured } = &mut self.content {
            *only_in_one += difference.only_in_one;
            *recoloured += difference.recoloured;
            if farther {
                *farthest = difference.farthest.map(|(x, y)| (tick.seq, x, y));
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
                    // Two NaN are the same. A number and a NaN differ, but not by a finite amount.
                    let distance = (x - y).abs();
                    differs |= x.to_bits() != y.to_bits();
                    if distance.is_finite() {
                        self.largest = self.largest.max(distance);
                        self.sum += distance;
                    }
                    self.values += 1.0;
                }
                self.pixels += 1.0;
                self.differing += f64::from(u8::from(differs));
            }
        }
    }
}
