//! A series of image files.

use std::path::{Path, PathBuf};

use super::decode::read;
use super::demands::Grab;
use super::error::CaptureError;
use super::picture::Picture;

/// Memory limit for decoded images that are shown repeatedly, bytes. Further files are read each time.
const RETAINED_BYTES: usize = 256 << 20;
/// Number of files that are read to find the bit depth of a series.
const PROBES: usize = 5;

/// Image files in order, and the position in them.
pub struct Images {
    files: Vec<PathBuf>,
    /// One file, shown as long as other views have frames.
    still: bool,
    next: usize,
    grabbed: usize,
    retained: Vec<Option<Picture>>,
    retained_bytes: usize,
}

impl Images {
    /// Shows `files` in order. With `is_repeated` decoded images stay in memory.
    pub fn new(files: Vec<PathBuf>, is_repeated: bool) -> Self {
        let retained = if is_repeated { vec![None; files.len()] } else { Vec::new() };
        Self { files, still: false, next: 0, grabbed: 0, retained, retained_bytes: 0 }
    }

    /// Shows one file repeatedly.
    pub fn still(file: PathBuf) -> Self {
        Self { still: true, ..Self::new(vec![file], true) }
    }

    /// Whether it is a single file, which has no end.
    pub fn is_still(&self) -> bool {
        self.still
    }

    /// Number of images grabbed: the index of the next one.
    pub fn grabbed(&self) -> u64 {
        self.next as u64
    }

    /// Number of images left.
    pub fn left(&self) -> u64 {
        self.files.len().saturating_sub(self.next) as u64
    }

    /// Advances to the next file.
    pub fn grab(&mut self) -> Grab {
        if self.still {
            self.next = 0;
        }
        if self.next >= self.files.len() {
            return Grab::End;
        }
        self.grabbed = self.next;
        self.next += 1;
        Grab::Ready(None)
    }

    /// The next file; `None` at the end.
    pub fn next_file(&self) -> Option<&Path> {
        self.files.get(self.next).map(PathBuf::as_path)
    }

    /// Continues at `file`, or at index `next` if that file no longer exists.
    pub fn go_to(&mut self, file: Option<&Path>, next: u64) {
        let here = file.and_then(|file| self.files.iter().position(|path| path == file));
        self.next = here.unwrap_or(usize::try_from(next).unwrap_or(usize::MAX)).min(self.files.len());
    }

    /// Reads the file that was grabbed.
    ///
    /// # Errors
    /// [`CaptureError::Unreadable`] with the file's name and number.
    pub fn retrieve(&mut self, out: &mut Picture) -> Result<(), CaptureError> {
        if let Some(Some(picture)) = self.retained.get(self.grabbed) {
            out.clone_from(picture);
            return Ok(());
        }
        let Some(path) = self.files.get(self.grabbed) else { return Ok(()) };
        let count = self.files.len();
        *out = read(path).map_err(|cause| CaptureError::Unreadable {
            path: path.clone(),
            place: if count > 1 { format!(" (image {} of {count})", self.grabbed + 1) } else { String::new() },
            cause,
        })?;
        if let Some(slot) = self.retained.get_mut(self.grabbed)
            && self.retained_bytes + out.bytes() <= RETAINED_BYTES
        {
            self.retained_bytes += out.bytes();
            *slot = Some(out.clone());
        }
        Ok(())
    }

    /// Maximum values of a few images spread over the series. Images of eight bits and damaged ones are left out.
    pub fn peaks(&self) -> Vec<f32> {
        let count = self.files.len();
        let probes = count.min(PROBES);
        let files = (0..probes).filter_map(|probe| self.files.get((2 * probe + 1) * count / (2 * probes)));
        files.filter_map(|path| read(path).ok()?.peak()).collect()
    }
}
