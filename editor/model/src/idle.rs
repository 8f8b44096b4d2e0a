//! Why a node does nothing, in words: the first cause along its inputs, and the node where it is.

use std::collections::BTreeSet;

use panoscope_engine::fault::Action;

use crate::graph_view::GraphView;
use crate::observe::Counters;
use crate::session::{Phase, Status};

/// Why a node is idle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reason {
    /// A sentence for the user.
    pub words: String,
    /// The node where the cause is, if it is another one.
    pub cause: Option<String>,
}

/// Why node `id` of the running graph does nothing; `None` while it works, and for a node that is not known.
pub fn reason(view: &GraphView, counters: &Counters, status: &Status, id: &str) -> Option<Reason> {
    let view = view.flat();
    let here = |words: String| Some(Reason { words, cause: None });
    let node = view.node(id)?;
    match &status.phase {
        Phase::Idle if view.valid => return here("the graph was not started".to_owned()),
        Phase::Idle => return here("the file has mistakes, so nothing runs yet".to_owned()),
        Phase::Starting => return here("the graph is starting".to_owned()),
        Phase::Ended => return here("the run has ended".to_owned()),
        Phase::Failed(why) => return here(format!("the run was stopped: {why}")),
        Phase::Running => {}
    }
    if works(counters, id) {
        return None;
    }
    let mut words = Vec::new();
    let cause = follow(view, counters, node, &mut words, &mut BTreeSet::new());
    let cause = Some(view.nodes[cause].id().to_owned()).filter(|cause| cause != id);
    Some(Reason { words: words.join("; "), cause })
}

fn works(counters: &Counters, id: &str) -> bool {
    counters.nodes.get(id).is_some_and(|node| node.fps > 0.0)
}

