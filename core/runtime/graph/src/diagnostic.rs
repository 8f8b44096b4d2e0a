//! Errors and warnings with their locations, rendered like those of rustc or as JSON.

use crate::source::{COMMAND_LINE, Source, Sources};
use serde::Serialize;
use std::fmt::{self, Write as _};
use std::ops::Range;

/// Whether a diagnostic keeps the graph from running.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The graph cannot run.
    Error,
    /// The graph runs, but probably not as intended.
    Warning,
}

/// A second location that explains a diagnostic, such as the first of two equal names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Note {
    /// File, where it is not that of the diagnostic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// Bytes of its file.
    pub span: Range<usize>,
    /// The whole line.
    pub line_text: String,
    /// Text next to the underline.
    pub label: String,
    width: usize,
}

/// One mistake or warning.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Diagnostic {
    /// Error or warning.
    pub severity: Severity,
    /// Stable kebab-case name of the kind of mistake.
    pub code: &'static str,
    /// What is wrong, in one sentence.
    pub message: String,
    /// File as it was named by the caller, or `command line`.
    pub file: String,
    /// Line, from 1; 0 when the file could not be read.
    pub line: usize,
    /// Column in characters, from 1; 0 when the file could not be read.
    pub column: usize,
    /// Bytes of the underlined text in its file.
    pub span: Range<usize>,
    /// The whole line that contains it.
    pub line_text: String,
    /// Text next to the underline; may be empty.
    pub label: String,
    /// Other locations that belong to it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<Note>,
    /// What to do; may be empty.
    pub help: String,
    width: usize,
    /// The underlined text among all texts of the graph.
    #[serde(skip)]
    global: Range<usize>,
}

impl Diagnostic {
    pub(crate) fn new(
        severity: Severity,
        code: &'static str,
        source: &Source,
        span: &Range<usize>,
        message: String,
    ) -> Self {
        let location = source.locate(span);
        Self {
            severity,
            code,
            message,
            file: source.name.clone(),
            line: location.line,
            column: location.column,
            span: source.local(span),
            line_text: location.line_text,
            label: String::new(),
            notes: Vec::new(),
            help: String::new(),
            width: location.width,
            global: span.clone(),
        }
    }

    /// The underlined text among all texts of the graph.
    pub(crate) fn global(&self) -> &Range<usize> {
        &self.global
    }

    /// Moves the diagnostic to another location; its old one becomes a note.
    pub(crate) fn move_to(&mut self, sources: &Sources, span: &Range<usize>, note: &str) {
        let old = std::mem::replace(&mut self.global, span.clone());
        let source = sources.of(span);
        let location = source.locate(span);
        // Notes name their file where it is not the diagnostic's.
        for other in &mut self.notes {
            let file = other.file.take().unwrap_or_else(|| self.file.clone());
            other.file = (file != source.name).then_some(file);
        }
        self.file.clone_from(&source.name);
        (self.line, self.column, self.width) = (location.line, location.column, location.width);
        self.span = source.local(span);
        self.line_text = location.line_text;
        self.note(sources, &old, note);
    }

    /// A diagnostic about a whole file.
    pub(crate) fn file(code: &'static str, file: String, message: String, help: String) -> Self {
        Self {
            severity: Severity::Error,
            code,
            message,
            file,
            line: 0,
            column: 0,
            span: 0..0,
            line_text: String::new(),
            label: String::new(),
            notes: Vec::new(),
            help,
            width: 0,
            global: 0..0,
        }
    }

    pub(crate) fn label(&mut self, label: impl Into<String>) -> &mut Self {
        self.label = label.into();
        self
    }

    pub(crate) fn help(&mut self, help: impl Into<String>) -> &mut Self {
        self.help = help.into();
        self
    }

    /// Adds a second location. `sources` are all texts of the graph.
    pub(crate) fn note(&mut self, sources: &Sources, span: &Range<usize>, label: impl Into<String>) -> &mut Self {
        self.note_in(sources.of(span), span, label)
    }

    /// Adds a second location in a known text.
    pub(crate) fn note_in(&mut self, source: &Source, span: &Range<usize>, label: impl Into<String>) -> &mut Self {
        let location = source.locate(span);
        self.notes.push(Note {
            file: (source.name != self.file).then(|| source.name.clone()),
            line: location.line,
            column: location.column,
            span: source.local(span),
            line_text: location.line_text,
            label: label.into(),
            width: location.width,
        });
        self
    }

