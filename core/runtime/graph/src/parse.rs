//! TOML text to a tree, with recovery: broken lines are reported and skipped, so that the rest of the file can still be
//! checked.

use crate::diagnostic::{Diagnostic, Diagnostics, Severity};
use crate::source::Source;
use crate::value::{Table, Value, from_toml, table_from_toml};
use std::ops::Range;
use toml::de::{DeTable, DeValue};

/// Parsed parts of a file.
pub(crate) struct Parsed {
    pub(crate) root: Table,
    pub(crate) diagnostics: Diagnostics,
    /// A line was skipped, so what seems missing may only be unreadable.
    pub(crate) incomplete: bool,
}

/// Largest number of broken lines that are skipped before the rest of the file is ignored.
const ROUNDS: usize = 50;

/// Bytes parsed over all rounds: a long file that is broken everywhere is not a graph, and parsing it must not take
/// long.
const MAX_BYTES: usize = 5_000_000;

pub(crate) fn parse(source: &Source) -> Parsed {
    let mut diagnostics = Diagnostics::default();
    let mut work = source.text.clone();
    let mut incomplete = false;
    let mut renamed = 0;
    let rounds = (MAX_BYTES / work.len().max(1)).clamp(3, ROUNDS);
    for _ in 0..rounds {
        let (root, errors) = DeTable::parse_recoverable(&work);
        let root = table_from_toml(root.get_ref());
        if errors.is_empty() {
            return Parsed { root: with_source_keys(root, source), diagnostics, incomplete };
        }
        // Two nodes of one name are kept apart here and named later, with the rest of their mistakes. The second's entries
        // no longer count as repetitions then, so what else was found in this round is looked for again.
        let doubles: Vec<_> = errors.iter().filter_map(|e| double_node(source, &work, e)).collect();
        if !doubles.is_empty() {
            for span in doubles {
                renamed += 1;
                rename(source, &mut work, &span, renamed);
            }
            continue;
        }
        // One mistake of syntax makes the parser stumble over what follows, so each is named alone and taken out whole.
        let first = errors.iter().find(|e| e.message() != "duplicate key");
        if let Some(error) = first {
            let span = source.clamp(error.span().unwrap_or(work.len()..work.len()));
            let left_out = match unclosed(source, &work, span.start) {
                Some((bracket, statement)) => {
                    let open = &source.text[bracket.clone()];
                    let close = if open == "[" { "]" } else { "}" };
                    let message = format!("this `{open}` is never closed");
                    let mut d = Diagnostic::new(Severity::Error, "toml-syntax", source, &bracket, message);
                    d.label(format!("expected `{close}` before the next line that starts something new"));
                    diagnostics.push(d);
                    statement
                }
                None => {
                    diagnostics.push(syntax(source, error.message(), &span));
                    statement(source, &work, &span)
                }
            };
            if !add_comma(source, &mut work, error.message(), span.start) {
                incomplete = true;
                blank(&mut work, &left_out);
            }
            continue;
        }
        for error in &errors {
            let span = source.clamp(error.span().unwrap_or(work.len()..work.len()));
            duplicate_key(source, &mut diagnostics, &root, &span);
            let left_out = entry(source, &work, &span);
            blank(&mut work, &left_out);
        }
    }
    Parsed { root: Table::new(), diagnostics, incomplete: true }
}

/// Parses one value of the command line; `None` when it is not TOML.
pub(crate) fn parse_value(text: &str) -> Option<Value> {
    let (value, errors) = DeValue::parse_recoverable(text);
    errors.is_empty().then(|| from_toml(&value))
}

/// Restores the names of nodes that were renamed to distinguish two of them.
fn with_source_keys(mut root: Table, source: &Source) -> Table {
    for (key, value) in &mut root {
        if key.value != "nodes" {
            continue;
        }
        if let crate::value::Kind::Table(nodes) = &mut value.value {
            for (id, _) in nodes {
                let written = &source.text[source.clamp(id.span.clone())];
                if *written != *id.value {
                    id.value = match parse_value(written).map(|v| v.value) {
                        Some(crate::value::Kind::Text(text)) => text,
                        _ => written.to_owned(),
                    };
                }
            }
        }
    }
    root
}

/// Finds the key of a second `[nodes.x]`.
fn double_node(source: &Source, work: &str, error: &toml::de::Error) -> Option<Range<usize>> {
    let span = source.clamp(error.span()?);
    let is_double = error.message() == "duplicate key" && !span.is_empty();
    let line = source.line_span(source.line(span.start));
    (is_double && is_node_header(&work[line])).then_some(span)
}

/// Whether a line is `[nodes.x]`, and not `[nodes.x.params]`.
fn is_node_header(line: &str) -> bool {
    let Some(inner) = line.trim().strip_prefix('[').and_then(|l| l.split(']').next()) else { return false };
    let mut parts = inner.split('.').map(str::trim);
    parts.next() == Some("nodes") && parts.next().is_some_and(|id| !id.is_empty()) && parts.next().is_none()
}

