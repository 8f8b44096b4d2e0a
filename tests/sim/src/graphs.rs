//! Random graphs of the simulated nodes, and random changes of them.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use crate::world::Dice;

use crate::content::{Step, name_hash};
use crate::harm::Harm;

/// Type of a simulated node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A source.
    Camera,
    /// Forwards the same buffer.
    Pass,
    /// Makes a new frame.
    Mark,
    /// As `Mark`, on a separate thread.
    MarkBlocking,
    /// As `Mark`, exclusive.
    MarkDevice,
    /// As `Mark`; reports wrong lengths on request.
    MarkLying,
    /// Changes the frame in place.
    Draw,
    /// Retains frames.
    Keep,
    /// Joins two frames.
    Pair,
    /// Reads frames.
    Look,
    /// Writes tick numbers.
    Write,
}

impl Kind {
    /// Name in graph files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Pass => "pass",
            Self::Mark => "mark",
            Self::MarkBlocking => "mark_blocking",
            Self::MarkDevice => "mark_device",
            Self::MarkLying => "mark_lying",
            Self::Draw => "draw",
            Self::Keep => "keep",
            Self::Pair => "pair",
            Self::Look => "look",
            Self::Write => "write",
        }
    }

    /// Whether it adds itself to the steps of the frames.
    pub fn adds_step(self) -> bool {
        !matches!(self, Self::Pass | Self::Keep | Self::Look | Self::Write)
    }

    /// Whether it has no readers.
    pub fn is_sink(self) -> bool {
        matches!(self, Self::Look | Self::Write)
    }
}

/// Misbehaviour of a node.
#[derive(Clone, Debug, PartialEq)]
pub struct Trouble {
    /// Kind of misbehaviour.
    pub harm: Harm,
    /// First tick.
    pub first: u64,
    /// Ticks in a row.
    pub ticks: u64,
    /// Duration of a call that hangs or is slow.
    pub hang_ms: f64,
    /// `on_fault` of the node.
    pub on_fault: &'static str,
    /// Budget of the node.
    pub budget_ms: Option<f64>,
}

/// A node.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Name.
    pub id: String,
    /// Type.
    pub kind: Kind,
    /// Names of the nodes that it reads.
    pub inputs: Vec<String>,
    /// Whether it takes the newest frame instead of that of its tick.
    pub latest: bool,
    /// Queue of its inputs.
    pub queue: Option<u32>,
    /// Number of its live values.
    pub live: u32,
    /// Number of its values that reopen it.
    pub reopened: u32,
    /// Duration of a call.
    pub cost_ms: f64,
    /// Nesting depth of its parallel loops.
    pub loops: u32,
    /// Duration of opening.
    pub open_ms: f64,
    /// Whether it refuses to open.
    pub refuses: bool,
    /// Misbehaviour, if any.
    pub trouble: Option<Trouble>,
    /// Further parameters.
    pub more: String,
}

impl Node {
    /// A healthy node.
    pub fn new(id: &str, kind: Kind, inputs: &[&str]) -> Self {
        Self {
            id: id.to_owned(),
            kind,
            inputs: inputs.iter().map(|i| (*i).to_owned()).collect(),
            latest: false,
            queue: None,
            live: 0,
            reopened: 0,
            cost_ms: 0.0,
            loops: 0,
            open_ms: 0.0,
            refuses: false,
            trouble: None,
            more: String::new(),
        }
    }

    /// Number that identifies its values in frames.
    pub fn values(&self) -> u32 {
        self.reopened << 16 | self.live
    }
}

/// A graph.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Whether it runs in batch mode.
    pub batch: bool,
    /// Producers come before their readers.
    pub nodes: Vec<Node>,
}

impl Model {
    /// A node by name.
    pub fn node(&self, id: &str) -> Option<&Node> {
        self.nodes.iter().find(|node| node.id == id)
    }

    /// A node by name.
    pub fn node_mut(&mut self, id: &str) -> Option<&mut Node> {
        self.nodes.iter_mut().find(|node| node.id == id)
    }

