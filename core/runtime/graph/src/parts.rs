//! Parts and overlays: nodes that are graph files are replaced by the nodes of those files before names are looked up,
//! so that a part costs nothing at run time.

use crate::args::refuse_in_part;
use crate::diagnostic::{Diagnostic, Diagnostics, Severity};
use crate::file::{Export, FileText, InputText, NodeText, PartText, PinText, RefText, Role, Supply, ViewText};
use crate::nearest::{list, nearest, sibling};
use crate::parse;
use crate::read::read_file;
use crate::shape;
use crate::source::{Source, Sources, folder, tidy};
use crate::value::{Spanned, Value, shift};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Maximum number of nodes and parts of a flattened graph: parts of parts multiply.
const MAX_NODES: usize = 10_000;
/// Maximum number of levels of parts in parts.
const MAX_LEVELS: usize = 64;
/// Maximum number of bytes of all texts of a graph: a part that is used again is read again.
const MAX_TEXT_BYTES: usize = 64 << 20;
/// Maximum number of inputs and parameters that parts hand on to their nodes: names of names multiply.
const MAX_FORWARDED: usize = 50_000;

/// Target of a name of a part in the flattened graph.
#[derive(Clone, Debug)]
pub(crate) struct Target {
    pub(crate) node: String,
    pub(crate) port: Spanned<String>,
}

/// A node that was replaced by the nodes of its file.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// As written in the file that uses it.
    pub(crate) node: NodeText,
    /// `None` when its file could not be used.
    pub(crate) interface: Option<Interface>,
}

/// The names that a part offers, in file order.
#[derive(Clone, Debug, Default)]
pub(crate) struct Interface {
    /// File as it is shown.
    pub(crate) file: String,
    pub(crate) inputs: Vec<(String, Vec<Target>)>,
    pub(crate) outputs: Vec<(String, Vec<Target>)>,
    pub(crate) params: Vec<(String, Vec<Target>)>,
}

impl Interface {
    fn find<'i>(entries: &'i [(String, Vec<Target>)], name: &str) -> Option<&'i [Target]> {
        entries.iter().find(|(known, _)| known == name).map(|(_, targets)| targets.as_slice())
    }
}

/// The nodes of a graph file and of all its parts.
#[derive(Clone, Debug, Default)]
pub(crate) struct Flat {
    pub(crate) nodes: Vec<NodeText>,
    pub(crate) parts: Vec<Part>,
    /// Plugins that each file lists, by the file's position among the sources.
    pub(crate) plugins: Vec<(usize, Vec<Spanned<String>>)>,
    pub(crate) plugin_paths: Vec<Spanned<String>>,
    /// Outputs and parameters that parts name, for the check that they exist.
    pub(crate) outputs: Vec<Target>,
    pub(crate) params: Vec<Target>,
    /// Nodes that overlays replaced, each with the bytes of its name in the overlay.
    pub(crate) replaced: BTreeMap<String, Range<usize>>,
    /// Nodes whose outputs leave a part that is checked alone.
    pub(crate) read_outside: Vec<String>,
    pub(crate) diagnostics: Diagnostics,
    pub(crate) incomplete: bool,
    /// Inputs and parameters handed on so far.
    forwarded: usize,
    index: HashMap<String, usize>,
}

impl Flat {
    pub(crate) fn part(&self, id: &str) -> Option<&Part> {
        self.parts.iter().find(|p| p.node.id.value == id)
    }

    /// All parameters of nodes that `part.param` stands for, through parts of parts.
    pub(crate) fn param_targets(&self, id: &str, param: &str) -> Option<Vec<Target>> {
        let inner = |id: &str, param: &str| {
            let targets = Interface::find(&self.part(id)?.interface.as_ref()?.params, param)?;
            Some(targets.iter().rev().cloned().collect::<Vec<_>>())
        };
        // Depth first, so in the order of the files; each name once, since names of names multiply.
        let (mut all, mut open, mut seen) = (Vec::new(), inner(id, param)?, HashSet::new());
        while let Some(target) = open.pop() {
            if !seen.insert((target.node.clone(), target.port.value.clone())) {
                continue;
            }
            match inner(&target.node, &target.port.value) {
                Some(more) => open.extend(more),
                None => all.push(target),
            }
        }
        Some(all)
    }

