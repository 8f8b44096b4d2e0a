//! Arguments of a graph: declared in `[args]`, given on the command line, used as `{ arg = "name" }` wherever a value
//! may stand.

use crate::diagnostic::{Diagnostic, Diagnostics, Severity};
use crate::nearest::{list, nearest};
use crate::source::{COMMAND_LINE, Source, Sources};
use crate::value::{Kind, Spanned, Table, Value};
use serde::Serialize;
use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Long options of the commands that run, check and show graphs, `-` written as `_`: no argument may have such a name.
/// A test of the command keeps it complete. Options of commands that measure take precedence over an argument of the
/// same name, which then needs `--graph-arg NAME=VALUE`.
pub const RESERVED_ARGS: &[&str] = &[
    "act",
    "after",
    "all_ports",
    "allow_edit",
    "allow_read",
    "arrangement",
    "attach",
    "attachable",
    "attachable_name",
    "csv",
    "digests",
    "do",
    "edit_every",
    "fault_log",
    "foxglove",
    "foxglove_set",
    "frames",
    "from",
    "graph",
    "graph_arg",
    "headless",
    "help",
    "into",
    "isolate_plugins",
    "json",
    "key",
    "keys",
    "kill_every",
    "label",
    "language",
    "lock",
    "log_format",
    "max_frames",
    "measure",
    "minutes",
    "new_key",
    "output",
    "param",
    "plot",
    "quick",
    "read_ports_only",
    "recording",
    "report",
    "scale",
    "screenshot",
    "script",
    "set",
    "size",
    "steps",
    "theme",
    "threads",
    "to",
    "trace",
    "trust",
    "trust_plugins",
    "uncompressed",
    "unlocked",
    "unpaced",
    "verbose",
    "verify",
    "version",
    "watch",
    "web",
    "windowed",
    "with",
];

/// Type of an argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ArgKind {
    /// Camera number, device, file, folder, pattern, address or pipeline.
    Source,
    /// File that must exist.
    File,
    /// File or folder that need not exist.
    Path,
    /// Any text.
    Text,
    /// Finite number.
    Number,
    /// Whole number.
    Whole,
    /// true or false.
    Flag,
    /// One of a list of words.
    Choice,
}

impl ArgKind {
    pub(crate) const WORDS: [(&'static str, Self); 8] = [
        ("source", Self::Source),
        ("file", Self::File),
        ("path", Self::Path),
        ("text", Self::Text),
        ("number", Self::Number),
        ("whole", Self::Whole),
        ("flag", Self::Flag),
        ("choice", Self::Choice),
    ];

    /// The word of a graph file.
    pub fn word(self) -> &'static str {
        Self::WORDS.iter().find(|(_, kind)| *kind == self).map_or("", |(word, _)| word)
    }

    /// Description of the type, for messages.
    fn expected(self) -> &'static str {
        match self {
            Self::Source => "a source in quotes (camera, file, folder, address or pipeline)",
            Self::File | Self::Path => "a path in quotes",
            Self::Text => "a text in quotes",
            Self::Number => "a number",
            Self::Whole => "a whole number",
            Self::Flag => "true or false",
            Self::Choice => "one of its choices",
        }
    }

    /// Whether relative values start from the folder of the file (or the working folder) that gives them.
    fn is_path(self) -> bool {
        matches!(self, Self::Source | Self::File | Self::Path)
    }
}

/// An argument as a program shows it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Arg {
    /// Name in the file; `-` and `_` are the same on the command line.
    pub name: String,
    /// Its type.
    pub kind: ArgKind,
    /// Documentation.
    pub doc: String,
    /// Unit of a number; empty for none.
    pub unit: String,
    /// Smallest and largest number.
    pub range: Option<(f64, f64)>,
    /// Words of a choice.
    pub choices: Vec<String>,
    /// Value when none is given; `None` makes it required.
    pub default: Option<String>,
}

