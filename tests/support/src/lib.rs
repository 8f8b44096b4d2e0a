//! Shared by the tests of every crate. Depends on nothing, so that any crate can use it as a dev-dependency.

#![forbid(unsafe_code)]

use std::fmt::Arguments;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Reports that the current test was skipped, with the reason as in `println!`. The test returns afterwards.
///
/// ```
/// if !std::path::Path::new("/no/such/data").exists() {
///     return panoscope_testing::skipped!("there is no {}", "/no/such/data");
/// }
/// ```
#[macro_export]
macro_rules! skipped {
    ($($reason:tt)*) => { $crate::report_skip(format_args!($($reason)*)) };
}

/// Prints `skipped: REASON` as the test's own output, which `cargo xtask test` counts, and `skipped: TEST: REASON` to
/// standard error.
///
/// libtest hides the output of a test that passes. It captures `println!` but not what is written to the handle of
/// standard error, so plain `cargo test` shows that line.
pub fn report_skip(reason: Arguments<'_>) {
    println!("skipped: {reason}");
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    // A closed standard error hides the line; the test is skipped all the same.
    let _ = writeln!(std::io::stderr(), "skipped: {test}: {reason}");
}

/// Gives a program separate settings and state, in `config` and `state` of a folder: the user's keys, audit log and latches are neither used nor
/// changed. Every test that starts a program that may write them calls it.
pub fn own_settings(command: &mut Command, folder: &Path) {
    command.env("XDG_CONFIG_HOME", folder.join("config")).env("XDG_STATE_HOME", folder.join("state"));
}

/// Makes `file` unless it exists and is newer than all `sources`. Each test has its own process, so several may need it at the same time: one makes
/// it, the others wait. `make` writes to the path that it is given, which becomes `file` when it is complete.
///
/// # Panics
/// `make` panics, or the folder of `file` cannot be written.
pub fn made_once(file: &Path, sources: &[&Path], make: impl FnOnce(&Path)) {
    let with_extension = |extension: &str| {
        let mut name = file.as_os_str().to_owned();
        name.push(extension);
        PathBuf::from(name)
    };
    let lock = std::fs::File::create(with_extension(".lock")).expect("the folder can be written");
    lock.lock().expect("a file can be locked");
    let changed = |path: &Path| std::fs::metadata(path).and_then(|data| data.modified());
    let made = changed(file);
    let is_new =
        made.is_ok_and(|made| sources.iter().all(|source| changed(source).is_ok_and(|changed| changed < made)));
    if !is_new {
        let part = with_extension(".part");
        make(&part);
        std::fs::rename(&part, file).expect("the file was made");
    }
}

/// A new folder for the files of one test, removed when dropped.
#[derive(Debug)]
pub struct Folder(PathBuf);

impl Folder {
    /// A folder whose name contains `name` and the process id, with these files: name and text. Folders in a name are created.
    ///
    /// # Panics
    /// Temporary files cannot be written.
    pub fn new(name: &str, files: &[(&str, &str)]) -> Self {
        let folder = Self(std::env::temp_dir().join(format!("panoscope-test-{}-{name}", std::process::id())));
        let _ = std::fs::remove_dir_all(&folder.0);
        std::fs::create_dir_all(&folder.0).expect("a folder for temporary files");
        files.iter().for_each(|(file, text)| folder.write(file, text));
        folder
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Path of a file in it.
    pub fn at(&self, file: &str) -> PathBuf {
        self.0.join(file)
    }

    /// Replaces a file in one step, as editors do.
    ///
    /// # Panics
    /// Temporary files cannot be written.
    pub fn write(&self, file: &str, text: &str) {
        let (path, part) = (self.at(file), self.at(&format!("{file}.part")));
        std::fs::create_dir_all(path.parent().unwrap_or(&self.0)).expect("a folder for temporary files");
        std::fs::write(&part, text).expect("a temporary file");
        std::fs::rename(&part, &path).expect("a temporary file");
    }

    /// Text of a file in it.
    ///
    /// # Panics
    /// It cannot be read.
    pub fn read(&self, file: &str) -> String {
        let path = self.at(file);
        std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_made_again_only_when_a_source_is_newer() {
        let folder = Folder::new("made", &[("source", "1")]);
        let (file, source) = (folder.at("made"), folder.at("source"));
        let copy = |to: &Path| {
            std::fs::copy(&source, to).expect("a copy");
        };
        made_once(&file, &[&source], copy);
        assert_eq!(folder.read("made"), "1");
        std::thread::sleep(std::time::Duration::from_millis(20));
        made_once(&file, &[&source], |_| panic!("it is there"));
        folder.write("source", "2");
        std::fs::File::open(&source).and_then(|file| file.set_modified(std::time::SystemTime::now())).expect("a time");
        made_once(&file, &[&source], copy);
        assert_eq!(folder.read("made"), "2");
    }
}
