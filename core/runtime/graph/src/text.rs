//! A graph file as read, before any name of it is looked up.

use crate::args::{Arg, ArgUse, Bindings};
use crate::catalog::Offer;
use crate::checked::{Deny, Mode};
use crate::diagnostic::{Diagnostic, Diagnostics, Severity};
use crate::file::{MachineText, PinText, Role, ViewText};
use crate::nearest::{list, nearest, sibling};
use crate::options::GraphOptions;
use crate::parse;
use crate::parts::{Flat, Flattener};
use crate::read::read_file;
use crate::shape;
use crate::source::{COMMAND_LINE, Source, Sources, folder, tidy};
use crate::value::{Spanned, shift};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

impl GraphFile<'_> {
    /// Its absolute path, as [`GraphOptions::texts`] names it.
    pub fn key(&self) -> PathBuf {
        tidy(Path::new(self.path))
    }
}

/// A graph file as read, with its parts and overlays: ready to be asked for its plugins, then to be checked against a
/// catalog.
#[derive(Clone, Debug)]
pub struct GraphText {
    pub(crate) sources: Sources,
    path: PathBuf,
    stem: String,
    name: Option<Spanned<String>>,
    pub(crate) mode: Mode,
    /// The nodes of all files.
    pub(crate) flat: Flat,
    /// Plugins and the groups of their nodes; of two entries of a plugin the last counts.
    pub(crate) isolate: Vec<(Spanned<String>, Spanned<String>)>,
    /// Groups and what their nodes may not do; of two entries of a group the last counts.
    pub(crate) deny: Vec<(Spanned<String>, Deny)>,
    /// Other machines that nodes run on; of two entries of a name the last counts.
    pub(crate) machines: Vec<MachineText>,
    pub(crate) pins: Vec<PinText>,
    pub(crate) views: Vec<ViewText>,
    pub(crate) editor: toml::Table,
    /// A part that is opened by itself.
    is_part: bool,
    args: Vec<Arg>,
    /// Arguments without a value, each with the diagnostic for a graph that is to run.
    missing_args: Vec<(String, Diagnostic)>,
    allow_missing_args: bool,
    /// Positions at which arguments are used; no two begin at the same byte.
    pub(crate) arg_uses: HashMap<usize, ArgUse>,
    /// Positions of the overlays among the sources.
    pub(crate) overlays: Vec<usize>,
    pub(crate) overrides: Vec<Override>,
    pub(crate) diagnostics: Diagnostics,
    /// Parts of the files could not be read, so what seems missing may only be unreadable.
    pub(crate) incomplete: bool,
    /// Nodes were left out, so that the text as read is not the graph.
    pub(crate) is_reduced: bool,
}

/// The role of a file in a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// The graph file itself.
    Graph,
    /// A part.
    Part,
    /// An overlay.
    Overlay,
}

/// A file that a graph was read from.
#[derive(Clone, Copy, Debug)]
pub struct GraphFile<'t> {
    /// Its role in the graph.
    pub kind: FileKind,
    /// Path as diagnostics show it.
    pub path: &'t str,
    /// The text that was read.
    pub text: &'t str,
}

/// `--set node.param=value`.
#[derive(Clone, Debug)]
pub(crate) struct Override {
    pub(crate) node: Spanned<String>,
    pub(crate) param: Spanned<String>,
    pub(crate) value: Spanned<String>,
}

impl GraphText {
    /// Reads a graph file with its parts.
    ///
    /// # Errors
    /// The file has no text: a missing or unreadable file, or one that is not UTF-8.
    pub fn load(path: &Path) -> Result<Self, Diagnostics> {
        Self::load_with(path, &GraphOptions::default())
    }