/// Overwrites a node's key with another of the same length that no file uses, and so in the tables below it
/// (`[nodes.x.params]`).
fn rename(source: &Source, work: &mut String, span: &Range<usize>, number: usize) {
    let length = span.len();
    let name = if length == 1 {
        char::from(b'A' + (number % 26) as u8).to_string()
    } else {
        let number = number.to_string();
        let number = &number[number.len().saturating_sub(length - 1)..];
        format!("_{}{number}", "-".repeat(length - 1 - number.len()))
    };
    let old = work[span.clone()].to_owned();
    work.replace_range(span.clone(), &name);
    let below = format!("[nodes.{old}.");
    for line in source.line(span.start) + 1..=source.line(source.text.len()) {
        let whole = source.line_span(line);
        let text = &work[whole.clone()];
        let start = whole.start + (text.len() - text.trim_start().len());
        if work[start..].starts_with(&below) {
            let key = start + below.len() - 1 - length;
            work.replace_range(key..key + length, &name);
        } else if work[start..].starts_with('[') {
            break;
        }
    }
}

/// Puts a missing comma where a space or line end was, so that nothing is lost to the checks that follow.
fn add_comma(source: &Source, work: &mut String, message: &str, position: usize) -> bool {
    if !message.starts_with("missing comma") || unclosed(source, work, position).is_some() {
        return false;
    }
    let before = work[..position].chars().next_back();
    let line = source.line(position);
    let comment_above = line > 1 && work[source.line_span(line - 1)].contains('#');
    let free = matches!(before, Some(' ' | '\t')) || before == Some('\n') && !comment_above;
    if free {
        work.replace_range(position - 1..position, ",");
    }
    free
}

/// Overwrites all but line ends with spaces.
fn blank(work: &mut String, span: &Range<usize>) {
    let spaces: String =
        work[span.clone()].bytes().map(|b| if b == b'\n' || b == b'\r' { b as char } else { ' ' }).collect();
    work.replace_range(span.clone(), &spaces);
}

/// Bytes to leave out for a mistake at `span`: its line, or the whole table when the line is a table's header.
fn statement(source: &Source, work: &str, span: &Range<usize>) -> Range<usize> {
    let first = source.line(span.start);
    let mut last = source.line(span.end.max(span.start + 1) - 1).max(first);
    let lines = source.line(source.text.len());
    if work[source.line_span(first)].trim_start().starts_with('[') {
        while last < lines && !work[source.line_span(last + 1)].trim_start().starts_with('[') {
            last += 1;
        }
    }
    source.line_span(first).start..source.line_span(last).end
}

fn duplicate_key(source: &Source, diagnostics: &mut Diagnostics, root: &Table, span: &Range<usize>) {
    let key = &source.text[span.clone()];
    let message = format!("`{key}` is given twice");
    let mut diagnostic = Diagnostic::new(Severity::Error, "duplicate-key", source, span, message);
    diagnostic.label("again here").help("keep one of the two");
    let mut first = None;
    find_before(root, key.trim_matches(['"', '\'']), span.start, &mut first);
    if let Some(first) = first {
        diagnostic.note_in(source, &first, "first here");
    }
    diagnostics.push(diagnostic);
}

/// The last key of that name before `position`.
fn find_before(table: &Table, name: &str, position: usize, best: &mut Option<Range<usize>>) {
    for (key, value) in table {
        let later = best.as_ref().is_none_or(|b| b.start < key.span.start);
        if key.value == name && key.span.start < position && later {
            *best = Some(key.span.clone());
        }
        if let crate::value::Kind::Table(inner) = &value.value {
            find_before(inner, name, position, best);
        }
    }
}

/// Bytes of a repeated `key = value`, on one line or inside an inline table.
fn entry(source: &Source, work: &str, span: &Range<usize>) -> Range<usize> {
    let line = source.line_span(source.line(span.start));
    if work[line.start..span.start].trim().is_empty() {
        return statement(source, work, span);
    }
    // Up to the comma or bracket that ends it; the comma goes too.
    let (mut depth, mut quote) = (0usize, None);
    for (at, c) in work[span.start..line.end].char_indices() {
        let at = span.start + at;
        match (quote, c) {
            (Some(q), c) if q == c => quote = None,
            (Some(_), _) => {}
            (None, '"' | '\'') => quote = Some(c),
            (None, '[' | '{') => depth += 1,
            (None, ',') if depth == 0 => return span.start..at + 1,
            (None, ']' | '}') if depth == 0 => return span.start..at,
            (None, ']' | '}') => depth -= 1,
            _ => {}
        }
    }
    line
}

