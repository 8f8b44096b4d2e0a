//! The texts that diagnostics point into: a graph file, its parts and overlays, and arguments of the command line.

use std::ops::Range;
use std::path::{Component, Path, PathBuf};

/// Name of the texts that come from the command line.
pub(crate) const COMMAND_LINE: &str = "command line";

/// A text with a name and its line starts.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    pub(crate) name: String,
    pub(crate) text: String,
    /// Folder that relative paths in the text start from.
    pub(crate) dir: PathBuf,
    /// Offset of the text among all texts of a [`Sources`].
    base: usize,
    line_starts: Vec<usize>,
}

/// A position in a [`Source`] as it is shown.
pub(crate) struct Location {
    /// From 1.
    pub(crate) line: usize,
    /// From 1, in characters.
    pub(crate) column: usize,
    pub(crate) line_text: String,
    /// Characters of the span that are on this line, at least 1.
    pub(crate) width: usize,
}

impl Source {
    pub(crate) fn new(name: String, text: String, dir: PathBuf) -> Self {
        let line_starts = std::iter::once(0).chain(text.match_indices('\n').map(|(i, _)| i + 1)).collect();
        Self { name, text, dir, base: 0, line_starts }
    }

    /// Offset of the text among all texts.
    pub(crate) fn base(&self) -> usize {
        self.base
    }

    /// A span of all texts as bytes of this one, clamped to the text and to character boundaries.
    pub(crate) fn local(&self, span: &Range<usize>) -> Range<usize> {
        self.clamp(span.start.saturating_sub(self.base)..span.end.saturating_sub(self.base))
    }

    /// `span` of this text clamped to the text and to character boundaries.
    pub(crate) fn clamp(&self, span: Range<usize>) -> Range<usize> {
        let start = self.text.floor_char_boundary(span.start.min(self.text.len()));
        let end = self.text.ceil_char_boundary(span.end.clamp(start, self.text.len()));
        start..end
    }

    /// Line of a byte position of this text, from 1.
    pub(crate) fn line(&self, position: usize) -> usize {
        self.line_starts.partition_point(|&s| s <= position).max(1)
    }

    /// Bytes of a line (from 1) without its line end.
    pub(crate) fn line_span(&self, line: usize) -> Range<usize> {
        let start = self.line_starts[line - 1];
        let end = self.line_starts.get(line).map_or(self.text.len(), |&next| next - 1);
        let end = if self.text[start..end].ends_with('\r') { end - 1 } else { end };
        start..end
    }

    /// Line, column and text of a span of all texts.
    pub(crate) fn locate(&self, span: &Range<usize>) -> Location {
        let span = self.local(span);
        let line = self.line(span.start);
        let whole = self.line_span(line);
        let start = span.start.min(whole.end);
        let end = span.end.clamp(start, whole.end);
        Location {
            line,
            column: self.text[whole.start..start].chars().count() + 1,
            line_text: self.text[whole].to_owned(),
            width: self.text[start..end].chars().count().max(1),
        }
    }
}

/// All texts of a graph, concatenated: a span of bytes identifies its text. The first is the graph file.
#[derive(Clone, Debug)]
pub(crate) struct Sources {
    list: Vec<Source>,
}

impl Sources {
    pub(crate) fn new(first: Source) -> Self {
        Self { list: vec![first] }
    }

    /// Appends a text; returns its position in the list.
    pub(crate) fn add(&mut self, mut source: Source) -> usize {
        // One byte between two texts keeps their ends apart.
        source.base = self.list.last().map_or(0, |last| last.base + last.text.len() + 1);
        self.list.push(source);
        self.list.len() - 1
    }

    /// The graph file.
    pub(crate) fn first(&self) -> &Source {
        &self.list[0]
    }

    pub(crate) fn list(&self) -> &[Source] {
        &self.list
    }

    /// Position in the list of the text that a byte belongs to.
    pub(crate) fn index(&self, position: usize) -> usize {
        self.list.partition_point(|s| s.base <= position).saturating_sub(1)
    }

    /// The text that a span belongs to.
    pub(crate) fn of(&self, span: &Range<usize>) -> &Source {
        &self.list[self.index(span.start)]
    }

    /// The text inside a span.
    pub(crate) fn text(&self, span: &Range<usize>) -> &str {
        let source = self.of(span);
        &source.text[source.local(span)]
    }

    /// Line in its own text, from 1.
    pub(crate) fn line(&self, span: &Range<usize>) -> usize {
        self.of(span).locate(span).line
    }
}

/// Folder of a file, for paths that are relative to it.
pub(crate) fn folder(file: &Path) -> PathBuf {
    file.parent().unwrap_or(Path::new("")).to_owned()
}

/// `path` made absolute, without `.` and `..`. Links are not followed: the files need not exist.
pub fn tidy(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut out = PathBuf::new();
    for part in whole.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => _ = out.pop(),
            part => out.push(part),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_span_knows_its_text() {
        let text = |name: &str, text: &str| Source::new(name.to_owned(), text.to_owned(), PathBuf::new());
        let mut sources = Sources::new(text("a", "one\ntwo"));
        assert_eq!(sources.add(text("b", "")), 1);
        assert_eq!(sources.add(text("c", "x\nyz\n")), 2);
        let base = sources.list()[2].base();
        assert_eq!(base, 9);
        assert_eq!((sources.index(7), sources.index(8), sources.index(base)), (0, 1, 2));
        let span = base + 2..base + 4;
        assert_eq!((sources.text(&span), sources.line(&span)), ("yz", 2));
        assert_eq!(sources.of(&span).name, "c");
        assert_eq!(sources.text(&(4..7)), "two");
    }
}
