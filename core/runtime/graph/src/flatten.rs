//! A graph of several files as one text, and the way back: which file a value comes from.

use crate::args::{absolute, absolute_files};
use crate::catalog::Catalog;
use crate::checked::{Align, Machine, Mode, OnFault};
use crate::edit::{EditError, GraphEdit, NoHome, edit_value, parse_value};
use crate::file::{MachineText, NodeText, RefText};
use crate::param::{ParamKind, Pick};
use crate::source::{COMMAND_LINE, tidy};
use crate::text::GraphText;
use crate::value::{Kind, Value};
use std::borrow::Cow;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Location of a parameter's value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParamHome {
    /// The file, as diagnostics show it.
    pub file: PathBuf,
    /// The entry in that file.
    pub entry: HomeEntry,
}

/// An entry of a file that gives a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HomeEntry {
    /// A parameter of a node, or of a node that is a part, by the names of that file.
    Param {
        /// The node.
        node: String,
        /// Its parameter.
        param: String,
    },
    /// The default of an argument.
    ArgDefault {
        /// The argument.
        arg: String,
    },
}

impl HomeEntry {
    /// Sets the value in the text of the home's file, or with `None` removes it.
    ///
    /// # Errors
    /// The text cannot be edited this way.
    pub fn set(&self, edit: &mut GraphEdit, value: Option<&toml::Value>) -> Result<(), EditError> {
        match (self, value) {
            (Self::Param { node, param }, Some(value)) => edit.set_param(node, param, value),
            (Self::Param { node, param }, None) => edit.unset_param(node, param),
            (Self::ArgDefault { arg }, value) => edit.set_arg_default(arg, value),
        }
    }
}

impl GraphText {
    /// The entry that gives the value of a parameter, or would give it: for a parameter of a part that is nowhere set,
    /// the part's entry in the graph.
    ///
    /// # Errors
    /// There is no such node, or the value comes from the command line.
    pub fn param_home(&self, node: &str, param: &str) -> Result<ParamHome, NoHome> {
        let whole = self.flat.nodes.iter().find(|n| n.id.value == node);
        let mut level = match (whole, self.flat.part(node)) {
            (Some(node), _) => (node, param.to_owned()),
            (None, Some(part)) => (&part.node, param.to_owned()),
            (None, None) => return Err(NoHome::NoNode(node.to_owned())),
        };
        // From the node outwards: each part may offer the parameter of the one inside.
        let mut levels = vec![level.clone()];
        loop {
            let offers = self.flat.parts.iter().find_map(|part| {
                let params = &part.interface.as_ref()?.params;
                let is = |t: &crate::parts::Target| t.node == level.0.id.value && t.port.value == level.1;
                let (name, _) = params.iter().find(|(_, targets)| targets.iter().any(is))?;
                Some((&part.node, name.clone()))
            });
            let Some(outer) = offers else { break };
            level = outer;
            levels.push(level.clone());
        }
        let given = levels.iter().rev().find_map(|(node, param)| {
            let (_, value) = node.params.iter().find(|(key, value)| {
                // A value that the user of the part gave belongs to the level that gave it.
                let own_file = self.sources.index(value.span.start) == self.sources.index(node.id.span.start);
                key.value == *param && own_file
            })?;
            Some((*node, param, value))
        });
        let (node, param, value) = match given {
            Some((node, param, value)) => (node, param, Some(value)),
            None => {
                let (node, param) = &levels[levels.len() - 1];
                (*node, param, None)
            }
        };
        let use_ = value.and_then(|v| self.arg_uses.get(&v.span.start).filter(|u| u.span == v.span));
        if let Some(use_) = use_ {
            let file = use_.origin.as_ref().map(|origin| self.sources.of(origin)).filter(|s| s.name != COMMAND_LINE);
            let Some(file) = file else {
                let param = format!("{}.{param}", node.id.value);
                return Err(NoHome::CommandLine { param, arg: use_.name.clone() });
            };
            let entry = HomeEntry::ArgDefault { arg: use_.name.clone() };
            return Ok(ParamHome { file: PathBuf::from(&file.name), entry });
        }
        let file = PathBuf::from(&self.sources.of(&node.id.span).name);
        let entry = HomeEntry::Param { node: node.local.clone(), param: param.clone() };
        Ok(ParamHome { file, entry })
    }

