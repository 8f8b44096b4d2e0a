//! From a path parameter to a finished file: names, folders, part files, and errors with help.

use std::collections::VecDeque;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Seek, SeekFrom, Write};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use panoscope_base::files::create;
use panoscope_node::{Context, Finish, Open, Result as NodeResult, Validation};

/// Extension of a file that is still being written.
pub const PART: &str = ".tmp-part";

/// Why a file could not be written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum SinkError {
    /// The operating system refused an operation.
    #[error("cannot write {path}: {reason}; {help}", path = path.display(), help = help(source))]
    Io { path: PathBuf, reason: String, source: io::Error },
    /// The path parameter is empty or has no file name.
    #[error("`path = \"{path}\"` has no file name: write for example `path = \"out/{example}\"`", path = path.display())]
    NoName { path: PathBuf, example: &'static str },
    /// The node has no format with this extension.
    #[error("{path}: the extension `{ending}` is not supported here; supported are: {known}", path = path.display())]
    Ending { path: PathBuf, ending: String, known: &'static str },
    /// The format cannot hold these pixels.
    #[error("{path}: {what} cannot be stored in this format; {help}", path = path.display())]
    Unfit { path: PathBuf, what: String, help: &'static str },
    /// An encoder failed.
    #[error("{path}: the encoder failed: {reason}", path = path.display())]
    Encode { path: PathBuf, reason: String },
}

impl SinkError {
    /// Wraps an error of the operating system with what to do about it.
    pub fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_owned(), reason: source.to_string(), source }
    }
}

fn help(error: &io::Error) -> &'static str {
    match error.kind() {
        ErrorKind::NotFound => "the folder does not exist and could not be created",
        ErrorKind::PermissionDenied => {
            "the folder is not writable for this user: choose another or change its permissions"
        }
        ErrorKind::ReadOnlyFilesystem => "the file system is mounted read-only: choose another folder",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            "the disk is full: free some space or choose another folder"
        }
        ErrorKind::FileTooLarge => {
            "the file has reached its size limit (`ulimit -f`, or the file system's): raise the limit or choose another folder"
        }
        ErrorKind::IsADirectory => "a folder has that name: choose another file name",
        ErrorKind::NotADirectory | ErrorKind::AlreadyExists => "a part of the path is a file, not a folder",
        _ => "check that the folder exists and is writable",
    }
}

/// Extension of a path in lower case, without the dot.
pub fn ending(path: &Path) -> String {
    path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase()
}

/// Creates the folder of `path` if it is missing, with mode 0700: results may show patients.
///
/// # Errors
/// A system error about `path`.
pub fn make_folder(path: &Path) -> Result<(), SinkError> {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => {
            let created = DirBuilder::new().recursive(true).mode(0o700).create(folder);
            created.map_err(|error| SinkError::io(path, error))
        }
        _ => Ok(()),
    }
}

/// Refuses a path without a file name, and one whose extension is not among `known` (`"png, jpg"`).
///
/// # Errors
/// [`SinkError::NoName`] and [`SinkError::Ending`].
pub fn check_name(path: &Path, example: &'static str, known: &'static str) -> Result<String, SinkError> {
    if path.file_name().is_none() || path.is_dir() {
        return Err(SinkError::NoName { path: path.to_owned(), example });
    }
    let ending = ending(path);
    if known.split(", ").any(|k| k == ending) {
        return Ok(ending);
    }
    Err(SinkError::Ending { path: path.to_owned(), ending, known })
}

/// Reports what [`check_name`] refuses about parameter `path`, and a parent folder that is a file.
pub fn check_path(
    check: &mut Validation<'_>,
    path: &Path,
    example: &'static str,
    known: &'static str,
) -> Option<String> {
    let ending = check_name(path, example, known).map_err(|error| check.error("path", error.to_string(), "")).ok()?;
    let there = path.ancestors().skip(1).find(|folder| folder.exists());
    if let Some(file) = there.filter(|there| !there.is_dir()) {
        let message = format!("cannot write {}: {} is a file, not a folder", path.display(), file.display());
        check.error("path", message, "choose another folder, or move that file away");
    }
    let (_, rest) = split_existing(path);
    if let Some(printf) = printf_number(&rest.to_string_lossy()) {
        let message = format!("`{printf}` is not a placeholder: each file replaces the previous one");
        check.warning("path", message, "write {seq} for the tick number, or {seq:4} for four digits");
    }
    Some(ending)
}

