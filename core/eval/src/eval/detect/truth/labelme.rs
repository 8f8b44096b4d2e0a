//! labelme: one JSON file per image, with polygons. Polygons of one label and one `group_id` are one object.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::{PICTURES, Picture, Truth, files, outlined, size_of};
use crate::error::{Context, FileAction, OnFile, Result, bail};
use panoscope_imaging::detect::Mask;

#[derive(Deserialize)]
struct File {
    #[serde(rename = "imagePath", default)]
    image_path: String,
    shapes: Vec<Shape>,
}

#[derive(Deserialize)]
struct Shape {
    label: String,
    points: Vec<[f64; 2]>,
    #[serde(default)]
    group_id: Option<i64>,
    #[serde(default)]
    shape_type: String,
}

/// The image of a file: by the path in it, or by the file's own name in nearby folders.
fn picture_of(file: &Path, named: &str, images: Option<&Path>) -> Option<PathBuf> {
    let folder = file.parent().unwrap_or(Path::new(""));
    let stem = file.file_stem()?.to_string_lossy().into_owned();
    let named = Path::new(named);
    let mut places = Vec::new();
    if let Some(images) = images {
        places.extend(named.file_name().map(|n| images.join(n)));
        places.extend(PICTURES.iter().map(|e| images.join(format!("{stem}.{e}"))));
    }
    if !named.as_os_str().is_empty() {
        places.push(folder.join(named));
        places.push(folder.join("..").join(named));
    }
    for near in [folder.to_owned(), folder.join("../img_dir"), folder.join("../images")] {
        places.extend(PICTURES.iter().map(|e| near.join(format!("{stem}.{e}"))));
    }
    places.into_iter().find(|p| p.is_file())
}

pub fn read(folder: &Path, images: Option<&Path>) -> Result<Truth> {
    let mut truth = Truth::default();
    for path in files(folder, &["json"]) {
        let text = std::fs::read_to_string(&path).on_file(FileAction::Read, &path)?;
        let file: File =
            serde_json::from_str(&text).with_context(|| format!("{} is not a labelme file", path.display()))?;
        let Some(picture) = picture_of(&path, &file.image_path, images) else {
            bail!("the image of {} ({}) is missing: give its folder with --images", path.display(), file.image_path);
        };
        let (width, height) = size_of(&picture)?;
        let mut groups: Vec<(usize, Option<i64>, Mask)> = Vec::new();
        for shape in file.shapes {
            let corners = match (shape.shape_type.as_str(), &shape.points[..]) {
                ("" | "polygon", [_, _, _, ..]) => shape.points,
                ("rectangle", [a, b]) => vec![*a, [b[0], a[1]], *b, [a[0], b[1]]],
                // Lines and points have no area.
                _ => continue,
            };
            let class = truth.class(&shape.label);
            let known = groups.iter_mut().find(|g| g.0 == class && shape.group_id.is_some() && g.1 == shape.group_id);
            if let Some((_, _, mask)) = known {
                mask.add_polygon(&corners);
            } else {
                let mut mask = Mask::new(width, height);
                mask.add_polygon(&corners);
                groups.push((class, shape.group_id, mask));
            }
        }
        let objects = groups.into_iter().filter_map(|(class, _, mask)| outlined(class, mask, false)).collect();
        truth.pictures.push(Picture { path: picture, width, height, objects });
    }
    Ok(truth)
}
