//! Why a node does nothing, in words: the first cause along its inputs, and the node where it is.

use std::collections::BTreeSet;

use crate::texts::text;
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
        Phase::Idle if view.valid => return here(text!("idle-not-started").to_owned()),
        Phase::Idle => return here(text!("idle-mistakes").to_owned()),
        Phase::Starting => return here(text!("idle-starting").to_owned()),
        Phase::Ended => return here(text!("idle-ended").to_owned()),
        Phase::Failed(why) => return here(text!("idle-stopped", reason = why)),
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
        words.push(text!("idle-mistake", node = id, mistake = mistake));
        return node;
    }
    let Some(counts) = counters.nodes.get(id) else {
        words.push(text!("idle-not-running", node = id));
        return node;
    };
    if let Some(fault) = counters.faults.get(id) {
        let reason = &fault.words;
        words.push(match fault.done {
            Action::Note => text!("idle-fault", node = id, reason = reason),
            Action::Bypass => text!("idle-bypassed", node = id, reason = reason),
            Action::Stop => text!("idle-stopped-run", node = id, reason = reason),
            Action::End => text!("idle-ended-by-fault", node = id, reason = reason),
            Action::Restart | Action::Abandon => text!("idle-restarting", node = id, reason = reason),
            Action::Withhold => text!("idle-withheld", node = id, reason = reason),
        });
        return node;
    }
    let Some(node_type) = &this.node_type else {
        words.push(text!("idle-unknown-type", node = id));
        return node;
    };
    if node_type.inputs.is_empty() {
        words.push(text!("idle-source", node = id, count = counts.count));
        return node;
    }
    if let Some(port) = node_type.inputs.iter().find(|p| !p.optional && view.wires_into(node, &p.name).next().is_none())
    {
        words.push(text!("idle-not-connected", node = id, input = &port.name));
        return node;
    }
    let wires: Vec<_> = view.wires.iter().filter(|w| w.to == node && !w.delayed).collect();
    let idle = wires.iter().find(|w| !works(counters, view.nodes[w.from].id()) && !visited.contains(&w.from));
    if let Some(wire) = idle {
        words.push(text!("idle-waits", node = id, output = format!("{}.{}", view.nodes[wire.from].id(), wire.output)));
        return follow(view, counters, wire.from, words, visited);
    }
    if wires.is_empty() {
        words.push(text!("idle-no-input", node = id));
        return node;
    }
    let producers: BTreeSet<String> =
        wires.iter().map(|w| format!("`{}.{}`", view.nodes[w.from].id(), w.output)).collect();
    let producers = producers.into_iter().collect::<Vec<_>>().join(", ");
    words.push(match wires.len() {
        1 => text!("idle-empty", node = id, outputs = producers),
        _ => text!("idle-apart", node = id, outputs = producers),
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
