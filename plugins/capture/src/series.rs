//! Files that belong to the images of a source: matched by the names or numbers of the images if those are given, else file n to image n.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use panoscope_data::calibration::pictures::{PatternError, is_image, is_pattern, numbered_files};
use panoscope_data::calibration::views::{gap, matched};
use panoscope_node::Context;

/// Why there are no files.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum SeriesError {
    /// No file, folder or pattern is given.
    #[error("`path` is empty: give a file, a folder or a pattern such as truth/*.pfm or truth/%04d.pfm")]
    Empty,
    /// The file does not exist.
    #[error("the file {path} does not exist", path = path.display())]
    Missing { path: PathBuf },
    /// No file matches a pattern or folder.
    #[error("no {what} matches {pattern}; {hint}", pattern = pattern.display())]
    NoMatch { what: &'static str, pattern: PathBuf, hint: PatternError },
    /// Numbers are missing in the series.
    #[error(
        "number(s) between {before} and {after} are missing, so the image of each {what} is unknown: name the images in `pictures`",
        before = before.display(),
        after = after.display()
    )]
    Gap { what: &'static str, before: PathBuf, after: PathBuf },
    /// No file belongs to any of the images.
    #[error(
        "no {what} has the name or the number of an image: {file} and {image} are the first of each",
        file = file.display(),
        image = image.display()
    )]
    Unpaired { what: &'static str, file: PathBuf, image: PathBuf },
}

/// The file that belongs to each image.
#[derive(Debug)]
pub struct Series {
    /// Kind of file, for messages.
    what: &'static str,
    /// Path by index of the image; `None` for an image without a file.
    files: Vec<Option<PathBuf>>,
    /// Whether one file belongs to every image.
    is_single: bool,
    is_end_reported: bool,
}

/// Matches files to `images` by name, else by number.
fn pair(what: &'static str, files: Vec<PathBuf>, images: &[PathBuf]) -> Result<Vec<Option<PathBuf>>, SeriesError> {
    let by_name: BTreeMap<_, _> = files.iter().map(|file| (file.file_stem(), file)).collect();
    let named: Vec<_> =
        images.iter().map(|image| by_name.get(&image.file_stem()).map(|file| (*file).clone())).collect();
    if named.iter().any(Option::is_some) {
        return Ok(named);
    }
    let found = matched(&[images.to_vec(), files]);
    let [shown, theirs] = found.views.as_slice() else { return Ok(named) };
    if !found.by_number {
        let first = |all: &[PathBuf]| all.first().cloned().unwrap_or_default();
        return Err(SeriesError::Unpaired { what, file: first(theirs), image: first(shown) });
    }
    let by_image: BTreeMap<_, _> = shown.iter().zip(theirs).collect();
    Ok(images.iter().map(|image| by_image.get(image).map(|file| (*file).clone())).collect())
}

impl Series {
    /// Opens `text` as `capture` reads its sources: a folder, a pattern with `*`, `?` or `%04d`, or a file; relative to `folder`. `images` names the
    /// images in the same way; without them the files must be numbered without gaps.
    ///
    /// # Errors
    /// See [`SeriesError`].
    pub fn open(
        (text, images): (&str, &str),
        folder: &Path,
        what: &'static str,
        fits: impl Fn(&Path) -> bool,
    ) -> Result<Self, SeriesError> {
        let text = text.trim();
        if text.is_empty() {
            return Err(SeriesError::Empty);
        }
        let (files, is_single) = list(text, folder, what, fits)?;
        let files = if is_single {
            files.into_iter().map(Some).collect()
        } else if images.trim().is_empty() {
            if let Some([before, after]) = gap(&files) {
                return Err(SeriesError::Gap { what, before: before.to_owned(), after: after.to_owned() });
            }
            files.into_iter().map(Some).collect()
        } else {
            pair(what, files, &list(images.trim(), folder, "image", is_image)?.0)?
        };
        Ok(Self { what, files, is_single, is_end_reported: false })
    }

    /// Index of the tick's image and its file, if there is one. `None` after the last image, unless `is_repeated`.
    pub fn of_tick(&mut self, cx: &Context<'_>, is_repeated: bool) -> Option<(usize, Option<&Path>)> {
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
                "image {} and later ones have no {}: only {count} exist, from {} on",
                number + 1,
                self.what,
                self.files().next().map_or_else(String::new, |file| file.display().to_string()),
            ));
        }
        self.files.get(index).map(|file| (index, file.as_deref()))
    }

    /// All files, in order.
    pub fn files(&self) -> impl Iterator<Item = &PathBuf> {
        self.files.iter().flatten()
    }
}

/// Files sorted by number, and whether `text` names a single file.
fn list(
    text: &str,
    folder: &Path,
    what: &'static str,
    fits: impl Fn(&Path) -> bool,
) -> Result<(Vec<PathBuf>, bool), SeriesError> {
    let path = std::path::absolute(folder.join(text)).unwrap_or_else(|_| folder.join(text));
    let pattern = match (path.is_dir(), path.exists()) {
        (true, _) => path.join("*"),
        (false, true) => return Ok((vec![path], true)),
        (false, false) if is_pattern(text) => path,
        (false, false) => return Err(SeriesError::Missing { path }),
    };
    let files = numbered_files(&pattern, what, fits);
    Ok((files.map_err(|hint| SeriesError::NoMatch { what, pattern, hint })?, false))
}