    /// The graph as text.
    pub fn text(&self) -> String {
        let mode = if self.batch { "batch" } else { "live" };
        let mut text = format!("mode = \"{mode}\"\nplugins = [\"sim\"]\n");
        for node in &self.nodes {
            let _ = write!(text, "[nodes.{}]\ntype = \"{}\"\n", node.id, node.kind.name());
            let align = if node.latest { ", align = \"latest\"" } else { "" };
            let queue = node.queue.map(|queue| format!(", queue = {queue}")).unwrap_or_default();
            let ports: &[&str] = if node.kind == Kind::Pair { &["left", "right"] } else { &["image"] };
            let inputs = ports.iter().zip(&node.inputs);
            let inputs: Vec<_> =
                inputs.map(|(port, from)| format!("{port} = {{ from = \"{from}.image\"{align}{queue} }}")).collect();
            if !inputs.is_empty() {
                let _ = writeln!(text, "inputs = {{ {} }}", inputs.join(", "));
            }
            if node.kind == Kind::Look {
                let _ = writeln!(text, "params = {{ exact = {}, cost_ms = {:?} }}", !node.latest, node.cost_ms);
                continue;
            }
            let mut params = format!(
                "live = {}, reopened = {}, cost_ms = {:?}, loops = {}, open_ms = {:?}, refuses = {}{}",
                node.live, node.reopened, node.cost_ms, node.loops, node.open_ms, node.refuses, node.more
            );
            if let Some(trouble) = &node.trouble {
                let Trouble { harm, first, ticks, hang_ms, on_fault, budget_ms } = trouble;
                let name = harm_name(*harm);
                let _ = write!(params, ", harm = \"{name}\", first = {first}, ticks = {ticks}, hang_ms = {hang_ms:?}");
                let _ = writeln!(text, "on_fault = \"{on_fault}\"");
                if let Some(budget_ms) = budget_ms {
                    let _ = writeln!(text, "budget_ms = {budget_ms:?}");
                }
            }
            let _ = writeln!(text, "params = {{ {params} }}");
        }
        text
    }

    /// The source whose ticks a node processes; `None` for a node that runs on arrivals.
    pub fn source_of(&self, id: &str) -> Option<&str> {
        let node = self.node(id)?;
        match node.inputs.first() {
            None => Some(&node.id),
            Some(_) if node.latest => None,
            Some(input) => self.source_of(input),
        }
    }

    /// The nodes that add themselves to the frame at the output of `id`, from the source on.
    pub fn steps_out_of(&self, id: &str) -> Vec<u32> {
        let Some(node) = self.node(id) else { return Vec::new() };
        let mut steps = node.inputs.first().map(|input| self.steps_out_of(input)).unwrap_or_default();
        if node.kind.adds_step() {
            steps.push(name_hash(id));
        }
        steps
    }

    /// Whether a frame with these steps can come from `id` in this graph.
    pub fn fits(&self, id: &str, steps: &[Step]) -> bool {
        let expected = self.steps_out_of(id);
        expected.len() == steps.len() && expected.iter().zip(steps).all(|(node, step)| *node == step.node)
    }

    /// All nodes upstream of `id`, including itself.
    pub fn upstream(&self, id: &str) -> Vec<&Node> {
        let mut all = Vec::new();
        let mut todo = vec![id];
        while let Some(id) = todo.pop() {
            let Some(node) = self.node(id) else { continue };
            if !all.iter().any(|known: &&Node| known.id == node.id) {
                all.push(node);
                todo.extend(node.inputs.iter().map(String::as_str));
            }
        }
        all
    }

    /// Whether no node upstream of `id` misbehaves.
    pub fn is_healthy(&self, id: &str) -> bool {
        self.upstream(id).iter().all(|node| node.trouble.is_none())
    }

    fn depth(&self, id: &str) -> usize {
        self.upstream(id).len()
    }

    fn is_read(&self, id: &str) -> bool {
        self.nodes.iter().any(|node| node.inputs.iter().any(|input| input == id))
    }
}

/// Name of a harm in graph files.
pub fn harm_name(harm: Harm) -> String {
    let mut name = String::new();
    for letter in format!("{harm:?}").chars() {
        if letter.is_uppercase() && !name.is_empty() {
            name.push('_');
        }
        name.extend(letter.to_lowercase());
    }
    name
}

/// Generates names, graphs and changes.
pub struct Maker {
    dice: Dice,
    names: u32,
    values: BTreeMap<String, u32>,
    /// Whether calls take time.
    pub costs: bool,
    /// Whether nodes retain frames. A node that releases twice may release what another instance of its plugin retains.
    pub keeps: bool,
}

/// A change of a running graph.
#[derive(Clone, Debug, PartialEq)]
pub enum Edit {
    /// To another graph.
    Graph(Model),
    /// As `Graph`, before a tick that is this many ticks ahead of the newest.
    GraphAt(Model, u64),
    /// One parameter of a node: `live` or `reopened`.
    Value {
        /// The node.
        node: String,
        /// Whether it opens the node again.
        reopens: bool,
        /// The number.
        value: u32,
    },
}

/// Maximum number of nodes from a source to a sink.
const MAX_DEPTH: usize = 9;

