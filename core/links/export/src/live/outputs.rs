//! The outputs of the running graph as topics.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::Kind;
use crate::foxglove::{Schema, topic, topics};
use foxglove::{Context, FoxgloveError, RawChannel};
use panoscope_engine::Preview;
use panoscope_graph::{Catalog, Graph};

/// An output with its topics.
pub struct Output {
    /// The node.
    pub node: String,
    /// Its output.
    pub port: String,
    /// Name of the packet's type.
    pub packet: String,
    /// Kind of its packets.
    pub kind: Kind,
    /// Channels by topic.
    pub channels: BTreeMap<String, Arc<RawChannel>>,
    /// Present only while there is a subscriber.
    pub preview: Option<Preview>,
}

impl Output {
    /// `node.output`.
    pub fn name(&self) -> String {
        format!("{}.{}", self.node, self.port)
    }

    /// Whether a client is subscribed to a topic of this output.
    pub fn is_wanted(&self) -> bool {
        self.channels.values().any(|channel| channel.has_sinks())
    }
}

/// All outputs of a graph that have a form in Foxglove: node, output, packet type and kind.
fn of_graph(graph: &Graph, catalog: &Catalog) -> Vec<(String, String, String, Kind)> {
    let mut all = Vec::new();
    for node in &graph.nodes {
        for port in &node.node_type(catalog).outputs {
            let packet = &port.packet.name;
            if let Some(kind) = Kind::of_packet(packet) {
                all.push((node.id.clone(), port.name.clone(), packet.clone(), kind));
            }
        }
    }
    all
}

/// Updates `outputs` to those of `graph`; channels that stay keep their subscribers. Returns the nodes whose previews
/// have ended.
///
/// # Errors
/// A channel cannot be made.
pub fn follow(
    outputs: &mut Vec<Output>,
    context: &Arc<Context>,
    graph: &Graph,
    catalog: &Catalog,
) -> Result<Vec<String>, FoxgloveError> {
    let wanted = of_graph(graph, catalog);
    let mut ended = Vec::new();
    outputs.retain(|output| {
        let stays = wanted.iter().any(|(node, port, packet, kind)| {
            (node, port, packet, kind) == (&output.node, &output.port, &output.packet, &output.kind)
        });
        if !stays {
            output.channels.values().for_each(|channel| channel.close());
            ended.extend(output.preview.is_some().then(|| output.node.clone()));
        }
        stays
    });
    for (node, port, packet, kind) in wanted {
        if outputs.iter().any(|output| output.node == node && output.port == port) {
            continue;
        }
        let mut channels = BTreeMap::new();
        for each in topics(kind, &topic(&format!("{node}.{port}"))) {
            let Schema { encoding, data, message_encoding } = Schema::of(each.form, &[]);
            let channel = context
                .channel_builder(each.name.clone())
                .message_encoding(message_encoding)
                .schema(foxglove::Schema::new(each.form, encoding, data))
                .build_raw()?;
            channels.insert(each.name, channel);
        }
        outputs.push(Output { node, port, packet, kind, channels, preview: None });
    }
    Ok(ended)
}