    /// The diagnostic as text: message, location, underlined line, help. Ends with a line end.
    pub fn render(&self, color: bool) -> String {
        let paint = Paint { on: color };
        let (word, main) = match self.severity {
            Severity::Error => ("error", Paint::RED),
            Severity::Warning => ("warning", Paint::YELLOW),
        };
        let mut out = String::new();
        let head = paint.with(main, &format!("{word}[{}]", self.code));
        let _ = writeln!(out, "{head}: {}", paint.with(Paint::BOLD, &printable(&self.message)));
        if self.line == 0 {
            let _ = writeln!(out, "  {} {}", paint.with(Paint::BLUE, "-->"), printable(&self.file));
            if !self.help.is_empty() {
                let _ = writeln!(out, "  {} help: {}", paint.with(Paint::BLUE, "="), printable(&self.help));
            }
            return out;
        }
        let digits = self.notes.iter().map(|n| n.line).fold(self.line, usize::max).to_string().len();
        let bar = paint.with(Paint::BLUE, "|");
        let pad = " ".repeat(digits);
        let arrow = paint.with(Paint::BLUE, "-->");
        let _ = writeln!(out, "{pad}{arrow} {}:{}:{}", printable(&self.file), self.line, self.column);
        let _ = writeln!(out, "{pad} {bar}");
        let mut snippets = vec![Snippet::main(self)];
        snippets.extend(self.notes.iter().filter(|n| n.file.is_none()).map(Snippet::note));
        snippets_of_a_file(&mut out, snippets, digits, paint, main);
        let others: Vec<&str> = self.notes.iter().filter_map(|n| n.file.as_deref()).collect();
        for (_, file) in others.iter().enumerate().filter(|(i, file)| !others[..*i].contains(file)) {
            let notes: Vec<&Note> = self.notes.iter().filter(|n| n.file.as_deref() == Some(file)).collect();
            let arrow = paint.with(Paint::BLUE, ":::");
            let (line, column) = (notes[0].line, notes[0].column);
            let _ = writeln!(out, "{pad}{arrow} {}:{line}:{column}", printable(file));
            let _ = writeln!(out, "{pad} {bar}");
            snippets_of_a_file(&mut out, notes.into_iter().map(Snippet::note).collect(), digits, paint, main);
        }
        if !self.help.is_empty() {
            let _ = writeln!(out, "{pad} {bar}");
            let indent = format!("\n{pad}         ");
            let help = printable(&self.help).replace('\n', &indent);
            let _ = writeln!(out, "{pad} {} {}: {help}", paint.with(Paint::BLUE, "="), paint.with(Paint::BOLD, "help"));
        }
        out
    }
}

/// An underlined text of one file.
struct Snippet<'d> {
    line: usize,
    column: usize,
    width: usize,
    text: &'d str,
    label: &'d str,
    is_main: bool,
}

impl<'d> Snippet<'d> {
    fn main(d: &'d Diagnostic) -> Self {
        let Diagnostic { line, column, width, line_text, label, .. } = d;
        Self { line: *line, column: *column, width: *width, text: line_text, label, is_main: true }
    }

    fn note(note: &'d Note) -> Self {
        let Note { line, column, width, line_text, label, .. } = note;
        Self { line: *line, column: *column, width: *width, text: line_text, label, is_main: false }
    }
}

/// Writes lines of one file with what is underlined in them, in file order; the main one keeps its `^`.
fn snippets_of_a_file(out: &mut String, mut snippets: Vec<Snippet<'_>>, digits: usize, paint: Paint, main: &str) {
    let (bar, pad) = (paint.with(Paint::BLUE, "|"), " ".repeat(digits));
    snippets.sort_by_key(|s| (s.line, s.column));
    let mut last_line = 0;
    for Snippet { line, column, width, text, label, is_main } in snippets {
        let cut = Cut::around(text, column, width);
        if line != last_line {
            if last_line != 0 && line > last_line + 1 {
                let _ = writeln!(out, "{pad}{}", paint.with(Paint::BLUE, "..."));
            }
            let number = paint.with(Paint::BLUE, &format!("{line:>digits$}"));
            let _ = writeln!(out, "{}", format!("{number} {bar} {}", cut.text).trim_end());
        }
        last_line = line;
        let (mark, color) = if is_main { ("^", main) } else { ("-", Paint::BLUE) };
        let under = paint.with(color, format!("{} {}", mark.repeat(cut.width), printable(label)).trim_end());
        let _ = writeln!(out, "{pad} {bar} {}{under}", " ".repeat(cut.before));
    }
}

/// The part of a line that is shown, and where the underline goes, in terminal columns.
struct Cut {
    text: String,
    before: usize,
    width: usize,
}

impl Cut {
    const TAB: &'static str = "    ";
    /// Lines longer than this are cut around the mistake.
    const MAX_COUNT: usize = 160;

