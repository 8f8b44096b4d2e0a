//! Reads a log and checks its chain.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use crate::audit::chain::{End, Line, sha256};
use crate::audit::day::date_and_time;
use crate::audit::event::Event;
use crate::audit::files::{HEAD, Head, files};

/// A line of the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Its number, from 1.
    pub number: u64,
    /// When it happened, in ms since 1970.
    pub unix_ms: i64,
    /// The event.
    pub event: Event,
}

impl fmt::Display for Entry {
    /// Formats one line; control characters in names and reasons are escaped, because the log is untrusted.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let event: String = self
            .event
            .to_string()
            .chars()
            .map(|c| if c.is_control() { c.escape_default().to_string() } else { c.to_string() })
            .collect();
        write!(f, "{:>6}  {} UTC  {event}", self.number, date_and_time(self.unix_ms))
    }
}

/// A break of the chain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The file.
    pub file: PathBuf,
    /// Line in the file, from 1; 0 for the file as a whole.
    pub line: usize,
    /// Description of the damage.
    pub message: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => write!(f, "{}: {}", self.file.display(), self.message),
            line => write!(f, "{}:{line}: {}", self.file.display(), self.message),
        }
    }
}

/// Content of a log, with its damage.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// All intact lines.
    pub entries: Vec<Entry>,
    /// Breaks of the chain; empty for an intact log.
    pub problems: Vec<Problem>,
    /// Number and hash of the last line. A copy of them kept elsewhere proves later that the log up to here is
    /// unchanged.
    pub last: Option<(u64, String)>,
}

/// Checks the chain line by line.
struct Checker {
    report: Report,
    /// The end so far; `None` before the first line of a file that is read alone.
    end: Option<End>,
    /// The rest of a line that could not be read: file, line and bytes.
    broken: Option<(PathBuf, usize, Vec<u8>)>,
}

impl Checker {
    fn problem(&mut self, file: &Path, line: usize, message: impl Into<String>) {
        self.report.problems.push(Problem { file: file.to_owned(), line, message: message.into() });
    }

    /// Reports a line that could not be read and that no later line accounts for.
    fn give_up_broken(&mut self) {
        if let Some((file, line, _)) = self.broken.take() {
            self.problem(&file, line, "the line is damaged: it is not what its hash was made of");
        }
    }

    fn line(&mut self, file: &Path, number: usize, text: &[u8]) {
        let Some((line, end)) = Line::parse(text) else {
            self.give_up_broken();
            self.broken = Some((file.to_owned(), number, text.to_vec()));
            return;
        };
        // A line that a crash cut off is named by the next one.
        if let (Event::Recovered { cut_bytes, cut_sha256 }, Some((_, _, rest))) = (&line.event, &self.broken)
            && *cut_bytes == rest.len() as u64
            && *cut_sha256 == sha256(rest)
        {
            self.broken = None;
        }
        self.give_up_broken();
        if let Some(before) = self.end.take().filter(|before| !line.follows(before)) {
            let message = match line.number {
                n if n > before.number.saturating_add(1) => {
                    format!("lines {} to {} are missing before this one", before.number + 1, n - 1)
                }
                n if n <= before.number => format!("line {n} follows line {}", before.number),
                _ => "it does not hold the hash of the line before it".to_owned(),
            };
            self.problem(file, number, message);
        }
        if let Event::Damaged { reason } = &line.event {
            let reason = format!("the log was damaged when this line was written: {reason}");
            self.problem(file, number, reason);
        }
        self.report.last = Some((end.number, end.hash.clone()));
        self.end = Some(end);
        self.report.entries.push(Entry { number: line.number, unix_ms: line.unix_ms, event: line.event });
    }

    fn file(&mut self, file: &Path) -> std::io::Result<()> {
        let bytes = fs::read(file)?;
        let mut lines: Vec<&[u8]> = bytes.split(|b| *b == b'\n').collect();
        // After the last line feed there is nothing, or a line that was cut off.
        let cut = lines.pop().filter(|rest| !rest.is_empty());
        for (k, text) in lines.iter().enumerate() {
            self.line(file, k + 1, text);
        }
        if let Some(rest) = cut.filter(|rest| Line::parse(rest).is_some()) {
            self.line(file, lines.len() + 1, rest);
        }
        self.give_up_broken();
        if let Some(rest) = cut.filter(|rest| Line::parse(rest).is_none()) {
            self.problem(file, lines.len() + 1, format!("the last line is cut off after {} bytes", rest.len()));
        }
        Ok(())
    }
}

/// Reads a log, a folder or one file of it, and checks that no line was changed, added or removed. In a single file,
/// lines missing before the first or after the last cannot be detected.
///
/// # Errors
/// A file cannot be read.
pub fn read(path: &Path) -> std::io::Result<Report> {
    // A log that was never written is an empty folder.
    let is_folder = path.is_dir() || !path.exists();
    // Before the lines: a process that appends meanwhile writes each line before its head.
    let head = Head::read(path);
    let files = if is_folder { files(path)? } else { vec![path.to_owned()] };
    let mut checker = Checker { report: Report::default(), end: is_folder.then(End::default), broken: None };
    for file in &files {
        checker.file(file)?;
    }
    if is_folder {
        let last = checker.end.clone().unwrap_or_default();
        let has_head = path.join(HEAD).exists();
        match head {
            None if (last.number > 0 || has_head) && Head::read(path).is_none() => {
                checker.problem(&path.join(HEAD), 0, "it is missing or damaged, so a cut-off end cannot be noticed")
            }
            // A crash may have come between a line and its head.
            Some(head) if head.number > last.number => {
                let message = format!("lines {} to {} are missing at the end", last.number + 1, head.number);
                checker.problem(&path.join(&head.file), 0, message);
            }
            Some(head) if head.number == last.number && head.hash != last.hash => {
                checker.problem(&path.join(&head.file), 0, "the last line is another one than when it was written");
            }
            _ => {}
        }
    }
    Ok(checker.report)
}
