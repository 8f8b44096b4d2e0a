//! Files of a procedure as objects of a study.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::dicom::entry::Entry;
use crate::dicom::error::{DicomError, Result};
use crate::dicom::object::{Clip, Group, Lengths, Region, Report, Still, Study};
use crate::dicom::part10::Pending;

/// Extensions of exported stills.
const STILLS: [&str; 5] = ["png", "jpg", "jpeg", "tif", "tiff"];
const CLIPS: [&str; 5] = ["mkv", "mp4", "mov", "webm", "avi"];
const LENGTHS: [&str; 1] = ["jsonl"];
/// Maximum number of files of one export.
const MAX_FILES: usize = 10_000;

/// Kind of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A still image.
    Still,
    /// A video.
    Clip,
    /// A table of measurements.
    Lengths,
}

impl Kind {
    /// Kind of a file by its extension; `None` for files that are not exported.
    pub fn of(file: &Path) -> Option<Self> {
        let ending = file.extension()?.to_str()?.to_ascii_lowercase();
        [(&STILLS[..], Self::Still), (&CLIPS, Self::Clip), (&LENGTHS, Self::Lengths)]
            .into_iter()
            .find_map(|(endings, kind)| endings.contains(&ending.as_str()).then_some(kind))
    }
}

/// A file to be exported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Input {
    /// The file.
    pub file: PathBuf,
    /// Kind of the file.
    pub kind: Kind,
}

/// The files to export: the named files and those in named folders; sorted, without duplicates.
///
/// # Errors
/// A named file cannot be exported, or a folder cannot be read or has none.
pub fn inputs(named: &[PathBuf]) -> Result<Vec<Input>> {
    let mut all = BTreeMap::new();
    for path in named {
        let wrong = |problem: &str| DicomError::Input { file: path.clone(), problem: problem.to_owned() };
        if !path.is_dir() {
            let help =
                "stills end in .png, .jpg or .tif, clips in .mkv, .mp4, .mov, .webm or .avi, measurements in .jsonl";
            let kind = Kind::of(path).ok_or_else(|| wrong(help))?;
            all.insert(path.clone(), kind);
            continue;
        }
        let failed = |cause| DicomError::Read { file: path.clone(), cause };
        let before = all.len();
        for entry in std::fs::read_dir(path).map_err(failed)? {
            let file = entry.map_err(failed)?.path();
            let is_hidden = file.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
            let Some(kind) = Kind::of(&file).filter(|_| !is_hidden && file.is_file()) else { continue };
            // A folder may hold tables of other things.
            if kind != Kind::Lengths || Lengths::has_any(&file)? {
                all.insert(file, kind);
            }
        }
        if all.len() == before {
            return Err(wrong("it has no stills, clips or measurements"));
        }
    }
    if all.len() > MAX_FILES {
        let problem = format!("{} files; {MAX_FILES} are the most at once", all.len());
        return Err(DicomError::Input { file: named.first().cloned().unwrap_or_default(), problem });
    }
    Ok(all.into_iter().map(|(file, kind)| Input { file, kind }).collect())
}

/// Makes an object from each file, and one report from all measurements, in `folder`. `mp4_of` gives the MP4 file of a
/// clip.
///
/// All objects appear together at the end. Objects of one study and the same content have the same UID, whenever they
/// are exported.
///
/// # Errors
/// A file cannot be exported, or the disk is full: then nothing is exported.
pub fn wrap(
    entry: &Entry,
    region: Region,
    inputs: &[Input],
    folder: &Path,
    mut mp4_of: impl FnMut(&Path) -> Result<PathBuf>,
) -> Result<Vec<PathBuf>> {
    let study = Study { entry, region };
    let mut pending: Vec<Pending> = Vec::new();
    let mut pictures = BTreeMap::new();
    let mut groups = Vec::new();
    let of_kind = |kind| inputs.iter().filter(move |input| input.kind == kind).zip(1u32..);
    for (input, number) in of_kind(Kind::Still) {
        let still = Still::open(&input.file)?;
        let (class, instance) = still.reference(&study);
        pictures.insert(input.file.clone(), (class.to_owned(), instance, study.stills()));
        pending.push(still.write(&study, number, folder)?);
    }
    for (input, number) in of_kind(Kind::Clip) {
        let mp4 = mp4_of(&input.file)?;
        pending.push(Clip::open(&mp4, &input.file)?.write(&study, number, folder)?);
    }
    for (input, _) in of_kind(Kind::Lengths) {
        let lengths = Lengths::open(&input.file)?;
        let picture = lengths.picture.as_ref().and_then(|name| pictures.get(&input.file.with_file_name(name)));
        groups.push(Group { picture: picture.cloned(), lengths });
    }
    if !groups.is_empty() {
        pending.push(Report { groups }.write(&study, folder)?);
    }
    pending.into_iter().map(Pending::keep).collect()
}
