//! What stands in a recording: an MCAP file (<https://mcap.dev/spec>) without chunks, so that every record is whole or absent.
//!
//! The channel [`EVENTS`] carries [`Event`]s as JSON. Every recorded port has a channel of its own, named `node.port`, whose messages are a
//! [`PacketHead`] followed by the frame's bytes as they lay in memory. All messages are in the order in which things happened to
//! their node.
//!
//! Since format 2 every message carries a checksum: an event as the last field of its JSON object (`xxh3`), a packet in its head. It covers
//! the topic of the channel, MCAP's header of the message, and the event or the packet's head. The head holds the sums of the packet's bytes.

use panoscope_abi::{Frame, Tick};
use panoscope_graph::{Graph, ParamValue};
use serde::{Deserialize, Serialize};

use panoscope_engine::Applied;
use panoscope_engine::Machine;
use panoscope_engine::fault::Fault;
use panoscope_engine::observe;

use crate::file_hash::{FileHash, hashes};

/// Topic of the events.
pub const EVENTS: &str = "panoscope/events";
/// Message encoding of packets.
pub(crate) const PACKET_ENCODING: &str = "panoscope.packet";
/// Number of the format that is written.
pub const FORMAT: u32 = 2;
/// The oldest format that is read: its messages carry no checksums.
pub const OLDEST_FORMAT: u32 = 1;
/// The first format whose messages carry checksums.
pub(crate) const CHECKED_FORMAT: u32 = 2;

/// What a recording begins with.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Head {
    /// [`FORMAT`].
    pub format: u32,
    /// Version of panoscope.
    pub version: String,
    /// Where the graph file lay; relative paths in it start from its folder.
    pub graph_path: String,
    /// The graph file.
    pub text: String,
    /// `node.param=value` of the command line, which win over the file.
    pub settings: Vec<String>,
    /// The checked graph.
    pub graph: Graph,
    /// The plugins it lists.
    pub plugins: Vec<FileHash>,
    /// Files that its parameters name and that must exist, such as models.
    pub models: Vec<FileHash>,
    /// Where it was recorded.
    pub machine: Machine,
    /// When, in ms since 1970.
    pub unix_ms: u64,
    /// Whether all ports of all nodes are in the recording, not only those of sources.
    pub all_ports: bool,
}

/// What happened, in the order in which it happened to its node.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The first message.
    Head(Box<Head>),
    /// A source made a tick; its packets stand before this.
    Tick {
        /// The source.
        node: String,
        /// Number of the tick.
        seq: u64,
        /// Media time.
        capture_ns: i64,
        /// Packets that belong to it.
        packets: u32,
        /// The disk was too slow: the packets are not in the recording.
        #[serde(default)]
        gap: bool,
    },
    /// A live source's tick was dropped where it would have entered.
    Dropped {
        /// The source.
        node: String,
        /// The tick.
        seq: u64,
    },
    /// Which packets a node took whose inputs do not all belong to one tick.
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
    /// From this tick on a node had these values.
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
    /// Before this tick a node was opened anew: after a fault, or with values that need it.
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
    /// A node made nothing of a tick although its inputs were there: it was down, failed, or had been called just before.
    LeftOut {
        /// The node.
        node: String,
        /// Slot of the tick's source.
        source: u32,
        /// The tick.
        seq: u64,
        /// Its instance was given up.
        closed: bool,
    },
    /// A parameter was set; a [`Event::Values`] or [`Event::Opened`] says from which tick on.
    Set {
        /// The node.
        node: String,
        /// All its parameters, in declaration order.
        values: Vec<ParamValue>,
    },
    /// The graph was changed.
    Edit {
        /// The graph from then on.
        graph: Box<Graph>,
        /// Ticks that the regions it touched had admitted, by head.
        admitted: Vec<(String, u64)>,
        /// What it did; `switched_at` names the first tick of each source that met the new graph.
        applied: Box<Applied>,
        /// The plugins' files, where they changed.
        plugins: Vec<FileHash>,
    },
    /// A fault.
    Fault(Fault),
    /// The run ended in good order.
    End {
        /// Source ticks that are missing because the disk was too slow.
        gaps: u64,
    },
}

impl From<observe::Event> for Event {
    fn from(event: observe::Event) -> Self {
        use observe::Event as Seen;
        match event {
            Seen::Dropped { node, seq } => Self::Dropped { node, seq },
            Seen::Took { node, tick: Tick { source, seq, capture_ns, .. }, inputs } => {
                Self::Took { node, source, seq, capture_ns, inputs }
            }
            Seen::Values { node, tick, values } => Self::Values { node, source: tick.source, seq: tick.seq, values },
            Seen::Opened { node, tick, values } => Self::Opened { node, source: tick.source, seq: tick.seq, values },
            Seen::Skipped { node, tick, closed } => Self::LeftOut { node, source: tick.source, seq: tick.seq, closed },
            Seen::Set { node, values } => Self::Set { node, values },
            Seen::Edit { graph, admitted, applied, plugins } => {
                Self::Edit { graph, admitted, applied, plugins: hashes(&plugins) }
            }
            Seen::Fault(fault) => Self::Fault(fault),
        }
    }
}

/// Bytes of a [`PacketHead`] in format 1.
pub(crate) const PLAIN_HEAD_BYTES: usize = 56;
/// Bytes of a [`PacketHead`] since format 2: with the sum of padded rows, and the message's own behind all.
pub(crate) const PACKET_HEAD_BYTES: usize = 72;
/// Of these, the ones that the message's sum covers.
pub(crate) const SUMMED_HEAD_BYTES: usize = 64;

/// Description of a packet, before its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PacketHead {
    /// The packet's tick.
    pub tick: Tick,
    /// One of the contract's `FORMAT_` numbers.
    pub format: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from row to row.
    pub stride_bytes: u32,
    /// Bytes that follow.
    pub len: u64,
    /// See [`super::digest::packet_hash`].
    pub hash: u64,
    /// XXH3 of all bytes where rows are padded, else 0: `hash` leaves the padding out.
    pub padded: u64,
}

impl PacketHead {
    pub(crate) fn of(frame: &Frame, hash: u64, padded: u64) -> Self {
        let Frame { format, width, height, stride_bytes, tick, len, .. } = *frame;
        Self { tick, format, width, height, stride_bytes, len: len as u64, hash, padded }
    }

    pub(crate) fn write(&self, out: &mut Vec<u8>) {
        for number in [self.tick.source, self.format, self.width, self.height, self.stride_bytes, 0] {
            out.extend(number.to_le_bytes());
        }
        out.extend(self.tick.seq.to_le_bytes());
        out.extend(self.tick.capture_ns.to_le_bytes());
        out.extend(self.len.to_le_bytes());
        out.extend(self.hash.to_le_bytes());
        out.extend(self.padded.to_le_bytes());
    }

    /// Reads a head of format 1, or the beginning of a newer one.
    pub(crate) fn read(bytes: &[u8; PLAIN_HEAD_BYTES]) -> Self {
        let four = |at: usize| bytes[at..at + 4].iter().rev().fold(0u32, |n, b| n << 8 | u32::from(*b));
        let eight = |at: usize| bytes[at..at + 8].iter().rev().fold(0u64, |n, b| n << 8 | u64::from(*b));
        let tick = Tick { source: four(0), flags: 0, seq: eight(24), capture_ns: eight(32) as i64 };
        let (format, width, height, stride_bytes) = (four(4), four(8), four(12), four(16));
        Self { tick, format, width, height, stride_bytes, len: eight(40), hash: eight(48), padded: 0 }
    }
}
