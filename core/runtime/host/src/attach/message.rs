//! What a window and a running graph say to each other: JSON, and packets with bytes behind a head in JSON.
//!
//! Both sides are of one version, which is compared first. Neither believes the other: what is malformed ends the connection.

use std::collections::BTreeMap;

use panoscope_engine::NodeWindow;
use panoscope_engine::fault::Fault;
use panoscope_graph::{Catalog, Graph, ParamValue};
use serde::{Deserialize, Serialize};

use crate::attach::packet::{self, Packet, PacketError};
use crate::attach::tunnel::{Frame, Kind};

/// Maximum number of outputs of which a window gets pictures.
pub const MAX_OUTPUTS: usize = 256;
/// Longest text of a graph.
pub const MAX_TEXT_BYTES: usize = 16 << 20;
/// First byte of a message in JSON.
const JSON: u8 = b'J';
/// First byte of a packet.
const PACKET: u8 = b'P';

/// An output of which a window wants packets.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Wanted {
    /// The node.
    pub node: String,
    /// Its output.
    pub port: String,
    /// Maximum width of a picture, px.
    pub max_width: u32,
}

/// What a window sends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// Send packets of these outputs, and of no others.
    Preview {
        /// The outputs.
        wanted: Vec<Wanted>,
        /// Minimum time between two packets of one.
        interval_ms: u64,
    },
    /// A packet of this output was taken.
    Taken {
        /// The node.
        node: String,
        /// Its output.
        port: String,
    },
    /// Make the running graph the one of `text`. Answered by [`Message::Ran`].
    Run {
        /// Names the answer.
        id: u64,
        /// The text that was edited. Where another one runs meanwhile, nothing is changed.
        base: String,
        /// The new text.
        text: String,
    },
}

/// A graph as it runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opened {
    /// The text that runs: the file with its parts, overlays and arguments in one.
    pub text: String,
    /// The graph that was made of it, with the names of types in `catalog`.
    pub graph: Graph,
    /// The node types of the graph.
    pub catalog: Catalog,
    /// Whether this window may edit.
    pub may_edit: bool,
    /// Who changed the graph last, in words; empty before the first change.
    pub changed_by: String,
}

/// Why a change was not made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refused {
    /// The node that caused it, if there is one.
    pub node: Option<String>,
    /// In words.
    pub words: String,
}

/// What the running side sends.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Message {
    /// First, and after every change.
    Opened(Box<Opened>),
    /// What each node did lately.
    Counters(BTreeMap<String, NodeWindow>),
    /// The newest faults, oldest first.
    Faults(Vec<Fault>),
    /// Values of the parameters of nodes.
    Values(BTreeMap<String, Vec<ParamValue>>),
    /// What became of a [`Command::Run`]: what was changed, or why nothing was.
    Ran {
        /// Of the command.
        id: u64,
        /// In words.
        result: Result<String, Refused>,
    },
    /// The run is over.
    Ended {
        /// In words.
        words: String,
    },
}

/// What arrives at a window.
pub enum Incoming {
    /// A message.
    Message(Message),
    /// A packet of an output.
    Packet(Box<Packet>),
}

/// A malformed message.
#[derive(Debug, thiserror::Error)]
pub enum BadMessage {
    /// It is neither JSON nor a packet, or too long.
    #[error("a message of another machine is malformed; install the same version on both")]
    Malformed,
    /// JSON of another form.
    #[error("a message of another machine is malformed ({0}); install the same version on both")]
    Json(#[from] serde_json::Error),
    /// A packet that is damaged.
    #[error(transparent)]
    Packet(#[from] PacketError),
}

fn json<T: Serialize>(value: &T) -> Vec<u8> {
    let mut bytes = vec![JSON];
    // What is sent here has text keys and finite numbers, see `finite`.
    if serde_json::to_writer(&mut bytes, value).is_err() {
        bytes.truncate(1);
    }
    bytes
}

/// A command as bytes.
pub fn write_command(command: &Command) -> Vec<u8> {
    json(command)
}

/// A message as bytes.
pub fn write_message(message: &Message) -> Vec<u8> {
    json(message)
}

/// The state that a frame carries and that a later frame replaces; `None` for what has to arrive as it is.
pub(crate) fn state_of(frame: &Frame) -> Option<&'static str> {
    let text = frame.bytes.strip_prefix(&[JSON, b'{', b'"'])?;
    let states = ["Opened", "Counters", "Faults", "Values"].into_iter();
    states.filter(|_| frame.kind == Kind::Data).find(|state| text.starts_with(state.as_bytes()))
}

/// A packet as bytes.
pub fn write_packet(packet: &packet::Outgoing) -> Vec<u8> {
    let mut bytes = vec![PACKET];
    packet.write(&mut bytes);
    bytes
}

/// Reads what a window sent.
///
/// # Errors
/// It is malformed, or asks for too much.
pub fn read_command(bytes: &[u8]) -> Result<Command, BadMessage> {
    let Some((&JSON, rest)) = bytes.split_first() else { return Err(BadMessage::Malformed) };
    let command = serde_json::from_slice(rest)?;
    match &command {
        Command::Preview { wanted, .. } if wanted.len() > MAX_OUTPUTS => Err(BadMessage::Malformed),
        Command::Run { base, text, .. } if base.len().max(text.len()) > MAX_TEXT_BYTES => Err(BadMessage::Malformed),
        _ => Ok(command),
    }
}

/// Reads what the running side sent.
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

/// Checks what a window takes for granted: a graph's indices lie inside the graph and its catalogue.
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

/// Counters as JSON can hold them: it knows no infinity.
pub fn finite(mut nodes: BTreeMap<String, NodeWindow>) -> BTreeMap<String, NodeWindow> {
    for node in nodes.values_mut() {
        for number in [&mut node.fps, &mut node.p50_ms, &mut node.p99_ms] {
            *number = if number.is_finite() { *number } else { 0.0 };
        }
        node.age_p50_ms = node.age_p50_ms.filter(|age| age.is_finite());
        node.age_p99_ms = node.age_p99_ms.filter(|age| age.is_finite());
        node.metrics.retain(|(_, value)| value.is_finite());
    }
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_and_messages_arrive_as_they_were_sent() {
        let command = Command::Run { id: 1, base: "a".to_owned(), text: "b".to_owned() };
        assert_eq!(read_command(&write_command(&command)).expect("a command"), command);
        let nodes = BTreeMap::from([("a".to_owned(), NodeWindow { fps: f64::NAN, count: 3, ..NodeWindow::default() })]);
        let nodes = finite(nodes);
        match read_incoming(&write_message(&Message::Counters(nodes.clone()))).expect("a message") {
            Incoming::Message(Message::Counters(arrived)) => assert_eq!(arrived, nodes),
            _ => panic!("counters"),
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        let wanted = Wanted { node: "a".to_owned(), port: "b".to_owned(), max_width: 1 };
        let greedy = Command::Preview { wanted: vec![wanted; MAX_OUTPUTS + 1], interval_ms: 1 };
        for bytes in [&b""[..], b"x", b"J", b"J{}", b"J{\"Run\":1}", &write_command(&greedy)] {
            assert!(read_command(bytes).is_err());
        }
        for bytes in [&b""[..], b"x", b"J", b"J[]", b"P"] {
            assert!(read_incoming(bytes).is_err());
        }
    }
}