impl Arg {
    /// Placeholder for its value in help text, such as `SOURCE`.
    pub fn value_name(&self) -> String {
        if self.kind == ArgKind::Choice { self.choices.join("|") } else { self.kind.word().to_uppercase() }
    }

    /// Its option on the command line, without the value: `--left`.
    pub fn option(&self) -> String {
        format!("--{}", self.name.replace('_', "-"))
    }

    /// Documentation with unit, range and default.
    pub fn help(&self) -> String {
        let mut facts = Vec::new();
        if let Some((low, high)) = self.range {
            facts.push(format!("{low} to {high}{}{}", if self.unit.is_empty() { "" } else { " " }, self.unit));
        } else if !self.unit.is_empty() {
            facts.push(format!("in {}", self.unit));
        }
        match &self.default {
            Some(default) if self.kind == ArgKind::Flag && default == "false" => {}
            Some(default) => facts.push(format!("default: {default}")),
            None => facts.push("required".to_owned()),
        }
        let facts = if facts.is_empty() { String::new() } else { format!("[{}]", facts.join(", ")) };
        [self.doc.as_str(), &facts].iter().filter(|t| !t.is_empty()).copied().collect::<Vec<_>>().join(" ")
    }
}

/// An entry of `[args]` as written.
#[derive(Clone, Debug)]
pub(crate) struct ArgText {
    pub(crate) name: Spanned<String>,
    /// `None` in an overlay that only gives another default, or where it could not be read.
    pub(crate) kind: Option<ArgKind>,
    pub(crate) kind_broken: bool,
    pub(crate) doc: Option<String>,
    pub(crate) default: Option<Value>,
    pub(crate) range: Option<(f64, f64)>,
    pub(crate) unit: String,
    pub(crate) choices: Vec<String>,
}

/// A use of an argument: `{ arg = "left" }`.
#[derive(Clone, Debug)]
pub(crate) struct ArgUse {
    /// The whole table.
    pub(crate) span: Range<usize>,
    pub(crate) name: String,
    /// Where the value was given; `None` where it is missing or wrong.
    pub(crate) origin: Option<Range<usize>>,
}

struct Bound {
    value: Kind,
    origin: Option<Range<usize>>,
    used: bool,
}

/// The arguments of a graph with their values.
pub(crate) struct Bindings {
    declared: Vec<ArgText>,
    bound: HashMap<String, Bound>,
    /// Names without a value, each with the diagnostic for a graph that is to run.
    pub(crate) missing: Vec<(String, Diagnostic)>,
    pub(crate) uses: Vec<ArgUse>,
    pub(crate) diagnostics: Diagnostics,
}

fn same_name(a: &str, b: &str) -> bool {
    a.replace('-', "_") == b.replace('-', "_")
}