    /// The output of a node that `part.output` stands for.
    pub(crate) fn output_target(&self, id: &str, output: &str) -> Option<Target> {
        let targets = Interface::find(&self.part(id)?.interface.as_ref()?.outputs, output)?;
        let target = targets.first()?;
        Some(self.output_target(&target.node, &target.port.value).unwrap_or_else(|| target.clone()))
    }
}

/// Replaces parts by their nodes.
pub(crate) struct Flattener<'a> {
    pub(crate) sources: &'a mut Sources,
    /// Texts in place of files.
    pub(crate) texts: &'a BTreeMap<PathBuf, String>,
    /// Nodes that replace those of their name, and whether they did.
    pub(crate) overlays: Vec<(NodeText, bool)>,
    pub(crate) flat: Flat,
}

impl Flattener<'_> {
    fn error(&mut self, code: &'static str, span: &Range<usize>, message: String) -> &mut Diagnostic {
        let d = Diagnostic::new(Severity::Error, code, self.sources.of(span), span, message);
        self.flat.diagnostics.push(d)
    }

    /// Flattens the graph file `root`, whose file is `path`.
    pub(crate) fn run(mut self, mut root: FileText, path: &Path) -> (Flat, Vec<ViewText>, Vec<PinText>) {
        let (mut views, mut pins) = (std::mem::take(&mut root.views), std::mem::take(&mut root.pins));
        let alone = root.part.is_some();
        let interface = self.file(root, 0, "", &[(tidy(path), path.display().to_string())]);
        if alone {
            for (name, targets) in interface.inputs {
                let port = Spanned::new(name, 0..0);
                let open = InputText {
                    port,
                    refs: Vec::new(),
                    span: 0..0,
                    is_list: false,
                    broken: false,
                    supply: Supply::Open,
                };
                targets.iter().for_each(|target| self.connect(target, &open));
            }
            let outputs = interface.outputs.into_iter().flat_map(|(_, targets)| targets);
            // An output may be one of a part inside.
            let inside = |t: Target| self.flat.output_target(&t.node, &t.port.value).map_or(t.node, |inner| inner.node);
            self.flat.read_outside = outputs.map(inside).collect();
        }
        let unused: Vec<NodeText> = self.overlays.iter().filter(|(_, used)| !used).map(|(n, _)| n.clone()).collect();
        for node in unused {
            let ids: Vec<String> = self.flat.nodes.iter().map(|n| n.id.value.clone()).collect();
            let near = nearest(&node.id.value, ids.iter().map(String::as_str)).map(|n| format!("did you mean `{n}`?"));
            let help = format!("nodes: {}", list(ids.iter().map(String::as_str), 12, "and"));
            let message = format!("`{}` replaces nothing: the graph has no node of that name", node.id.value);
            self.error("overlay-replaces-nothing", &node.id.span, message).label(near.unwrap_or_default()).help(help);
        }
        self.references();
        views.retain_mut(|view| self.resolve(&mut view.from));
        pins.retain_mut(|pin| self.pin(pin));
        (self.flat, views, pins)
    }

    /// Adds the nodes of a file. `chain` holds the files that lead here, as paths and as they are shown.
    fn file(&mut self, file: FileText, index: usize, prefix: &str, chain: &[(PathBuf, String)]) -> Interface {
        self.flat.diagnostics.extend(file.diagnostics);
        self.flat.incomplete |= file.incomplete;
        self.flat.plugins.push((index, file.plugins));
        self.flat.plugin_paths.extend(file.plugin_paths);
        for mut node in file.nodes {
            let id = format!("{prefix}{}", node.id.value);
            if let Some((over, used)) = self.overlays.iter_mut().rev().find(|(n, _)| n.id.value == id) {
                *used = true;
                self.flat.replaced.insert(id.clone(), over.id.span.clone());
                node = over.clone();
            } else {
                node.id.value.clone_from(&id);
                for reference in node.inputs.iter_mut().flat_map(|i| &mut i.refs) {
                    reference.node = format!("{prefix}{}", reference.node);
                }
            }
            if node.part.is_some() {
                self.part(node, chain);
            } else {
                self.flat.index.entry(id).or_insert(self.flat.nodes.len());
                self.flat.nodes.push(node);
            }
        }
        self.interface(file.part, prefix)
    }

    /// The names a part offers. Reports names that stand for nothing.
    fn interface(&mut self, part: Option<PartText>, prefix: &str) -> Interface {
        let PartText { inputs, outputs, params } = part.unwrap_or_default();
        let mut known = |exports: Vec<Export>| {
            let entries = exports.into_iter().map(|export| {
                let targets = export.targets.into_iter().filter_map(|(node, port)| self.target(prefix, &node, port));
                (export.name.value, targets.collect::<Vec<_>>())
            });
            entries.collect::<Vec<_>>()
        };
        let (inputs, outputs, params) = (known(inputs), known(outputs), known(params));
        let of = |entries: &[(String, Vec<Target>)]| entries.iter().flat_map(|(_, t)| t.clone()).collect::<Vec<_>>();
        self.flat.outputs.extend(of(&outputs));
        self.flat.params.extend(of(&params));
        Interface { file: String::new(), inputs, outputs, params }
    }

    fn target(&mut self, prefix: &str, node: &str, port: Spanned<String>) -> Option<Target> {
        let id = format!("{prefix}{node}");
        if self.flat.index.contains_key(&id) || self.flat.part(&id).is_some() {
            return Some(Target { node: id, port });
        }
        if !self.flat.incomplete {
            let of_file = |id: &str| id.strip_prefix(prefix).filter(|rest| !rest.contains('/')).map(str::to_owned);
            let nodes = self.flat.nodes.iter().map(|n| &n.id.value);
            let parts = self.flat.parts.iter().map(|p| &p.node.id.value);
            let names: Vec<String> = nodes.chain(parts).filter_map(|id| of_file(id)).collect();
            let near = nearest(node, names.iter().map(String::as_str)).map(|n| format!("did you mean `{n}`?"));
            let help = format!("nodes of this part: {}", list(names.iter().map(String::as_str), 12, "and"));
            let span = port.span.start..(port.span.start + node.len()).min(port.span.end);
            self.error("unknown-node", &span, format!("the part has no node `{node}`"))
                .label(near.unwrap_or_default())
                .help(help);
        }
        None
    }

    /// Replaces a node by the nodes of its file.
    fn part(&mut self, node: NodeText, chain: &[(PathBuf, String)]) {
        let Some(file) = node.part.clone() else { return };
        let interface = self.load(&node, &file, chain);
        let id = node.id.value.clone();
        if let Some(interface) = &interface {
            self.given(&node, interface);
        }
        if let (Some(group), true) = (&node.isolate, interface.is_some()) {
            // The use of a part decides for all nodes inside.
            let inside = format!("{id}/");
            let nodes = self.flat.nodes.iter_mut().filter(|n| n.id.value.starts_with(&inside));
            nodes.for_each(|n| n.isolate = Some(group.clone()));
        }
        if let (Some(machine), true) = (&node.on, interface.is_some()) {
            let inside = format!("{id}/");
            let nodes = self.flat.nodes.iter_mut().filter(|n| n.id.value.starts_with(&inside));
            nodes.for_each(|n| (n.on, n.isolate) = (Some(machine.clone()), None));
        }
        self.flat.index.remove(&id);
        self.flat.parts.push(Part { node, interface });
    }

    /// The text of a part: of the editor if it is open there, else of the file.
    fn read(&mut self, file: &Spanned<String>, path: &Path, key: &Path) -> Option<String> {
        Some(match self.texts.get(key) {
            Some(text) => text.clone(),
            // Errors quote the file: what is no graph must not show in them.
            None if path.canonicalize().is_ok_and(|file| file.is_file() && !has_extension_of_graph(&file)) => {
                let message = format!("`{}` is not a part: names of graph files end in .toml", file.value);
                self.error("part-unreadable", &file.span, message)
                    .help("rename the file, or correct the path; of a link the name of its target counts");
                return None;
            }
            None => match read_file(path) {
                Ok(bytes) => match String::from_utf8(bytes) {
                    Ok(text) => text,
                    Err(_) => {
                        let message = format!("`{}` is not UTF-8 text", file.value);
                        self.error("part-unreadable", &file.span, message).help("save it as UTF-8 in your editor");
                        return None;
                    }
                },
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                    let message = format!("there is no part `{}`", file.value);
                    let near = sibling(path).and_then(|p| p.file_name().map(|n| n.to_string_lossy().into_owned()));
                    self.error("part-missing", &file.span, message)
                        .label(near.map(|n| format!("did you mean `{n}`?")).unwrap_or_default())
                        .help(format!("looked for {}; paths are relative to the file that names them", path.display()));
                    return None;
                }
                Err(e) => {
                    let message = format!("the part `{}` cannot be read: {e}", file.value);
                    self.error("part-unreadable", &file.span, message);
                    return None;
                }
            },
        })
    }

    /// Reads the file of a part and adds its nodes.
    fn load(&mut self, node: &NodeText, file: &Spanned<String>, chain: &[(PathBuf, String)]) -> Option<Interface> {
        let path = self.sources.of(&file.span).dir.join(&file.value);
        let (key, shown) = (tidy(&path), path.display().to_string());
        if let Some(at) = chain.iter().position(|(known, _)| *known == key) {
            let names: Vec<&str> = chain[at..].iter().map(|(_, name)| name.as_str()).chain([shown.as_str()]).collect();
            let message = format!("this part would contain itself: {}", names.join(" -> "));
            self.error("part-recursion", &file.span, message)
                .help("a part cannot use itself, nor a file that leads back to it");
            return None;
        }
        if chain.len() > MAX_LEVELS {
            self.error("part-recursion", &file.span, format!("parts stand in parts more than {MAX_LEVELS} deep"))
                .help("use the nodes of the inner parts directly");
            return None;
        }
        let text = self.read(file, &path, &key)?;
        let text_length = text.len();
        let read: usize = self.sources.list().last().map_or(0, |last| last.base() + last.text.len());
        if read + text_length > MAX_TEXT_BYTES {
            let message = format!("the graph has more than {MAX_TEXT_BYTES} bytes with this part");
            self.error("too-many-nodes", &file.span, message).help("parts of parts multiply: use fewer");
            return None;
        }
        let source = Source::new(shown.clone(), text, folder(&path));
        let mut parsed = parse::parse(&source);
        let index = self.sources.add(source);
        let base = self.sources.list()[index].base();
        shift(&mut parsed.root, base);
        refuse_in_part(self.sources, &mut parsed.root, &mut parsed.diagnostics);
        let complete = !parsed.incomplete;
        let part = shape::read(self.sources, Role::Part, parsed);
        if part.part.is_none() && complete && !part.diagnostics.has_errors() {
            self.flat.diagnostics.extend(part.diagnostics);
            let message = format!("`{}` is not a part: it has no table `[part]`", file.value);
            let start = base..base + text_length.min(1);
            let sources = &*self.sources;
            let d = Diagnostic::new(Severity::Error, "not-a-part", sources.of(&file.span), &file.span, message);
            self.flat.diagnostics.push(d).note(
                sources,
                &start,
                "expected [part] with inputs, outputs and params in this file",
            );
            return None;
        }
        // A part without nodes of its own counts, too: otherwise empty parts multiply without end.
        if self.flat.nodes.len() + self.flat.parts.len() + part.nodes.len() > MAX_NODES {
            let message = format!("the graph has more than {MAX_NODES} nodes with this part");
            self.error("too-many-nodes", &file.span, message).help("parts of parts multiply: use fewer");
            return None;
        }
        let mut longer = chain.to_vec();
        longer.push((key, shown.clone()));
        let mut interface = self.file(part, index, &format!("{}/", node.id.value), &longer);
        interface.file = shown;
        Some(interface)
    }

    /// Passes what the graph gives to a part on to the nodes inside.
    fn given(&mut self, node: &NodeText, interface: &Interface) {
        for input in &node.inputs {
            match Interface::find(&interface.inputs, &input.port.value) {
                Some(targets) => targets.iter().for_each(|target| self.connect(target, input)),
                None => self.unknown(
                    "unknown-part-input",
                    &node.id.value,
                    "input",
                    &input.port,
                    &interface.inputs,
                    &interface.file,
                ),
            }
        }
        for (name, targets) in &interface.inputs {
            if node.inputs.iter().any(|i| i.port.value == *name) {
                continue;
            }
            let (span, part, input) = (node.id.span.clone(), node.id.value.clone(), name.clone());
            let supply = Supply::Unconnected { span: span.clone(), part, input };
            let port = Spanned::new(name.clone(), span.clone());
            let missing = InputText { port, refs: Vec::new(), span, is_list: false, broken: false, supply };
            targets.iter().for_each(|target| self.connect(target, &missing));
        }
        for (key, value) in &node.params {
            match Interface::find(&interface.params, &key.value) {
                Some(targets) => targets.iter().for_each(|target| self.set(target, value)),
                None => self.unknown(
                    "unknown-part-param",
                    &node.id.value,
                    "parameter",
                    key,
                    &interface.params,
                    &interface.file,
                ),
            }
        }
    }

    fn unknown(
        &mut self,
        code: &'static str,
        part: &str,
        what: &str,
        name: &Spanned<String>,
        entries: &[(String, Vec<Target>)],
        file: &str,
    ) {
        let names = || entries.iter().map(|(name, _)| name.as_str());
        let near = nearest(&name.value, names()).map(|n| format!("did you mean `{n}`?"));
        let help = match entries.is_empty() {
            true => format!("{file} names none in [part]"),
            false => format!("{what}s of {file}: {}", list(names(), 20, "and")),
        };
        let message = format!("part `{part}` has no {what} `{}`", name.value);
        self.error(code, &name.span, message).label(near.unwrap_or_default()).help(help);
    }

    /// Counts a name that is passed on. Reports the first one beyond the limit; `false` from there on.
    fn may_forward(&mut self, span: &Range<usize>) -> bool {
        self.flat.forwarded += 1;
        if self.flat.forwarded == MAX_FORWARDED {
            let message = format!("parts hand on more than {MAX_FORWARDED} inputs and parameters");
            self.error("too-many-nodes", span, message)
                .help("names in [part] that stand for several names multiply: use fewer");
        }
        self.flat.forwarded < MAX_FORWARDED
    }

    /// Connects an input inside a part as its user connects the part.
    fn connect(&mut self, target: &Target, input: &InputText) {
        if !self.may_forward(&target.port.span) {
            return;
        }
        if let Some(inner) = self.flat.part(&target.node) {
            let Some(interface) = inner.interface.clone() else { return };
            match Interface::find(&interface.inputs, &target.port.value) {
                Some(targets) => targets.iter().for_each(|target| self.connect(target, input)),
                None => {
                    let (node, file) = (target.node.clone(), interface.file.clone());
                    self.unknown("unknown-part-input", &node, "input", &target.port, &interface.inputs, &file);
                }
            }
            return;
        }
        let Some(&index) = self.flat.index.get(&target.node) else { return };
        let new = InputText { port: target.port.clone(), ..input.clone() };
        let node = &mut self.flat.nodes[index];
        match node.inputs.iter_mut().find(|i| i.port.value == target.port.value) {
            Some(old) if old.supply == Supply::Given && !old.refs.is_empty() && old.port.span != target.port.span => {
                let (taken, name) = (old.port.span.clone(), node.local.clone());
                let message = format!("`{}` of `{name}` is connected inside the part already", target.port.value);
                let sources = &*self.sources;
                let d = Diagnostic::new(
                    Severity::Error,
                    "part-input-taken",
                    sources.of(&target.port.span),
                    &target.port.span,
                    message,
                );
                self.flat.diagnostics.push(d).note(sources, &taken, "connected here").help("remove one of the two");
            }
            Some(old) => *old = new,
            None => node.inputs.push(new),
        }
    }

    /// Sets a parameter inside a part as its user sets it.
    fn set(&mut self, target: &Target, value: &Value) {
        if !self.may_forward(&target.port.span) {
            return;
        }
        if let Some(inner) = self.flat.part(&target.node) {
            let Some(interface) = inner.interface.clone() else { return };
            match Interface::find(&interface.params, &target.port.value) {
                Some(targets) => targets.iter().for_each(|target| self.set(target, value)),
                None => {
                    let (node, file) = (target.node.clone(), interface.file.clone());
                    self.unknown("unknown-part-param", &node, "parameter", &target.port, &interface.params, &file);
                }
            }
            return;
        }
        let Some(&index) = self.flat.index.get(&target.node) else { return };
        let node = &mut self.flat.nodes[index];
        node.params.retain(|(key, _)| key.value != target.port.value);
        node.params.push((target.port.clone(), value.clone()));
    }

    /// Points references at outputs of parts to the nodes inside.
    fn references(&mut self) {
        if self.flat.parts.is_empty() {
            return;
        }
        let mut nodes = std::mem::take(&mut self.flat.nodes);
        for input in nodes.iter_mut().flat_map(|n| &mut n.inputs) {
            let before = input.refs.len();
            input.refs.retain_mut(|reference| self.resolve(reference));
            input.broken |= input.refs.len() < before;
        }
        self.flat.nodes = nodes;
    }

    fn pin(&mut self, pin: &mut PinText) -> bool {
        let Some((id, param)) = pin.param.value.split_once('.') else { return true };
        let Some(part) = self.flat.part(id) else { return true };
        let Some(interface) = part.interface.clone() else { return false };
        let name = Spanned::new(param.to_owned(), pin.param.span.clone());
        match self.flat.param_targets(id, param).as_deref() {
            Some([only]) => {
                pin.label.get_or_insert_with(|| param.to_owned());
                pin.param.value = format!("{}.{}", only.node, only.port.value);
                true
            }
            Some(several) => {
                let message = format!("`{}` sets {} parameters, a pin shows one", pin.param.value, several.len());
                let help = several.iter().map(|t| format!("{}.{}", t.node, t.port.value)).collect::<Vec<_>>();
                let help = format!("pin one of them: {}", list(help.iter().map(String::as_str), 8, "or"));
                self.error("pin-of-several", &pin.param.span, message).help(help);
                false
            }
            None if pin.optional && self.flat.replaced.contains_key(id) => {
                pin.absent = true;
                true
            }
            None => {
                let id = id.to_owned();
                self.unknown("unknown-part-param", &id, "parameter", &name, &interface.params, &interface.file);
                false
            }
        }
    }

    /// Points a reference to the node inside a part; `false` when the part has no such output.
    fn resolve(&mut self, reference: &mut RefText) -> bool {
        let Some(part) = self.flat.part(&reference.node) else { return true };
        let Some(interface) = &part.interface else { return false };
        if let Some(target) = self.flat.output_target(&reference.node, &reference.port) {
            let node = std::mem::replace(&mut reference.node, target.node);
            let port = std::mem::replace(&mut reference.port, target.port.value);
            reference.written = Some((node, port));
            reference.through_part = true;
            // A part whose file could not be used has no nodes.
            return self.flat.part(&reference.node).is_none();
        }
        // A name that stands for nothing inside is reported in the part's file.
        if Interface::find(&interface.outputs, &reference.port).is_some() {
            return false;
        }
        if reference.optional && self.flat.replaced.contains_key(&reference.node) {
            reference.absent = true;
            return true;
        }
        let (entries, file) = (interface.outputs.clone(), interface.file.clone());
        let local = part.node.local.len();
        let start = (reference.span.start + local + 1).min(reference.span.end);
        let name = Spanned::new(reference.port.clone(), start..reference.span.end);
        self.unknown("unknown-part-output", &reference.node.clone(), "output", &name, &entries, &file);
        false
    }
}

fn has_extension_of_graph(file: &Path) -> bool {
    file.extension().is_some_and(|extension| extension == "toml")
}