impl Maker {
    /// A generator whose graphs depend only on the dice.
    pub fn new(dice: Dice) -> Self {
        Self { dice, names: 0, values: BTreeMap::new(), costs: true, keeps: true }
    }

    fn name(&mut self, letter: &str) -> String {
        self.names += 1;
        format!("{letter}{}", self.names)
    }

    /// The next number of values of a node. No number is used twice, so that old values are recognised.
    fn next_value(&mut self, id: &str) -> u32 {
        let value = self.values.entry(id.to_owned()).or_default();
        *value += 1;
        *value
    }

    fn costs(&mut self, node: &mut Node) {
        if self.costs && self.dice.one_in(3) {
            node.cost_ms = self.dice.within(1, 60) as f64 / 10.0;
        }
        if matches!(node.kind, Kind::Mark | Kind::MarkBlocking | Kind::Pair) {
            node.loops = self.dice.below(3) as u32;
        }
    }

    /// A node that can have readers in a tree of `source`, not too deep.
    fn tip(&mut self, model: &Model, source: &str) -> String {
        let fits = |node: &&Node| {
            !node.kind.is_sink()
                && !node.latest
                && model.source_of(&node.id) == Some(source)
                && model.depth(&node.id) < MAX_DEPTH
        };
        let tips: Vec<_> = model.nodes.iter().filter(fits).map(|node| node.id.clone()).collect();
        self.dice.pick(&tips).clone()
    }

    fn filter(&mut self, model: &Model, source: &str) -> Node {
        const KINDS: [Kind; 7] =
            [Kind::Pass, Kind::Mark, Kind::Mark, Kind::MarkBlocking, Kind::MarkDevice, Kind::Draw, Kind::Keep];
        let from = self.tip(model, source);
        let id = self.name("n");
        let mut node = if self.dice.one_in(4) {
            let other = self.tip(model, source);
            Node::new(&id, Kind::Pair, &[&from, &other])
        } else {
            let kind = *self.dice.pick(&KINDS);
            Node::new(&id, if kind == Kind::Keep && !self.keeps { Kind::Pass } else { kind }, &[&from])
        };
        self.costs(&mut node);
        if self.dice.one_in(4) {
            node.queue = Some(self.dice.within(1, 6) as u32);
        }
        node
    }

    fn sink(&mut self, from: &str) -> Node {
        let kind = *self.dice.pick(&[Kind::Look, Kind::Write, Kind::Write]);
        let mut node = Node::new(&self.name("s"), kind, &[from]);
        if kind == Kind::Look && self.costs && self.dice.one_in(4) {
            node.cost_ms = self.dice.within(1, 40) as f64 / 10.0;
        }
        node
    }

    /// A graph of one or two sources with sinks at all ends.
    pub fn graph(&mut self, batch: bool) -> Model {
        let mut model = Model { batch, nodes: Vec::new() };
        let sources = 1 + self.dice.below(2);
        for number in 0..sources {
            let id = format!("camera{number}");
            let mut camera = Node::new(&id, Kind::Camera, &[]);
            camera.loops = self.dice.below(2) as u32;
            let period_ms = self.dice.within(40, 330) as f64 / 10.0;
            let (width, height) = (self.dice.within(16, 40), self.dice.within(16, 24));
            let begin = *self.dice.pick(&["zero", "zero", "lowest", "highest"]);
            camera.more =
                format!(", period_ms = {period_ms:?}, width_px = {width}, height_px = {height}, begin = \"{begin}\"");
            model.nodes.push(camera);
            for _ in 0..self.dice.within(1, 6) {
                let node = self.filter(&model, &id);
                model.nodes.push(node);
            }
        }
        self.close_ends(&mut model);
        if self.dice.one_in(3) {
            // A reader that takes the newest: another region.
            let from = self.tip(&model, "camera0");
            let id = self.name("l");
            let mut look = Node::new(&id, Kind::Look, &[&from]);
            look.latest = true;
            model.nodes.push(look);
        }
        model
    }

    fn close_ends(&mut self, model: &mut Model) {
        let ends: Vec<String> = model
            .nodes
            .iter()
            .filter(|node| !node.kind.is_sink() && !model.is_read(&node.id))
            .map(|node| node.id.clone())
            .collect();
        for end in ends {
            let sink = self.sink(&end);
            model.nodes.push(sink);
        }
    }