/// The folder of `path` that exists, and the rest. The names of existing folders are as they are: what looks like a placeholder there is none.
fn split_existing(path: &Path) -> (&Path, &Path) {
    let folder = path.ancestors().skip(1).find(|folder| folder.is_dir()).unwrap_or(Path::new(""));
    (folder, path.strip_prefix(folder).unwrap_or(path))
}

/// A placeholder in the style of other programs, such as `%04d`.
fn printf_number(text: &str) -> Option<&str> {
    text.match_indices('%').find_map(|(start, _)| {
        let rest = &text[start + 1..];
        let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
        rest[digits..].starts_with('d').then(|| &text[start..start + digits + 2])
    })
}

/// Claims the pattern of a node that replaces whole files, such as `out/{seq}.png`, and returns the one to write. Creates the folders before the
/// first placeholder.
///
/// # Errors
/// Another node or run writes these files, or the system refuses the folder.
pub fn claim_files(open: &Open<'_>, pattern: &Path) -> NodeResult<PathBuf> {
    let (folder, rest) = split_existing(pattern);
    let is_pattern = |path: &&Path| path.to_string_lossy().contains('{');
    make_folder(&folder.join(rest.ancestors().take_while(is_pattern).last().unwrap_or(rest)))?;
    open.claim_files(pattern)
}

/// Claims the file of a node that is being opened and checks that it can be written. Creates folders; does not change the file's content.
///
/// # Errors
/// Another node or run writes the file, or the system refuses it.
pub fn claim(open: &Open<'_>, path: &Path) -> NodeResult<()> {
    make_folder(path)?;
    open.claim_file(path)?;
    let tried = match OpenOptions::new().write(true).create_new(true).open(path) {
        Ok(_) => fs::remove_file(path),
        // A pipe would wait for its reader.
        Err(error) if error.kind() == ErrorKind::AlreadyExists => match path.symlink_metadata() {
            Ok(found) if found.is_file() => OpenOptions::new().write(true).open(path).map(drop),
            _ => Ok(()),
        },
        Err(error) => Err(error),
    };
    tried.map_err(|error| SinkError::io(path, error).into())
}

/// Flushes a file to the disk. Does nothing for pipes and devices.
///
/// # Errors
/// Those of the system, including deferred writes.
pub fn sync(file: &File) -> io::Result<()> {
    match file.sync_all() {
        Err(error) if error.kind() == ErrorKind::InvalidInput => Ok(()),
        done => done,
    }
}

/// A file that grows while the graph runs. It is created with the first bytes. Every instance of its node starts a separate part, so that what was
/// written before is never truncated.
pub struct Growing {
    asked: PathBuf,
    begun: Option<Begun>,
}

struct Begun {
    file: File,
    path: PathBuf,
    /// Number of bytes that were written completely.
    len: u64,
}

impl Growing {
    /// Prepares a claimed file; creates nothing yet.
    pub fn new(path: &Path) -> Self {
        Self { asked: path.to_owned(), begun: None }
    }

    /// Appends bytes. On return the file contains all of them or none.
    ///
    /// # Errors
    /// Another node writes the file; those of the system.
    pub fn append(&mut self, cx: &Context<'_>, bytes: &[u8]) -> NodeResult<()> {
        if bytes.is_empty() {
            return Ok(());
        }
        if self.begun.is_none() {
            let path = cx.begin_file(&self.asked, true)?;
            if path != self.asked {
                cx.info(&format!("continues in {}", path.display()));
            }
            self.create(path)?;
        }
        let Some(begun) = &mut self.begun else { return Ok(()) };
        match begun.file.write_all(bytes) {
            Ok(()) => {
                begun.len += bytes.len() as u64;
                Ok(())
            }
            Err(error) => {
                let error = SinkError::io(&begun.path, error);
                if begun.cut_back() {
                    self.begun = None;
                }
                Err(error.into())
            }
        }
    }

    /// Whether the file has been created.
    pub fn is_begun(&self) -> bool {
        self.begun.is_some()
    }

    /// Creates the file.
    ///
    /// # Errors
    /// Those of the system.
    pub fn create(&mut self, path: PathBuf) -> Result<(), SinkError> {
        let file = create(&path).map_err(|error| SinkError::io(&path, error))?;
        self.begun = Some(Begun { file, path, len: 0 });
        Ok(())
    }