impl Bindings {
    /// Takes the declarations of the graph file and of its overlays, and the values of the command line. `file_of`
    /// opens `file` arguments.
    pub(crate) fn new(
        sources: &mut Sources,
        graph: Vec<ArgText>,
        overlays: Vec<ArgText>,
        given: &[(String, String)],
    ) -> Self {
        let mut this = Self {
            declared: graph,
            bound: HashMap::new(),
            missing: Vec::new(),
            uses: Vec::new(),
            diagnostics: Diagnostics::default(),
        };
        for over in overlays {
            this.overlay(sources, over);
        }
        for arg in &this.declared {
            let d = &mut this.diagnostics;
            name_is_right(sources, &arg.name, d);
            if arg.kind.is_none() && !arg.kind_broken {
                let message = format!("argument `{}` has no `type`", arg.name.value);
                let types = list(ArgKind::WORDS.iter().map(|(word, _)| *word), 10, "and");
                error(d, "missing-type", sources, &arg.name.span, message)
                    .help(format!("as in type = \"source\"; types are {types}"));
            }
        }
        for (name, text) in given {
            this.given(sources, name, text);
        }
        let command_line: Vec<String> = this.bound.keys().cloned().collect();
        for arg in &this.declared {
            let name = &arg.name.value;
            if command_line.contains(name) {
                continue;
            }
            let (value, origin) = match &arg.default {
                Some(default) => {
                    let kind = arg.kind.map_or(Ok(default.value.clone()), |kind| check(kind, arg, &default.value));
                    match kind {
                        Ok(value) => {
                            let value = rebased(arg, value, &sources.of(&default.span).dir, &sources.first().dir);
                            match file_is_there(arg, &value) {
                                Ok(()) => {}
                                Err(wrong) => wrong.report(&mut this.diagnostics, sources, &default.span, arg),
                            }
                            (value, Some(default.span.clone()))
                        }
                        Err(wrong) => {
                            wrong.report(&mut this.diagnostics, sources, &default.span, arg);
                            (Kind::Missing, None)
                        }
                    }
                }
                None => {
                    if let Some(shown) = shown(arg) {
                        let message = format!("argument `{name}` is not given");
                        let (source, span) = (sources.of(&arg.name.span), &arg.name.span);
                        let mut d = Diagnostic::new(Severity::Error, "missing-arg", source, span, message);
                        d.label(shown.doc.clone());
                        d.help(format!("give it on the command line: {} {}", shown.option(), shown.value_name()));
                        this.missing.push((name.clone(), d));
                    }
                    (Kind::Missing, None)
                }
            };
            this.bound.insert(name.clone(), Bound { value, origin, used: false });
        }
        this
    }

    /// Applies a default or an argument of an overlay.
    fn overlay(&mut self, sources: &Sources, over: ArgText) {
        match self.declared.iter_mut().find(|a| same_name(&a.name.value, &over.name.value)) {
            Some(arg) if over.kind.is_none() && !over.kind_broken => {
                arg.default = over.default.or(arg.default.take());
                arg.doc = over.doc.or(arg.doc.take());
            }
            Some(arg) => *arg = over,
            None if over.kind.is_none() && !over.kind_broken => {
                let names = || self.declared.iter().map(|a| a.name.value.as_str());
                let near = nearest(&over.name.value, names()).map(|n| format!("did you mean `{n}`?"));
                let message =
                    format!("the graph has no argument `{}` whose default could be replaced", over.name.value);
                let help = format!("add a `type` to declare a new one; arguments: {}", list(names(), 12, "and"));
                let d = error(&mut self.diagnostics, "unknown-arg", sources, &over.name.span, message);
                d.label(near.unwrap_or_default()).help(help);
            }
            None => self.declared.push(over),
        }
    }

    /// Applies a value of the command line.
    fn given(&mut self, sources: &mut Sources, name: &str, text: &str) {
        let option = format!("--{} ", name.replace('_', "-"));
        let index = sources.add(Source::new(COMMAND_LINE.to_owned(), format!("{option}{text}"), PathBuf::new()));
        let source = &sources.list()[index];
        let (start, end) = (source.base(), source.base() + source.text.len());
        let value_at = start + option.len()..end.max(start + option.len());
        let Some(arg) = self.declared.iter().find(|a| same_name(&a.name.value, name)) else {
            let names = || self.declared.iter().map(|a| a.name.value.as_str());
            let near = nearest(name, names()).map(|n| format!("did you mean --{}?", n.replace('_', "-")));
            let message = format!("this graph has no argument `{name}`");
            let help = match self.declared.is_empty() {
                true => "it declares none; a table such as [args.left] declares one".to_owned(),
                false => format!("arguments: {}", list(names(), 12, "and")),
            };
            let span = start..start + option.len() - 1;
            let d = error(&mut self.diagnostics, "unknown-arg", sources, &span, message);
            d.label(near.unwrap_or_default()).help(help);
            return;
        };
        let kind = arg.kind.unwrap_or(ArgKind::Text);
        let value = check(kind, arg, &typed(kind, text)).and_then(|value| {
            let here = std::path::absolute(".").unwrap_or_default();
            let value = rebased(arg, value, &here, Path::new("not the working folder"));
            file_is_there(arg, &value).map(|()| value)
        });
        let (value, origin) = match value {
            Ok(value) => (value, Some(value_at)),
            Err(wrong) => {
                wrong.report(&mut self.diagnostics, sources, &value_at, arg);
                (Kind::Missing, None)
            }
        };
        self.bound.insert(arg.name.value.clone(), Bound { value, origin, used: false });
    }

