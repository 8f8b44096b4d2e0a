//! Folder layouts of public data sets: which images, calibration, ground truth and labels belong together.
//!
//! [`find`] searches a folder and lists its [`Sequence`]s; nothing is unpacked and no image is decoded. Files are
//! read later: calibrations by [`CalibrationFiles::read`], maps, points, masks and boxes by `crate::truth`. Each file
//! in `layouts` describes one data set and names its source. This module does not know graphs.

#![forbid(unsafe_code)]

mod error;
mod folder;
mod layouts;
mod picture_size;
mod sequence;

use std::path::Path;

use crate::calibration::pictures::natural_order;
pub use error::DataSetError;
use folder::Folder;
pub use layouts::{KNOWN, Known};
pub use sequence::{CalibrationFiles, Holds, Labels, MaskFile, MaskLayer, Masks, Pictures, Sequence, Stacked, Truth};

/// Levels of folders below the given one that are searched: archives often add a folder with the name of the data set.
pub const MAX_LEVELS: usize = 4;
/// Maximum number of folders that are searched.
const MAX_FOLDERS: usize = 20_000;
/// Maximum number of packed files in a remark.
const LISTED: usize = 5;

/// Content of a folder.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// The sequences, in the order of their names.
    pub sequences: Vec<Sequence>,
    /// Obstacles to finding more.
    pub remarks: Vec<String>,
    /// Number of folders that were searched.
    pub folders: usize,
}

impl Found {
    /// The sequence of a name; the first one for an empty name.
    ///
    /// # Errors
    /// There is none of that name, or none at all.
    pub fn sequence(&self, folder: &Path, name: &str) -> Result<&Sequence, DataSetError> {
        let Some(first) = self.sequences.first() else {
            return Err(DataSetError::Nothing {
                folder: folder.to_owned(),
                known: layouts::names(),
                remarks: self.remarks.clone(),
            });
        };
        let name = name.trim().trim_matches('/');
        if name.is_empty() {
            return Ok(first);
        }
        self.sequences.iter().find(|sequence| sequence.name == name).ok_or_else(|| DataSetError::NoSequence {
            folder: folder.to_owned(),
            name: name.to_owned(),
            names: self.sequences.iter().map(|sequence| sequence.name.clone()).collect(),
        })
    }
}

/// Lists the sequences of all known layouts at a folder and up to [`MAX_LEVELS`] levels below.
///
/// A folder that a layout claims is not searched further. Hidden folders are skipped.
///
/// # Errors
/// The folder does not exist or cannot be read. A folder without any known layout is not an error.
pub fn find(folder: &Path) -> Result<Found, DataSetError> {
    if !folder.is_dir() {
        return Err(DataSetError::NoFolder { path: folder.to_owned() });
    }
    let mut found = Found::default();
    let mut packed = Vec::new();
    let mut level = vec![Folder::read(folder, String::new())?];
    for depth in 0..=MAX_LEVELS {
        let mut below = Vec::new();
        for folder in &level {
            found.folders += 1;
            packed.extend(folder.archives());
            if layouts::claim(folder, &mut found.sequences) || depth == MAX_LEVELS {
                continue;
            }
            for inner in folder.folders() {
                if found.folders + below.len() >= MAX_FOLDERS {
                    break;
                }
                match Folder::read(&folder.at(inner), folder.name_of(inner)) {
                    Ok(inner) => below.push(inner),
                    Err(error) => found.remarks.push(error.to_string()),
                }
            }
        }
        level = below;
    }
    if found.folders >= MAX_FOLDERS {
        found.remarks.push(format!("only the first {MAX_FOLDERS} folders were searched: name a folder further down"));
    }
    if !packed.is_empty() {
        let more = if packed.len() > LISTED { format!(" and {} more", packed.len() - LISTED) } else { String::new() };
        packed.sort();
        packed.truncate(LISTED);
        found.remarks.push(format!("packed files are not read, unpack them: {}{more}", packed.join(", ")));
    }
    found.sequences.sort_by_cached_key(|sequence| natural_order(&sequence.name));
    Ok(found)
}