    /// Completes the file. If nothing was written, it is created empty, so that it does not show an earlier run's content; a further part is not
    /// created then.
    ///
    /// # Errors
    /// Those of the system.
    pub fn finish(&mut self, cx: &Finish<'_>) -> NodeResult<()> {
        if self.begun.is_none() {
            let path = cx.begin_file(&self.asked, true)?;
            if path != self.asked {
                return Ok(());
            }
            self.create(path)?;
        }
        match self.begun.take() {
            Some(begun) => sync(&begun.file).map_err(|error| SinkError::io(&begun.path, error).into()),
            None => Ok(()),
        }
    }
}

impl Begun {
    /// Truncates an incomplete write. If that fails too, readers find half a line at the end. Returns whether nothing was left and the file was
    /// removed.
    fn cut_back(&mut self) -> bool {
        let is_file = self.file.metadata().is_ok_and(|found| found.is_file());
        if self.len == 0 && is_file {
            return fs::remove_file(&self.path).is_ok();
        }
        if self.file.set_len(self.len).is_ok() {
            let _ = self.file.seek(SeekFrom::Start(self.len));
        }
        false
    }
}

/// Files that are each written in one step, see [`write_whole`].
#[derive(Default)]
pub struct Wholes {
    /// The newest files, which the system may not have written to the disk yet.
    recent: VecDeque<PathBuf>,
}

/// Number of newest files to flush at the end: the system itself flushes older ones, after half a minute at most.
const MAX_RECENT: usize = 300;

impl Wholes {
    /// Writes a file.
    ///
    /// # Errors
    /// As [`write_whole`].
    pub fn write(
        &mut self,
        path: &Path,
        body: impl FnOnce(&mut BufWriter<File>) -> Result<(), SinkError>,
    ) -> Result<(), SinkError> {
        // A file of an earlier run must not be lost for one that a power failure leaves empty.
        let is_other = self.recent.back().is_none_or(|last| last != path);
        write_whole(path, is_other && path.exists(), body)?;
        if is_other {
            if self.recent.len() == MAX_RECENT {
                self.recent.pop_front();
            }
            self.recent.push_back(path.to_owned());
        }
        Ok(())
    }

    /// Flushes the newest files to the disk.
    ///
    /// # Errors
    /// Those of the system, including deferred writes.
    pub fn finish(&mut self) -> Result<(), SinkError> {
        for path in self.recent.drain(..) {
            // Removed or replaced by another program meanwhile: no longer this node's.
            let Ok(file) = File::open(&path) else { continue };
            sync(&file).map_err(|error| SinkError::io(&path, error))?;
        }
        Ok(())
    }
}

/// Writes a file under another name and then renames it, so that no reader sees half of it. With `sync_first` its content is flushed to the disk
/// before it replaces the file of that name.
///
/// # Errors
/// Errors of `body` and of the system; the part file is removed.
pub fn write_whole(
    path: &Path,
    sync_first: bool,
    body: impl FnOnce(&mut BufWriter<File>) -> Result<(), SinkError>,
) -> Result<(), SinkError> {
    let mut part = path.as_os_str().to_owned();
    part.push(PART);
    let part = PathBuf::from(part);
    let io = |error| SinkError::io(path, error);
    let written = (|| {
        let mut file = BufWriter::with_capacity(1 << 16, create(&part).map_err(io)?);
        body(&mut file)?;
        file.flush().map_err(io)?;
        if sync_first {
            sync(file.get_ref()).map_err(io)?;
        }
        drop(file);
        fs::rename(&part, path).map_err(io)
    })();
    if written.is_err() {
        // Only the first error is reported.
        let _ = fs::remove_file(&part);
    }
    written
}

/// A file name with the placeholders `{seq}` (six digits), `{seq:N}` (N digits) and `{port}`, which are filled in per tick.
#[derive(Clone, Debug)]
pub struct Pattern {
    path: PathBuf,
    /// The part that existed at the start, without placeholders.
    folder: PathBuf,
    text: String,
    every: u64,
    seen: u64,
}

impl Pattern {
    /// Parses `path` as the graph names it.
    pub fn new(path: &Path) -> Self {
        let (folder, rest) = split_existing(path);
        let (folder, text) = (folder.to_owned(), rest.to_string_lossy().into_owned());
        Self { path: path.to_owned(), folder, text, every: 1, seen: 0 }
    }

