//! How ticks flow: cycles, order, joins that can never happen, unused nodes.

use super::{Checker, Link};
use crate::checked::Align;
use crate::file::Supply;
use petgraph::algo::tarjan_scc;
use petgraph::graph::{DiGraph, NodeIndex};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::ops::Range;

/// Maximum number of reported cycles; each may hide others that share its edges.
const MAX_CYCLES: usize = 20;

/// Whose ticks a node works on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Head {
    Node(usize),
    /// Not known because of another mistake.
    Unknown,
}

impl<'a> Checker<'a> {
    /// Checks the flow and returns the order of the nodes.
    pub(super) fn flow(&mut self) -> Vec<usize> {
        // Edges that carry this tick's value; those a cycle's message proposes to delay are taken out as it does.
        let mut direct: Vec<bool> = self.links.iter().map(|l| l.delay == 0).collect();
        for _ in 0..MAX_CYCLES {
            let cycles = self.cycles(|link| direct[link]);
            if cycles.is_empty() {
                break;
            }
            for cycle in cycles {
                let back = self.back_edge(&cycle);
                self.report_cycle(&cycle, back);
                direct[back] = false;
            }
        }
        self.dead_cycles();
        let order = self.order(&direct);
        self.joins(&order, &direct);
        self.unused();
        order
    }

    /// One shortest cycle, as positions of links, of every strongly connected part of the links that `take` admits.
    fn cycles(&self, take: impl Fn(usize) -> bool) -> Vec<Vec<usize>> {
        let count = self.text.flat.nodes.len();
        let mut graph: DiGraph<(), usize> = DiGraph::with_capacity(count, self.links.len());
        for _ in 0..count {
            graph.add_node(());
        }
        for (i, link) in self.links.iter().enumerate().filter(|(i, _)| take(*i)) {
            graph.add_edge(NodeIndex::new(link.from_node), NodeIndex::new(link.to_node), i);
        }
        let mut part_of = vec![usize::MAX; count];
        let mut firsts = Vec::new();
        for (part, nodes) in tarjan_scc(&graph).into_iter().enumerate() {
            let loops = nodes.len() > 1 || graph.contains_edge(nodes[0], nodes[0]);
            for node in &nodes {
                part_of[node.index()] = part;
            }
            if loops {
                firsts.extend(nodes.iter().map(|n| n.index()).min());
            }
        }
        firsts.sort_unstable();
        firsts.into_iter().filter_map(|first| min_cycle(&graph, first, &part_of)).collect()
    }

    /// The link of a cycle that is best delayed: into an optional input if there is one, and from a later node of the
    /// file to an earlier one.
    fn back_edge(&self, cycle: &[usize]) -> usize {
        let badness = |&&i: &&usize| {
            let link = &self.links[i];
            (self.is_required(link), link.from_node < link.to_node, Reverse(link.from_node), i)
        };
        cycle.iter().min_by_key(badness).copied().unwrap_or(cycle[0])
    }

    fn is_required(&self, link: &Link<'_>) -> bool {
        let port = self.type_of(link.to_node).zip(link.to_port).map(|(t, p)| &t.inputs[p]);
        port.is_none_or(|p| !p.optional)
    }

    /// `` `a` -> `b` -> `a` ``
    fn path(&self, cycle: &[usize]) -> String {
        let mut names: Vec<String> = cycle.iter().map(|&i| format!("`{}`", self.id(self.links[i].from_node))).collect();
        names.extend(names.first().cloned());
        if names.len() > 12 {
            let left_out = names.len() - 10;
            names.splice(6..names.len() - 4, [format!("({left_out} more)")]);
        }
        names.join(" -> ")
    }

