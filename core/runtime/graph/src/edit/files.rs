//! Changes to a graph of several files: each goes into the file that the node is written in, and a connection across
//! the boundary of a part goes through the names that the part offers.

use super::part::PartPortKind;
use super::references::mentions;
use super::{EditError, GraphEdit};
use crate::outline::{NodeHome, PartOutline};
use crate::source::tidy;
use crate::text::{FileKind, GraphText};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The files of a graph under edit. Nodes have whole names: `depth/match` is node `match` of part `depth`.
pub struct FileEdits<'g> {
    pub(super) graph: &'g GraphText,
    pub(super) parts: Vec<PartOutline>,
    root: PathBuf,
    edits: BTreeMap<PathBuf, GraphEdit>,
    created: BTreeMap<PathBuf, String>,
}

/// The part that a node belongs to; empty for a node of the graph file.
pub(super) fn parent(id: &str) -> &str {
    id.rsplit_once('/').map_or("", |(parent, _)| parent)
}

/// A node's name among those of its part.
pub(super) fn local(id: &str) -> &str {
    id.rsplit_once('/').map_or(id, |(_, local)| local)
}

/// The whole name of a node of a part.
pub(super) fn whole(parent: &str, local: &str) -> String {
    if parent.is_empty() { local.to_owned() } else { format!("{parent}/{local}") }
}

/// Whether a part is another one or inside it.
fn is_within(inner: &str, outer: &str) -> bool {
    outer.is_empty() || mentions(inner, outer)
}

impl<'g> FileEdits<'g> {
    /// Nothing is changed yet.
    pub fn new(graph: &'g GraphText) -> Self {
        let root = tidy(graph.path());
        Self { graph, parts: graph.parts(), root, edits: BTreeMap::new(), created: BTreeMap::new() }
    }

    /// The graph file.
    ///
    /// # Errors
    /// It is not TOML.
    pub fn root(&mut self) -> Result<&mut GraphEdit, EditError> {
        let root = self.root.clone();
        self.file(&root)
    }

    /// A file of the graph by its absolute path.
    ///
    /// # Errors
    /// It is not TOML.
    pub fn file(&mut self, path: &Path) -> Result<&mut GraphEdit, EditError> {
        if !self.edits.contains_key(path) {
            let files = self.graph.files();
            let is = |f: &&crate::text::GraphFile<'_>| f.key() == path;
            let text = match path == self.root {
                true => self.graph.text(),
                false => files.iter().find(is).map_or("", |f| f.text),
            };
            self.edits.insert(path.to_owned(), GraphEdit::parse(text)?);
        }
        // Present: inserted above.
        Ok(self.edits.entry(path.to_owned()).or_default())
    }

    /// Adds a file.
    pub(super) fn create(&mut self, path: PathBuf, text: String) {
        self.created.insert(path, text);
    }

    /// The changed files by absolute path: the text before, `None` for a new file, and the text now.
    pub fn into_texts(self) -> Vec<(PathBuf, Option<String>, String)> {
        let files = self.graph.files();
        let before = |path: &Path| files.iter().find(|f| f.key() == path).map(|f| f.text.to_owned());
        let changed = self.edits.iter().map(|(path, edit)| (path.clone(), before(path), edit.text()));
        let new = self.created.into_iter().map(|(path, text)| (path, None, text));
        changed.filter(|(_, old, new)| old.as_ref() != Some(new)).chain(new).collect()
    }

    /// Absolute path of the file that holds the nodes of a part; of the graph file for an empty name.
    pub(super) fn level_file(&self, part: &str) -> Result<PathBuf, EditError> {
        if part.is_empty() {
            return Ok(self.root.clone());
        }
        let found = self.parts.iter().find(|p| p.id == part).and_then(|p| p.path.clone());
        found.ok_or_else(|| EditError::NoPart { id: part.to_owned() })
    }

    /// File that defines a node; for a node that was just added, the file of its part.
    pub(super) fn home(&mut self, id: &str) -> Result<NodeHome, EditError> {
        if let Some(home) = self.graph.node_home(id) {
            return Ok(home);
        }
        let (file, name) = (self.level_file(parent(id))?, local(id).to_owned());
        let kind = if file == self.root { FileKind::Graph } else { FileKind::Part };
        match self.file(&file)?.node_names().contains(&name) {
            true => Ok(NodeHome { file, kind, local: name, line: 0 }),
            false => Err(EditError::NoNode { id: id.to_owned() }),
        }
    }