    /// Puts values in place of `{ arg = "name" }` in the tree of the graph file or an overlay.
    pub(crate) fn substitute(&mut self, sources: &Sources, root: &mut Table) {
        walk(root, &mut |value, name| {
            let key = self.bound.keys().find(|k| same_name(k, &name.value)).cloned();
            let Some(bound) = key.as_ref().and_then(|key| self.bound.get_mut(key)) else {
                let names = || self.declared.iter().map(|a| a.name.value.as_str());
                let near = nearest(&name.value, names()).map(|n| format!("did you mean \"{n}\"?"));
                let message = format!("this graph has no argument `{}`", name.value);
                let help = match self.declared.is_empty() {
                    true => format!("declare it: [args.{}] with a type and a doc", name.value),
                    false => format!("arguments: {}", list(names(), 12, "and")),
                };
                let d = error(&mut self.diagnostics, "unknown-arg", sources, &name.span, message);
                d.label(near.unwrap_or_default()).help(help);
                value.value = Kind::Missing;
                return;
            };
            bound.used = true;
            value.value = bound.value.clone();
            let use_ = ArgUse { span: value.span.clone(), name: name.value.clone(), origin: bound.origin.clone() };
            self.uses.push(use_);
        });
    }

    /// Warns of arguments that nothing uses.
    pub(crate) fn unused(&self, sources: &Sources, diagnostics: &mut Diagnostics) {
        for arg in &self.declared {
            if self.bound.get(&arg.name.value).is_some_and(|b| !b.used) {
                let message = format!("argument `{}` is not used", arg.name.value);
                let d = Diagnostic::new(
                    Severity::Warning,
                    "unused-arg",
                    sources.of(&arg.name.span),
                    &arg.name.span,
                    message,
                );
                let help = format!("write {{ arg = \"{}\" }} where its value belongs, or remove it", arg.name.value);
                diagnostics.push(d).help(help);
            }
        }
    }

    /// The arguments for a help text.
    pub(crate) fn shown(&self) -> Vec<Arg> {
        self.declared.iter().filter_map(shown).collect()
    }
}

fn shown(arg: &ArgText) -> Option<Arg> {
    Some(Arg {
        name: arg.name.value.clone(),
        kind: arg.kind?,
        doc: arg.doc.clone().unwrap_or_default(),
        unit: arg.unit.clone(),
        range: arg.range,
        choices: arg.choices.clone(),
        default: arg.default.as_ref().map(|v| match &v.value {
            Kind::Text(text) => text.clone(),
            other => other.plain().to_string(),
        }),
    })
}

/// Refuses `{ arg = "name" }` in a part: parts have parameters instead.
pub(crate) fn refuse_in_part(sources: &Sources, root: &mut Table, diagnostics: &mut Diagnostics) {
    walk(root, &mut |value, name| {
        let message = format!("a part has no arguments, so `{}` cannot be used here", name.value);
        error(diagnostics, "arg-in-part", sources, &value.span, message).help(format!(
            "declare a parameter in `params` of [part], and write {{ arg = \"{}\" }} where the graph uses the part",
            name.value
        ));
        value.value = Kind::Missing;
    });
}

