//! Files that nodes of the graph write while it is shown: the window shows that they are written, and their size.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, SystemTime};

/// Time between two readings of the sizes.
const POLL_INTERVAL: Duration = Duration::from_secs(2);

/// Measures the files of a graph's sinks, on a thread of its own: a folder may be on a slow disk.
#[derive(Default)]
pub struct SinkFiles {
    paths: Vec<PathBuf>,
    total: Arc<AtomicU64>,
    /// Ends the thread when it is dropped.
    alive: Option<Sender<()>>,
}

impl SinkFiles {
    /// Measures the files at these paths from here on; place holders such as `{seq}` stand for anything.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn watch(&mut self, paths: Vec<PathBuf>) -> std::io::Result<()> {
        if paths == self.paths {
            return Ok(());
        }
        *self = Self { paths: paths.clone(), ..Self::default() };
        if paths.is_empty() {
            return Ok(());
        }
        let (alive, end) = channel::<()>();
        let (total, since) = (Arc::clone(&self.total), SystemTime::now());
        self.alive = Some(alive);
        let measure = move || {
            while end.recv_timeout(POLL_INTERVAL) == Err(RecvTimeoutError::Timeout) {
                total.store(paths.iter().map(|path| written_bytes(path, since)).sum(), Ordering::Relaxed);
            }
        };
        std::thread::Builder::new().name("sink sizes".to_owned()).spawn(measure).map(drop)
    }

    /// Size of the files, as last measured.
    pub fn bytes(&self) -> u64 {
        self.total.load(Ordering::Relaxed)
    }
}

/// Size of the files that a sink with this path has written since a time. A sink may put a number or another ending behind the name: all files that
/// begin like it count.
fn written_bytes(path: &Path, since: SystemTime) -> u64 {
    let (Some(folder), Some(name)) = (path.parent(), path.file_name().map(|name| name.to_string_lossy())) else {
        return 0;
    };
    let begin = name.split_once('{').map_or_else(|| stem(&name), |(begin, _)| begin);
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let files = files.filter(|file| file.file_name().to_string_lossy().starts_with(begin));
    let facts = files.filter_map(|file| file.metadata().ok());
    facts.filter(|facts| facts.is_file() && facts.modified().is_ok_and(|at| at >= since)).map(|facts| facts.len()).sum()
}

/// A file name without its extension.
fn stem(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_a_sink_count_from_the_start_on() {
        let folder = std::env::temp_dir().join(format!("panoscope_sinks_{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        let write = |name: &str, len: usize| std::fs::write(folder.join(name), vec![0; len]).unwrap();
        write("film.mkv", 10);
        write("film.part2.mkv", 20);
        write("image_000001.png", 3);
        write("image_000002.png", 4);
        write("other.csv", 1000);
        let past = SystemTime::now() - Duration::from_secs(60);
        assert_eq!(written_bytes(&folder.join("film.mkv"), past), 30);
        assert_eq!(written_bytes(&folder.join("image_{seq}.png"), past), 7);
        assert_eq!(written_bytes(&folder.join("film.mkv"), SystemTime::now() + Duration::from_secs(60)), 0);
        assert_eq!(written_bytes(&folder.join("none/film.mkv"), past), 0);
        std::fs::remove_dir_all(folder).unwrap();
    }
}
