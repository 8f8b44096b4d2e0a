//! Files of a target, in a folder of the calling thread: some readers open their file by path.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

thread_local! {
    static FOLDER: Folder = new_folder();
}

fn new_folder() -> Folder {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let base = match std::env::var_os(crate::SCRATCH_VARIABLE) {
        Some(folder) => PathBuf::from(folder),
        None if Path::new("/dev/shm").is_dir() => PathBuf::from("/dev/shm"),
        None => std::env::temp_dir(),
    };
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    let folder = base.join(format!("panoscope-fuzz-{}-{number}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for temporary files");
    Folder(folder)
}

/// Path of a file in the folder; creates its parent folder.
pub fn path(name: &str) -> PathBuf {
    let path = FOLDER.with(|folder| folder.0.join(name));
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).expect("a folder for temporary files");
    }
    path
}

/// Writes a file and returns its path.
pub fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let path = path(name);
    std::fs::write(&path, bytes).expect("a temporary file");
    path
}
