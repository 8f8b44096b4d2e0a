//! The same detections evaluated by `pycocotools`: both must agree to four decimals.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use serde::Deserialize;
use serde_json::{Value, json};

use super::truth::Truth;
use crate::error::{Context, FileAction, OnFile, Result, bail};
use crate::inputs::Folder;
use crate::session::{Session, note};
use panoscope_imaging::detect::{Find, Mask, Scores, Shape};

/// Reads both files, evaluates, prints one line of JSON.
const SCRIPT: &str = r#"
import contextlib, io, json, sys
import numpy as np
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
truth, found, shape = sys.argv[1:4]
with contextlib.redirect_stdout(io.StringIO()):
    real = COCO(truth)
    judged = COCOeval(real, real.loadRes(found), shape)
    judged.evaluate()
    judged.accumulate()
p = judged.eval["precision"][:, :, :, 0, 2]
def mean(a):
    a = a[a > -1]
    return float(a.mean()) if a.size else None
print(json.dumps({"ap": mean(p), "ap50": mean(p[0]), "classes": [[mean(p[:, :, k]), mean(p[0, :, k])] for k in range(p.shape[2])]}))
"#;

#[derive(Deserialize)]
struct PeerScores {
    ap: Option<f64>,
    ap50: Option<f64>,
    classes: Vec<[Option<f64>; 2]>,
}

fn runs(mask: &Mask) -> Value {
    json!({ "size": [mask.height, mask.width], "counts": mask.runs() })
}

/// Truth as COCO JSON. Ids begin at 1.
fn truth_json(truth: &Truth, shape: Shape) -> Value {
    let mut annotations = Vec::new();
    for (index, picture) in truth.pictures.iter().enumerate() {
        for object in &picture.objects {
            let [_, _, w, h] = object.bbox;
            let mut a = json!({
                "id": annotations.len() + 1, "image_id": index + 1, "category_id": object.class + 1,
                "bbox": object.bbox, "area": w * h, "iscrowd": u8::from(object.ignored),
            });
            if let (Shape::Mask, Some(mask)) = (shape, &object.mask) {
                a["area"] = json!(mask.area);
                a["segmentation"] = runs(mask);
            }
            annotations.push(a);
        }
    }
    let images: Vec<Value> = truth
        .pictures
        .iter()
        .enumerate()
        .map(|(i, p)| json!({ "id": i + 1, "width": p.width, "height": p.height, "file_name": p.stem() }))
        .collect();
    let categories: Vec<Value> =
        truth.classes.iter().enumerate().map(|(i, name)| json!({ "id": i + 1, "name": name })).collect();
    json!({ "info": {}, "images": images, "annotations": annotations, "categories": categories })
}

fn finds_json(finds: &[Vec<Find>], shape: Shape) -> Value {
    let one = |index: usize, f: &Find| {
        let mut v = json!({ "image_id": index + 1, "category_id": f.class + 1, "score": f.score });
        match (shape, &f.mask) {
            (Shape::Mask, Some(mask)) => v["segmentation"] = runs(mask),
            _ => v["bbox"] = json!(f.bbox),
        }
        v
    };
    finds.iter().enumerate().flat_map(|(i, list)| list.iter().map(move |f| one(i, f))).collect::<Vec<_>>().into()
}

/// Packs run-length masks with the functions of `pycocotools`.
const PACK: &str = r#"
from pycocotools import mask
for path in (truth, found):
    held = json.load(open(path))
    for a in (held["annotations"] if isinstance(held, dict) else held):
        s = a.get("segmentation")
        if s is not None:
            a["segmentation"] = mask.frPyObjects(s, *s["size"])
            a["segmentation"]["counts"] = a["segmentation"]["counts"].decode()
    json.dump(held, open(path, "w"))
"#;

/// Evaluates the same detections with `pycocotools` of `python` and compares; an error when a figure differs by more
/// than 0.00005.
pub fn compare(
    session: &dyn Session,
    python: &Path,
    truth: &Truth,
    finds: &[Vec<Find>],
    shape: Shape,
    ours: &Scores,
) -> Result<()> {
    if finds.iter().all(Vec::is_empty) {
        note!(session, "self-check: nothing was found, so there is nothing to compare");
        return Ok(());
    }
    let scratch = Folder::new("panoscope-selfcheck")?;
    let (truth_file, found_file) = (scratch.path().join("truth.json"), scratch.path().join("found.json"));
    for (path, value) in [(&truth_file, truth_json(truth, shape)), (&found_file, finds_json(finds, shape))] {
        std::fs::write(path, value.to_string()).on_file(FileAction::Write, path)?;
    }
    let script = SCRIPT.replacen("with contextlib", &format!("{}with contextlib", PACK.trim_start()), 1);
    let mut child = Command::new(python)
        .arg("-")
        .args([&truth_file, &found_file])
        .arg(if shape == Shape::Mask { "segm" } else { "bbox" })
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start {}: choose a Python with --python", python.display()))?;
    if let Some(mut input) = child.stdin.take() {
        // A Python that ended already says why below.
        let _ = input.write_all(script.as_bytes());
    }
    let output = child.wait_with_output()?;
    let words = String::from_utf8_lossy(&output.stderr);
    if words.contains("No module named") {
        bail!(
            "{} has no pycocotools: run `{} -m pip install pycocotools`, or choose another Python with --python",
            python.display(),
            python.display()
        );
    }
    if !output.status.success() {
        bail!("pycocotools failed: {}", words.lines().last().unwrap_or("no reason given"));
    }
    let theirs: PeerScores =
        serde_json::from_slice(&output.stdout).context("the output of pycocotools is malformed")?;
    let mut worst = 0f64;
    let mut check = |what: &str, own: f64, other: Option<f64>| -> Result<()> {
        let Some(other) = other else {
            if own.is_nan() {
                return Ok(());
            }
            bail!("self-check: {what} is {own:.6} here, but missing in pycocotools");
        };
        worst = worst.max((own - other).abs());
        // NaN agrees with nothing.
        if own.is_nan() || (own - other).abs() > 5e-5 {
            bail!("self-check: {what} is {own:.6} here and {other:.6} in pycocotools");
        }
        Ok(())
    };
    check("AP", ours.ap(), theirs.ap)?;
    check("AP50", ours.ap_at(0), theirs.ap50)?;
    for (index, (own, other)) in ours.classes.iter().zip(&theirs.classes).enumerate() {
        let name = truth.classes.get(index).map_or("?", String::as_str);
        check(&format!("AP of {name}"), own.mean_ap(), other[0])?;
        check(&format!("AP50 of {name}"), own.ap[0], other[1])?;
    }
    let what = if shape == Shape::Mask { "masks" } else { "boxes" };
    note!(
        session,
        "self-check against pycocotools, {what}: AP {:.4}, AP50 {:.4}, {} classes agree; largest difference {worst:.1e}",
        ours.ap(),
        ours.ap_at(0),
        theirs.classes.len()
    );
    Ok(())
}
