//! A text that diagnostics point into: a graph file, or one `--set` of the command line.

use std::ops::Range;

/// A text with a name and its line starts.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    pub(crate) name: String,
    pub(crate) text: String,
    line_starts: Vec<usize>,
}

/// A place in a [`Source`], for people.
pub(crate) struct Place {
    /// From 1.
    pub(crate) line: usize,
    /// From 1, in characters.
    pub(crate) column: usize,
    pub(crate) line_text: String,
    /// Characters of the span that lie on this line, at least 1.
    pub(crate) width: usize,
}

impl Source {
    pub(crate) fn new(name: String, text: String) -> Self {
        let line_starts = std::iter::once(0).chain(text.match_indices('\n').map(|(i, _)| i + 1)).collect();
        Self { name, text, line_starts }
    }

    /// `span` pulled inside the text and onto character boundaries.
    pub(crate) fn clamp(&self, span: Range<usize>) -> Range<usize> {
        let start = self.text.floor_char_boundary(span.start.min(self.text.len()));
        let end = self.text.ceil_char_boundary(span.end.clamp(start, self.text.len()));
        start..end
    }

    /// Line of a byte position, from 1.
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

    pub(crate) fn place(&self, span: &Range<usize>) -> Place {
        let span = self.clamp(span.clone());
        let line = self.line(span.start);
        let whole = self.line_span(line);
        let start = span.start.min(whole.end);
        let end = span.end.clamp(start, whole.end);
        Place {
            line,
            column: self.text[whole.start..start].chars().count() + 1,
            line_text: self.text[whole].to_owned(),
            width: self.text[start..end].chars().count().max(1),
        }
    }
}