    /// As [`Self::home`]; refuses nodes of overlays.
    pub(super) fn own_home(&mut self, id: &str) -> Result<NodeHome, EditError> {
        let home = self.home(id)?;
        match home.kind {
            FileKind::Overlay => {
                Err(EditError::FromOverlay { id: id.to_owned(), file: home.file.display().to_string() })
            }
            _ => Ok(home),
        }
    }

    /// Parts that use the same file as `part`, including `part`.
    pub(super) fn users(&self, part: &str) -> Vec<String> {
        let file = self.parts.iter().find(|p| p.id == part).and_then(|p| p.path.clone());
        file.map(|file| self.graph.part_users(&file)).unwrap_or_default()
    }

    /// The file that a node is written in, and the node's name there.
    ///
    /// # Errors
    /// There is no such node.
    pub fn entry(&mut self, id: &str) -> Result<(&GraphEdit, String), EditError> {
        let home = self.home(id)?;
        Ok((&*self.file(&home.file)?, home.local))
    }

    /// Adds a node to a part, or to the graph file where `part` is empty; returns its whole name.
    ///
    /// # Errors
    /// The name is taken or cannot name a node.
    pub fn add_node(&mut self, part: &str, name: &str, type_name: &str, plugin: &str) -> Result<String, EditError> {
        let file = self.level_file(part)?;
        let edit = self.file(&file)?;
        edit.add_plugin(plugin)?;
        edit.add_node(name, type_name)?;
        Ok(whole(part, name))
    }

    /// Connects one entry of an input, as [`GraphEdit::connect`]. Where the connection leaves or enters a part, the
    /// part then offers a name for it.
    ///
    /// # Errors
    /// There is no such node, or a list would be supplied from inside and from outside a part.
    pub fn connect(&mut self, from: (&str, &str), to: (&str, &str), list: bool, index: usize) -> Result<(), EditError> {
        let (mut node, mut port) = (from.0.to_owned(), from.1.to_owned());
        let (mut end, mut input) = (to.0.to_owned(), to.1.to_owned());
        while !is_within(parent(&end), parent(&node)) {
            let part = parent(&node).to_owned();
            port = self.offer_output(&part, local(&node), &port)?;
            node = part;
        }
        while parent(&end) != parent(&node) {
            let part = parent(&end).to_owned();
            input = self.offer_input(&part, &end, &input, list)?;
            end = part;
        }
        let home = self.home(&end)?;
        // An overlay names nodes by their whole names.
        let from = if home.kind == FileKind::Overlay { node.as_str() } else { local(&node) };
        let from = format!("{from}.{port}");
        self.file(&home.file)?.connect(&home.local, &input, list, index, &from)
    }

    /// The name under which a part offers an output; added if absent.
    fn offer_output(&mut self, part: &str, node: &str, port: &str) -> Result<String, EditError> {
        let file = self.level_file(part)?;
        let edit = self.file(&file)?;
        let target = format!("{node}.{port}");
        if let Some(name) = edit.part_port_of(PartPortKind::Output, &target) {
            return Ok(name);
        }
        let name = edit.free_part_port(PartPortKind::Output, node, port);
        edit.set_part_port(PartPortKind::Output, &name, &[target]);
        Ok(name)
    }

    /// The name under which a part offers an input of `id` alone; added if absent.
    fn offer_input(&mut self, part: &str, id: &str, input: &str, list: bool) -> Result<String, EditError> {
        let home = self.home(id)?;
        if let Some(inside) = self.file(&home.file)?.input_references(&home.local, input) {
            if list && !inside.is_empty() {
                return Err(EditError::MixedInput { id: id.to_owned(), input: input.to_owned() });
            }
            self.file(&home.file)?.remove_input(&home.local, input)?;
        }
        let (file, target) = (self.level_file(part)?, format!("{}.{input}", local(id)));
        let edit = self.file(&file)?;
        let shared = edit.part_port_of(PartPortKind::Input, &target);
        if let Some(name) = &shared {
            let mut targets = edit.part_targets(PartPortKind::Input, name);
            if targets.len() == 1 {
                return Ok(name.clone());
            }
            // The other inputs of the name keep what they read.
            targets.retain(|t| *t != target);
            edit.set_part_port(PartPortKind::Input, name, &targets);
        }
        let edit = self.file(&file)?;
        let name = edit.free_part_port(PartPortKind::Input, local(id), input);
        edit.set_part_port(PartPortKind::Input, &name, &[target]);
        if let Some(before) = shared {
            for user in self.users(part) {
                let home = self.home(&user)?;
                self.file(&home.file)?.copy_input(&home.local, &before, &name)?;
            }
        }
        Ok(name)
    }

