//! COCO: one JSON file for all images.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::{MAX_PIXELS, Picture, Truth, outlined};
use crate::error::{Context, FileAction, OnFile, Result, bail};
use panoscope_imaging::detect::Mask;
use panoscope_imaging::detect::Object;

#[derive(Deserialize)]
struct File {
    images: Vec<Image>,
    #[serde(default)]
    annotations: Vec<Annotation>,
    #[serde(default)]
    categories: Vec<Category>,
}

#[derive(Deserialize)]
struct Image {
    id: u64,
    file_name: String,
    width: usize,
    height: usize,
}

#[derive(Deserialize)]
struct Category {
    id: u64,
    name: String,
}

/// An annotation, of the ground truth, or of detections written by the node `write_table`.
#[derive(Deserialize)]
pub struct Annotation {
    /// Number of the image.
    pub image_id: u64,
    /// Number of the class.
    pub category_id: u64,
    /// Left, top, width, height.
    pub bbox: [f64; 4],
    /// Outline.
    #[serde(default)]
    pub segmentation: Option<Segmentation>,
    #[serde(default)]
    iscrowd: u8,
    /// Certainty.
    #[serde(default)]
    pub score: f64,
}

#[derive(Deserialize)]
#[serde(untagged)]
pub enum Segmentation {
    Runs { size: [usize; 2], counts: Vec<u64> },
    Packed { size: [usize; 2], counts: String },
    Polygons(Vec<Vec<f64>>),
}

impl Segmentation {
    /// The mask in an image of `width` x `height` px.
    pub fn mask(&self, width: usize, height: usize) -> Result<Mask> {
        // Compared before a mask of that size is made.
        if let Self::Runs { size, .. } | Self::Packed { size, .. } = self
            && *size != [height, width]
        {
            bail!("a mask of {}x{} px belongs to an image of {width}x{height} px", size[1], size[0]);
        }
        let mask = match self {
            Self::Runs { counts, .. } => Mask::from_runs(width, height, counts),
            Self::Packed { counts, .. } => Mask::from_packed(width, height, counts),
            Self::Polygons(lists) => {
                let mut mask = Mask::new(width, height);
                for list in lists {
                    let points: Vec<[f64; 2]> = list.chunks_exact(2).map(|p| [p[0], p[1]]).collect();
                    mask.add_polygon(&points);
                }
                Some(mask)
            }
        };
        mask.context("the run lengths do not cover the image")
    }
}

/// Content of a file of found boxes: per image id its annotations, and the class names by id.
pub struct FoundFile {
    /// By image.
    pub by_image: BTreeMap<u64, Vec<Annotation>>,
    /// By class.
    pub names: BTreeMap<u64, String>,
}

/// Reads a file that `write_table` wrote.
pub fn read_found(path: &Path) -> Result<FoundFile> {
    let file = parse(path)?;
    let mut by_image: BTreeMap<u64, Vec<Annotation>> = file.images.iter().map(|i| (i.id, Vec::new())).collect();
    for a in file.annotations {
        by_image.entry(a.image_id).or_default().push(a);
    }
    Ok(FoundFile { by_image, names: file.categories.into_iter().map(|c| (c.id, c.name)).collect() })
}

fn parse(path: &Path) -> Result<File> {
    let text = std::fs::read_to_string(path).on_file(FileAction::Read, path)?;
    serde_json::from_str(&text).with_context(|| format!("{} is neither a COCO nor a VIA file", path.display()))
}

/// Reads the ground truth; each image is in the first of `folders` that has it.
pub fn read(path: &Path, folders: &[PathBuf]) -> Result<Truth> {
    let file = parse(path)?;
    let mut truth = Truth::default();
    let classes: BTreeMap<u64, usize> = file.categories.iter().map(|c| (c.id, truth.class(&c.name))).collect();
    let mut place = BTreeMap::new();
    for image in file.images {
        let Some(picture) = folders.iter().map(|folder| folder.join(&image.file_name)).find(|file| file.is_file())
        else {
            bail!("{} names {}, which is not in {}", path.display(), image.file_name, folders[0].display());
        };
        if image.width.checked_mul(image.height).is_none_or(|n| n == 0 || n as u64 > MAX_PIXELS) {
            bail!("{}: {} of {}x{} px", path.display(), image.file_name, image.width, image.height);
        }
        place.insert(image.id, truth.pictures.len());
        let (width, height) = (image.width, image.height);
        truth.pictures.push(Picture { path: picture, width, height, objects: Vec::new() });
    }
    for a in file.annotations {
        let (Some(&at), Some(&class)) = (place.get(&a.image_id), classes.get(&a.category_id)) else {
            bail!(
                "{}: an annotation refers to image {} and category {}, which the file does not list",
                path.display(),
                a.image_id,
                a.category_id
            );
        };
        let picture = &mut truth.pictures[at];
        let ignored = a.iscrowd != 0;
        let object = match &a.segmentation {
            Some(shape) => {
                let mask = shape
                    .mask(picture.width, picture.height)
                    .with_context(|| format!("{}: {}", path.display(), picture.path.display()))?;
                outlined(class, mask, ignored).map(|o| Object { bbox: a.bbox, ..o })
            }
            None => Some(Object { class, bbox: a.bbox, mask: None, ignored }),
        };
        picture.objects.extend(object);
    }
    Ok(truth)
}
