//! The format of a recording: an MCAP file (<https://mcap.dev/spec>), since format 5 in uncompressed chunks, see
//! [`crate::mcap_file`]. Every record is complete or absent.
//!
//! The channel [`EVENTS`] carries [`Event`]s as JSON. Every recorded port has a channel named `node.port`, whose
//! messages are a [`PacketHead`] followed by the frame's bytes, stored with a [`Coding`]. The messages of a node are in
//! the order in which they happened.
//!
//! Since format 2 every message carries a checksum: an event as the last field of its JSON object (`xxh3`), a packet in
//! its head. It covers the topic of the channel, MCAP's header of the message, and the event or the packet's head. The
//! head contains the hashes of the packet's bytes.

use panoscope_abi::{Frame, Tick};
use panoscope_graph::{Graph, ParamValue};
use serde::{Deserialize, Serialize};

use panoscope_engine::Applied;
use panoscope_engine::Machine;
use panoscope_engine::decide::Ages;
use panoscope_engine::fault::Fault;
use panoscope_engine::observe;

use crate::file_hash::{FileHash, hashes};
use crate::mcap_file::Schema;

/// Topic of the events.
pub const EVENTS: &str = "panoscope/events";
/// Message encoding of packets.
pub(crate) const PACKET_ENCODING: &str = "panoscope.packet";
/// Version of the format that is written.
pub const FORMAT: u32 = 5;
/// The oldest version that is read: its messages have no checksums.
pub const OLDEST_FORMAT: u32 = 1;
/// The first version whose messages have checksums.
pub(crate) const CHECKED_FORMAT: u32 = 2;

/// Schemas of the events and of packets. They have been in files since format 5.
pub(crate) const SCHEMAS: [Schema; 2] = [
    Schema {
        id: 1,
        name: "panoscope.Event",
        encoding: "jsonschema",
        data: r#"{"type":"object","properties":{"event":{"type":"string"},"xxh3":{"type":"string"}},"required":["event"]}"#,
    },
    Schema {
        id: 2,
        name: "panoscope.Packet",
        encoding: "x-panoscope",
        data: "little-endian: u32 source, u32 format (0 bytes, 1 gray8, 2 bgr8, 3 rgba8, 4 gray16, 5 f32, 6 cloud), u32 width, u32 height, \
            u32 bytes per row, u32 storage (0 plain, 1 packed, 2 reference), u64 tick, i64 capture time in ns, u64 bytes, u64 XXH3 of the rows, \
            u64 XXH3 of all bytes, u64 XXH3 of topic and head; then the bytes",
    },
];

/// The first event of a recording: the graph and the machine.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Head {
    /// Version of the format, see [`FORMAT`].
    pub format: u32,
    /// Version of panoscope.
    pub version: String,
    /// Path of the graph file; relative paths in the graph start from its folder.
    pub graph_path: String,
    /// Text of the graph file.
    pub text: String,
    /// `node.param=value` settings of the command line, which override the file.
    pub settings: Vec<String>,
    /// The checked graph.
    pub graph: Graph,
    /// The plugins that the graph lists.
    pub plugins: Vec<FileHash>,
    /// Files that its parameters name and that must exist, such as models.
    pub models: Vec<FileHash>,
    /// The machine that recorded it.
    pub machine: Machine,
    /// Start of the recording, in ms since 1970.
    pub unix_ms: u64,
    /// Whether all ports of all nodes are recorded, not only those of sources.
    pub all_ports: bool,
}

/// An event of a run. The events of a node are in the order in which they happened.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The first message.
    Head(Box<Head>),
    /// A source made a tick; its packets come before this event.
    Tick {
        /// The source.
        node: String,
        /// Number of the tick.
        seq: u64,
        /// Capture time of the tick, media time.
        capture_ns: i64,
        /// Number of packets that belong to it.
        packets: u32,
        /// Whether the packets are missing because the disk was too slow.
        #[serde(default)]
        gap: bool,
    },
    /// A live source's tick was dropped before it entered its region.
    Dropped {
        /// The source.
        node: String,
        /// The tick.
        seq: u64,
    },
    /// The packets that a node took whose inputs do not all belong to one tick.
    Took {
        /// The node.
        node: String,
        /// Slot of the tick's source.
        source: u32,
        /// The tick that fired it.
        seq: u64,
        /// Capture time of that tick.
        capture_ns: i64,
        /// The tick of each connection's packet, `None` where there was none.
        inputs: Vec<Option<(u32, u64)>>,
    },
    /// Input ages that a node received. Since format 3.
    Ages {
        /// The node.
        node: String,
        /// Slot of the tick's source.
        source: u32,
        /// The tick.
        seq: u64,
        /// The moment for which ages were given, ns.
        now_ns: i64,
        /// Index of the connection and arrival of its light, ns; `None` where it was unknown.
        arrived: Vec<(u32, Option<i64>)>,
    },
    /// A node had these values from this tick on.
    Values {
        /// The node.
        node: String,
        /// Slot of the tick's source.
        source: u32,
        /// The tick.
        seq: u64,
        /// All its parameters, in declaration order.
        values: Vec<ParamValue>,
    },
    /// A node was reopened before this tick, after a fault or for values that require it.
    Opened {
        /// The node.
        node: String,
        /// Slot of the tick's source.
        source: u32,
        /// The tick.
        seq: u64,
        /// All its parameters, in declaration order.
        values: Vec<ParamValue>,
    },
    /// A node skipped a tick although its inputs were complete: it was down, failed, or over its rate limit.
    #[serde(rename = "left_out")]
    Skipped {
        /// The node.
        node: String,
        /// Slot of the tick's source.
        source: u32,
        /// The tick.
        seq: u64,
        /// Whether its instance was closed.
        closed: bool,
    },
    /// A parameter was set; an [`Event::Values`] or [`Event::Opened`] has the first tick with it.
    Set {
        /// The node.
        node: String,
        /// All its parameters, in declaration order.
        values: Vec<ParamValue>,
    },
    /// The graph was changed.
    Edit {
        /// The new graph.
        graph: Box<Graph>,
        /// Number of ticks that each changed region had admitted, by the region's head.
        admitted: Vec<(String, u64)>,
        /// The effect of the change; `switched_at` has the first tick of each source in the new graph.
        applied: Box<Applied>,
        /// The plugins' files, where they changed.
        plugins: Vec<FileHash>,
    },
    /// A node failed.
    Fault(Fault),
    /// The run ended normally.
    End {
        /// Source ticks that are missing because the disk was too slow.
        gaps: u64,
    },
}

