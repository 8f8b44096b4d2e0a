//! True boxes and outlines in common formats: VOC XML, COCO JSON, labelme JSON, VIA JSON, YOLO text.

mod coco;
mod labelme;
mod via;
mod voc;
mod yolo_text;

use std::path::{Path, PathBuf};

use panoscope_imaging::detect::{Mask, Object};

use crate::error::{FileAction, OnFile, Result, bail};
use crate::session::Session;

pub use coco::read_found;
pub use panoscope_imaging::detect::normal_name;

/// An image with its objects.
#[derive(Clone, Debug)]
pub struct Picture {
    /// The file.
    pub path: PathBuf,
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Objects in the image.
    pub objects: Vec<Object>,
}

impl Picture {
    /// Name without folder and extension.
    pub fn stem(&self) -> String {
        self.path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned())
    }

    /// The operation it comes from: the text before the last underscore of its name, `v02` of `v02_001250`.
    pub fn operation(&self) -> String {
        let stem = self.stem();
        stem.rsplit_once('_').map_or(stem.clone(), |(operation, _)| operation.to_owned())
    }
}

/// Images and the classes that their truth names.
#[derive(Clone, Debug, Default)]
pub struct Truth {
    /// Class names, normalised.
    pub classes: Vec<String>,
    /// Images in order.
    pub pictures: Vec<Picture>,
}

impl Truth {
    /// Number of a class, new ones at the end.
    fn class(&mut self, name: &str) -> usize {
        let name = normal_name(name);
        self.classes.iter().position(|c| *c == name).unwrap_or_else(|| {
            self.classes.push(name);
            self.classes.len() - 1
        })
    }

    /// Absolute paths of the images, one per line, as `capture` accepts them.
    pub fn file_list(&self) -> String {
        let absolute = |p: &PathBuf| std::path::absolute(p).unwrap_or_else(|_| p.clone());
        self.pictures.iter().map(|p| format!("{}\n", absolute(&p.path).to_string_lossy())).collect()
    }

    /// Whether any object has an outline.
    pub fn has_masks(&self) -> bool {
        self.pictures.iter().any(|p| p.objects.iter().any(|o| o.mask.is_some()))
    }

    /// Only the images of these operations.
    pub fn only(&self, operations: &[String]) -> Self {
        let wanted = |p: &&Picture| operations.contains(&p.operation());
        Self { classes: self.classes.clone(), pictures: self.pictures.iter().filter(wanted).cloned().collect() }
    }

    /// Reorders the classes: those in `order` first, if present, then the others by name.
    pub fn ordered(mut self, order: &[String]) -> Self {
        let mut classes: Vec<String> = order.iter().map(|name| normal_name(name)).collect();
        let mut others: Vec<String> = self.classes.iter().filter(|c| !classes.contains(c)).cloned().collect();
        others.sort();
        classes.extend(others);
        let place: Vec<usize> = self.classes.iter().map(|c| classes.iter().position(|o| o == c).unwrap_or(0)).collect();
        for object in self.pictures.iter_mut().flat_map(|p| &mut p.objects) {
            object.class = place[object.class];
        }
        self.classes = classes;
        self
    }
}

/// Width and height of an image file.
fn size_of(path: &Path) -> Result<(usize, usize)> {
    let (w, h) = image::image_dimensions(path).on_file(FileAction::Read, path)?;
    if u64::from(w) * u64::from(h) > MAX_PIXELS {
        bail!("{}: {w}x{h} px exceed the limit of {MAX_PIXELS} px", path.display());
    }
    Ok((w as usize, h as usize))
}

/// The images of a folder, by name, without objects.
pub fn sizes_of(folder: &Path) -> Result<Vec<Picture>> {
    let pictures = files(folder, &PICTURES).into_iter().map(|path| {
        let (width, height) = size_of(&path)?;
        Ok(Picture { path, width, height, objects: Vec::new() })
    });
    pictures.collect()
}

/// Maximum number of pixels of an image; a mask has a bit for each.
const MAX_PIXELS: u64 = 1 << 28;

const PICTURES: [&str; 5] = ["jpg", "jpeg", "png", "JPG", "PNG"];