    /// The path with its placeholders.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether each tick has a separate file.
    pub fn has_seq(&self) -> bool {
        self.text.contains("{seq")
    }

    /// The file for tick `seq` and `port`. With several ports and no `{port}` in the pattern (`tell_apart`), the port's name is inserted before the
    /// extension.
    pub fn file(&self, seq: u64, port: &str, tell_apart: bool) -> PathBuf {
        let mut out = String::with_capacity(self.text.len() + 16);
        let mut rest = self.text.as_str();
        while let Some(open) = rest.find('{') {
            let Some(close) = rest[open..].find('}').map(|c| open + c) else { break };
            out.push_str(&rest[..open]);
            match &rest[open + 1..close] {
                "seq" => out.push_str(&format!("{seq:06}")),
                "port" => out.push_str(port),
                other => match other.strip_prefix("seq:").and_then(|n| n.parse::<usize>().ok()) {
                    Some(digits) => out.push_str(&format!("{seq:0digits$}", digits = digits.min(20))),
                    None => out.push_str(&rest[open..=close]),
                },
            }
            rest = &rest[close + 1..];
        }
        out.push_str(rest);
        if tell_apart && !self.text.contains("{port}") {
            let dot = out.rfind('.').unwrap_or(out.len());
            out.insert_str(dot, &format!("_{port}"));
        }
        self.folder.join(out)
    }

    /// Counts a call; returns true for every `every`-th.
    pub fn is_due(&mut self, every: u64) -> bool {
        if every != self.every {
            (self.every, self.seen) = (every, 0);
        }
        let due = self.seen.is_multiple_of(every.max(1));
        self.seen += 1;
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_as_other_programs_write_them_are_found() {
        assert_eq!(printf_number("out/still_%04d.png"), Some("%04d"));
        assert_eq!(printf_number("100%/a_%d.png"), Some("%d"));
        assert_eq!((printf_number("50%_done.png"), printf_number("{seq}.png")), (None, None));
    }

    #[test]
    fn place_holders_are_filled_in() {
        let at = |text: &str, apart| Pattern::new(Path::new(text)).file(42, "depth", apart).display().to_string();
        assert_eq!(at("out/{seq}.png", false), "out/000042.png");
        assert_eq!(at("out/{seq:4}_{port}.pfm", true), "out/0042_depth.pfm");
        assert_eq!(at("out/x.npy", true), "out/x_depth.npy");
        assert_eq!(at("out/{other}.npy", false), "out/{other}.npy");
        assert_eq!(at("out/{seq.png", false), "out/{seq.png");
    }

    #[test]
    fn folders_that_exist_have_no_placeholders() {
        use std::os::unix::ffi::OsStrExt;

        let folder = std::env::temp_dir().join(format!("panoscope_pattern_{}", std::process::id()));
        // Not UTF-8.
        let named = folder.join(std::ffi::OsStr::from_bytes(b"{seq} %d \xe9"));
        fs::create_dir_all(&named).unwrap();
        let file = Pattern::new(&named.join("new {port}/{seq:3}.png")).file(7, "depth", false);
        assert_eq!(file, named.join("new depth/007.png"));
        let (_, rest) = split_existing(&file);
        assert_eq!((rest, printf_number(&rest.to_string_lossy())), (Path::new("new depth/007.png"), None));
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn every_third_is_due() {
        let mut pattern = Pattern::new(Path::new("a.png"));
        let due: Vec<bool> = (0..7).map(|_| pattern.is_due(3)).collect();
        assert_eq!(due, [true, false, false, true, false, false, true]);
        assert!(pattern.is_due(2), "a new rhythm starts at once");
    }

    #[test]
    fn a_failed_file_leaves_nothing_behind() {
        let folder = std::env::temp_dir().join(format!("panoscope_target_{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join("x.bin");
        let error = write_whole(&path, false, |w| {
            w.write_all(b"half").unwrap();
            Err(SinkError::Encode { path: path.clone(), reason: "no".into() })
        });
        assert!(error.is_err());
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        write_whole(&path, true, |w| w.write_all(b"whole").map_err(|e| SinkError::io(&path, e))).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        // The path of a file used as a folder.
        let error = make_folder(&path.join("deeper/y.bin")).unwrap_err().to_string();
        assert!(error.contains("is a file, not a folder"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }
}