/// Calls `replace` for every `{ arg = "name" }`. Tables that map names (`nodes`, `params`, `inputs`) are not such
/// values, whatever their keys.
fn walk(root: &mut Table, replace: &mut dyn FnMut(&mut Value, Spanned<String>)) {
    for (key, value) in root {
        match (key.value.as_str(), &mut value.value) {
            ("args" | "editor" | "part", _) => {}
            ("nodes", Kind::Table(nodes)) => {
                for (_, node) in nodes {
                    let Kind::Table(node) = &mut node.value else { continue };
                    for (key, value) in node {
                        match (key.value.as_str(), &mut value.value) {
                            ("params" | "inputs", Kind::Table(entries)) => {
                                entries.iter_mut().for_each(|(_, value)| walk_value(value, replace));
                            }
                            _ => walk_value(value, replace),
                        }
                    }
                }
            }
            ("preset", Kind::Table(preset)) => preset.iter_mut().for_each(|(_, value)| walk_value(value, replace)),
            _ => walk_value(value, replace),
        }
    }
}

fn walk_value(value: &mut Value, replace: &mut dyn FnMut(&mut Value, Spanned<String>)) {
    match &mut value.value {
        Kind::Table(table) => {
            if let [(key, Value { value: Kind::Text(name), span })] = table.as_slice()
                && key.value == "arg"
            {
                let name = Spanned::new(name.clone(), span.clone());
                return replace(value, name);
            }
            table.iter_mut().for_each(|(_, value)| walk_value(value, replace));
        }
        Kind::List(items) => items.iter_mut().for_each(|value| walk_value(value, replace)),
        _ => {}
    }
}

/// Reason why a value of an argument is refused.
struct Wrong {
    code: &'static str,
    message: String,
    label: String,
    help: String,
}

impl Wrong {
    fn report(self, diagnostics: &mut Diagnostics, sources: &Sources, span: &Range<usize>, arg: &ArgText) {
        let d = error(diagnostics, self.code, sources, span, self.message);
        d.label(self.label).help(self.help);
        let declared_elsewhere = sources.index(span.start) != sources.index(arg.name.span.start);
        if declared_elsewhere {
            d.note(sources, &arg.name.span, "declared here");
        }
    }
}

/// Parses text of the command line as the argument's type; text that does not parse stays text.
fn typed(kind: ArgKind, text: &str) -> Kind {
    let text = text.trim();
    let parsed = match kind {
        ArgKind::Number | ArgKind::Whole => {
            text.parse().ok().map(Kind::Int).or_else(|| text.parse().ok().map(Kind::Float))
        }
        ArgKind::Flag => match text {
            "" | "true" => Some(Kind::Bool(true)),
            "false" => Some(Kind::Bool(false)),
            _ => None,
        },
        _ => None,
    };
    parsed.unwrap_or_else(|| Kind::Text(text.to_owned()))
}

/// The value, when it is of the argument's type and inside its limits.
fn check(kind: ArgKind, arg: &ArgText, value: &Kind) -> Result<Kind, Wrong> {
    let name = &arg.name.value;
    let wrong_type = || Wrong {
        code: "arg-type",
        message: format!("argument `{name}` must be {}, not {}", kind.expected(), value.found()),
        label: format!("expected {}", kind.expected()),
        help: arg.doc.clone().unwrap_or_default(),
    };
    match (kind, value) {
        (ArgKind::Source | ArgKind::File | ArgKind::Path | ArgKind::Text, Kind::Text(_))
        | (ArgKind::Flag, Kind::Bool(_)) => Ok(value.clone()),
        (ArgKind::Choice, Kind::Text(word)) => {
            // Without choices the declaration itself is wrong.
            if arg.choices.is_empty() || arg.choices.contains(word) {
                return Ok(value.clone());
            }
            let words = || arg.choices.iter().map(String::as_str);
            let near = nearest(word, words()).map(|n| format!("did you mean \"{n}\"?"));
            Err(Wrong {
                code: "arg-choice",
                message: format!("`{word}` is not a choice of argument `{name}`"),
                label: near.unwrap_or_default(),
                help: format!("choices: {}", list(words(), 20, "and")),
            })
        }
        (ArgKind::Whole, Kind::Int(_)) | (ArgKind::Number, Kind::Int(_) | Kind::Float(_)) => {
            let number = value.number().unwrap_or(f64::NAN);
            match arg.range {
                Some((low, high)) if !(low..=high).contains(&number) => {
                    let unit = if arg.unit.is_empty() { String::new() } else { format!(" {}", arg.unit) };
                    Err(Wrong {
                        code: "arg-range",
                        message: format!("argument `{name}` is {number}{unit}; it must be {low} to {high}{unit}"),
                        label: format!("expected {low} to {high}{unit}"),
                        help: arg.doc.clone().unwrap_or_default(),
                    })
                }
                _ if !number.is_finite() => Err(Wrong { code: "arg-range", ..wrong_type() }),
                _ => Ok(value.clone()),
            }
        }
        _ => Err(wrong_type()),
    }
}

