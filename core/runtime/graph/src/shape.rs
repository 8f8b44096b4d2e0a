//! The shape of a graph file: which tables and keys it may have, and of what TOML type. Names are not looked up here.

mod declarations;

use crate::args::ArgText;
use crate::checked::{Align, Mode, OnFault};
use crate::diagnostic::{Diagnostic, Diagnostics, Severity};
use crate::file::{FileText, InputText, NodeText, PinText, RefText, Role, Supply, ViewText};
use crate::nearest::{list, nearest};
use crate::parse::Parsed;
use crate::source::Sources;
use crate::value::{Kind, Spanned, Table, Value, plain_table};
use std::collections::HashMap;
use std::ops::Range;

const TOP: [&str; 11] =
    ["name", "mode", "plugins", "plugin_paths", "args", "nodes", "isolate", "deny", "machines", "preset", "editor"];
const TOP_OF_PART: [&str; 6] = ["name", "plugins", "plugin_paths", "part", "nodes", "editor"];
const TOP_OF_OVERLAY: [&str; 7] = ["plugins", "plugin_paths", "args", "nodes", "isolate", "deny", "machines"];
const NODE: [&str; 10] =
    ["type", "graph", "inputs", "params", "on_fault", "budget_ms", "max_rate_hz", "cpu", "isolate", "on"];
/// Limits of times and rates in a graph: a day, and a tick per nanosecond.
pub(crate) const MAX_MS: f64 = 86_400_000.0;
pub(crate) const HIGHEST_HZ: f64 = 1e9;
const INPUT: [&str; 9] =
    ["from", "align", "tolerance_ms", "max_age_ms", "queue", "delay", "trigger", "guide", "optional"];
const PRESET: [&str; 2] = ["pinned", "views"];
const PIN: [&str; 4] = ["param", "range", "label", "optional"];
const VIEW: [&str; 3] = ["from", "label", "optional"];

/// Reads the tree of a file; mistakes follow the parser's diagnostics. `sources` holds the file's text.
pub(crate) fn read(sources: &Sources, role: Role, parsed: Parsed) -> FileText {
    let Parsed { root, diagnostics, incomplete } = parsed;
    let mut reader = Reader::new(sources);
    (reader.file.diagnostics, reader.file.incomplete) = (diagnostics, incomplete);
    reader.root(role, &root);
    reader.file
}

/// The arguments that the tree of a file declares. They are read before the rest, which uses them.
pub(crate) fn read_args(sources: &Sources, role: Role, root: &Table) -> (Vec<ArgText>, Diagnostics) {
    let mut reader = Reader::new(sources);
    let args = root.iter().filter(|(key, _)| key.value == "args" && role != Role::Part);
    let args = args.flat_map(|(_, value)| reader.args(value)).collect();
    (args, reader.file.diagnostics)
}

struct Reader<'s> {
    sources: &'s Sources,
    file: FileText,
    /// Diagnostics of missing arguments, which are reported elsewhere.
    unheard: Option<Diagnostic>,
    /// First position of each node's name.
    ids: HashMap<String, Range<usize>>,
}

impl<'s> Reader<'s> {
    fn new(sources: &'s Sources) -> Self {
        Self { sources, file: FileText::default(), unheard: None, ids: HashMap::new() }
    }

    fn error(&mut self, code: &'static str, span: &Range<usize>, message: String) -> &mut Diagnostic {
        let d = Diagnostic::new(Severity::Error, code, self.sources.of(span), span, message);
        self.file.diagnostics.push(d)
    }

    fn wrong_type(&mut self, what: &str, expected: &str, found: &Value) -> &mut Diagnostic {
        let message = format!("{what} must be {expected}, not {}", found.value.found());
        if found.value == Kind::Missing {
            let d = Diagnostic::new(Severity::Error, "wrong-type", self.sources.of(&found.span), &found.span, message);
            return self.unheard.insert(d);
        }
        self.error("wrong-type", &found.span, message).label(format!("expected {expected}"))
    }

