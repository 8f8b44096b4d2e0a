//! Messages between a window and a running graph: JSON, and packets as a JSON head followed by bytes.
//!
//! Both sides must be of one version, which is compared first. Neither trusts the other: a malformed message ends the
//! connection.

use std::collections::BTreeMap;

use panoscope_engine::NodeWindow;
use panoscope_engine::fault::Fault;
use panoscope_graph::{Catalog, Graph, ParamValue};
use serde::{Deserialize, Serialize};

use crate::attach::packet::{self, Packet, PacketError};
use crate::attach::tunnel::{Frame, Kind};

/// Maximum number of outputs whose packets a window receives.
pub const MAX_OUTPUTS: usize = 256;
/// Maximum length of a graph's text, bytes.
pub const MAX_TEXT_BYTES: usize = 16 << 20;
/// First byte of a message in JSON.
const JSON: u8 = b'J';
/// First byte of a packet.
const PACKET: u8 = b'P';

/// An output whose packets a window requests.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Wanted {
    /// The node.
    pub node: String,
    /// Its output.
    pub port: String,
    /// Maximum width of an image, px.
    pub max_width: u32,
    /// Its group, 0 for none. Of the outputs of a group of two, packets of one tick are sent.
    pub group: u32,
}

/// A command from a window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// Sends packets of these outputs and of no others.
    Preview {
        /// The outputs.
        wanted: Vec<Wanted>,
        /// Minimum time between two packets of one output.
        interval_ms: u64,
    },
    /// Acknowledges a packet of this output.
    Taken {
        /// The node.
        node: String,
        /// Its output.
        port: String,
    },
    /// Replaces the running graph by the one in `text`. Answered by [`Message::Ran`].
    Run {
        /// Identifies the answer.
        id: u64,
        /// The text that was edited. Nothing changes if another text runs by now.
        base: String,
        /// The new text.
        text: String,
    },
}

/// A running graph as a window sees it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opened {
    /// The running text: the file with its parts, overlays and arguments in one.
    pub text: String,
    /// The graph of that text; its types are in `catalog`.
    pub graph: Graph,
    /// The node types of the graph.
    pub catalog: Catalog,
    /// Whether this window may edit.
    pub may_edit: bool,
    /// Description of who changed the graph last; empty before the first change.
    pub changed_by: String,
}

/// A change that was refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refused {
    /// The node that caused it, if there is one.
    pub node: Option<String>,
    /// The reason, as text.
    pub words: String,
}

/// A message from the running side.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Message {
    /// The graph; sent first, and after every change.
    Opened(Box<Opened>),
    /// Counters and times of each node since the previous message.
    Counters(BTreeMap<String, NodeWindow>),
    /// The newest faults, oldest first.
    Faults(Vec<Fault>),
    /// Values of the parameters of nodes.
    Values(BTreeMap<String, Vec<ParamValue>>),
    /// Result of a [`Command::Run`]: the change, or why there was none.
    Ran {
        /// The `id` of the command.
        id: u64,
        /// Description of the change, or the refusal.
        result: Result<String, Refused>,
    },
    /// The run has ended.
    Ended {
        /// The reason, as text.
        words: String,
    },
}

/// A message or packet received by a window.
pub enum Incoming {
    /// A message.
    Message(Message),
    /// A packet of an output.
    Packet(Box<Packet>),
}

