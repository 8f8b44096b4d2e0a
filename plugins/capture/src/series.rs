//! Files that belong to the pictures of a source: number n of the files to picture n.

use std::path::{Path, PathBuf};

use panoscope_calibration::pictures::{is_pattern, numbered_files};
use panoscope_node::Context;

/// Why there are no files.
#[derive(Debug, thiserror::Error)]
pub enum SeriesError {
    /// Nothing is given.
    #[error("`path` is empty: give a file, a folder or a pattern such as truth/*.pfm or truth/%04d.pfm")]
    Empty,
    /// The file does not exist.
    #[error("there is no file {path}", path = path.display())]
    Missing {
        /// Absolute path.
        path: PathBuf,
    },
    /// A pattern or folder without such files.
    #[error("no {what} matches {pattern}; {hint}", pattern = pattern.display())]
    NoMatch {
        /// What is searched.
        what: &'static str,
        /// Absolute pattern.
        pattern: PathBuf,
        /// What the folder holds instead.
        hint: String,
    },
}

/// Files in the order of their numbers.
#[derive(Debug)]
pub struct Series {
    /// What the files are, for messages.
    what: &'static str,
    files: Vec<PathBuf>,
    /// One file that belongs to every picture.
    is_single: bool,
    is_end_reported: bool,
}

impl Series {
    /// Reads `text` as `capture` reads its sources: a folder, a pattern with `*`, `?` or `%04d`, or a file; relative paths stand in `folder`.
    ///
    /// # Errors
    /// See [`SeriesError`].
    pub fn open(
        text: &str,
        folder: &Path,
        what: &'static str,
        fits: impl Fn(&Path) -> bool,
    ) -> Result<Self, SeriesError> {
        let text = text.trim();
        if text.is_empty() {
            return Err(SeriesError::Empty);
        }
        let path = std::path::absolute(folder.join(text)).unwrap_or_else(|_| folder.join(text));
        let pattern = match (path.is_dir(), path.exists()) {
            (true, _) => path.join("*"),
            (false, true) => {
                return Ok(Self { what, files: vec![path], is_single: true, is_end_reported: false });
            }
            (false, false) if is_pattern(text) => path,
            (false, false) => return Err(SeriesError::Missing { path }),
        };
        let files = numbered_files(&pattern, what, fits);
        let files = files.map_err(|hint| SeriesError::NoMatch { what, pattern, hint })?;
        Ok(Self { what, files, is_single: false, is_end_reported: false })
    }

    /// The file of the tick's picture and its index; `None` behind the last one unless they start again with `is_repeated`.
    pub fn of_tick(&mut self, cx: &Context<'_>, is_repeated: bool) -> Option<(usize, &Path)> {
        let (number, count) = (cx.tick().seq, self.files.len());
        let index = if self.is_single {
            0
        } else if is_repeated {
            (number % count as u64) as usize
        } else {
            usize::try_from(number).unwrap_or(usize::MAX)
        };
        if index >= count && !self.is_end_reported {
            self.is_end_reported = true;
            cx.warn(&format!(
                "picture {} and later ones have no {}: there are {count} files, from {} on",
                number + 1,
                self.what,
                self.files.first().map_or_else(String::new, |file| file.display().to_string()),
            ));
        }
        self.files.get(index).map(|file| (index, file.as_path()))
    }

    /// The files.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }
}