impl From<observe::Event> for Event {
    fn from(event: observe::Event) -> Self {
        use observe::Event as Observed;
        match event {
            Observed::Dropped { node, seq } => Self::Dropped { node, seq },
            Observed::Took { node, tick: Tick { source, seq, capture_ns, .. }, inputs } => {
                Self::Took { node, source, seq, capture_ns, inputs }
            }
            Observed::Ages { node, tick, ages: Ages { now_ns, arrived } } => {
                Self::Ages { node, source: tick.source, seq: tick.seq, now_ns, arrived }
            }
            Observed::Values { node, tick, values } => {
                Self::Values { node, source: tick.source, seq: tick.seq, values }
            }
            Observed::Opened { node, tick, values } => {
                Self::Opened { node, source: tick.source, seq: tick.seq, values }
            }
            Observed::Skipped { node, tick, closed } => {
                Self::Skipped { node, source: tick.source, seq: tick.seq, closed }
            }
            Observed::Set { node, values } => Self::Set { node, values },
            Observed::Edit { graph, admitted, applied, plugins } => {
                Self::Edit { graph, admitted, applied, plugins: hashes(&plugins) }
            }
            Observed::Fault(fault) => Self::Fault(fault),
        }
    }
}

/// Bytes of a [`PacketHead`] in format 1.
pub(crate) const PLAIN_HEAD_BYTES: usize = 56;
/// Bytes of a [`PacketHead`] since format 2: followed by the hash of padded rows and the checksum of the message.
pub(crate) const PACKET_HEAD_BYTES: usize = 72;
/// Number of bytes of a [`PacketHead`] that the message's checksum covers.
pub(crate) const SUMMED_HEAD_BYTES: usize = 64;

/// Storage of a packet's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coding {
    /// Uncompressed.
    Plain,
    /// Differences, compressed by zstd.
    Packed,
    /// Offset in the file at which the same bytes are stored.
    Reference,
}

impl Coding {
    /// Number in the head of a packet.
    pub(crate) fn number(self) -> u32 {
        match self {
            Self::Plain => 0,
            Self::Packed => 1,
            Self::Reference => 2,
        }
    }

    pub(crate) fn of(number: u32) -> Option<Self> {
        [Self::Plain, Self::Packed, Self::Reference].into_iter().find(|coding| coding.number() == number)
    }
}

/// Description of a packet, before its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PacketHead {
    /// The packet's tick.
    pub tick: Tick,
    /// One of the ABI's `FORMAT_` constants.
    pub format: u32,
    /// Width in px or points; 0 for packets without rows.
    pub width: u32,
    /// Height in px or points.
    pub height: u32,
    /// Bytes from one row to the next.
    pub stride_bytes: u32,
    /// Number of bytes in memory.
    pub len: u64,
    /// Fingerprint, see [`super::digest::packet_hash`].
    pub hash: u64,
    /// XXH3 of all bytes when rows are padded, else 0; `hash` does not cover the padding.
    pub padded: u64,
    /// Storage of the bytes. Since format 4; plain before.
    pub coding: Coding,
}

impl PacketHead {
    pub(crate) fn of(frame: &Frame, hash: u64, padded: u64) -> Self {
        let Frame { format, width, height, stride_bytes, tick, len, .. } = *frame;
        Self { tick, format, width, height, stride_bytes, len: len as u64, hash, padded, coding: Coding::Plain }
    }

    pub(crate) fn write(&self, out: &mut Vec<u8>) {
        for number in [self.tick.source, self.format, self.width, self.height, self.stride_bytes, self.coding.number()]
        {
            out.extend(number.to_le_bytes());
        }
        out.extend(self.tick.seq.to_le_bytes());
        out.extend(self.tick.capture_ns.to_le_bytes());
        out.extend(self.len.to_le_bytes());
        out.extend(self.hash.to_le_bytes());
        out.extend(self.padded.to_le_bytes());
    }

    /// Reads a head of format 1, or the first part of a newer one. `None` if the storage is unknown.
    pub(crate) fn read(bytes: &[u8; PLAIN_HEAD_BYTES]) -> Option<Self> {
        let four = |at: usize| bytes[at..at + 4].iter().rev().fold(0u32, |n, b| n << 8 | u32::from(*b));
        let eight = |at: usize| bytes[at..at + 8].iter().rev().fold(0u64, |n, b| n << 8 | u64::from(*b));
        let tick = Tick { source: four(0), flags: 0, seq: eight(24), capture_ns: eight(32) as i64 };
        let (format, width, height, stride_bytes) = (four(4), four(8), four(12), four(16));
        let coding = Coding::of(four(20))?;
        Some(Self { tick, format, width, height, stride_bytes, len: eight(40), hash: eight(48), padded: 0, coding })
    }
}
