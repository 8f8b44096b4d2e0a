//! Detections in the held-out operations, in the format of the training script.
//!
//! `foldN.json` of a folder: `{"format": "panoscope-predictions-1", "fold": "N", "held_out": [operations],
//! "trained_on": [operations], "classes": [names], "network": {anything}, "frames": {"v01_002075": [[class, score, x0,
//! y0, x1, y1, objectness], ...], ...}}`. Class is an index into `classes`, score 0..1, boxes in px of the stored
//! image; objectness, 0..1, may be missing. Each frame of the held-out operations is there.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::super::truth::{Truth, normal_name};
use super::file::Folds;
use crate::error::{Context, FileAction, OnFile, Result, bail, ensure};
use panoscope_imaging::detect::Find;

const FORMAT: &str = "panoscope-predictions-1";

#[derive(Deserialize)]
struct File {
    format: String,
    fold: String,
    held_out: Vec<String>,
    trained_on: Vec<String>,
    classes: Vec<String>,
    frames: BTreeMap<String, Vec<Vec<f64>>>,
}

/// Content of a file, per image.
#[derive(Clone, Debug)]
pub struct Predicted {
    /// Finds; class numbers are those of the ground truth.
    pub finds: Vec<Vec<Find>>,
    /// Objectness of each find by the network; NaN if it was not stored.
    pub objectness: Vec<Vec<f64>>,
}

/// The file of a fold.
pub fn path_of(folder: &Path, fold: &str) -> PathBuf {
    folder.join(format!("fold{fold}.json"))
}

/// Reads the detections in the images of `truth`, which are those of `fold`.
///
/// # Errors
/// The file is missing or damaged, belongs to another fold or to other folds, comes from a training that saw one of the
/// operations, names a class that the ground truth does not have, or has other frames than the fold.
pub fn read(folder: &Path, folds: &Folds, fold: &str, truth: &Truth) -> Result<Predicted> {
    let path = path_of(folder, fold);
    let file = path.display();
    ensure!(
        path.is_file(),
        "{file} is missing: `train_detector.py --fold {fold} --out {}` writes it at its end; \
         `--only-fold` scores those that are there",
        folder.display()
    );
    let text = std::fs::read_to_string(&path).on_file(FileAction::Read, &path)?;
    let stored: File =
        serde_json::from_str(&text).with_context(|| format!("{file} has no predictions of a fold; train it again"))?;
    ensure!(stored.format == FORMAT, "{file}: its format is `{}`; this program reads `{FORMAT}`", stored.format);
    ensure!(stored.fold == fold, "{file} has predictions of fold {}: rename it to that of its fold", stored.fold);
    check_operations(&stored, folds, fold, &path)?;
    let classes = stored
        .classes
        .iter()
        .map(|name| {
            let class = truth.classes.iter().position(|c| *c == normal_name(name));
            class.with_context(|| {
                format!(
                    "{file}: the ground truth has no class `{name}`, only {}: train with these classes",
                    truth.classes.join(", ")
                )
            })
        })
        .collect::<Result<Vec<usize>>>()?;
    let wanted: BTreeMap<String, usize> = truth.pictures.iter().enumerate().map(|(n, p)| (p.stem(), n)).collect();
    let mut finds = vec![None; truth.pictures.len()];
    for (name, rows) in &stored.frames {
        let Some(&picture) = wanted.get(name) else {
            let operation = name.rsplit_once('_').map_or(name.as_str(), |(operation, _)| operation);
            match folds.fold_of(operation) {
                Some(other) if other != fold => bail!(
                    "{file}: frame {name} is of operation {operation}, which the training of fold {fold} learned from: \
                     only frames of {} belong there",
                    stored.held_out.join(", ")
                ),
                _ => bail!("{file}: the ground truth has no frame {name}: are the predictions from other data?"),
            }
        };
        finds[picture] = Some(rows_of(rows, &classes).with_context(|| format!("{file}, frame {name}"))?);
    }
    let missing: Vec<String> =
        truth.pictures.iter().zip(&finds).filter(|(_, f)| f.is_none()).map(|(p, _)| p.stem()).collect();
    if let Some(first) = missing.first() {
        bail!(
            "{file}: {} of {} frames are missing, such as {first}; a frame in which nothing was found has an empty list. \
             Train the fold again, or go on with --resume",
            missing.len(),
            finds.len()
        );
    }
    let (finds, objectness) = finds.into_iter().flatten().unzip();
    Ok(Predicted { finds, objectness })
}

/// Checks that the training held out the operations of the file of folds.
fn check_operations(stored: &File, folds: &Folds, fold: &str, path: &Path) -> Result<()> {
    let file = path.display();
    let sorted = |list: &[String]| {
        let mut list = list.to_vec();
        list.sort();
        list
    };
    let held_out = sorted(folds.folds.get(fold).map_or(&[][..], Vec::as_slice));
    ensure!(
        sorted(&stored.held_out) == held_out,
        "{file}: its training kept out {}, while fold {fold} of {} keeps out {}: train it again with these folds",
        stored.held_out.join(", "),
        folds.path().display(),
        held_out.join(", ")
    );
    if let Some(seen) = stored.trained_on.iter().find(|o| held_out.contains(o)) {
        bail!("{file}: its training learned from operation {seen}, which fold {fold} keeps out: train it again");
    }
    Ok(())
}

fn rows_of(rows: &[Vec<f64>], classes: &[usize]) -> Result<(Vec<Find>, Vec<f64>)> {
    let find = |(number, row): (usize, &Vec<f64>)| {
        let ([class, score, x0, y0, x1, y1], objectness) = match *row.as_slice() {
            [class, score, x0, y0, x1, y1] => ([class, score, x0, y0, x1, y1], f64::NAN),
            [class, score, x0, y0, x1, y1, objectness] => ([class, score, x0, y0, x1, y1], objectness),
            _ => bail!("row {}: expected 6 or 7 numbers, got {}", number + 1, row.len()),
        };
        let index = (class >= 0.0 && class.fract() == 0.0).then_some(class as usize);
        let Some(&class) = index.and_then(|c| classes.get(c)) else {
            bail!("row {}: class {class} of {} classes", number + 1, classes.len());
        };
        ensure!((0.0..=1.0).contains(&score), "row {}: score {score} is not between 0 and 1", number + 1);
        ensure!(
            objectness.is_nan() || (0.0..=1.0).contains(&objectness),
            "row {}: objectness {objectness}; 0 to 1 was expected",
            number + 1
        );
        ensure!(
            x1 >= x0 && y1 >= y0,
            "row {}: a box from ({x0}, {y0}) to ({x1}, {y1}); the upper left corner comes first",
            number + 1
        );
        Ok((Find { class, bbox: [x0, y0, x1 - x0, y1 - y0], mask: None, score }, objectness))
    };
    rows.iter().enumerate().map(find).collect()
}
