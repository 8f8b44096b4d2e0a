//! Cache of descriptions on disk. Read data is untrusted, like the answer of a process; a failed write only costs time
//! later.

use std::fs;
use std::path::Path;
use std::time::SystemTime;

use panoscope_base::files;

/// Maximum length of a description, bytes.
const MAX_BYTES: u64 = 16 << 20;
/// Maximum number of descriptions that a folder keeps; the oldest are removed.
const MAX_COUNT: usize = 256;

/// Reads a kept description.
pub(super) fn read(file: &Path) -> Option<Vec<u8>> {
    let size = fs::metadata(file).ok()?.len();
    (size <= MAX_BYTES).then(|| fs::read(file).ok()).flatten()
}

/// Keeps a description: the file is complete or absent.
pub(super) fn write(file: &Path, bytes: &[u8]) {
    let Some(folder) = file.parent() else { return };
    let _ = fs::create_dir_all(folder).and_then(|()| files::replace(file, bytes));
    remove_oldest(folder);
}

fn remove_oldest(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let age =
        |entry: &fs::DirEntry| entry.metadata().and_then(|meta| meta.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    let mut files: Vec<_> = entries.flatten().map(|entry| (age(&entry), entry.path())).collect();
    files.sort();
    let surplus = files.len().saturating_sub(MAX_COUNT);
    for (_, file) in &files[..surplus] {
        let _ = fs::remove_file(file);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_is_kept_and_old_ones_go() {
        let folder = std::env::temp_dir().join(format!("panoscope_kept_{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        let file = folder.join("more").join("a");
        assert_eq!(read(&file), None);
        write(&file, b"what it offers");
        assert_eq!(read(&file).as_deref(), Some(&b"what it offers"[..]));
        // Times of files are coarse: several of them may be equal.
        let old = SystemTime::now() - std::time::Duration::from_secs(60);
        fs::File::options().write(true).open(&file).unwrap().set_modified(old).unwrap();
        (0..MAX_COUNT).for_each(|number| write(&file.with_file_name(number.to_string()), b""));
        assert_eq!(fs::read_dir(folder.join("more")).unwrap().count(), MAX_COUNT);
        assert_eq!(read(&file), None, "the oldest");
        // A folder that cannot be made is no mistake.
        write(Path::new("/proc/no/such/folder"), b"");
        fs::remove_dir_all(&folder).unwrap();
    }
}