    /// The intended key: the key itself when known; otherwise reports it and returns the closest one that the table
    /// does not have, so that a misspelt key does not hide the mistakes below it.
    fn key<'k>(&mut self, what: &str, key: &'k Spanned<String>, known: &[&'static str], table: &'k Table) -> &'k str {
        if known.contains(&key.value.as_str()) {
            return &key.value;
        }
        let near = nearest(&key.value, known.iter().copied());
        self.unknown_key(what, key, known);
        near.filter(|n| !table.iter().any(|(k, _)| k.value == *n)).unwrap_or("")
    }

    fn unknown_key(&mut self, what: &str, key: &Spanned<String>, known: &[&str]) {
        let near = nearest(&key.value, known.iter().copied());
        let message = format!("{what} has no key `{}`", key.value);
        let help = format!("allowed are {}", list(known.iter().copied(), 20, "and"));
        let d = self.error("unknown-key", &key.span, message).help(help);
        if let Some(near) = near {
            d.label(format!("did you mean `{near}`?"));
        }
    }

    fn text(&mut self, what: &str, value: &Value) -> Option<Spanned<String>> {
        let Some(text) = value.value.text() else {
            self.wrong_type(what, "a text in quotes", value);
            return None;
        };
        Some(Spanned::new(text.to_owned(), value.span.clone()))
    }

    fn table<'v>(&mut self, what: &str, expected: &str, value: &'v Value) -> Option<&'v Table> {
        let Kind::Table(table) = &value.value else {
            self.wrong_type(what, expected, value);
            return None;
        };
        Some(table)
    }

    /// Looks up one of a few words, each of which stands for a value.
    fn word<T: Copy>(&mut self, what: &str, value: &Value, words: &[(&str, T)]) -> Option<T> {
        let text = self.text(&format!("`{what}`"), value)?;
        if let Some((_, result)) = words.iter().find(|(w, _)| *w == text.value) {
            return Some(*result);
        }
        let known = || words.iter().map(|(w, _)| *w);
        // Close in meaning goes before close in letters.
        let meant = if text.value == "newest" { "latest" } else { text.value.as_str() };
        let near = known().find(|w| *w == meant).or_else(|| nearest(meant, known()));
        let label = near.map(|n| format!("did you mean \"{n}\"?"));
        let help = format!("`{what}` is {}", known().map(|w| format!("\"{w}\"")).collect::<Vec<_>>().join(" or "));
        let message = format!("\"{}\" is no value of `{what}`", text.value);
        self.error("unknown-word", &value.span, message).label(label.unwrap_or_default()).help(help);
        None
    }

    /// A number above 0 and not above `most`.
    fn positive(&mut self, what: &str, value: &Value, most: f64) -> Option<f64> {
        let Some(number) = value.value.number() else {
            self.wrong_type(&format!("`{what}`"), "a number", value);
            return None;
        };
        if !(number.is_finite() && number > 0.0) {
            self.error("out-of-range", &value.span, format!("`{what}` must be more than 0"))
                .label("expected more than 0");
            return None;
        }
        if number > most {
            self.error("out-of-range", &value.span, format!("`{what}` is {number:?}; allowed: at most {most}"))
                .label(format!("expected at most {most}"));
            return None;
        }
        Some(number)
    }

    /// A whole number in a range.
    fn whole(&mut self, what: &str, value: &Value, range: std::ops::RangeInclusive<i64>) -> Option<i64> {
        let Kind::Int(number) = value.value else {
            self.wrong_type(&format!("`{what}`"), "a whole number", value);
            return None;
        };
        if !range.contains(&number) {
            let (low, high) = (range.start(), range.end());
            let message = format!("`{what}` is {number}; allowed: {low} to {high}");
            self.error("out-of-range", &value.span, message).label(format!("expected {low} to {high}"));
            return None;
        }
        Some(number)
    }

    fn root(&mut self, role: Role, root: &Table) {
        let is_part = root.iter().any(|(key, _)| key.value == "part");
        let (what, known): (&str, &[&'static str]) = match role {
            Role::Overlay => ("an overlay", &TOP_OF_OVERLAY),
            Role::Part => ("a part", &TOP_OF_PART),
            Role::Graph if is_part => ("a part", &TOP_OF_PART),
            Role::Graph => ("a graph file", &TOP),
        };
        for (key, value) in root {
            match self.key(what, key, known, root) {
                "part" => self.file.part = self.part(value),
                "name" => self.file.name = self.text("`name`", value),
                "mode" => {
                    let words = [("live", Mode::Live), ("batch", Mode::Batch)];
                    self.file.mode = self.word("mode", value, &words).unwrap_or_default();
                }
                "plugins" => self.file.plugins = self.texts("plugins", "[\"phantom\", \"sinks\"]", value),
                "plugin_paths" => self.file.plugin_paths = self.texts("plugin_paths", "[\"../my_plugins\"]", value),
                "nodes" => self.nodes(value),
                "isolate" => self.isolate(value),
                "deny" => self.deny(value),
                "machines" => self.machines(value),
                "preset" => self.preset(value),
                "editor" => {
                    if let Some(table) = self.table("`editor`", "a table", value) {
                        self.file.editor = plain_table(table);
                    }
                }
                _ => {}
            }
        }
    }

    fn texts(&mut self, what: &str, example: &str, value: &Value) -> Vec<Spanned<String>> {
        let items = match &value.value {
            Kind::List(items) => items.as_slice(),
            found => {
                let text = found.text();
                let written = text.map_or_else(|| example.to_owned(), |t| format!("[\"{t}\"]"));
                self.wrong_type(&format!("`{what}`"), "a list of texts", value)
                    .help(format!("write {what} = {written}"));
                // A single text is unambiguous; with anything else, what seems missing may stand there.
                self.file.incomplete |= text.is_none();
                return text.map(|t| Spanned::new(t.to_owned(), value.span.clone())).into_iter().collect();
            }
        };
        items.iter().filter_map(|item| self.text(&format!("an entry of `{what}`"), item)).collect()
    }

    fn nodes(&mut self, value: &Value) {
        let Some(nodes) = self.table("`nodes`", "a table of nodes such as [nodes.scope]", value) else { return };
        for (id, value) in nodes {
            self.node_id(id);
            match self.table("a node", "a table such as [nodes.scope]", value) {
                Some(table) => self.node(id, table),
                // It stays known, so that references to it are no mistakes as well.
                None => self.file.nodes.push(NodeText { type_broken: true, ..NodeText::new(id) }),
            }
        }
    }

    fn node_id(&mut self, id: &Spanned<String>) {
        if !is_node_id(&id.value) {
            self.error("bad-node-id", &id.span, format!("`{}` cannot name a node", id.value)).help(
                "a node's name starts with a letter or _ and goes on with letters, digits, _ and -, all of ASCII",
            );
        }
        if let Some(first) = self.ids.get(&id.value).cloned() {
            let line = self.sources.line(&first);
            let message = format!("two nodes are called `{}`; the first is in line {line}", id.value);
            let d = Diagnostic::new(Severity::Error, "duplicate-node", self.sources.of(&id.span), &id.span, message);
            self.file
                .diagnostics
                .push(d)
                .label("again here")
                .help("give one of them another name, and change the references that mean it")
                .note(self.sources, &first, "first here");
        } else {
            self.ids.insert(id.value.clone(), id.span.clone());
        }
    }

    fn node(&mut self, id: &Spanned<String>, table: &Table) {
        let mut node = NodeText::new(id);
        let (mut type_key, mut policy_key) = (None, None);
        for (key, value) in table {
            if ["on_fault", "budget_ms", "max_rate_hz", "cpu"].contains(&key.value.as_str()) {
                policy_key.get_or_insert(key.clone());
            }
            match self.key("a node", key, &NODE, table) {
                "graph" => match self.text("`graph`", value) {
                    Some(file) => node.part = Some(file),
                    None => node.type_broken = true,
                },
                "type" => {
                    type_key = Some(key.span.clone());
                    node.type_name = self.text("`type`", value);
                    node.type_broken = node.type_name.is_none();
                }
                "inputs" => {
                    let expected = "a table such as { left = \"scope.left\" }";
                    if let Some(inputs) = self.table("`inputs`", expected, value) {
                        node.inputs = inputs.iter().map(|(port, value)| self.input(port, value)).collect();
                    }
                }
                "params" => {
                    let expected = "a table such as { seed = 7 }";
                    node.params = self.table("`params`", expected, value).cloned().unwrap_or_default();
                }
                "on_fault" => {
                    let words = [("restart", OnFault::Restart), ("bypass", OnFault::Bypass), ("stop", OnFault::Stop)];
                    node.on_fault = self.word("on_fault", value, &words).unwrap_or_default();
                }
                "budget_ms" => node.budget_ms = self.positive("budget_ms", value, MAX_MS),
                "max_rate_hz" => node.max_rate_hz = self.positive("max_rate_hz", value, HIGHEST_HZ),
                "cpu" => node.cpu = self.whole("cpu", value, 0..=4095).map(|n| n as u32),
                "isolate" => node.isolate = self.group(value),
                "on" => node.on = self.text("`on`", value),
                _ => {}
            }
        }
        if let (Some(part), Some(span)) = (&node.part, type_key) {
            let file = part.span.clone();
            let sources = self.sources;
            let message = format!("node `{}` has a `type` and a `graph`", id.value);
            let d = self.error("type-and-graph", &span, message);
            d.help("keep `type` for a node of a plugin, `graph` for a part").note(sources, &file, "its graph");
            (node.type_name, node.type_broken) = (None, false);
        }
        if let (Some(_), Some(key)) = (&node.part, policy_key) {
            let message = format!("a part has no `{}`", key.value);
            self.error("policy-of-part", &key.span, message).help("set it at a node inside the part's file");
        }
        if node.type_name.is_none() && node.part.is_none() && !node.type_broken && !self.file.incomplete {
            let message = format!("node `{}` has no `type`", id.value);
            self.error("missing-type", &id.span, message)
                .label("which node type?")
                .help("add a line such as type = \"phantom\"; `panoscope list` shows all types");
        }
        self.file.nodes.push(node);
    }

    fn input(&mut self, port: &Spanned<String>, value: &Value) -> InputText {
        let items = match &value.value {
            Kind::List(items) => items.as_slice(),
            _ => std::slice::from_ref(value),
        };
        let refs: Vec<RefText> = items.iter().filter_map(|item| self.connection(item)).collect();
        InputText {
            port: port.clone(),
            broken: refs.len() < items.len(),
            refs,
            span: value.span.clone(),
            is_list: matches!(value.value, Kind::List(_)),
            supply: Supply::Given,
        }
    }

    fn connection(&mut self, value: &Value) -> Option<RefText> {
        match &value.value {
            Kind::Text(text) => self.reference(text, &value.span),
            Kind::Table(table) => self.connection_table(value, table),
            _ => {
                self.wrong_type("an input", "\"node.port\" or { from = \"node.port\" }", value);
                None
            }
        }
    }

    fn reference(&mut self, text: &str, span: &Range<usize>) -> Option<RefText> {
        // Inside the quotes, where the text has no escapes.
        let inside = span.start + 1..span.end.saturating_sub(1);
        let span = if self.sources.text(&inside) == text { inside } else { span.clone() };
        let parts: Vec<&str> = text.split('.').collect();
        if let [node, port] = parts[..]
            && !node.is_empty()
            && !port.is_empty()
            && text == text.trim()
        {
            return Some(RefText {
                node: node.to_owned(),
                port: port.to_owned(),
                span,
                align: Align::Exact,
                max_age_ms: None,
                guide: false,
                queue: None,
                delay: 0,
                trigger: None,
                through_part: false,
                optional: false,
                absent: false,
                written: None,
            });
        }
        let help = match parts[..] {
            _ if text != text.trim() => "remove the spaces inside the quotes".to_owned(),
            [node] if !node.is_empty() => format!("name the output too, as in \"{node}.left\""),
            _ => "write node, a dot, and the output's name, as in \"scope.left\"".to_owned(),
        };
        self.error("bad-reference", &span, format!("`{text}` is no reference to an output"))
            .label("expected \"node.port\"")
            .help(help);
        None
    }

    fn connection_table(&mut self, value: &Value, table: &Table) -> Option<RefText> {
        let mut reference = None;
        let mut from_given = false;
        let mut align = Align::Exact;
        let mut align_given = false;
        let mut tolerance = None;
        let mut tolerance_key = None;
        let (mut max_age, mut queue, mut delay, mut trigger) = (None, None, 0, None);
        let (mut guide, mut optional) = (false, false);
        for (key, value) in table {
            match self.key("an input", key, &INPUT, table) {
                "from" => {
                    from_given = true;
                    reference = self.text("`from`", value).and_then(|t| self.reference(&t.value, &t.span));
                }
                "align" => {
                    let nearest = Align::Nearest { tolerance_ms: 0.0 };
                    let words = [("exact", Align::Exact), ("latest", Align::Latest), ("nearest", nearest)];
                    align = self.word("align", value, &words).unwrap_or_default();
                    align_given = true;
                    if align == nearest {
                        tolerance_key.get_or_insert(value.span.clone());
                    }
                }
                "tolerance_ms" => {
                    tolerance = Some((key.span.clone(), self.positive("tolerance_ms", value, MAX_MS)));
                }
                "max_age_ms" => {
                    max_age = Some((key.span.clone(), self.positive("max_age_ms", value, MAX_MS)));
                }
                "queue" => queue = self.whole("queue", value, 1..=1024).map(|n| n as u32),
                "delay" => delay = self.delay(value),
                "trigger" => trigger = self.flag("trigger", value).then(|| key.span.clone()),
                "guide" => guide = self.flag("guide", value),
                "optional" => optional = self.flag("optional", value),
                _ => {}
            }
        }
        match (&mut align, tolerance) {
            (Align::Nearest { tolerance_ms }, Some((_, Some(ms)))) => *tolerance_ms = ms,
            (Align::Nearest { .. }, Some((_, None))) => {}
            (Align::Nearest { .. }, None) => {
                let span = tolerance_key.unwrap_or(value.span.clone());
                self.error("missing-tolerance", &span, "`nearest` needs `tolerance_ms`".to_owned())
                    .help("say how far apart two pictures may be, as in tolerance_ms = 5");
            }
            (other, Some((key, _))) => {
                let word = other.word();
                let how = if align_given { "says" } else { "without a word means" };
                let message = format!("`tolerance_ms` is for align = \"nearest\" only; this input {how} \"{word}\"");
                self.error("useless-tolerance", &key, message).help("add align = \"nearest\", or remove tolerance_ms");
            }
            (_, None) => {}
        }
        if let Some((key, _)) = &max_age
            && align == Align::Exact
            && delay == 0
        {
            let message =
                "`max_age_ms` is for inputs that do not wait for the same tick; this one is \"exact\"".to_owned();
            self.error("useless-max-age", key, message)
                .help("add align = \"latest\" or align = \"nearest\", or remove max_age_ms");
        }
        let max_age_ms = max_age.and_then(|(_, ms)| ms);
        if !from_given {
            self.error("missing-from", &value.span, "this input does not say what it is connected to".to_owned())
                .label("expected `from`")
                .help("as in { from = \"scope.left\", align = \"latest\" }");
        }
        let reference = reference?;
        Some(RefText { align, max_age_ms, guide, queue, delay, trigger, optional, ..reference })
    }

    fn flag(&mut self, what: &str, value: &Value) -> bool {
        if let Kind::Bool(on) = value.value {
            return on;
        }
        self.wrong_type(&format!("`{what}`"), "true or false", value);
        false
    }

    fn delay(&mut self, value: &Value) -> u8 {
        match value.value {
            Kind::Int(n @ 0..=1) => return n as u8,
            Kind::Int(n) => {
                let message = format!("`delay` is {n}; allowed: 0 and 1");
                self.error("out-of-range", &value.span, message).label("expected 0 or 1").help(
                    "1 gives the value of the consumer's previous tick; longer delays need a node that stores values",
                );
            }
            _ => {
                self.wrong_type("`delay`", "0 or 1", value);
            }
        }
        0
    }

    fn preset(&mut self, value: &Value) {
        let Some(table) = self.table("`preset`", "a table", value) else { return };
        for (key, value) in table {
            match self.key("`preset`", key, &PRESET, table) {
                "pinned" => {
                    let help =
                        "as in pinned = [ { param = \"wide.blend_px\", range = [0, 40], label = \"Seam softness\" } ]";
                    for item in self.items("pinned", "a list of tables", help, value) {
                        if let Some(table) = self.table("an entry of `pinned`", "a table", item) {
                            self.pin(item, table);
                        }
                    }
                }
                "views" => {
                    let help = "as in views = [\"wide.panorama\", { from = \"points.cloud\", label = \"Surface\" }]";
                    for item in self.items("views", "a list of outputs", help, value) {
                        self.view(item);
                    }
                }
                _ => {}
            }
        }
    }

    fn items<'v>(&mut self, what: &str, expected: &str, help: &str, value: &'v Value) -> &'v [Value] {
        let Kind::List(items) = &value.value else {
            self.wrong_type(&format!("`{what}`"), expected, value).help(help);
            return &[];
        };
        items
    }

    fn view(&mut self, item: &Value) {
        let table = match &item.value {
            Kind::Text(text) => {
                let view = self.reference(text, &item.span).map(|from| ViewText { from, label: None });
                self.file.views.extend(view);
                return;
            }
            Kind::Table(table) => table,
            _ => {
                self.wrong_type("an entry of `views`", "\"node.port\" or { from = \"node.port\" }", item);
                return;
            }
        };
        let (mut from, mut label, mut from_given, mut optional) = (None, None, false, false);
        for (key, value) in table {
            match self.key("an entry of `views`", key, &VIEW, table) {
                "from" => {
                    from_given = true;
                    from = self.text("`from`", value).and_then(|t| self.reference(&t.value, &t.span));
                }
                "label" => label = self.text("`label`", value).map(|t| t.value),
                "optional" => optional = self.flag("optional", value),
                _ => {}
            }
        }
        if !from_given {
            self.error("missing-from", &item.span, "this entry of `views` names no output".to_owned())
                .label("expected `from`")
                .help("as in { from = \"points.cloud\", label = \"Surface\" }");
        }
        self.file.views.extend(from.map(|from| ViewText { from: RefText { optional, ..from }, label }));
    }

    fn pin(&mut self, item: &Value, table: &Table) {
        let (mut param, mut range, mut label) = (None, None, None);
        let (mut param_given, mut optional) = (false, false);
        for (key, value) in table {
            match self.key("an entry of `pinned`", key, &PIN, table) {
                "param" => {
                    param_given = true;
                    param = self.text("`param`", value);
                }
                "range" => range = self.pin_range(value),
                "label" => label = self.text("`label`", value).map(|t| t.value),
                "optional" => optional = self.flag("optional", value),
                _ => {}
            }
        }
        if !param_given {
            self.error("missing-param", &item.span, "this entry of `pinned` names no parameter".to_owned())
                .help("as in { param = \"wide.blend_px\" }");
        }
        if let Some(param) = param {
            self.file.pins.push(PinText { param, range, label, optional, absent: false });
        }
    }

    fn pin_range(&mut self, value: &Value) -> Option<(Spanned<f64>, Spanned<f64>)> {
        let numbers = match &value.value {
            Kind::List(items) if items.len() == 2 => {
                let number =
                    |v: &Value| Some(Spanned::new(v.value.number().filter(|n| n.is_finite())?, v.span.clone()));
                number(&items[0]).zip(number(&items[1]))
            }
            _ => None,
        };
        let Some((low, high)) = numbers else {
            let missing = |v: &Value| v.value == Kind::Missing;
            if missing(value) || matches!(&value.value, Kind::List(items) if items.iter().any(missing)) {
                return None;
            }
            self.error("wrong-type", &value.span, "`range` must be a list of two numbers".to_owned())
                .label("expected [lowest, highest]");
            return None;
        };
        if low.value >= high.value {
            let message = format!("`range` goes from {} down to {}", low.value, high.value);
            self.error("bad-range", &value.span, message).label("expected [lowest, highest]");
            return None;
        }
        Some((low, high))
    }
}

/// A name of a node; `/` joins the names of parts, as in `depth/match`.
pub(crate) fn is_node_id(id: &str) -> bool {
    let is_name = |name: &str| {
        let mut chars = name.chars();
        let start = chars.next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_');
        start && chars.all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
    };
    id.split('/').all(is_name)
}