    /// A change of a graph: one that works, or one whose new nodes do not open.
    pub fn edit(&mut self, model: &Model) -> Edit {
        let mut next = model.clone();
        for _ in 0..1 + self.dice.below(2) {
            self.change(&mut next);
        }
        if self.dice.one_in(5) {
            let changed: Vec<String> = next
                .nodes
                .iter()
                .filter(|n| !n.kind.is_sink() && n.kind != Kind::Camera)
                .map(|n| n.id.clone())
                .collect();
            if let Some(id) = changed.get(self.dice.below(changed.len())).cloned() {
                let hangs = self.dice.one_in(2);
                let reopened = self.next_value(&id);
                if let Some(node) = next.node_mut(&id) {
                    node.reopened = reopened;
                    if hangs {
                        node.open_ms = 60_000.0;
                    } else {
                        node.refuses = true;
                    }
                }
            }
        }
        let simple: Vec<String> = model
            .nodes
            .iter()
            .filter(|node| node.kind.adds_step() && node.kind != Kind::Camera)
            .map(|node| node.id.clone())
            .collect();
        match self.dice.below(6) {
            0 | 1 if !simple.is_empty() => {
                let node = self.dice.pick(&simple).clone();
                let (reopens, value) = (self.dice.one_in(2), self.next_value(&node));
                Edit::Value { node, reopens, value }
            }
            2 => Edit::GraphAt(next, self.dice.within(1, 6)),
            _ => Edit::Graph(next),
        }
    }

    fn change(&mut self, model: &mut Model) {
        let inner: Vec<String> = model
            .nodes
            .iter()
            .filter(|node| !node.kind.is_sink() && node.kind != Kind::Camera && node.trouble.is_none())
            .map(|node| node.id.clone())
            .collect();
        let sources: Vec<String> =
            model.nodes.iter().filter(|n| n.kind == Kind::Camera).map(|n| n.id.clone()).collect();
        let source = self.dice.pick(&sources).clone();
        match self.dice.below(7) {
            // A new branch.
            0 | 1 => {
                let node = self.filter(model, &source);
                model.nodes.push(node);
                self.close_ends(model);
            }
            // A node between two others.
            2 if !inner.is_empty() => {
                let reader = self.dice.pick(&inner).clone();
                let Some(at) = model.nodes.iter().position(|node| node.id == reader) else { return };
                if model.nodes.iter().any(|node| model.depth(&node.id) >= MAX_DEPTH) {
                    return;
                }
                let from = model.nodes[at].inputs[0].clone();
                let kind = *self.dice.pick(&[Kind::Pass, Kind::Mark, Kind::Draw, Kind::MarkBlocking]);
                let id = self.name("n");
                let mut node = Node::new(&id, kind, &[&from]);
                self.costs(&mut node);
                model.nodes[at].inputs[0] = id;
                model.nodes.insert(at, node);
            }
            // A branch less.
            3 => {
                let ends: Vec<String> =
                    model.nodes.iter().filter(|node| node.kind.is_sink()).map(|node| node.id.clone()).collect();
                if ends.len() > 1 {
                    let end = self.dice.pick(&ends).clone();
                    model.nodes.retain(|node| node.id != end);
                    self.close_ends(model);
                }
            }
            // Other values.
            4 if !inner.is_empty() => {
                let id = self.dice.pick(&inner).clone();
                let (reopens, value) = (self.dice.one_in(2), self.next_value(&id));
                if let Some(node) = model.node_mut(&id) {
                    *(if reopens { &mut node.reopened } else { &mut node.live }) = value;
                }
            }
            // Another type.
            5 if !inner.is_empty() => {
                let id = self.dice.pick(&inner).clone();
                let kind = *self.dice.pick(&[Kind::Mark, Kind::Draw, Kind::Pass, Kind::MarkBlocking, Kind::MarkDevice]);
                if let Some(node) = model.node_mut(&id).filter(|node| node.kind != Kind::Pair) {
                    node.kind = kind;
                    node.loops = 0;
                }
            }
            // A sink elsewhere.
            _ => {
                let ends: Vec<String> = model
                    .nodes
                    .iter()
                    .filter(|node| node.kind.is_sink() && model.source_of(&node.id) == Some(&source))
                    .map(|node| node.id.clone())
                    .collect();
                if ends.is_empty() {
                    return;
                }
                let (end, tip) = (self.dice.pick(&ends).clone(), self.tip(model, &source));
                // It reads only what comes before it in the list.
                let Some(at) = model.nodes.iter().position(|node| node.id == end) else { return };
                let mut sink = model.nodes.remove(at);
                sink.inputs[0] = tip;
                model.nodes.push(sink);
                self.close_ends(model);
            }
        }
    }

    /// A generator for changes: its names and values begin after those of the graph.
    pub fn with_names(dice: Dice, after: u32) -> Self {
        Self { names: after, ..Self::new(dice) }
    }
}