/// The image called `stem` in the first of `folders` that has one.
fn picture_called(folders: &[PathBuf], stem: &str) -> Option<PathBuf> {
    let all = folders.iter().flat_map(|f| PICTURES.iter().map(move |e| f.join(format!("{stem}.{e}"))));
    all.into_iter().find(|p| p.is_file())
}

/// Files of a folder with one of these extensions, by name.
fn files(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let has = |p: &PathBuf| p.extension().is_some_and(|e| endings.iter().any(|w| e.eq_ignore_ascii_case(w)));
    let mut found: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(has).collect();
    found.sort();
    found
}

/// One file for all images: of VIA, or of COCO with images in one of `folders`.
fn one_file(path: &Path, folders: &[PathBuf]) -> Result<Truth> {
    let text = std::fs::read_to_string(path).on_file(FileAction::Read, path)?;
    let value: Option<serde_json::Value> = serde_json::from_str(&text).ok();
    match value.as_ref().and_then(via::pictures) {
        Some(pictures) => via::read(path, pictures, &folders[0]),
        None => coco::read(path, folders),
    }
}

/// The COCO or VIA file of a folder: under the names of COCO, Roboflow, CVAT and `eval` itself.
fn file_in(folder: &Path, split: Option<&str>) -> Option<PathBuf> {
    let names = match split {
        Some(s) => vec![
            format!("{s}.json"),
            format!("{s}/_annotations.coco.json"),
            format!("{s}/annotations.json"),
            format!("annotations/instances_{s}.json"),
            format!("annotations/{s}.json"),
        ],
        None => ["annotations.json", "_annotations.coco.json", "annotations/instances_default.json"]
            .map(str::to_owned)
            .into(),
    };
    names.iter().map(|name| folder.join(name)).find(|file| file.is_file())
}

/// Reads `path` in any of the formats. `split` selects a list of VOC, COCO or YOLO; `None` for all.
///
/// # Errors
/// There is no ground truth, it is damaged, or it has no image or no object at all.
pub fn read(session: &dyn Session, path: &Path, split: Option<&str>, images: Option<&Path>) -> Result<Truth> {
    let truth = read_any(session, path, split, images)?;
    if truth.pictures.iter().all(|picture| picture.objects.is_empty()) {
        bail!(
            "{}: no labelled object in {} images; are the labels in another folder?",
            path.display(),
            truth.pictures.len()
        );
    }
    Ok(truth)
}

fn read_any(session: &dyn Session, path: &Path, split: Option<&str>, images: Option<&Path>) -> Result<Truth> {
    if path.is_file() {
        let folder = images.or(path.parent()).unwrap_or(Path::new(""));
        return one_file(path, &[folder.to_owned(), folder.join("images")]);
    }
    if !path.is_dir() {
        bail!("{} does not exist: give a COCO or VIA file, or a folder of VOC, labelme or YOLO files", path.display());
    }
    let annotations = path.join("Annotations");
    if annotations.is_dir() {
        return voc::read(session, path, split);
    }
    if let Some(file) = file_in(path, split) {
        let mut folders = vec![images.unwrap_or(path).to_owned()];
        folders.push(folders[0].join("images"));
        for folder in split.into_iter().flat_map(|s| [path.join(s), path.join("images").join(s)]) {
            folders.push(folder);
        }
        return one_file(&file, &folders);
    }
    if yolo_text::folder_of(path, "labels", split).is_dir() || yolo_text::folder_of(path, "images", split).is_dir() {
        return yolo_text::read(path, split);
    }
    let polygons = [path.to_owned(), path.join("ann_dir")].into_iter().find(|f| !files(f, &["json"]).is_empty());
    if let Some(folder) = polygons {
        return labelme::read(&folder, images);
    }
    bail!(
        "{}: no Annotations/ (VOC), no SPLIT.json, annotations.json or _annotations.coco.json (COCO, VIA), no labels/ (YOLO) and no labelme files in it",
        path.display()
    )
}

/// An object from an outline; `None` if the outline has no pixel.
fn outlined(class: usize, mask: Mask, ignored: bool) -> Option<Object> {
    (mask.area > 0).then(|| Object { class, bbox: mask.bounds(), mask: Some(mask), ignored })
}

#[cfg(test)]
mod tests;