/// A bracket that opens a value above `position` and is not closed where a new statement begins: the bracket, and the
/// lines from its own to there.
fn unclosed(source: &Source, work: &str, position: usize) -> Option<(Range<usize>, Range<usize>)> {
    let mut line = source.line(position.min(work.len().saturating_sub(1)));
    let last = source.line(work.len());
    let mut start = line;
    // The statement that was being read when the parser stumbled: the line itself, or one above that opens a bracket.
    let bracket = loop {
        let text = &work[source.line_span(start)];
        if let Some(at) = is_assignment(text).then(|| open_bracket(text)).flatten() {
            break source.line_span(start).start + at;
        }
        if start == 1 || line - start > 200 || is_header(text) && start < line {
            return None;
        }
        start -= 1;
    };
    // Its end: the first line below that begins something new.
    line = line.max(start);
    let mut end = start;
    let starts_new = |l: usize| {
        let text = &work[source.line_span(l)];
        is_header(text) || is_assignment(text)
    };
    while end < last && !starts_new(end + 1) {
        end += 1;
    }
    // A mistake inside brackets that do get closed is another one.
    let body = &work[source.line_span(start).start..source.line_span(end).end];
    if line < start || line > end + 1 || open_bracket(body).is_none() {
        return None;
    }
    Some((bracket..bracket + 1, source.line_span(start).start..source.line_span(end).end))
}

/// Whether a line is `[a.b]` or `[[a]]` alone, without anything that only a list of values could hold.
fn is_header(line: &str) -> bool {
    let line = line.split('#').next().unwrap_or_default().trim();
    let inner = line.trim_start_matches('[').trim_end_matches(']');
    line.starts_with('[')
        && line.ends_with(']')
        && inner.starts_with(|c: char| c.is_alphabetic() || c == '_' || c == '"')
        && !inner.contains([',', '[', '{', '='])
}

/// Whether a line begins with `key =`.
fn is_assignment(line: &str) -> bool {
    let Some((key, _)) = line.split_once('=') else { return false };
    let key = key.trim();
    !key.is_empty() && key.chars().all(|c| c.is_alphanumeric() || "_-.\"'".contains(c))
}

/// Position of the outermost bracket that is open at the end of `text`.
fn open_bracket(text: &str) -> Option<usize> {
    let (mut open, mut quote, mut comment) = (Vec::new(), None, false);
    for (at, c) in text.char_indices() {
        match (quote, c) {
            // No string of a graph file goes over several lines; one left open is a mistake of its own.
            (_, '\n') => (quote, comment) = (None, false),
            _ if comment => {}
            (Some(q), c) if q == c => quote = None,
            (Some(_), _) => {}
            (None, '"' | '\'') => quote = Some(c),
            (None, '#') => comment = true,
            (None, '[' | '{') => open.push(at),
            (None, ']' | '}') => _ = open.pop(),
            _ => {}
        }
    }
    open.first().copied()
}

/// Rewords the parser's terse message so that it says what to do.
fn syntax(source: &Source, message: &str, span: &Range<usize>) -> Diagnostic {
    let line = &source.text[source.line_span(source.line(span.start))];
    let written = &source.text[span.clone()];
    let is_key_side = !source.text[source.line_span(source.line(span.start)).start..span.start].contains('=');
    let (message, help) = if message.starts_with("string values must be quoted") && written.trim().is_empty() {
        ("there is no value after `=`".to_owned(), "write key = value, or remove the line")
    } else if message.starts_with("string values must be quoted") && written.starts_with(|c: char| c.is_ascii_digit()) {
        (format!("`{written}` is neither a number nor a text"), "a number has no unit; a text stands in quotes")
    } else if message.starts_with("string values must be quoted") {
        (format!("`{written}` is no value"), "put text in quotes, as in type = \"phantom\"")
    } else if is_key_side && line.contains(':') && !line.contains('=') {
        ("`:` cannot stand here".to_owned(), "TOML writes key = value, with an equals sign")
    } else if message.starts_with("unclosed table") || line.trim_start().starts_with('[') && !line.contains('=') {
        ("this is not a table header".to_owned(), "a node's table starts with a line such as [nodes.scope]")
    } else if message.starts_with("key with no value") {
        ("a key without a value".to_owned(), "write key = value, as in type = \"phantom\"")
    } else if message.contains("escape") {
        (
            "a `\\` in \"...\" starts an escape, and this is none".to_owned(),
            "write / in paths, or put the text in '...', where a `\\` is itself",
        )
    } else if message.contains("recursion") || message.contains("recurse") {
        ("too many brackets inside each other".to_owned(), "")
    } else if message.starts_with("invalid basic string") || message.starts_with("invalid literal string") {
        (
            "this text is not right: a quote is missing, or a `\\` starts no escape".to_owned(),
            "a text starts and ends with the same quote, on one line",
        )
    } else if let Some((what, _)) = message.split_once(", expected `,`") {
        (what.to_owned(), "put a comma between the two")
    } else {
        (format!("this is not TOML: {message}"), "")
    };
    let mut diagnostic = Diagnostic::new(Severity::Error, "toml-syntax", source, span, message);
    diagnostic.help(help);
    diagnostic
}