    /// Reads a graph file with its parts, overlays and values of arguments.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_with(path: &Path, options: &GraphOptions) -> Result<Self, Diagnostics> {
        Ok(Self::parse_with(path, &read_text(path, "graph")?, options))
    }

    /// Reads the text of a graph file, and its parts from disk. `path` names it in messages; paths in it are relative
    /// to the folder of `path`. Mistakes are kept and returned by [`check`](crate::check) together with its own.
    pub fn parse(path: &Path, text: &str) -> Self {
        Self::parse_with(path, text, &GraphOptions::default())
    }

    /// As [`Self::parse`], with overlays and values of arguments.
    pub fn parse_with(path: &Path, text: &str, options: &GraphOptions) -> Self {
        let source = Source::new(path.display().to_string(), text.to_owned(), folder(path));
        let mut graph = parse::parse(&source);
        let mut sources = Sources::new(source);
        let (declared, mut diagnostics) = shape::read_args(&sources, Role::Graph, &graph.root);
        let mut overlays = Vec::new();
        let mut overlay_args = Vec::new();
        for file in &options.with {
            let text = match options.texts.get(&tidy(file)) {
                Some(text) => Ok(text.clone()),
                None => read_text(file, "overlay"),
            };
            let text = match text {
                Ok(text) => text,
                Err(wrong) => {
                    diagnostics.extend(wrong);
                    continue;
                }
            };
            let source = Source::new(file.display().to_string(), text, folder(file));
            let mut parsed = parse::parse(&source);
            let index = sources.add(source);
            shift(&mut parsed.root, sources.list()[index].base());
            let (args, wrong) = shape::read_args(&sources, Role::Overlay, &parsed.root);
            diagnostics.extend(wrong);
            overlay_args.extend(args);
            overlays.push((index, parsed));
        }
        let mut bindings = Bindings::new(&mut sources, declared, overlay_args, &options.args);
        bindings.substitute(&sources, &mut graph.root);
        let incomplete = graph.incomplete || overlays.iter().any(|(_, parsed)| parsed.incomplete);
        let mut root = shape::read(&sources, Role::Graph, graph);
        let mut isolate = std::mem::take(&mut root.isolate);
        let mut deny = std::mem::take(&mut root.deny);
        let mut machines = std::mem::take(&mut root.machines);
        let (mut nodes, mut plugins, mut plugin_paths) = (Vec::new(), Vec::new(), Vec::new());
        let overlay_files: Vec<usize> = overlays.iter().map(|(index, _)| *index).collect();
        for (index, mut parsed) in overlays {
            bindings.substitute(&sources, &mut parsed.root);
            let overlay = shape::read(&sources, Role::Overlay, parsed);
            diagnostics.extend(overlay.diagnostics);
            nodes.extend(overlay.nodes.into_iter().map(|node| (node, false)));
            plugins.push((index, overlay.plugins));
            plugin_paths.extend(overlay.plugin_paths);
            isolate.extend(overlay.isolate);
            deny.extend(overlay.deny);
            machines.extend(overlay.machines);
        }
        diagnostics.extend(std::mem::take(&mut bindings.diagnostics));
        let (name, mode, editor, is_part) = (root.name.clone(), root.mode, root.editor.clone(), root.part.is_some());
        let flattener =
            Flattener { sources: &mut sources, texts: &options.texts, overlays: nodes, flat: Flat::default() };
        let (mut flat, views, pins) = flattener.run(root, path);
        flat.plugins.extend(plugins);
        flat.plugin_paths.extend(plugin_paths);
        diagnostics.extend(std::mem::take(&mut flat.diagnostics));
        // A mistake may hide the use of an argument.
        if !incomplete && !diagnostics.has_errors() {
            bindings.unused(&sources, &mut diagnostics);
        }
        let mut this = Self {
            path: path.to_owned(),
            stem: path.file_stem().map_or_else(|| "graph".to_owned(), |s| s.to_string_lossy().into_owned()),
            name,
            mode,
            incomplete: incomplete || flat.incomplete,
            flat,
            isolate,
            deny,
            machines,
            pins,
            views,
            editor,
            is_part,
            args: bindings.shown(),
            missing_args: bindings.missing,
            allow_missing_args: options.allow_missing_args,
            arg_uses: bindings.uses.into_iter().map(|u| (u.span.start, u)).collect(),
            overlays: overlay_files,
            overrides: Vec::new(),
            diagnostics,
            sources,
            is_reduced: false,
        };
        if is_part && !options.allow_missing_args {
            let message = "this file is a part: it cannot run by itself".to_owned();
            let help = "use it in a graph, as in [nodes.depth] graph = \"FILE\"; `panoscope check` checks it alone";
            let d = Diagnostic::new(Severity::Error, "part-alone", this.sources.first(), &(0..0), message);
            this.diagnostics.push(d).help(help);
        }
        options.set.iter().for_each(|setting| this.set(setting));
        this
    }

    /// Adds one `node.param=value` of the command line; it overrides the file. Checked like the file's own values.
    pub fn set(&mut self, assignment: &str) {
        const OPTION: &str = "--set ";
        // Relative paths start from the graph file, as if the value stood there.
        let dir = self.sources.first().dir.clone();
        let index = self.sources.add(Source::new(COMMAND_LINE.to_owned(), format!("{OPTION}{assignment}"), dir));
        let source = &self.sources.list()[index];
        let at = source.base() + OPTION.len();
        let parts = assignment.split_once('=').and_then(|(key, value)| Some((key.split_once('.')?, value)));
        let Some(((node, param), value)) = parts.filter(|((n, p), _)| !n.trim().is_empty() && !p.trim().is_empty())
        else {
            let message = "a setting is written node.param=value".to_owned();
            let span = at..source.base() + source.text.len();
            let mut d = Diagnostic::new(Severity::Error, "set-malformed", source, &span, message);
            d.help("as in --set wide.blend_px=20");
            self.diagnostics.push(d);
            return;
        };
        let spanned = |part: &str| {
            let trimmed = part.trim();
            let start =
                at + (part.as_ptr() as usize - assignment.as_ptr() as usize) + (part.len() - part.trim_start().len());
            Spanned::new(trimmed.to_owned(), start..start + trimmed.len())
        };
        let (node, param, value) = (spanned(node), spanned(param), spanned(value));
        // A parameter of a part stands for one or more of its nodes.
        match self.flat.param_targets(&node.value, &param.value) {
            Some(targets) => self.overrides.extend(targets.into_iter().map(|target| Override {
                node: Spanned::new(target.node, node.span.clone()),
                param: Spanned::new(target.port.value, param.span.clone()),
                value: value.clone(),
            })),
            None => match self.flat.part(&node.value).map(|part| part.interface.as_ref()) {
                Some(Some(interface)) => {
                    let message = format!("part `{}` has no parameter `{}`", node.value, param.value);
                    let names = || interface.params.iter().map(|(name, _)| name.as_str());
                    let near = nearest(&param.value, names()).map(|n| format!("did you mean `{n}`?"));
                    let help = format!(
                        "parameters: {}; or name a node inside, as in {}/NODE.PARAM",
                        list(names(), 20, "and"),
                        node.value
                    );
                    let source = self.sources.of(&param.span);
                    let d = Diagnostic::new(Severity::Error, "unknown-part-param", source, &param.span, message);
                    self.diagnostics.push(d).label(near.unwrap_or_default()).help(help);
                }
                // The part's file could not be used, which is reported.
                Some(None) => {}
                None => self.overrides.push(Override { node, param, value }),
            },
        }
    }

    /// Names of the plugins that the files list, in order, without repetitions.
    pub fn plugins(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for plugin in self.flat.plugins.iter().flat_map(|(_, plugins)| plugins) {
            if !names.contains(&plugin.value) {
                names.push(plugin.value.clone());
            }
        }
        names
    }

    /// Those of [`Self::plugins`] whose nodes all run in separate processes: the process of the graph need not load
    /// them. `[isolate]` names them, or each of their nodes says `isolate`.
    ///
    /// `offers` has the node types of the plugins. Where a node that is not isolated is of a type that no plugin
    /// offers, only those that `[isolate]` names count, because the offers are incomplete.
    pub fn isolated_plugins(&self, offers: &[Offer]) -> Vec<String> {
        let plugins = self.plugins();
        let of_plugin = |plugin: &str| offers.iter().find(|offer| offer.plugin == plugin);
        let may_be_of = |plugin: &str, type_name: &str| {
            let (named, name) =
                type_name.split_once('/').map_or((None, type_name), |(plugin, name)| (Some(plugin), name));
            named.is_none_or(|named| named == plugin)
                && of_plugin(plugin).is_some_and(|offer| offer.node_types.iter().any(|known| known == name))
        };
        let types = || self.flat.nodes.iter().filter_map(|node| Some((node, node.type_name.as_ref()?.value.as_str())));
        let is_complete = types()
            .all(|(node, type_name)| node.is_elsewhere() || plugins.iter().any(|plugin| may_be_of(plugin, type_name)));
        let has_isolated_nodes = |plugin: &str| {
            let mut nodes = types().filter(|(_, type_name)| may_be_of(plugin, type_name)).peekable();
            nodes.peek().is_some() && nodes.all(|(node, _)| node.is_elsewhere())
        };
        let is_isolated = |plugin: &String| {
            self.isolate.iter().any(|(name, _)| name.value == *plugin) || (is_complete && has_isolated_nodes(plugin))
        };
        plugins.iter().filter(|plugin| is_isolated(plugin)).cloned().collect()
    }

    /// Extra folders to look for plugins, each resolved against the folder of its file.
    pub fn plugin_paths(&self) -> Vec<PathBuf> {
        self.flat.plugin_paths.iter().map(|p| self.sources.of(&p.span).dir.join(&p.value)).collect()
    }

    /// Path of the graph file as it was given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The files it was read from: the graph file, then parts and overlays.
    pub fn files(&self) -> Vec<GraphFile<'_>> {
        let all = self.sources.list().iter().enumerate().filter(|(_, source)| source.name != COMMAND_LINE);
        let kind = |index: usize| match index {
            0 => FileKind::Graph,
            _ if self.overlays.contains(&index) => FileKind::Overlay,
            _ => FileKind::Part,
        };
        let mut files: Vec<GraphFile<'_>> = Vec::new();
        for (index, source) in all {
            // A part that is used twice was read twice.
            if !files.iter().any(|f| f.path == source.name) {
                files.push(GraphFile { kind: kind(index), path: &source.name, text: &source.text });
            }
        }
        files
    }

    /// Whether the file is a part that was opened by itself.
    pub fn is_part(&self) -> bool {
        self.is_part
    }

    /// The arguments that it declares, in file order.
    pub fn args(&self) -> &[Arg] {
        &self.args
    }

    /// Names of required arguments that have no value, and whose parameters no setting gives either.
    pub fn missing_args(&self) -> Vec<&str> {
        self.missing().map(|(name, _)| name.as_str()).collect()
    }

    /// Diagnostics of the missing arguments, for a graph that is to run.
    pub(crate) fn missing_diagnostics(&self) -> impl Iterator<Item = &Diagnostic> {
        self.missing().filter(|_| !self.allow_missing_args).map(|(_, diagnostic)| diagnostic)
    }

    fn missing(&self) -> impl Iterator<Item = &(String, Diagnostic)> {
        self.missing_args.iter().filter(|(name, _)| {
            let mut uses = self.arg_uses.values().filter(|u| u.name.replace('-', "_") == name.replace('-', "_"));
            uses.any(|u| !self.is_set(u))
        })
    }

    /// Whether settings replace the value that an argument would give: all parameters that it gives.
    fn is_set(&self, use_: &ArgUse) -> bool {
        let params = self.flat.nodes.iter().flat_map(|node| node.params.iter().map(move |param| (node, param)));
        let mut params = params.filter(|(_, (_, value))| value.span == use_.span).peekable();
        let set =
            |node: &str, param: &str| self.overrides.iter().any(|o| o.node.value == node && o.param.value == param);
        params.peek().is_some() && params.all(|(node, (key, _))| set(&node.id.value, &key.value))
    }

    /// Whether it consists of the whole graph file alone, without arguments, parts and overlays.
    pub fn is_plain(&self) -> bool {
        !self.is_reduced && self.args.is_empty() && self.flat.parts.is_empty() && self.overlays.is_empty()
    }

    /// The parameter of a node that `node.param` stands for, where `node` may be a part.
    pub fn resolve_param(&self, reference: &str) -> String {
        let target = reference.split_once('.').and_then(|(node, param)| self.flat.param_targets(node, param));
        target
            .and_then(|t| t.into_iter().next())
            .map_or_else(|| reference.to_owned(), |t| format!("{}.{}", t.node, t.port.value))
    }

    /// The output of a node that `node.output` (and what may follow, `.column`) stands for, where `node` may be a part.
    pub fn resolve_output(&self, reference: &str) -> String {
        let Some((node, rest)) = reference.split_once('.') else { return reference.to_owned() };
        let (port, more) =
            rest.split_once('.').map_or((rest, String::new()), |(port, more)| (port, format!(".{more}")));
        let target = self.flat.output_target(node, port);
        target.map_or_else(|| reference.to_owned(), |t| format!("{}.{}{more}", t.node, t.port.value))
    }

    /// The settings of the command line with parameters of parts replaced by those of nodes.
    pub fn settings(&self) -> Vec<String> {
        let all = self.overrides.iter();
        all.map(|o| format!("{}.{}={}", o.node.value, o.param.value, o.value.value)).collect()
    }

    /// Name of the graph: the one in the file, else the stem of its name.
    pub fn name(&self) -> &str {
        self.name.as_ref().map_or(&self.stem, |n| &n.value)
    }

    /// The text as read.
    pub fn text(&self) -> &str {
        &self.sources.first().text
    }

    /// A diagnostic of the caller about a parameter of a node, at the parameter's value where a file gives one, else at
    /// the node's name. `help` may be empty.
    pub fn about_param(
        &self,
        severity: Severity,
        code: &'static str,
        (node, param): (&str, &str),
        message: String,
        help: &str,
    ) -> Diagnostics {
        let found = self.flat.nodes.iter().find(|n| n.id.value == node);
        let value = found.and_then(|n| n.params.iter().find(|(key, _)| key.value == param));
        let span = value.map(|(_, value)| value.span.clone()).or_else(|| found.map(|n| n.id.span.clone()));
        let span = span.unwrap_or(0..0);
        let mut diagnostic = Diagnostic::new(severity, code, self.sources.of(&span), &span, message);
        diagnostic.help(help);
        Diagnostics::one(diagnostic)
    }

    /// Mistakes in the shape of the file found so far. [`check`](crate::check) repeats these.
    pub fn diagnostics(&self) -> &Diagnostics {
        &self.diagnostics
    }
}

