//! VOC: one XML file per image, lists of names in `ImageSets`.

use std::path::Path;

use super::{Picture, Truth, files, picture_called, size_of};
use panoscope_data::truth::labels;
use panoscope_imaging::detect::Object;

use crate::error::{Context, FileAction, OnFile, Result, bail};
use crate::session::{Session, note};

pub fn read(session: &dyn Session, folder: &Path, split: Option<&str>) -> Result<Truth> {
    let annotations = folder.join("Annotations");
    let names: Vec<String> = match split {
        None => files(&annotations, &["xml"])
            .iter()
            .filter_map(|f| Some(f.file_stem()?.to_string_lossy().into_owned()))
            .collect(),
        Some(split) => {
            let places = [folder.join("ImageSets"), folder.join("ImageSets/Main")];
            let list = places.iter().map(|p| p.join(format!("{split}.txt"))).find(|f| f.is_file());
            let list = list.with_context(|| format!("{} has no ImageSets/{split}.txt", folder.display()))?;
            let text = std::fs::read_to_string(&list).on_file(FileAction::Read, &list)?;
            text.lines().filter_map(|l| l.split_whitespace().next()).map(str::to_owned).collect()
        }
    };
    let pictures = [folder.join("JPEGImages"), annotations.clone(), folder.to_owned()];
    let mut truth = Truth::default();
    // Fixes the order of the classes and names those that no picture shows.
    if let Ok(list) = std::fs::read_to_string(folder.join("class_list.txt")) {
        for line in list.lines() {
            if let Some(name) = line.split_whitespace().last() {
                truth.class(name);
            }
        }
    }
    let mut absent = 0;
    for name in &names {
        let file = annotations.join(format!("{name}.xml"));
        let Some(path) = picture_called(&pictures, name).filter(|_| file.is_file()) else {
            absent += 1;
            continue;
        };
        let text = std::fs::read_to_string(&file).on_file(FileAction::Read, &file)?;
        let picture =
            one(&mut truth, &text, path).with_context(|| format!("{} is not a VOC annotation", file.display()))?;
        truth.pictures.push(picture);
    }
    if absent > 0 {
        note!(session, "{}: {absent} of {} named pictures are not there", folder.display(), names.len());
    }
    if truth.pictures.is_empty() {
        bail!("{} has no image with an annotation", folder.display());
    }
    Ok(truth)
}

fn one(truth: &mut Truth, text: &str, path: std::path::PathBuf) -> Result<Picture> {
    let found = labels::voc(text)?;
    let (width, height) = size_of(&path)?;
    // Boxes are in px of the size that the file names, which need not be the picture's any more.
    let scale = |declared: Option<f64>, real: usize| declared.map_or(1.0, |declared| real as f64 / declared);
    let (sx, sy) = (scale(found.size[0], width), scale(found.size[1], height));
    let mut objects = Vec::new();
    for object in found.objects {
        let [x0, y0, x1, y1] = object.corners;
        let bbox = [x0 * sx, y0 * sy, (x1 - x0) * sx, (y1 - y0) * sy];
        if bbox.iter().any(|px| !px.is_finite()) {
            bail!("the <bndbox> of `{}` has an infinite size", object.name);
        }
        let class = truth.class(&object.name);
        objects.push(Object { class, bbox, mask: None, ignored: object.is_difficult });
    }
    Ok(Picture { path, width, height, objects })
}
