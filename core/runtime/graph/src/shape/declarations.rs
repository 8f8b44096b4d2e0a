//! Declarations of a file for its users: arguments of a graph, the names that a part offers.

use super::{Reader, is_node_id};
use crate::args::{ArgKind, ArgText};
use crate::checked::{Deny, Machine, Pixels};
use crate::file::{Export, MachineText, PartText};
use crate::value::{Kind, Spanned, Value};

const ARG: [&str; 6] = ["type", "doc", "default", "range", "unit", "choices"];
const PART: [&str; 3] = ["inputs", "outputs", "params"];
const MACHINE: [&str; 4] = ["address", "pixels", "timeout_ms", "plaintext"];
/// Maximum time without a message from a machine, ms.
const MAX_SILENCE_MS: i64 = 60_000;

impl Reader<'_> {
    /// The table `[isolate]`: plugins and the groups of their nodes.
    pub(super) fn isolate(&mut self, value: &Value) {
        let Some(table) = self.table("`isolate`", "a table such as { tools = \"networks\" }", value) else { return };
        for (plugin, value) in table {
            if let Some(group) = self.group(value) {
                self.file.isolate.push((plugin.clone(), group));
            }
        }
    }

    /// The table `[deny]`: groups of isolated nodes and what they may not do.
    pub(super) fn deny(&mut self, value: &Value) {
        let example = "a table such as { networks = [\"network\", \"new_files\"] }";
        let Some(table) = self.table("`deny`", example, value) else { return };
        for (group, value) in table {
            let Kind::List(items) = &value.value else {
                self.wrong_type("an entry of `deny`", "a list of texts", value)
                    .help(format!("write {} = [\"network\", \"new_files\"]", group.value));
                continue;
            };
            let mut deny = Deny::default();
            for item in items {
                match self.word("deny", item, &Deny::WORDS) {
                    Some("network") => deny.network = true,
                    Some(_) => deny.new_files = true,
                    None => {}
                }
            }
            self.file.deny.push((group.clone(), deny));
        }
    }

    /// The table `[machines]`: other machines, each with its address and how pixels go there.
    pub(super) fn machines(&mut self, value: &Value) {
        let example = "a table such as [machines.rack] with address = \"tls/10.0.0.2:7447\"";
        let Some(table) = self.table("`machines`", example, value) else { return };
        for (name, value) in table {
            if !is_node_id(&name.value) || name.value.contains('/') {
                self.error("bad-machine", &name.span, format!("`{}` cannot name a machine", name.value))
                    .help("its name has letters, digits, _ and -, as in [machines.rack]");
                continue;
            }
            let Some(entries) = self.table("a machine", example, value) else { continue };
            let mut machine = Machine::new(&name.value);
            let mut has_address = false;
            for (key, value) in entries {
                match self.key("a machine", key, &MACHINE, entries) {
                    "address" => {
                        has_address = true;
                        if let Some(address) = self.text("`address`", value) {
                            self.address(&address);
                            machine.address = address.value;
                        }
                    }
                    "pixels" => machine.pixels = self.word("pixels", value, &Pixels::WORDS).unwrap_or_default(),
                    "timeout_ms" => {
                        if let Some(ms) = self.whole("timeout_ms", value, 100..=MAX_SILENCE_MS) {
                            machine.timeout_ms = ms as u32;
                        }
                    }
                    "plaintext" => match value.value {
                        Kind::Bool(plaintext) => machine.plaintext = plaintext,
                        _ => _ = self.wrong_type("`plaintext`", "true or false", value),
                    },
                    _ => {}
                }
            }
            if !has_address {
                self.error("machine-without-address", &name.span, format!("machine `{}` has no `address`", name.value))
                    .help("write where `panoscope serve` listens there, as in address = \"tls/10.0.0.2:7447\"");
            }
            self.file.machines.push(MachineText { name: name.clone(), machine });
        }
    }

    /// Reports an address without a protocol or port.
    fn address(&mut self, address: &Spanned<String>) {
        let (protocol, rest) = address.value.split_once('/').unwrap_or(("", &address.value));
        let (host, port) = rest.rsplit_once(':').unwrap_or((rest, ""));
        let is_known = ["tls", "tcp"].contains(&protocol);
        if !is_known || host.is_empty() || port.parse::<u16>().is_err() {
            self.error("bad-address", &address.span, format!("`{}` is no address of a machine", address.value))
                .label("expected tls/HOST:PORT, or tcp/HOST:PORT inside one machine")
                .help("it is the address that `panoscope serve` shows there, as in \"tls/10.0.0.2:7447\"");
        }
    }

    /// The name of a group of isolated nodes.
    pub(super) fn group(&mut self, value: &Value) -> Option<Spanned<String>> {
        let group = self.text("`isolate`", value)?;
        if is_node_id(&group.value) && !group.value.contains('/') {
            return Some(group);
        }
        self.error("bad-group", &group.span, format!("`{}` cannot name a group of nodes", group.value)).help(
            "nodes with the same group share a process; its name has letters, digits, _ and -, as in isolate = \"networks\"",
        );
        None
    }

    pub(super) fn args(&mut self, value: &Value) -> Vec<ArgText> {
        let Some(table) = self.table("`args`", "a table of arguments such as [args.left]", value) else {
            return Vec::new();
        };
        table.iter().filter_map(|(name, value)| self.arg(name, value)).collect()
    }

    fn arg(&mut self, name: &Spanned<String>, value: &Value) -> Option<ArgText> {
        let table = self.table("an argument", "a table such as { type = \"source\", doc = \"Left view\" }", value)?;
        let mut arg = ArgText {
            name: name.clone(),
            kind: None,
            kind_broken: false,
            doc: None,
            default: None,
            range: None,
            unit: String::new(),
            choices: Vec::new(),
        };
        let (mut range_key, mut choices_key) = (None, None);
        for (key, value) in table {
            match self.key("an argument", key, &ARG, table) {
                "type" => {
                    arg.kind = self.word("type", value, &ArgKind::WORDS);
                    arg.kind_broken = arg.kind.is_none();
                }
                "doc" => arg.doc = self.text("`doc`", value).map(|t| t.value),
                "default" => arg.default = Some(value.clone()),
                "range" => {
                    range_key = Some(key.span.clone());
                    arg.range = self.pin_range(value).map(|(low, high)| (low.value, high.value));
                }
                "unit" => arg.unit = self.text("`unit`", value).map(|t| t.value).unwrap_or_default(),
                "choices" => {
                    choices_key = Some(key.span.clone());
                    arg.choices =
                        self.texts("choices", "[\"left\", \"right\"]", value).into_iter().map(|t| t.value).collect();
                }
                _ => {}
            }
        }
        let is_number = matches!(arg.kind, Some(ArgKind::Number | ArgKind::Whole));
        if let Some(span) = range_key.filter(|_| arg.kind.is_some() && !is_number) {
            let message = format!("argument `{}` is not a number, so it has no range", name.value);
            self.error("useless-range", &span, message).help("remove `range`");
        }
        match (arg.kind, choices_key) {
            (Some(ArgKind::Choice), None) => {
                let message = format!("argument `{}` has no `choices`", name.value);
                self.error("missing-choices", &name.span, message).help("as in choices = [\"left\", \"right\"]");
            }
            (Some(kind), Some(span)) if kind != ArgKind::Choice => {
                let message = format!("argument `{}` is of type {}, so it has no choices", name.value, kind.word());
                self.error("useless-choices", &span, message).help("write type = \"choice\", or remove `choices`");
            }
            _ => {}
        }
        Some(arg)
    }

    pub(super) fn part(&mut self, value: &Value) -> Option<PartText> {
        let table = self.table("`part`", "a table of inputs, outputs and params", value)?;
        let mut part = PartText::default();
        for (key, value) in table {
            match self.key("`part`", key, &PART, table) {
                "inputs" => part.inputs = self.exports("inputs", "left = \"rectify.left\"", true, value),
                "outputs" => part.outputs = self.exports("outputs", "disparity = \"match.disparity\"", false, value),
                "params" => part.params = self.exports("params", "search_px = \"match.search_px\"", true, value),
                _ => {}
            }
        }
        Some(part)
    }

    fn exports(&mut self, what: &str, example: &str, several: bool, value: &Value) -> Vec<Export> {
        let expected = format!("a table such as {{ {example} }}");
        let Some(table) = self.table(&format!("`{what}`"), &expected, value) else { return Vec::new() };
        let mut exports = Vec::new();
        for (name, value) in table {
            let items = match &value.value {
                Kind::List(items) if several => items.as_slice(),
                _ => std::slice::from_ref(value),
            };
            let mut targets = Vec::new();
            for item in items {
                let Some(text) = self.text(&format!("an entry of `{what}`"), item) else { continue };
                let inside = text.span.start + 1..text.span.end.saturating_sub(1);
                let span = if self.sources.text(&inside) == text.value { inside } else { text.span };
                match text.value.split_once('.').filter(|(n, p)| !n.is_empty() && !p.is_empty() && !p.contains('.')) {
                    Some((node, port)) => targets.push((node.to_owned(), Spanned::new(port.to_owned(), span))),
                    None => {
                        let message = format!("`{}` names nothing inside the part", text.value);
                        self.error("bad-reference", &span, message).help(format!("as in {example}"));
                    }
                }
            }
            exports.push(Export { name: name.clone(), targets });
        }
        exports
    }
}
