//! A graph file as read, before any name of it is looked up.

use crate::checked::Mode;
use crate::diagnostic::{Diagnostic, Diagnostics, Severity};
use crate::file::{NodeText, PinText, ViewText};
use crate::nearest::nearest;
use crate::parse;
use crate::shape;
use crate::source::{COMMAND_LINE, Source, Sources, folder};
use crate::value::Spanned;
use std::path::{Path, PathBuf};

/// A graph file as read: ready to be asked for its plugins, then to be checked against a catalog.
#[derive(Clone, Debug)]
pub struct GraphText {
    pub(crate) sources: Sources,
    pub(crate) stem: String,
    pub(crate) name: Option<Spanned<String>>,
    pub(crate) mode: Mode,
    pub(crate) plugins: Vec<Spanned<String>>,
    pub(crate) plugin_paths: Vec<Spanned<String>>,
    pub(crate) nodes: Vec<NodeText>,
    pub(crate) pins: Vec<PinText>,
    pub(crate) views: Vec<ViewText>,
    pub(crate) editor: toml::Table,
    pub(crate) overrides: Vec<Override>,
    pub(crate) diagnostics: Diagnostics,
    /// Parts of the file could not be read, so what seems missing may only be unreadable.
    pub(crate) incomplete: bool,
}

/// `--set node.param=value`.
#[derive(Clone, Debug)]
pub(crate) struct Override {
    pub(crate) node: Spanned<String>,
    pub(crate) param: Spanned<String>,
    pub(crate) value: Spanned<String>,
}

impl GraphText {
    /// Reads a graph file. Fails only when there is no text to look at: a missing or unreadable file, or one that is not UTF-8.
    pub fn load(path: &Path) -> Result<Self, Diagnostics> {
        let name = path.display().to_string();
        let fail = |code, message: String, help: String| {
            Err(Diagnostics::one(Diagnostic::file(code, name.clone(), message, help)))
        };
        let bytes = match std::fs::read(path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                let help = match sibling(path) {
                    Some(other) => format!("did you mean `{}`?", other.display()),
                    None => "give the path of a graph file (.toml)".to_owned(),
                };
                return fail("graph-missing", "there is no such graph file".to_owned(), help);
            }
            Err(e) if e.kind() == std::io::ErrorKind::IsADirectory => {
                let message = "this is a folder, not a graph file".to_owned();
                return fail("graph-unreadable", message, "give the path of a graph file (.toml)".to_owned());
            }
            Err(e) => return fail("graph-unreadable", format!("the graph file cannot be read: {e}"), String::new()),
        };
        match String::from_utf8(bytes) {
            Ok(text) => Ok(Self::parse(path, &text)),
            Err(e) => {
                let at = e.utf8_error().valid_up_to();
                let line = e.as_bytes()[..at].iter().filter(|&&b| b == b'\n').count() + 1;
                let message = format!("the file is not UTF-8 text (first wrong byte in line {line})");
                fail("graph-not-utf8", message, "save it as UTF-8 in your editor".to_owned())
            }
        }
    }

    /// Reads the text of a graph file. `path` names it in messages and its folder is what paths in it are relative to.
    /// Mistakes are kept and come out of [`check`](crate::check), together with those found there.
    pub fn parse(path: &Path, text: &str) -> Self {
        let source = Source::new(path.display().to_string(), text.to_owned(), folder(path));
        let parsed = parse::parse(&source);
        let sources = Sources::new(source);
        let file = shape::read(&sources, parsed);
        Self {
            stem: path.file_stem().map_or_else(|| "graph".to_owned(), |s| s.to_string_lossy().into_owned()),
            sources,
            name: file.name,
            mode: file.mode,
            plugins: file.plugins,
            plugin_paths: file.plugin_paths,
            nodes: file.nodes,
            pins: file.pins,
            views: file.views,
            editor: file.editor,
            overrides: Vec::new(),
            diagnostics: file.diagnostics,
            incomplete: file.incomplete,
        }
    }

    /// Adds one `node.param=value` of the command line; it wins over the file. Checked like the file's own values.
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
        self.overrides.push(Override { node, param, value });
    }

    /// Names of the plugins the file lists, in order, without repetitions.
    pub fn plugins(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for plugin in &self.plugins {
            if !names.contains(&plugin.value) {
                names.push(plugin.value.clone());
            }
        }
        names
    }

    /// Extra folders to look for plugins, resolved against the folder of the graph file.
    pub fn plugin_paths(&self) -> Vec<PathBuf> {
        self.plugin_paths.iter().map(|p| self.sources.of(&p.span).dir.join(&p.value)).collect()
    }

    /// Name of the graph: what the file says, else the stem of its name.
    pub fn name(&self) -> &str {
        self.name.as_ref().map_or(&self.stem, |n| &n.value)
    }

    /// The text as read.
    pub fn text(&self) -> &str {
        &self.sources.first().text
    }

    /// An error or warning of the caller's own about a parameter of a node, at the parameter's value where a file gives one, else at the node's
    /// name. `help` may be empty.
    pub fn about_param(
        &self,
        severity: Severity,
        code: &'static str,
        (node, param): (&str, &str),
        message: String,
        help: &str,
    ) -> Diagnostics {
        let found = self.nodes.iter().find(|n| n.id.value == node);
        let value = found.and_then(|n| n.params.iter().find(|(key, _)| key.value == param));
        let span = value.map(|(_, value)| value.span.clone()).or_else(|| found.map(|n| n.id.span.clone()));
        let span = span.unwrap_or(0..0);
        let mut diagnostic = Diagnostic::new(severity, code, self.sources.of(&span), &span, message);
        diagnostic.help(help);
        Diagnostics::one(diagnostic)
    }

    /// What is wrong with the shape of the file so far. [`check`](crate::check) repeats these.
    pub fn diagnostics(&self) -> &Diagnostics {
        &self.diagnostics
    }
}

/// A file of nearly that name in the same folder.
fn sibling(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_str()?;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|n| n.ends_with(".toml"))
        .collect();
    names.sort();
    nearest(name, names.iter().map(String::as_str)).map(|n| path.with_file_name(n))
}
