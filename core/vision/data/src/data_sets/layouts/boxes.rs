//! Images with boxes: m2cai16-tool-locations (Jin et al., "Tool detection and operative skill assessment in surgical
//! videos", 2018) and other sets in the layouts of Pascal VOC and YOLO.
//!
//! ```text
//! VOC   JPEGImages/v01_002075.jpg, Annotations/v01_002075.xml
//!       ImageSets/train.txt, or ImageSets/Main/train.txt: names without extension; each list is also a sequence
//!       class_list.txt: "1 Grasper" (m2cai16-tool-locations)
//! YOLO  images/NAME.jpg, labels/NAME.txt; or images/train, labels/train; classes.txt or data.yaml
//! ```

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::truth::labels::yolo_names;

use crate::data_sets::folder::{Folder, files_in, matching, stem};
use crate::data_sets::sequence::{Labels, Sequence};

fn has_ending(path: &Path, ending: &str) -> bool {
    path.extension().is_some_and(|own| own.eq_ignore_ascii_case(ending))
}

/// A sequence of images with the labels of their names.
fn sequence(
    data_set: &'static str,
    name: String,
    folder: &Folder,
    pictures: Vec<PathBuf>,
    labels: &[PathBuf],
    classes: &[String],
) -> Sequence {
    let files = matching(&pictures, labels);
    let missing = files.iter().filter(|file| file.is_none()).count();
    let mut sequence = Sequence::of_files(data_set, name, &folder.path, pictures, Vec::new());
    if missing > 0 {
        sequence.remarks.push(format!("{missing} pictures without a file of labels count as empty"));
    }
    sequence.labels = Some(Labels::Boxes { files, classes: classes.to_vec() });
    sequence
}

/// Names of `class_list.txt`: a number and a name per line.
fn class_list(folder: &Folder) -> Option<Vec<String>> {
    let text = std::fs::read_to_string(folder.first(&["class_list.txt"])?).ok()?;
    let name = |line: &str| line.trim().split_once(char::is_whitespace).map(|(_, name)| name.trim().to_owned());
    Some(text.lines().filter_map(name).collect())
}

fn voc(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    let pictures = folder.pictures("JPEGImages");
    let labels = files_in(&folder.at("Annotations"), |path| has_ending(path, "xml"));
    if pictures.is_empty() || labels.is_empty() {
        return false;
    }
    let classes = class_list(folder);
    let data_set = if classes.is_some() { "m2cai16-tool-locations" } else { "VOC" };
    let classes = classes.unwrap_or_default();
    let lists = folder.at("ImageSets");
    let is_list = |path: &Path| has_ending(path, "txt");
    for list in files_in(&lists, is_list).into_iter().chain(files_in(&lists.join("Main"), is_list)) {
        let Ok(text) = std::fs::read_to_string(&list) else { continue };
        let names: BTreeSet<&str> = text.lines().filter_map(|line| line.split_whitespace().next()).collect();
        let listed: Vec<PathBuf> =
            pictures.iter().filter(|file| names.contains(stem(file).as_str())).cloned().collect();
        if !listed.is_empty() {
            let name = format!("{}/{}", folder.sequence_name(), stem(&list));
            sequences.push(sequence(data_set, name, folder, listed, &labels, &classes));
        }
    }
    sequences.push(sequence(data_set, folder.sequence_name(), folder, pictures, &labels, &classes));
    true
}

fn yolo(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    let is_labels = |path: &Path| has_ending(path, "txt") && path.file_name().is_none_or(|name| name != "classes.txt");
    let Some(images) = folder.inner("images").filter(|_| folder.has_folder("labels")) else { return false };
    let classes: Vec<String> = [folder.at("labels"), folder.path.clone()]
        .iter()
        .map(|folder| yolo_names(folder))
        .find(|names| !names.is_empty())
        .unwrap_or_default();
    let before = sequences.len();
    for split in std::iter::once("").chain(images.folders()) {
        let (pictures, labels) = (images.pictures(split), files_in(&folder.at("labels").join(split), is_labels));
        if !pictures.is_empty() && !labels.is_empty() {
            let own = folder.sequence_name();
            let name = if split.is_empty() { own } else { format!("{own}/{split}") };
            sequences.push(sequence("YOLO", name, folder, pictures, &labels, &classes));
        }
    }
    sequences.len() > before
}

/// Adds the sequences of a folder; see [`super::Known`].
pub(super) fn claim(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    voc(folder, sequences) || yolo(folder, sequences)
}