/// Reads a file as text; `what` is its role, for the code and message of an error.
fn read_text(path: &Path, what: &str) -> Result<String, Diagnostics> {
    let name = path.display().to_string();
    let fail = |code, message: String, help: String| {
        Err(Diagnostics::one(Diagnostic::file(code, name.clone(), message, help)))
    };
    let is_graph = what == "graph";
    let (missing, unreadable, not_utf8) = match is_graph {
        true => ("graph-missing", "graph-unreadable", "graph-not-utf8"),
        false => ("overlay-missing", "overlay-unreadable", "overlay-not-utf8"),
    };
    let file = if is_graph { "graph file" } else { "overlay" };
    let bytes = match read_file(path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            let help = match sibling(path) {
                Some(other) => format!("did you mean `{}`?", other.display()),
                None if is_graph => "give the path of a graph file (.toml)".to_owned(),
                None => "give the path of an overlay (.toml) after --with".to_owned(),
            };
            return fail(missing, format!("the {file} does not exist"), help);
        }
        Err(e) if e.kind() == std::io::ErrorKind::IsADirectory => {
            let message = format!("this is a folder, not a {file}").replace("a overlay", "an overlay");
            return fail(
                unreadable,
                message,
                format!("give the path of a {file} (.toml)").replace("a overlay", "an overlay"),
            );
        }
        Err(e) => return fail(unreadable, format!("the {file} cannot be read: {e}"), String::new()),
    };
    String::from_utf8(bytes).or_else(|e| {
        let at = e.utf8_error().valid_up_to();
        let line = e.as_bytes()[..at].iter().filter(|&&b| b == b'\n').count() + 1;
        let message = format!("the file is not UTF-8 text (first wrong byte in line {line})");
        fail(not_utf8, message, "save it as UTF-8 in your editor".to_owned())
    })
}