    fn around(line: &str, column: usize, width: usize) -> Self {
        let start = column - 1;
        let count = line.chars().count();
        let (from, to) = if count <= Self::MAX_COUNT {
            (0, count)
        } else {
            let from = start.saturating_sub(Self::MAX_COUNT / 4);
            (from, (from + Self::MAX_COUNT).min(count))
        };
        let mut cut = Self { text: String::new(), before: 0, width: 0 };
        if from > 0 {
            cut.text.push_str("... ");
            cut.before = 4;
        }
        for (i, c) in line.chars().enumerate().take(to).skip(from) {
            let shown = if c == '\t' { Self::TAB.to_owned() } else { printable(c.encode_utf8(&mut [0; 4])) };
            let columns = shown.chars().count();
            if i < start {
                cut.before += columns;
            } else if i < start + width {
                cut.width += columns;
            }
            cut.text.push_str(&shown);
        }
        if to < count {
            cut.text.push_str(" ...");
        }
        cut.width = cut.width.max(1);
        cut
    }
}

/// `text` without control characters of a terminal.
fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() && c != '\n' { char::REPLACEMENT_CHARACTER } else { c }).collect()
}

#[derive(Clone, Copy)]
struct Paint {
    on: bool,
}

impl Paint {
    const RED: &'static str = "\x1b[1;31m";
    const YELLOW: &'static str = "\x1b[1;33m";
    const BLUE: &'static str = "\x1b[1;34m";
    const BOLD: &'static str = "\x1b[1m";

    fn with(&self, style: &str, text: &str) -> String {
        if self.on { format!("{style}{text}\x1b[0m") } else { text.to_owned() }
    }
}

/// All mistakes and warnings of a file, sorted by position.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Diagnostics {
    list: Vec<Diagnostic>,
}

impl Diagnostics {
    pub(crate) fn push(&mut self, diagnostic: Diagnostic) -> &mut Diagnostic {
        self.list.push(diagnostic);
        let last = self.list.len() - 1;
        &mut self.list[last]
    }

    /// Mutable access, for moves before they are shown.
    pub(crate) fn iter_mut(&mut self) -> std::slice::IterMut<'_, Diagnostic> {
        self.list.iter_mut()
    }

    pub(crate) fn one(diagnostic: Diagnostic) -> Self {
        Self { list: vec![diagnostic] }
    }

    /// Adds those of another file or step.
    pub fn extend(&mut self, other: Diagnostics) {
        self.list.extend(other.list);
    }

    /// Sorts by file, position and severity and removes repetitions. The graph file comes first, `command line` last.
    pub(crate) fn finish(&mut self, first_file: &str) {
        fn key<'d>(d: &'d Diagnostic, first_file: &str) -> (u8, &'d str, usize, usize, bool) {
            let rank = if d.file == first_file { 0 } else { 1 + u8::from(d.file == COMMAND_LINE) };
            (rank, &d.file, d.span.start, d.span.end, d.severity == Severity::Warning)
        }
        self.list.sort_by(|a, b| key(a, first_file).cmp(&key(b, first_file)));
        self.list.dedup();
    }

    /// Diagnostics in order.
    pub fn iter(&self) -> std::slice::Iter<'_, Diagnostic> {
        self.list.iter()
    }

    /// Number of errors and warnings together.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Whether there is neither an error nor a warning.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Number of errors.
    pub fn errors(&self) -> usize {
        self.list.iter().filter(|d| d.severity == Severity::Error).count()
    }

    /// Number of warnings.
    pub fn warnings(&self) -> usize {
        self.len() - self.errors()
    }

    /// Whether any is an error.
    pub fn has_errors(&self) -> bool {
        self.errors() > 0
    }

    /// All as text with an empty line between, and a last line that counts them. Empty when there are none.
    pub fn render(&self, color: bool) -> String {
        let mut out = String::new();
        for diagnostic in &self.list {
            out.push_str(&diagnostic.render(color));
            out.push('\n');
        }
        let count = |n: usize, word: &str| format!("{n} {word}{}", if n == 1 { "" } else { "s" });
        match (self.errors(), self.warnings()) {
            (0, 0) => {}
            (e, 0) => out.push_str(&format!("{}\n", count(e, "error"))),
            (0, w) => out.push_str(&format!("{}\n", count(w, "warning"))),
            (e, w) => out.push_str(&format!("{}, {}\n", count(e, "error"), count(w, "warning"))),
        }
        out
    }
}

impl<'a> IntoIterator for &'a Diagnostics {
    type Item = &'a Diagnostic;
    type IntoIter = std::slice::Iter<'a, Diagnostic>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl fmt::Display for Diagnostics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.render(false))
    }
}

impl std::error::Error for Diagnostics {}
