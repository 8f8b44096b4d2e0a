//! Appends to the log.

use std::fs::{self, File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use crate::audit::chain::{End, Line, sha256};
use crate::audit::day::date;
use crate::audit::event::Event;
use crate::audit::files::{self, HEAD, Head};

/// File that is locked while a process appends.
const LOCK: &str = "lock";

/// An event that was not written; earlier ones are intact.
#[derive(Debug, thiserror::Error)]
pub enum AuditError {
    /// The disk is full.
    #[error("the disk is full ({file})", file = file.display())]
    DiskFull {
        /// The file that was written.
        file: PathBuf,
    },
    /// A file cannot be read or written.
    #[error("{file}: {cause}", file = file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// An event cannot be written as JSON.
    #[error("an event cannot be written: {0}")]
    Json(#[from] serde_json::Error),
}

fn in_file(file: &Path) -> impl Fn(std::io::Error) -> AuditError {
    move |cause| match cause.kind() {
        std::io::ErrorKind::StorageFull => AuditError::DiskFull { file: file.to_owned() },
        _ => AuditError::File { file: file.to_owned(), cause },
    }
}

/// Name of the file of a day.
fn file_name(unix_ms: i64) -> String {
    format!("audit-{}.jsonl", date(unix_ms))
}

/// A log that is appended to. Several processes may append to one log: each line is written under a lock of the folder.
pub struct Log {
    folder: PathBuf,
}

/// The end of the log while it is locked.
struct Tail {
    end: End,
    /// Name and length of the file with the last line; an empty name where there is none.
    file: String,
    bytes: u64,
    /// An event to write before the next one.
    said_first: Option<Event>,
}

impl Log {
    /// The log in `folder`, which is created with the first event.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    /// Appends an event that happened at a time in ms since 1970, and returns when it is on the disk.
    ///
    /// # Errors
    /// See [`AuditError`]; a partly written line is removed, and later calls may succeed.
    pub fn append(&self, unix_ms: i64, event: Event) -> Result<(), AuditError> {
        let mut builder = fs::DirBuilder::new();
        builder.recursive(true).mode(0o700).create(&self.folder).map_err(in_file(&self.folder))?;
        let _lock = self.lock()?;
        let mut tail = self.tail()?;
        // Not an earlier file than the last one, however the clock was set.
        tail.file = file_name(unix_ms).max(tail.file);
        if let Some(first) = tail.said_first.take() {
            self.write(&mut tail, unix_ms, first)?;
        }
        self.write(&mut tail, unix_ms, event)
    }

    /// Waits until no other process appends. The lock ends when the returned file is dropped.
    fn lock(&self) -> Result<File, AuditError> {
        let path = self.folder.join(LOCK);
        let file = OpenOptions::new().create(true).truncate(false).write(true).mode(0o600).open(&path);
        let file = file.map_err(in_file(&path))?;
        loop {
            // SAFETY: a plain system call on a file descriptor that `file` owns.
            if unsafe { libc::flock(file.as_raw_fd(), libc::LOCK_EX) } == 0 {
                return Ok(file);
            }
            let error = std::io::Error::last_os_error();
            if error.kind() != std::io::ErrorKind::Interrupted {
                return Err(AuditError::File { file: path, cause: error });
            }
        }
    }

    /// Finds the end of the chain, and what happened to the log since the head was written.
    fn tail(&self) -> Result<Tail, AuditError> {
        let damaged = |reason: String| Some(Event::Damaged { reason });
        let head = match Head::read(&self.folder) {
            Some(head) => head,
            None => {
                // Without a head the newest file tells where the chain ends.
                let Some(file) = files::files(&self.folder).map_err(in_file(&self.folder))?.pop() else {
                    let end = End::default();
                    return Ok(Tail { end, file: String::new(), bytes: 0, said_first: None });
                };
                let bytes = fs::read(&file).map_err(in_file(&file))?;
                let last = bytes.split(|b| *b == b'\n').rev().find_map(Line::parse).map(|(_, end)| end);
                let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
                // A file that has no line yet, such as one on a disk that was full from the start.
                let said_first = if bytes.is_empty() { None } else { damaged(format!("{HEAD} is missing")) };
                let end = last.unwrap_or_default();
                return Ok(Tail { end, file: name, bytes: bytes.len() as u64, said_first });
            }
        };
        let path = self.folder.join(&head.file);
        let mut tail = Tail { end: head.end(), file: head.file.clone(), bytes: head.bytes, said_first: None };
        let len = match fs::metadata(&path) {
            Ok(meta) => meta.len(),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => 0,
            Err(cause) => return Err(AuditError::File { file: path, cause }),
        };
        if len < head.bytes {
            let missing = head.bytes - len;
            tail.said_first = damaged(format!("the last {missing} bytes of {} are missing", head.file));
            tail.bytes = len;
            return Ok(tail);
        }
        if len == head.bytes {
            return Ok(tail);
        }
        // Lines whose head was not written any more, and what a crash left of the last one.
        let mut rest = Vec::new();
        let mut file = File::open(&path).map_err(in_file(&path))?;
        file.seek(SeekFrom::Start(head.bytes)).and_then(|_| file.read_to_end(&mut rest)).map_err(in_file(&path))?;
        let mut rest = rest.as_slice();
        while let Some(at) = rest.iter().position(|b| *b == b'\n') {
            let Some((_, end)) = Line::parse(&rest[..at]).filter(|(line, _)| line.follows(&tail.end)) else { break };
            tail.end = end;
            rest = &rest[at + 1..];
        }
        // A line that lacks only its line feed, which the next one adds.
        if let Some((_, end)) = Line::parse(rest).filter(|(line, _)| line.follows(&tail.end)) {
            tail.end = end;
            rest = &[];
        }
        tail.bytes = len;
        if rest.contains(&b'\n') {
            tail.said_first = damaged(format!("{} has lines that do not follow the chain", tail.file));
        } else if !rest.is_empty() {
            tail.said_first = Some(Event::Recovered { cut_bytes: rest.len() as u64, cut_sha256: sha256(rest) });
        }
        Ok(tail)
    }

    fn write(&self, tail: &mut Tail, unix_ms: i64, event: Event) -> Result<(), AuditError> {
        let (text, end) = Line::after(&tail.end, unix_ms, event).text()?;
        let path = self.folder.join(&tail.file);
        let fail = in_file(&path);
        let mut file =
            OpenOptions::new().create(true).append(true).read(true).mode(0o600).open(&path).map_err(&fail)?;
        let before = file.metadata().map_err(&fail)?.len();
        // What a crash or a cut left of a line ends here.
        let is_cut = before > 0 && {
            let mut last = [0];
            file.seek(SeekFrom::End(-1)).and_then(|_| file.read_exact(&mut last)).map_err(&fail)?;
            last != *b"\n"
        };
        let text = if is_cut { format!("\n{text}") } else { text };
        if tail.end.number == 0 && before == 0 {
            // A log has its head before its first line, so that a head that is missing was removed.
            let _ =
                self.write_head(&Head { number: 0, hash: tail.end.hash.clone(), file: tail.file.clone(), bytes: 0 });
        }
        if let Err(cause) = file.write_all(text.as_bytes()).and_then(|()| file.sync_data()) {
            // A part of the line must not stay. Where that fails too, the next line names it.
            let _ = file.set_len(before);
            return Err(fail(cause));
        }
        let bytes = before + text.len() as u64;
        let head = Head { number: end.number, hash: end.hash.clone(), file: tail.file.clone(), bytes };
        // The line is on the disk. A head that is behind is brought up to date with the next one.
        let _ = self.write_head(&head);
        tail.end = end;
        tail.bytes = bytes;
        Ok(())
    }

    /// Replaces the head, completely or not at all. A crash before it leaves a head that is a line behind.
    fn write_head(&self, head: &Head) -> Result<(), AuditError> {
        let (path, part) = (self.folder.join(HEAD), self.folder.join(format!("{HEAD}.part")));
        let text = serde_json::to_string(head)? + "\n";
        let mut file = OpenOptions::new().create(true).truncate(true).write(true).mode(0o600).open(&part);
        let written = file.as_mut().map_err(|e| std::io::Error::from(e.kind())).and_then(|file| {
            file.write_all(text.as_bytes())?;
            file.sync_data()?;
            fs::rename(&part, &path)
        });
        written.map_err(in_file(&path))
    }
}
