//! YOLO: `images/SPLIT`, `labels/SPLIT/NAME.txt` (Ultralytics) or `SPLIT/images`, `SPLIT/labels/NAME.txt` (Roboflow)
//! with class, centre and size in shares of the image, or class and a polygon; names in `data.yaml`, `classes.txt` or
//! numbers.

use std::path::{Path, PathBuf};

use super::{Picture, Truth, files, outlined, size_of};
use panoscope_data::truth::labels::{self, LabelError, YoloShape};
use panoscope_imaging::detect::{Mask, Object};

use crate::error::{EvalError, FileAction, OnFile, Result, bail};

/// Folder of the `images` or `labels` of a split.
pub fn folder_of(folder: &Path, kind: &str, split: Option<&str>) -> PathBuf {
    let Some(split) = split else { return folder.join(kind) };
    let inside = folder.join(split).join(kind);
    if inside.is_dir() { inside } else { folder.join(kind).join(split) }
}

pub fn read(folder: &Path, split: Option<&str>) -> Result<Truth> {
    let part = |kind: &str| folder_of(folder, kind, split);
    let pictures = files(&part("images"), &["jpg", "jpeg", "png"]);
    if pictures.is_empty() {
        bail!("{} has no images; choose a subfolder with --split", part("images").display());
    }
    let mut truth = Truth::default();
    let names = labels::yolo_names(folder);
    for name in &names {
        truth.class(name);
    }
    for path in pictures {
        let (width, height) = size_of(&path)?;
        let (w, h) = (width as f64, height as f64);
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let label = part("labels").join(format!("{stem}.txt"));
        let mut objects = Vec::new();
        // A picture without a file of labels shows nothing.
        let text = if label.is_file() {
            std::fs::read_to_string(&label).on_file(FileAction::Read, &label)?
        } else {
            String::new()
        };
        let wrong = |error: LabelError| match error {
            LabelError::Line { line } | LabelError::NoShare { line, .. } => {
                EvalError::Input { reason: format!("{}:{line}: {error}", label.display()) }
            }
            other => other.into(),
        };
        for object in labels::yolo(&text).map_err(wrong)? {
            let name = match names.get(object.class) {
                Some(name) => name.clone(),
                None if names.is_empty() => format!("class {}", object.class),
                None => bail!(
                    "{}:{}: class {}, but data.yaml or classes.txt names {} classes, from 0",
                    label.display(),
                    object.line,
                    object.class,
                    names.len()
                ),
            };
            let class = truth.class(&name);
            match &object.shape {
                YoloShape::Box([x, y, bw, bh]) => {
                    let bbox = [x * w, y * h, bw * w, bh * h];
                    if bbox.iter().any(|px| !px.is_finite()) {
                        bail!("{}:{}: the box has an infinite size", label.display(), object.line);
                    }
                    objects.push(Object { class, bbox, mask: None, ignored: false });
                }
                YoloShape::Polygon(points) => {
                    let points: Vec<[f64; 2]> = points.iter().map(|p| [p[0] * w, p[1] * h]).collect();
                    let mut mask = Mask::new(width, height);
                    mask.add_polygon(&points);
                    objects.extend(outlined(class, mask, false));
                }
            }
        }
        truth.pictures.push(Picture { path, width, height, objects });
    }
    Ok(truth)
}