/// Whether a text names no file: a camera number, an address, a pipeline.
pub(crate) fn is_no_file(text: &str) -> bool {
    text.is_empty() || text.bytes().all(|b| b.is_ascii_digit()) || text.contains("://") || text.contains(" ! ")
}

/// A path of a file in `from`, as a file in `graph_dir` would write it.
fn rebased(arg: &ArgText, value: Kind, from: &Path, graph_dir: &Path) -> Kind {
    match value {
        Kind::Text(text) if arg.kind.is_some_and(ArgKind::is_path) && from != graph_dir && !is_no_file(&text) => {
            Kind::Text(absolute(&from.join(&text)))
        }
        value => value,
    }
}

/// The absolute path as text.
pub(crate) fn absolute(path: &Path) -> String {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).display().to_string()
}

/// A text that may name files (several are separated by `;`), with relative ones made absolute from `dir`.
pub(crate) fn absolute_files(text: &str, dir: &Path) -> String {
    let one = |part: &str| match is_no_file(part.trim()) {
        true => part.to_owned(),
        false => absolute(&dir.join(part.trim())),
    };
    if text.contains(" ! ") { text.to_owned() } else { text.split(';').map(one).collect::<Vec<_>>().join(";") }
}

fn file_is_there(arg: &ArgText, value: &Kind) -> Result<(), Wrong> {
    let (Some(ArgKind::File), Some(text)) = (arg.kind, value.text()) else { return Ok(()) };
    // A default is relative to the graph file and looked for where it is used.
    let path = Path::new(text);
    if !path.is_absolute() || path.exists() {
        return Ok(());
    }
    Err(Wrong {
        code: "missing-file",
        message: format!("argument `{}` names a file that does not exist", arg.name.value),
        label: String::new(),
        help: format!("looked for {}", path.display()),
    })
}

fn name_is_right(sources: &Sources, name: &Spanned<String>, diagnostics: &mut Diagnostics) {
    let text = &name.value;
    let letters = text.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '-');
    if !letters || !text.starts_with(|c: char| c.is_ascii_lowercase()) {
        let message = format!("`{text}` cannot name an argument");
        error(diagnostics, "bad-arg-name", sources, &name.span, message)
            .help("a name starts with a small letter and goes on with small letters, digits, _ and -");
    } else if RESERVED_ARGS.iter().any(|r| same_name(r, text)) {
        let option = text.replace('_', "-");
        let message = format!("argument `{text}` would be --{option}, which is an option of the command itself");
        error(diagnostics, "arg-name-taken", sources, &name.span, message).help("give the argument another name");
    }
}

fn error<'d>(
    diagnostics: &'d mut Diagnostics,
    code: &'static str,
    sources: &Sources,
    span: &Range<usize>,
    message: String,
) -> &'d mut Diagnostic {
    diagnostics.push(Diagnostic::new(Severity::Error, code, sources.of(span), span, message))
}
