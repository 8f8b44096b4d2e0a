//! The graph file on disk: saves it atomically with a backup, and watches it for changes by other programs.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use panoscope_loader::Stamp;

/// Why the file was not saved; it is unchanged.
#[derive(Debug, thiserror::Error)]
#[error("{path} was not saved: {cause}", path = path.display())]
pub struct SaveError {
    /// The file.
    pub path: PathBuf,
    /// The operating system's error.
    pub cause: std::io::Error,
}

/// The backup file of `path`, with the text before the last save.
pub fn backup_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".bak");
    name.into()
}

/// Saves a text atomically: at any moment the file contains the complete old or the complete new text. The old text is kept as a backup.
///
/// # Errors
/// The file or its backup cannot be written; the file is unchanged.
pub fn save(path: &Path, text: &str) -> Result<(), SaveError> {
    let fail = |cause| SaveError { path: path.to_owned(), cause };
    // For a symbolic link, its target is replaced and not the link.
    let path = &fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    if let Ok(old) = fs::read(path) {
        replace(&backup_of(path), &old, None).map_err(fail)?;
    }
    let mode = fs::metadata(path).ok().map(|m| m.permissions());
    replace(path, text.as_bytes(), mode).map_err(fail)
}

/// Reads the text of a file of at most `max_bytes`; `None` for a larger one, of which no more is read.
///
/// # Errors
/// The file cannot be read, or is no UTF-8.
pub fn read_text(path: &Path, max_bytes: u64) -> std::io::Result<Option<String>> {
    if fs::metadata(path)?.len() > max_bytes {
        return Ok(None);
    }
    fs::read_to_string(path).map(Some)
}

/// Writes a file atomically: at any moment the complete old or the complete new file exists.
///
/// # Errors
/// The file or its backup cannot be written; the file is unchanged.
pub fn replace(path: &Path, bytes: &[u8], mode: Option<fs::Permissions>) -> std::io::Result<()> {
    let mut part = path.as_os_str().to_owned();
    part.push(format!(".{}.part", std::process::id()));
    let part = PathBuf::from(part);
    let written = (|| {
        let mut file = File::create(&part)?;
        if let Some(mode) = mode {
            file.set_permissions(mode)?;
        }
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&part, path)
    })();
    if written.is_err() {
        let _ = fs::remove_file(&part);
        return written;
    }
    // Makes the rename survive a power failure. File systems that cannot sync a folder ensure this themselves.
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let _ = File::open(folder).and_then(|f| f.sync_all());
    Ok(())
}

/// Polls whether another program changed the file.
pub struct DiskWatch {
    path: PathBuf,
    reported: Stamp,
    polled: Stamp,
    next: Instant,
}

impl DiskWatch {
    /// Time between two polls. A change is reported once the file stays the same for this time.
    pub const INTERVAL: Duration = Duration::from_millis(500);

    /// Starts from the file as it is now.
    pub fn new(path: &Path) -> Self {
        let reported = Stamp::of(path);
        Self { path: path.to_owned(), reported, polled: reported, next: Instant::now() }
    }

    /// Ignores changes of the file up to now.
    pub fn mark_known(&mut self) {
        self.reported = Stamp::of(&self.path);
        self.polled = self.reported;
    }

    /// The new text, once, after another program changed the file.
    pub fn poll(&mut self) -> Option<String> {
        if Instant::now() < self.next {
            return None;
        }
        self.next = Instant::now() + Self::INTERVAL;
        let now = Stamp::of(&self.path);
        let still = now == self.polled;
        self.polled = now;
        if !still || now == self.reported {
            return None;
        }
        self.reported = now;
        fs::read_to_string(&self.path).ok()
    }
}

/// Whether a node's error message means that the disk is full.
pub fn is_full(words: &str) -> bool {
    words.contains("No space left") || words.contains("the disk is full")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("panoscope_disk_{name}_{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_save_keeps_the_old_text_and_leaves_nothing_else() {
        let folder = folder("save");
        let path = folder.join("g.toml");
        fs::write(&path, "old").unwrap();
        save(&path, "new").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert_eq!(fs::read_to_string(backup_of(&path)).unwrap(), "old");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_link_stays_a_link() {
        let folder = folder("link");
        let (path, link) = (folder.join("g.toml"), folder.join("l.toml"));
        fs::write(&path, "old").unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        save(&link, "new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_folder_that_is_gone_is_an_error() {
        let folder = folder("gone");
        fs::remove_dir_all(&folder).unwrap();
        let error = save(&folder.join("g.toml"), "x").unwrap_err();
        assert!(error.to_string().contains("g.toml"), "{error}");
    }

    #[test]
    fn a_change_is_reported_once_the_file_is_stable() {
        let folder = folder("watch");
        let path = folder.join("g.toml");
        fs::write(&path, "one").unwrap();
        let mut watch = DiskWatch::new(&path);
        assert_eq!(watch.poll(), None);
        fs::write(&path, "three").unwrap();
        let mut found = None;
        for _ in 0..4 {
            watch.next = Instant::now();
            found = found.or(watch.poll());
        }
        assert_eq!(found.as_deref(), Some("three"));
        fs::remove_dir_all(folder).unwrap();
    }
}