    /// A reference as written in the file, without quotes.
    fn written(&self, span: &Range<usize>) -> &'a str {
        self.text.sources.text(span).trim_matches(['"', '\''])
    }

    fn report_cycle(&mut self, cycle: &[usize], back: usize) {
        let path = self.path(cycle);
        let link = &self.links[back];
        let (span, name) = (link.span, link.to_name);
        let reference = self.written(span);
        let align = match link.align {
            Align::Exact => String::new(),
            Align::Latest => ", align = \"latest\"".to_owned(),
            Align::Nearest { tolerance_ms } => format!(", align = \"nearest\", tolerance_ms = {tolerance_ms}"),
        };
        let delayed = format!("{{ from = \"{reference}\"{align}, delay = 1 }}");
        let to = self.id(link.to_node);
        let listed = self.text.flat.nodes[link.to_node].inputs.iter().any(|i| i.port.value == name && i.is_list);
        let write = if listed { format!("write {delayed} in the list") } else { format!("write {name} = {delayed}") };
        let help = if cycle.iter().all(|&i| self.is_required(&self.links[i])) {
            // A delayed input is empty on the first tick.
            "take one connection out: a delay would not help, as each of these inputs is required and the first value \
             would never come\na cycle needs delay = 1 at an input that is optional"
                .to_owned()
        } else {
            format!("{write}: `{to}` then sees the value of its previous tick")
        };
        let message = if cycle.len() == 1 {
            format!("`{to}` waits for its own output: {path}")
        } else {
            format!("these nodes wait for each other: {path}")
        };
        let notes: Vec<_> = cycle.iter().filter(|&&i| i != back).take(8).map(|&i| self.links[i].span).collect();
        let sources = &self.text.sources;
        let d = self.error("cycle", span, message);
        d.label("closes the cycle").help(help);
        for note in notes {
            d.note(sources, note, "");
        }
    }

    /// Reports cycles in which every node needs the one before, so that a first value never exists, with or without
    /// `delay`.
    fn dead_cycles(&mut self) {
        let required: Vec<bool> = self.links.iter().map(|l| l.to_port.is_some() && self.is_required(l)).collect();
        for cycle in self.cycles(|i| required[i]) {
            // Without a delay it is reported as a cycle.
            let Some(&delayed) = cycle.iter().find(|&&i| self.links[i].delay == 1) else { continue };
            let link = &self.links[delayed];
            let (span, to, name) = (link.span, self.id(link.to_node), link.to_name);
            let message = format!(
                "no node of this cycle ever starts, as each needs a value of the one before: {}",
                self.path(&cycle)
            );
            self.warning("cycle-never-starts", span, message)
                .label(format!("empty on the first tick, and `{name}` of `{to}` must not be empty"))
                .help("close the cycle at an optional input");
        }
    }

    /// Order of the nodes in which direct links go forward, ties in file order.
    fn order(&self, direct: &[bool]) -> Vec<usize> {
        let count = self.text.flat.nodes.len();
        let mut waiting = vec![0usize; count];
        let mut next: Vec<Vec<usize>> = vec![Vec::new(); count];
        for (link, _) in self.links.iter().zip(direct).filter(|(_, direct)| **direct) {
            waiting[link.to_node] += 1;
            next[link.from_node].push(link.to_node);
        }
        let mut ready: BinaryHeap<Reverse<usize>> = (0..count).filter(|&n| waiting[n] == 0).map(Reverse).collect();
        let mut order = Vec::with_capacity(count);
        while let Some(Reverse(node)) = ready.pop() {
            order.push(node);
            for &to in &next[node] {
                waiting[to] -= 1;
                if waiting[to] == 0 {
                    ready.push(Reverse(to));
                }
            }
        }
        order
    }

    /// Reports nodes whose exact inputs carry ticks of different sources, which never match.
    fn joins(&mut self, order: &[usize], direct: &[bool]) {
        let mut into: Vec<Vec<usize>> = vec![Vec::new(); self.text.flat.nodes.len()];
        for (i, link) in self.links.iter().enumerate() {
            into[link.to_node].push(i);
        }
        let mut heads = vec![Head::Unknown; self.text.flat.nodes.len()];
        for &node in order {
            let Some(node_type) = self.type_of(node) else { continue };
            if node_type.source {
                heads[node] = Head::Node(node);
                continue;
            }
            let live: Vec<usize> = into[node].iter().copied().filter(|&i| direct[i]).collect();
            let exact = live.iter().copied().find(|&i| self.links[i].align == Align::Exact);
            heads[node] = match exact {
                Some(i) => heads[self.links[i].from_node],
                None if !live.is_empty() => Head::Node(node),
                None => Head::Unknown,
            };
            let delayed = into[node].first().filter(|&&i| self.links[i].delay == 1);
            // What the user of a part connects makes it run.
            let open = self.text.flat.nodes[node].inputs.iter().any(|i| i.supply == Supply::Open);
            if let Some(&first) =
                delayed.filter(|_| !open && live.is_empty() && into[node].iter().all(|&i| self.links[i].delay == 1))
            {
                let message = format!("nothing makes `{}` run: all its inputs are delayed", self.id(node));
                self.error("never-runs", self.links[first].span, message)
                    .label("a delayed value makes no node run")
                    .help("leave one input without delay");
            }
        }
        for &node in order {
            let exact: Vec<usize> =
                into[node].iter().copied().filter(|&i| self.links[i].align == Align::Exact).collect();
            let Head::Node(own) = heads[node] else { continue };
            let reference = exact.iter().copied().find(|&i| direct[i]);
            for &i in &exact {
                // Links proposed for a delay are reported already.
                if !direct[i] && self.links[i].delay == 0 {
                    continue;
                }
                if let Head::Node(other) = heads[self.links[i].from_node]
                    && other != own
                {
                    self.report_join(node, i, own, other, reference.filter(|&r| r != i));
                }
            }
        }
    }

    fn report_join(&mut self, node: usize, link: usize, own: usize, other: usize, reference: Option<usize>) {
        let (span, name) = (self.links[link].span, self.links[link].to_name);
        let (id, own_id, other_id) = (self.id(node), self.id(own), self.id(other));
        let whose = if own == node { "its own".to_owned() } else { format!("those of `{own_id}`") };
        let message = format!(
            "input `{name}` of `{id}` waits for ticks of `{other_id}`, the node works on {whose}: they never match"
        );
        let written = self.written(span);
        let delay = if self.links[link].delay == 1 { ", delay = 1" } else { "" };
        let help = format!(
            "take the newest value with {{ from = \"{written}\", align = \"latest\"{delay} }}, or the closest in time with align = \"nearest\""
        );
        let first = reference.map(|r| self.links[r].span);
        let sources = &self.text.sources;
        let d = self.error("exact-join", span, message);
        d.label(format!("ticks of `{other_id}`")).help(help);
        if let Some(first) = first {
            d.note(sources, first, format!("ticks of `{own_id}`"));
        }
    }

    /// Reports nodes that have no effect and feed no node that has one.
    fn unused(&mut self) {
        // An unread line or a wrong input may be the one that uses a node.
        const WIRING: [&str; 17] = [
            "part-missing",
            "part-unreadable",
            "part-recursion",
            "not-a-part",
            "too-many-nodes",
            "unknown-part-input",
            "unknown-part-output",
            "part-input-taken",
            "missing-input",
            "never-runs",
            "unknown-node",
            "unknown-input",
            "bad-reference",
            "missing-from",
            "missing-type",
            "wrong-type",
            "duplicate-node",
        ];
        let broken = self.diagnostics.iter().any(|d| WIRING.contains(&d.code));
        if self.text.incomplete || broken {
            return;
        }
        let count = self.text.flat.nodes.len();
        let mut from: Vec<Vec<usize>> = vec![Vec::new(); count];
        for link in &self.links {
            from[link.to_node].push(link.from_node);
        }
        let read_outside = &self.text.flat.read_outside;
        let acts = |node: &usize| {
            let type_acts = self.type_of(*node).is_none_or(|t| t.side_effects || t.outputs.is_empty());
            type_acts || read_outside.iter().any(|id| id == self.id(*node))
        };
        let mut used = vec![false; count];
        let mut queue: VecDeque<usize> = (0..count).filter(acts).collect();
        let no_effect = queue.is_empty();
        for &node in &queue {
            used[node] = true;
        }
        while let Some(node) = queue.pop_front() {
            for &producer in &from[node] {
                if !std::mem::replace(&mut used[producer], true) {
                    queue.push_back(producer);
                }
            }
        }
        if no_effect && count > 0 {
            let span = &self.text.flat.nodes[count - 1].id.span;
            self.warning("no-effect", span, "nothing in this graph writes, shows or moves anything".to_owned())
                .help("connect a sink such as `preview` or `write_video`");
            return;
        }
        for node in (0..count).filter(|&n| !used[n]) {
            let message =
                format!("node `{}` is of no use: nothing that writes, shows or moves anything needs it", self.id(node));
            self.warning("unused-node", &self.text.flat.nodes[node].id.span, message)
                .help("connect one of its outputs, or remove it");
        }
    }
}

/// A shortest cycle through `start` inside its part, as link positions.
fn min_cycle(graph: &DiGraph<(), usize>, start: usize, part_of: &[usize]) -> Option<Vec<usize>> {
    use petgraph::visit::EdgeRef;
    let mut reached_by: Vec<Option<(usize, usize)>> = vec![None; part_of.len()];
    let mut queue = VecDeque::from([start]);
    while let Some(node) = queue.pop_front() {
        let mut edges: Vec<_> = graph.edges(NodeIndex::new(node)).map(|e| (*e.weight(), e.target().index())).collect();
        edges.sort_unstable();
        for (link, to) in edges {
            if part_of[to] != part_of[start] {
                continue;
            }
            if to == start {
                let mut cycle = vec![link];
                let mut at = node;
                while at != start {
                    let (before, link) = reached_by[at]?;
                    cycle.push(link);
                    at = before;
                }
                cycle.reverse();
                return Some(cycle);
            }
            if reached_by[to].is_none() {
                reached_by[to] = Some((node, link));
                queue.push_back(to);
            }
        }
    }
    None
}