/// Adds the reason of one node, and of the node that it waits for; returns the node where the cause is.
fn follow(
    view: &GraphView,
    counters: &Counters,
    node: usize,
    words: &mut Vec<String>,
    visited: &mut BTreeSet<usize>,
) -> usize {
    let (this, id) = (&view.nodes[node], view.nodes[node].id());
    visited.insert(node);
    if let Some(mistake) = this.mistakes.first() {
        words.push(format!("`{id}` has a mistake in the file: {mistake}"));
        return node;
    }
    let Some(counts) = counters.nodes.get(id) else {
        words.push(format!("`{id}` is not part of the running graph yet"));
        return node;
    };
    if let Some(fault) = counters.faults.get(id) {
        let state = match fault.done {
            Action::Note => "has a fault",
            Action::Bypass => "is bypassed since a fault",
            Action::Stop => "stopped the run with a fault",
            Action::End => "ended with a fault",
            Action::Restart | Action::Abandon => "is being restarted after a fault",
            Action::Withhold => "sent a packet that was not delivered",
        };
        words.push(format!("`{id}` {state}: {}", fault.words));
        return node;
    }
    let Some(node_type) = &this.node_type else {
        words.push(format!("the type of `{id}` is not known"));
        return node;
    };
    if node_type.inputs.is_empty() {
        words.push(match counts.count {
            0 => format!("the source `{id}` has sent nothing yet"),
            1 => format!("the source `{id}` has sent 1 tick and none in the last half second"),
            count => format!("the source `{id}` has sent {count} ticks and none in the last half second"),
        });
        return node;
    }
    if let Some(port) = node_type.inputs.iter().find(|p| !p.optional && view.wires_into(node, &p.name).next().is_none())
    {
        words.push(format!("the input `{}` of `{id}` is not connected", port.name));
        return node;
    }
    let wires: Vec<_> = view.wires.iter().filter(|w| w.to == node && !w.delayed).collect();
    let idle = wires.iter().find(|w| !works(counters, view.nodes[w.from].id()) && !visited.contains(&w.from));
    if let Some(wire) = idle {
        words.push(format!("`{id}` waits for `{}.{}`", view.nodes[wire.from].id(), wire.output));
        return follow(view, counters, wire.from, words, visited);
    }
    if wires.is_empty() {
        words.push(format!("no input of `{id}` is connected"));
        return node;
    }
    let producers: BTreeSet<String> =
        wires.iter().map(|w| format!("`{}.{}`", view.nodes[w.from].id(), w.output)).collect();
    let producers = producers.into_iter().collect::<Vec<_>>().join(", ");
    words.push(match wires.len() {
        1 => format!("`{id}` is skipped: its input {producers} runs but is empty"),
        _ => format!(
            "`{id}` is skipped: its inputs run, but one of them is empty or they never hold the same tick: {producers}"
        ),
    });
    node
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use panoscope_engine::NodeWindow;
    use panoscope_graph::{NodeOutline, NodeType, Port};

    use super::*;
    use crate::graph_view::{NodeView, Wire};

    fn port(name: &str, optional: bool) -> Port {
        Port { name: name.to_owned(), optional, ..Port::default() }
    }

    fn node(id: &str, inputs: &[(&str, bool)]) -> NodeView {
        let inputs = inputs.iter().map(|(name, optional)| port(name, *optional)).collect();
        let node_type = NodeType { inputs, outputs: vec![port("image", false)], ..NodeType::default() };
        NodeView {
            outline: NodeOutline {
                id: id.to_owned(),
                type_name: String::new(),
                inputs: Vec::new(),
                params: toml::Table::new(),
                line: 1,
            },
            node_type: Some(Arc::new(node_type)),
            position: None,
            mistakes: Vec::new(),
            is_part: false,
        }
    }

    fn wire(from: usize, to: usize, input: &str) -> Wire {
        Wire { from, output: "image".to_owned(), to, input: input.to_owned(), index: 0, delayed: false }
    }

    /// camera -> smooth -> join <- other, with counters of their rates.
    fn scene(rates: [(u64, f64); 4]) -> (GraphView, Counters, Status) {
        let nodes = vec![
            node("camera", &[]),
            node("smooth", &[("image", false)]),
            node("other", &[]),
            node("join", &[("a", false), ("b", false)]),
        ];
        let wires = vec![wire(0, 1, "image"), wire(1, 3, "a"), wire(2, 3, "b")];
        let mut counters = Counters::default();
        for (node, (count, fps)) in nodes.iter().zip(rates) {
            counters.nodes.insert(node.id().to_owned(), NodeWindow { count, fps, ..NodeWindow::default() });
        }
        let status = Status { phase: Phase::Running, ..Status::default() };
        (GraphView { nodes, wires, valid: true, ..GraphView::default() }, counters, status)
    }

    #[test]
    fn the_first_cause_along_the_inputs_is_named() {
        let (view, counters, mut status) = scene([(12, 0.0), (12, 0.0), (90, 30.0), (12, 0.0)]);
        let why = reason(&view, &counters, &status, "join").expect("it is idle");
        assert_eq!(
            why.words,
            "`join` waits for `smooth.image`; `smooth` waits for `camera.image`; \
             the source `camera` has sent 12 ticks and none in the last half second"
        );
        assert_eq!(why.cause.as_deref(), Some("camera"));
        assert_eq!(reason(&view, &counters, &status, "other"), None, "it works");
        let why = reason(&view, &counters, &status, "camera").expect("it is idle");
        assert_eq!((why.cause, why.words.starts_with("the source")), (None, true));
        status.phase = Phase::Ended;
        assert_eq!(reason(&view, &counters, &status, "other").expect("ended").words, "the run has ended");
    }

    #[test]
    fn empty_inputs_open_wires_and_mistakes_are_named() {
        let (mut view, counters, status) = scene([(90, 30.0), (90, 30.0), (90, 30.0), (0, 0.0)]);
        let why = reason(&view, &counters, &status, "join").expect("it is idle");
        assert!(why.words.contains("never hold the same tick: `other.image`, `smooth.image`"), "{}", why.words);
        view.wires.truncate(2);
        let why = reason(&view, &counters, &status, "join").expect("it is idle");
        assert_eq!(why.words, "the input `b` of `join` is not connected");
        view.nodes[3].mistakes.push("no such type".to_owned());
        let why = reason(&view, &counters, &status, "join").expect("it is idle");
        assert!(why.words.ends_with("no such type"), "{}", why.words);
        assert_eq!(reason(&view, &counters, &status, "nobody"), None);
    }

    #[test]
    fn a_loop_of_waiting_nodes_ends() {
        let (mut view, counters, status) = scene([(0, 0.0); 4]);
        view.wires.push(wire(3, 1, "image"));
        view.wires.remove(0);
        let why = reason(&view, &counters, &status, "join").expect("it is idle");
        assert!(why.words.contains("`join` waits for `smooth.image`"), "{}", why.words);
    }
}
