//! What tests of every crate share. Depends on nothing, so that any crate can use it as a dev-dependency.

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

/// Gives a program settings and state of its own, in `config` and `state` of a folder: the keys, the audit log and the latches of who runs the
/// tests do not count, and are not changed. Every test that starts a program that may write them calls it.
pub fn own_settings(command: &mut Command, folder: &Path) {
    command.env("XDG_CONFIG_HOME", folder.join("config")).env("XDG_STATE_HOME", folder.join("state"));
}

/// A fresh folder for the files of one test, removed at the end.
#[derive(Debug)]
pub struct Folder(PathBuf);

impl Folder {
    /// A folder whose name holds `name` and the process, with these files: name and text, folders in the name are made.
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

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Path of a file in it.
    pub fn at(&self, file: &str) -> PathBuf {
        self.0.join(file)
    }

    /// Writes a file in one step, as editors do.
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