    /// Disconnects one entry of an input, in the file that connects it. Nothing happens when there is no such entry.
    ///
    /// # Errors
    /// There is no such node.
    pub fn disconnect(&mut self, id: &str, input: &str, index: usize) -> Result<(), EditError> {
        let (mut end, mut input) = (id.to_owned(), input.to_owned());
        loop {
            let home = self.home(&end)?;
            let edit = self.file(&home.file)?;
            if edit.input_references(&home.local, &input).is_some() {
                return edit.disconnect(&home.local, &input, index);
            }
            let part = parent(&end).to_owned();
            if part.is_empty() {
                return Ok(());
            }
            let (file, target) = (self.level_file(&part)?, format!("{}.{input}", local(&end)));
            let edit = self.file(&file)?;
            let Some(name) = edit.part_port_of(PartPortKind::Input, &target) else { return Ok(()) };
            let mut targets = edit.part_targets(PartPortKind::Input, &name);
            if targets.len() > 1 {
                // The other inputs of the name stay connected.
                targets.retain(|t| *t != target);
                edit.set_part_port(PartPortKind::Input, &name, &targets);
                return Ok(());
            }
            (end, input) = (part, name);
        }
    }

    /// Removes a node with everything that names it, in all files of the graph.
    ///
    /// # Errors
    /// There is no such node, or it is an overlay's.
    pub fn remove_node(&mut self, id: &str) -> Result<(), EditError> {
        let home = self.own_home(id)?;
        let edit = self.file(&home.file)?;
        let gone = edit.remove_part_targets(&home.local);
        edit.remove_node(&home.local)?;
        let part = parent(id).to_owned();
        for (kind, name) in gone {
            self.forget(&part, kind, &name)?;
        }
        for user in self.level_users(&part) {
            self.root()?.remove_mentions(&whole(&user, &home.local))?;
        }
        Ok(())
    }

    /// The parts that have the nodes of `part`: itself and the others of its file; the graph file's level for an empty
    /// name.
    fn level_users(&self, part: &str) -> Vec<String> {
        if part.is_empty() { vec![String::new()] } else { self.users(part) }
    }

    /// Removes uses of a name that a part no longer offers.
    fn forget(&mut self, part: &str, kind: PartPortKind, name: &str) -> Result<(), EditError> {
        for user in self.level_users(part) {
            if user.is_empty() {
                continue;
            }
            let home = self.home(&user)?;
            let edit = self.file(&home.file)?;
            let gone = edit.forget_port(&home.local, kind, name)?;
            let outer = parent(&user).to_owned();
            for (kind, name) in gone {
                self.forget(&outer, kind, &name)?;
            }
        }
        Ok(())
    }

    /// Renames a node in all files of the graph; returns its new whole name.
    ///
    /// # Errors
    /// There is no such node, it is an overlay's, or the new name is taken.
    pub fn rename_node(&mut self, id: &str, new: &str) -> Result<String, EditError> {
        let home = self.own_home(id)?;
        self.file(&home.file)?.rename_node(&home.local, new)?;
        let part = parent(id).to_owned();
        if !part.is_empty() {
            for user in self.level_users(&part) {
                self.root()?.rename_mentions(&whole(&user, &home.local), &whole(&user, new))?;
            }
        }
        Ok(whole(&part, new))
    }

    /// Adds a copy of a node next to it, with its inputs and parameters; returns the copy's whole name.
    ///
    /// # Errors
    /// There is no such node, it is an overlay's, or the name is taken.
    pub fn duplicate_node(&mut self, id: &str, copy: &str) -> Result<String, EditError> {
        let home = self.own_home(id)?;
        let edit = self.file(&home.file)?;
        edit.duplicate_node(&home.local, copy)?;
        for name in edit.part_port_names(PartPortKind::Input) {
            let mut targets = edit.part_targets(PartPortKind::Input, &name);
            let of_node = |t: &String| t.split_once('.').filter(|(n, _)| *n == home.local).map(|(_, p)| p.to_owned());
            let ports: Vec<String> = targets.iter().filter_map(of_node).collect();
            if !ports.is_empty() {
                targets.extend(ports.iter().map(|port| format!("{copy}.{port}")));
                edit.set_part_port(PartPortKind::Input, &name, &targets);
            }
        }
        Ok(whole(parent(id), copy))
    }
}