/// A malformed message.
#[derive(Debug, thiserror::Error)]
pub enum BadMessage {
    /// Neither JSON nor a packet, or too long.
    #[error("a message of another machine is malformed; install the same version on both")]
    Malformed,
    /// JSON of an unexpected form.
    #[error("a message of another machine is malformed ({0}); install the same version on both")]
    Json(#[from] serde_json::Error),
    /// A damaged packet.
    #[error(transparent)]
    Packet(#[from] PacketError),
}

fn json<T: Serialize>(value: &T) -> Vec<u8> {
    let mut bytes = vec![JSON];
    // What is sent here has text keys and finite numbers, see `NodeWindow::finite`.
    if serde_json::to_writer(&mut bytes, value).is_err() {
        bytes.truncate(1);
    }
    bytes
}

/// Encodes a command.
pub fn write_command(command: &Command) -> Vec<u8> {
    json(command)
}

/// Encodes a message.
pub fn write_message(message: &Message) -> Vec<u8> {
    json(message)
}

/// The state in a frame that a later frame may replace; `None` for frames that must all arrive.
pub(crate) fn state_of(frame: &Frame) -> Option<&'static str> {
    let text = frame.bytes.strip_prefix(&[JSON, b'{', b'"'])?;
    let states = ["Opened", "Counters", "Faults", "Values"].into_iter();
    states.filter(|_| frame.kind == Kind::Data).find(|state| text.starts_with(state.as_bytes()))
}

/// Encodes a packet.
pub fn write_packet(packet: &packet::Outgoing) -> Vec<u8> {
    let mut bytes = vec![PACKET];
    packet.write(&mut bytes);
    bytes
}

/// Decodes a command of a window.
///
/// # Errors
/// It is malformed or exceeds a limit.
pub fn read_command(bytes: &[u8]) -> Result<Command, BadMessage> {
    let Some((&JSON, rest)) = bytes.split_first() else { return Err(BadMessage::Malformed) };
    let command = serde_json::from_slice(rest)?;
    match &command {
        Command::Preview { wanted, .. } if wanted.len() > MAX_OUTPUTS => Err(BadMessage::Malformed),
        Command::Run { base, text, .. } if base.len().max(text.len()) > MAX_TEXT_BYTES => Err(BadMessage::Malformed),
        _ => Ok(command),
    }
}

/// Decodes a message or packet of the running side.
///
/// # Errors
/// It is malformed.
pub fn read_incoming(bytes: &[u8]) -> Result<Incoming, BadMessage> {
    match bytes.split_first() {
        Some((&JSON, rest)) => Ok(Incoming::Message(checked(serde_json::from_slice(rest)?)?)),
        Some((&PACKET, rest)) => Ok(Incoming::Packet(Box::new(Packet::read(rest)?))),
        _ => Err(BadMessage::Malformed),
    }
}

/// Checks what a window relies on: that a graph's indices are inside the graph and its catalogue.
fn checked(message: Message) -> Result<Message, BadMessage> {
    let Message::Opened(opened) = &message else { return Ok(message) };
    let Opened { graph, catalog, .. } = &**opened;
    let ports = |node: usize| {
        let node_type = catalog.node_types.get(graph.nodes.get(node)?.type_index)?;
        Some((node_type.inputs.len(), node_type.outputs.len(), node_type.params.len()))
    };
    let edges = graph.edges.iter().all(|edge| {
        let (from, to) = (ports(edge.from_node), ports(edge.to_node));
        from.is_some_and(|(_, outputs, _)| edge.from_port < outputs)
            && to.is_some_and(|(inputs, ..)| edge.to_port < inputs)
    });
    let nodes = (0..graph.nodes.len())
        .all(|node| ports(node).is_some_and(|(.., params)| graph.nodes[node].params.len() <= params));
    let views =
        graph.preset.views.iter().all(|view| ports(view.node).is_some_and(|(_, outputs, _)| view.port < outputs));
    let pins = graph.preset.pinned.iter().all(|pin| ports(pin.node).is_some_and(|(.., params)| pin.param < params));
    if edges && nodes && views && pins { Ok(message) } else { Err(BadMessage::Malformed) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_and_messages_arrive_as_they_were_sent() {
        let command = Command::Run { id: 1, base: "a".to_owned(), text: "b".to_owned() };
        assert_eq!(read_command(&write_command(&command)).expect("a command"), command);
        let nodes = BTreeMap::from([(
            "a".to_owned(),
            NodeWindow { fps: f64::NAN, count: 3, ..NodeWindow::default() }.finite(),
        )]);
        match read_incoming(&write_message(&Message::Counters(nodes.clone()))).expect("a message") {
            Incoming::Message(Message::Counters(arrived)) => assert_eq!(arrived, nodes),
            _ => panic!("counters"),
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        let wanted = Wanted { node: "a".to_owned(), port: "b".to_owned(), max_width: 1, group: 0 };
        let greedy = Command::Preview { wanted: vec![wanted; MAX_OUTPUTS + 1], interval_ms: 1 };
        for bytes in [&b""[..], b"x", b"J", b"J{}", b"J{\"Run\":1}", &write_command(&greedy)] {
            assert!(read_command(bytes).is_err());
        }
        for bytes in [&b""[..], b"x", b"J", b"J[]", b"P"] {
            assert!(read_incoming(bytes).is_err());
        }
    }
}