    /// The graph as one text that means the same, with the nodes of parts under their whole names
    /// (`[nodes."depth/match"]`), values of arguments in place and paths of other folders made absolute. The text
    /// itself where the graph is one plain file. The catalog says which values are paths; the graph must be right.
    pub fn flattened(&self, catalog: &Catalog) -> Cow<'_, str> {
        if self.is_plain() { Cow::Borrowed(self.text()) } else { Cow::Owned(self.fitted(catalog).write(catalog)) }
    }

    /// As [`Self::flattened`], with the settings of the command line in place too.
    ///
    /// # Errors
    /// As [`GraphEdit::set_param`].
    pub fn settled(&self, catalog: &Catalog) -> Result<String, EditError> {
        let text = self.flattened(catalog).into_owned();
        if self.overrides.is_empty() {
            return Ok(text);
        }
        let mut edit = GraphEdit::parse(&text)?;
        for setting in &self.overrides {
            edit.set_param(&setting.node.value, &setting.param.value, &parse_value(&setting.value.value))?;
        }
        Ok(edit.text())
    }

    fn write(&self, catalog: &Catalog) -> String {
        let text = |text: &str| edit_value(&toml::Value::from(text)).to_string();
        let texts = |all: &mut dyn Iterator<Item = String>| all.map(|t| text(&t)).collect::<Vec<_>>().join(", ");
        let mut out = String::new();
        let _ = writeln!(out, "name = {}", text(self.name()));
        let _ = writeln!(out, "mode = {}", text(if self.mode == Mode::Batch { "batch" } else { "live" }));
        let _ = writeln!(out, "plugins = [{}]", texts(&mut self.plugins().into_iter()));
        let folders = self.plugin_paths();
        if !folders.is_empty() {
            let _ = writeln!(out, "plugin_paths = [{}]", texts(&mut folders.iter().map(|f| absolute(f))));
        }
        for node in &self.flat.nodes {
            self.write_node(&mut out, node, catalog);
        }
        if !self.isolate.is_empty() {
            out.push_str("\n[isolate]\n");
        }
        for (k, (plugin, group)) in self.isolate.iter().enumerate() {
            if !self.isolate[k + 1..].iter().any(|(later, _)| later.value == plugin.value) {
                let _ = writeln!(out, "{} = {}", text(&plugin.value), text(&group.value));
            }
        }
        if !self.deny.is_empty() {
            out.push_str("\n[deny]\n");
        }
        for (k, (group, deny)) in self.deny.iter().enumerate() {
            if !self.deny[k + 1..].iter().any(|(later, _)| later.value == group.value) {
                let words = texts(&mut deny.words().map(str::to_owned));
                let _ = writeln!(out, "{} = [{words}]", text(&group.value));
            }
        }
        for (k, MachineText { name, machine }) in self.machines.iter().enumerate() {
            if self.machines[k + 1..].iter().any(|later| later.name.value == name.value) {
                continue;
            }
            let Machine { address, pixels, timeout_ms, plaintext, .. } = machine;
            let _ = writeln!(out, "\n[machines.{}]\naddress = {}", text(&name.value), text(address));
            let _ = writeln!(out, "pixels = {}\ntimeout_ms = {timeout_ms}", text(pixels.word()));
            if *plaintext {
                out.push_str("plaintext = true\n");
            }
        }
        if !self.pins.is_empty() || !self.views.is_empty() {
            out.push_str("\n[preset]\n");
        }
        if !self.views.is_empty() {
            let view = |view: &crate::file::ViewText| {
                let label = view.label.as_ref().map(|label| format!(", label = {}", text(label))).unwrap_or_default();
                format!("{{ from = {}{label} }}", text(&format!("{}.{}", view.from.node, view.from.port)))
            };
            let _ = writeln!(out, "views = [{}]", self.views.iter().map(view).collect::<Vec<_>>().join(", "));
        }
        if !self.pins.is_empty() {
            let pin = |pin: &crate::file::PinText| {
                let range =
                    pin.range.as_ref().map(|(low, high)| format!(", range = [{:?}, {:?}]", low.value, high.value));
                let label = pin.label.as_ref().map(|label| format!(", label = {}", text(label)));
                let (range, label) = (range.unwrap_or_default(), label.unwrap_or_default());
                format!("{{ param = {}{range}{label} }}", text(&pin.param.value))
            };
            let _ = writeln!(out, "pinned = [{}]", self.pins.iter().map(pin).collect::<Vec<_>>().join(", "));
        }
        if !self.editor.is_empty() {
            out.push_str("\n[editor]\n");
            for (key, value) in &self.editor {
                let _ = writeln!(out, "{} = {}", text(key), edit_value(value));
            }
        }
        out
    }

    fn write_node(&self, out: &mut String, node: &NodeText, catalog: &Catalog) {
        let text = |text: &str| edit_value(&toml::Value::from(text)).to_string();
        let _ = writeln!(out, "\n[nodes.{}]", text(&node.id.value));
        let type_name = node.type_name.as_ref().map_or("", |t| t.value.as_str());
        let _ = writeln!(out, "type = {}", text(type_name));
        let inputs = node.inputs.iter().filter(|i| !i.refs.is_empty() || i.is_list).map(|input| {
            let refs: Vec<String> = input.refs.iter().map(reference).collect();
            let refs = if input.is_list { format!("[{}]", refs.join(", ")) } else { refs.concat() };
            format!("{} = {refs}", text(&input.port.value))
        });
        let inputs: Vec<String> = inputs.collect();
        if !inputs.is_empty() {
            let _ = writeln!(out, "inputs = {{ {} }}", inputs.join(", "));
        }
        let plugins = self.plugins();
        let mut of_type = catalog.find(type_name).into_iter().map(|i| &catalog.node_types[i]);
        let node_type = of_type.find(|t| plugins.contains(&t.plugin));
        let params = node.params.iter().filter(|(_, value)| value.value != Kind::Missing).map(|(key, value)| {
            let kind = node_type.and_then(|t| t.params.get(t.param(&key.value)?));
            let value = match (&value.value, kind.map(|p| (&p.kind, p.pick))) {
                (Kind::Text(path), Some((ParamKind::Path { .. }, _)))
                    if !path.is_empty() && self.is_elsewhere(value) =>
                {
                    toml::Value::from(absolute(&self.dir_of(value).join(path)))
                }
                (Kind::Text(files), Some((_, Pick::File))) if self.is_elsewhere(value) => {
                    toml::Value::from(absolute_files(files, self.dir_of(value)))
                }
                (value, _) => value.plain(),
            };
            format!("{} = {}", text(&key.value), edit_value(&value))
        });
        let params: Vec<String> = params.collect();
        if !params.is_empty() {
            let _ = writeln!(out, "params = {{ {} }}", params.join(", "));
        }
        match node.on_fault {
            OnFault::Restart => {}
            OnFault::Bypass => out.push_str("on_fault = \"bypass\"\n"),
            OnFault::Stop => out.push_str("on_fault = \"stop\"\n"),
        }
        for (key, number) in [("budget_ms", node.budget_ms), ("max_rate_hz", node.max_rate_hz)] {
            if let Some(number) = number {
                let _ = writeln!(out, "{key} = {number:?}");
            }
        }
        if let Some(cpu) = node.cpu {
            let _ = writeln!(out, "cpu = {cpu}");
        }
        if let Some(group) = &node.isolate {
            let _ = writeln!(out, "isolate = {}", text(&group.value));
        }
        if let Some(machine) = &node.on {
            let _ = writeln!(out, "on = {}", text(&machine.value));
        }
    }

    fn dir_of(&self, value: &Value) -> &Path {
        &self.sources.of(&value.span).dir
    }

    /// Whether a value comes from a file in another folder than the graph file.
    fn is_elsewhere(&self, value: &Value) -> bool {
        tidy(self.dir_of(value)) != tidy(&self.sources.first().dir)
    }
}

/// A connection as a file would write it.
fn reference(reference: &RefText) -> String {
    let from = edit_value(&toml::Value::from(format!("{}.{}", reference.node, reference.port)));
    let mut more = String::new();
    match reference.align {
        Align::Exact => {}
        Align::Latest => more.push_str(", align = \"latest\""),
        Align::Nearest { tolerance_ms } => _ = write!(more, ", align = \"nearest\", tolerance_ms = {tolerance_ms:?}"),
    }
    if let Some(max_age_ms) = reference.max_age_ms {
        let _ = write!(more, ", max_age_ms = {max_age_ms:?}");
    }
    if reference.guide {
        more.push_str(", guide = true");
    }
    if let Some(queue) = reference.queue {
        let _ = write!(more, ", queue = {queue}");
    }
    if reference.delay > 0 {
        let _ = write!(more, ", delay = {}", reference.delay);
    }
    if reference.trigger.is_some() {
        more.push_str(", trigger = true");
    }
    if more.is_empty() { from.to_string() } else { format!("{{ from = {from}{more} }}") }
}
