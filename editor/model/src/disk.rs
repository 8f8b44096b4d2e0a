//! The graph file on disk: saves it atomically with a backup, and watches it for changes by other programs.

use std::collections::HashMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_base::files;
use panoscope_engine::sync::lock;
use panoscope_host::loader::Stamp;

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
    let mode = fs::metadata(path).ok().map(|m| m.permissions());
    if let Ok(old) = fs::read(path) {
        files::replace_with(&backup_of(path), mode.clone(), |file| file.write_all(&old)).map_err(fail)?;
    }
    files::replace_with(path, mode, |file| file.write_all(text.as_bytes())).map_err(fail)
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

/// A thread that calls for attention while watched files change, so that a window in which nothing happens need not draw to notice.
pub struct DiskAlarm {
    watched: Arc<Mutex<Vec<PathBuf>>>,
    quit: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl DiskAlarm {
    /// Starts the thread; `wake` is called in the intervals in which a [`DiskWatch`] of a file may have something to report.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn new(wake: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        let watched = Arc::<Mutex<Vec<PathBuf>>>::default();
        let quit = Arc::new(AtomicBool::new(false));
        let (files, stop) = (Arc::clone(&watched), Arc::clone(&quit));
        let run = move || {
            let mut known: HashMap<PathBuf, Stamp> = HashMap::new();
            let mut rounds = 0u32;
            while !stop.load(Ordering::Acquire) {
                let now: HashMap<PathBuf, Stamp> =
                    lock(&files).iter().map(|path| (path.clone(), Stamp::of(path))).collect();
                if now != known {
                    known = now;
                    // The watch sees the change, and that the file stays as it is.
                    rounds = 4;
                }
                if rounds > 0 {
                    rounds -= 1;
                    wake();
                }
                std::thread::park_timeout(DiskWatch::INTERVAL);
            }
        };
        let thread = std::thread::Builder::new().name("disk".to_owned()).spawn(run)?;
        Ok(Self { watched, quit, thread: Some(thread) })
    }

    /// Sets the files to watch.
    pub fn watch<'p>(&self, paths: impl Iterator<Item = &'p Path>) {
        let mut watched = lock(&self.watched);
        watched.clear();
        watched.extend(paths.map(Path::to_owned));
    }
}

impl Drop for DiskAlarm {
    fn drop(&mut self) {
        self.quit.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
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
    fn a_backup_can_be_read_by_no_more_users_than_its_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = folder("mode");
        let path = folder.join("g.toml");
        fs::write(&path, "old").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        save(&path, "new").unwrap();
        for file in [&path, &backup_of(&path)] {
            assert_eq!(fs::metadata(file).unwrap().permissions().mode() & 0o777, 0o600);
        }
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
    fn an_alarm_calls_while_a_file_changes_and_is_quiet_after_that() {
        let folder = folder("alarm");
        let path = folder.join("g.toml");
        fs::write(&path, "one").unwrap();
        let calls = Arc::new(std::sync::atomic::AtomicU32::new(0));
        let count = Arc::clone(&calls);
        let alarm = DiskAlarm::new(move || _ = count.fetch_add(1, Ordering::Relaxed)).unwrap();
        alarm.watch(std::iter::once(path.as_path()));
        let until = |what: &str, holds: &dyn Fn(u32) -> bool| {
            let end = Instant::now() + Duration::from_secs(20);
            while !holds(calls.load(Ordering::Relaxed)) {
                assert!(Instant::now() < end, "{what}: {}", calls.load(Ordering::Relaxed));
                std::thread::sleep(Duration::from_millis(20));
            }
        };
        until("the file is new to it", &|calls| calls == 4);
        std::thread::sleep(3 * DiskWatch::INTERVAL);
        assert_eq!(calls.load(Ordering::Relaxed), 4, "nothing changes");
        fs::write(&path, "three").unwrap();
        until("the file changed", &|calls| calls == 8);
        drop(alarm);
        fs::remove_dir_all(folder).unwrap();
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
