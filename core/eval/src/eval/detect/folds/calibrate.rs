//! Calibration of scores on left-out operations: calibration error per class, the curve that corrects it, limits for a
//! required precision, and the effect of an `unknown` class.

use std::path::Path;

use serde_json::json;

use super::super::picture::{self, Reliability};
use super::super::reliability::{Curve, Outcome, expected_error, limit_for};
use super::predictions::Predicted;
use crate::error::{FileAction, OnFile, Result};
use crate::figures::Figure;
use crate::session::{Session, note};
use panoscope_engine::text_table::table;
use panoscope_imaging::detect::{Find, Object, Shape, overlap};

/// Minimum evaluated score; a network returns any number of wrong boxes below it, which would make every error small.
pub const FLOOR: f64 = 0.05;
/// Format of the file that `export_detector.py --calibration` reads.
const FORMAT: &str = "panoscope-calibration-1";
/// Probability from which boxes are counted in the evaluation of `unknown`: the default of `yolo`.
const REPORTED: f64 = 0.3;
/// Limits of the class's probability that are tried.
const TRIED: [f64; 5] = [0.0, 0.4, 0.5, 0.6, 0.7];

/// A box as reported by `yolo`: the likeliest class per position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Number of its image.
    picture: usize,
    bbox: [f64; 4],
    class: usize,
    score: f64,
    is_right: bool,
    /// NaN where it was not stored.
    objectness: f64,
    /// Whether it is on an object of any class.
    is_object: bool,
}

impl Sample {
    fn named(&self) -> Outcome {
        Outcome { score: self.score, is_right: self.is_right }
    }

    fn any(&self) -> Outcome {
        Outcome { score: self.objectness, is_right: self.is_object }
    }
}

/// The boxes of an image matched with its objects. Boxes on crowds only are ignored.
fn of_picture(picture: usize, objects: &[Object], finds: &[Find], objectness: &[f64], out: &mut Vec<Sample>) {
    let mut order: Vec<usize> =
        (0..finds.len()).filter(|&f| finds[f].score >= FLOOR || objectness[f] >= FLOOR).collect();
    order.sort_by(|&a, &b| finds[b].score.total_cmp(&finds[a].score));
    let mut taken = vec![false; objects.len()];
    for (rank, &f) in order.iter().enumerate() {
        let find = &finds[f];
        // A weaker class of the same place.
        if order[..rank].iter().any(|&better| finds[better].bbox == find.bbox) {
            continue;
        }
        let meets = |o: &Object| overlap(find, o, Shape::Box);
        let of_class = |o: &&(usize, &Object)| o.1.class == find.class;
        let near: Vec<(usize, &Object)> = objects.iter().enumerate().filter(|(_, o)| meets(o) >= 0.5).collect();
        let free = near.iter().filter(of_class).filter(|(at, o)| !o.ignored && !taken[*at]);
        let best = free.max_by(|a, b| meets(a.1).total_cmp(&meets(b.1))).map(|(at, _)| *at);
        if best.is_none() && near.iter().any(|(_, o)| o.ignored) {
            continue;
        }
        best.into_iter().for_each(|at| taken[at] = true);
        let (score, class, objectness) = (find.score, find.class, objectness[f]);
        let (bbox, is_object) = (find.bbox, !near.is_empty());
        out.push(Sample { picture, bbox, class, score, is_right: best.is_some(), objectness, is_object });
    }
}

/// The boxes of all images of a fold.
pub fn samples(objects: &[Vec<Object>], predicted: &Predicted) -> Vec<Sample> {
    let mut out = Vec::new();
    let pictures = objects.iter().zip(&predicted.finds).zip(&predicted.objectness);
    for (picture, ((objects, finds), objectness)) in pictures.enumerate() {
        of_picture(picture, objects, finds, objectness, &mut out);
    }
    out
}

/// Outcomes of a detector's finds, with their classes, from [`FLOOR`] on.
pub fn outcomes(objects: &[Vec<Object>], finds: &[Vec<Find>]) -> Vec<(usize, Outcome)> {
    let mut out = Vec::new();
    for (picture, (objects, finds)) in objects.iter().zip(finds).enumerate() {
        of_picture(picture, objects, finds, &vec![f64::NAN; finds.len()], &mut out);
    }
    out.iter().map(|sample| (sample.class, sample.named())).collect()
}

/// Curves of scores and of objectness, the second where every box has one.
fn fit<'a>(samples: impl Iterator<Item = &'a Sample> + Clone) -> (Curve, Option<Curve>) {
    let named: Vec<Outcome> = samples.clone().map(Sample::named).filter(|o| o.score >= FLOOR).collect();
    let any: Vec<Outcome> = samples.map(Sample::any).collect();
    let is_stored = !any.is_empty() && any.iter().all(|o| o.score.is_finite());
    (Curve::fit(&named), is_stored.then(|| Curve::fit(&any)))
}

/// Options of [`report`].
pub struct Wanted<'a> {
    /// Names of the classes.
    pub classes: &'a [String],
    /// Input of the figures.
    pub input: &'a str,
    /// Precision that the limits of the classes guarantee.
    pub precision: f64,
    /// Folder for the diagram.
    pub pictures: Option<&'a Path>,
    /// File for the export of a model.
    pub file: Option<&'a Path>,
}

fn percent(share: f64) -> String {
    if share.is_nan() { "-".to_owned() } else { format!("{:.1}", 100.0 * share) }
}

/// The boxes of all folds, each with the probabilities of its class and of any class by the curves of the other folds; of a single fold by `own`.
/// Images are numbered on from fold to fold.
fn corrected(folds: &[&[Sample]], own: (Curve, Option<Curve>)) -> Vec<(Sample, f64, f64)> {
    let mut corrected: Vec<(Sample, f64, f64)> = Vec::new();
    for (index, fold) in folds.iter().enumerate() {
        let others = folds.iter().enumerate().filter(|(k, _)| *k != index).flat_map(|(_, fold)| fold.iter());
        let (score, objectness) = if folds.len() > 1 { fit(others) } else { own };
        let any = |s: &Sample| objectness.map_or(f64::NAN, |c| c.probability(s.objectness));
        let first = corrected.last().map_or(0, |(s, ..)| s.picture + 1);
        let on = |s: &Sample| Sample { picture: first + s.picture, ..*s };
        corrected.extend(fold.iter().map(|s| (on(s), score.probability(s.score), any(s))));
    }
    corrected
}

/// Reports the calibration of folds. Each fold is corrected by the curve of the others, so that the corrected error is
/// measured on unseen operations; a single fold is corrected by its own curve, which is reported.
///
/// # Errors
/// An image or the file cannot be written.
pub fn report(session: &dyn Session, folds: &[&[Sample]], wanted: &Wanted<'_>) -> Result<Vec<Figure>> {
    let all = || folds.iter().flat_map(|fold| fold.iter());
    let (score, objectness) = fit(all());
    let corrected = corrected(folds, (score, objectness));
    let judged: Vec<&(Sample, f64, f64)> = corrected.iter().filter(|(s, ..)| s.score >= FLOOR).collect();
    let of = |class: Option<usize>| judged.iter().filter(move |(s, ..)| class.is_none_or(|c| s.class == c));
    let before = |class: Option<usize>| of(class).map(|(s, ..)| s.named());
    let after = |class: Option<usize>| of(class).map(|(s, p, _)| Outcome { score: *p, ..s.named() });
    let limit = |class: usize| {
        let own: Vec<Outcome> = all().filter(|s| s.class == class).map(|s| score.of(s.named())).collect();
        limit_for(&own, wanted.precision)
    };
    let limits: Vec<f64> = (0..wanted.classes.len()).map(limit).collect();
    let mut figures = Vec::new();
    let mut figure = |name: String, value: f64| {
        if !value.is_nan() {
            figures.push(Figure::new(&name, value, "1", wanted.input));
        }
    };
    let head = format!("limit for {:.0} % right", 100.0 * wanted.precision);
    let mut rows =
        vec![["class", "boxes", "right, %", "error, %", "error calibrated, %", &head].map(str::to_owned).to_vec()];
    let names = wanted.classes.iter().map(|name| name.as_str()).enumerate().map(|(k, name)| (name, Some(k)));
    for (name, class) in names.chain([("all", None)]) {
        let (count, right) = before(class).fold((0, 0), |(n, r), o| (n + 1, r + usize::from(o.is_right)));
        let errors = (expected_error(before(class)), expected_error(after(class)));
        rows.push(vec![
            name.to_owned(),
            count.to_string(),
            percent(right as f64 / f64::from(count)),
            percent(errors.0),
            percent(errors.1),
            class.map_or_else(String::new, |class| format!("{:.2}", limits[class])),
        ]);
        figure(format!("calibration_error/{name}"), errors.0);
        figure(format!("calibration_error_corrected/{name}"), errors.1);
    }
    note!(
        session,
        "Expected calibration error of boxes of {FLOOR} and more; temperature {:.3}, bias {:.3}{}",
        score.temperature,
        score.bias,
        if folds.len() > 1 {
            ", each fold corrected by the others"
        } else {
            ", corrected by the fold itself: too good"
        }
    );
    session.table(&table(&rows));
    figure("calibration_temperature".to_owned(), score.temperature);
    figure("calibration_bias".to_owned(), score.bias);
    if objectness.is_some() {
        session.table(&unknown(&corrected, &mut figure));
    } else {
        note!(
            session,
            "these predictions hold no objectness: train_detector.py --resume of this version adds it; without it there is no `unknown`"
        );
    }
    if let Some(folder) = wanted.pictures {
        let series = |name: &str, class| Reliability {
            name: name.to_owned(),
            before: before(class).collect(),
            after: after(class).collect(),
        };
        let classes = wanted.classes.iter().enumerate().map(|(k, name)| series(name, Some(k)));
        let all = std::iter::once(series("all", None)).chain(classes).collect::<Vec<_>>();
        picture::reliability(&folder.join("reliability.png"), wanted.input, &all)?;
    }
    if let Some(path) = wanted.file {
        let errors = (expected_error(before(None)), expected_error(after(None)));
        write_file(path, wanted, (score, objectness), &limits, errors)?;
        note!(session, "{}: calibration for export_detector.py --calibration", path.display());
    }
    Ok(figures)
}

/// Writes what the export of a model reads: the curves, the limits of the classes, and the error before and after the correction.
fn write_file(
    path: &Path,
    wanted: &Wanted<'_>,
    (score, objectness): (Curve, Option<Curve>),
    limits: &[f64],
    (before, after): (f64, f64),
) -> Result<()> {
    let curve = |c: Curve| json!({"temperature": c.temperature, "bias": c.bias});
    let value = json!({
        "format": FORMAT,
        "source": wanted.input,
        "classes": wanted.classes,
        "score": curve(score),
        "objectness": objectness.map(curve),
        "precision": wanted.precision,
        "limits": limits,
        "error": {"before": before, "after": after},
    });
    std::fs::write(path, format!("{value:#}\n")).on_file(FileAction::Write, path)
}

/// Intersection over union of two boxes (left, top, width, height).
fn iou(a: [f64; 4], b: [f64; 4]) -> f64 {
    let both = |k: usize| ((a[k] + a[k + 2]).min(b[k] + b[k + 2]) - a[k].max(b[k])).max(0.0);
    let both = both(0) * both(1);
    let union = a[2] * a[3] + b[2] * b[3] - both;
    if union > 0.0 { both / union } else { 0.0 }
}

/// Effect of a limit of the class's probability on reported boxes: a table, and figures.
fn unknown(corrected: &[(Sample, f64, f64)], figure: &mut impl FnMut(String, f64)) -> String {
    let mut rows = vec![
        ["unknown below", "right names", "wrong names", "named, no instrument", "unknown", "of them instruments, %"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for limit in TRIED {
        let (mut right, mut wrong, mut nothing, mut unknown, mut real) = (0, 0, 0, 0, 0);
        for boxes in corrected.chunk_by(|a, b| a.0.picture == b.0.picture) {
            let is_unknown = |named: f64, any: f64| {
                let any = any.max(named);
                limit > 0.0 && any >= REPORTED && named < limit * any
            };
            // As the node does it: a named box takes the place of unknown ones, the surest of these that of others.
            let mut shown: Vec<[f64; 4]> = Vec::new();
            for (sample, named, _) in boxes.iter().filter(|(_, named, any)| !is_unknown(*named, *any)) {
                if *named < REPORTED {
                    continue;
                }
                shown.push(sample.bbox);
                let count = match (sample.is_right, sample.is_object) {
                    (true, _) => &mut right,
                    (false, true) => &mut wrong,
                    (false, false) => &mut nothing,
                };
                *count += 1;
            }
            let mut unsure: Vec<_> = boxes.iter().filter(|(_, named, any)| is_unknown(*named, *any)).collect();
            unsure.sort_by(|a, b| b.2.total_cmp(&a.2));
            for (sample, ..) in unsure {
                if shown.iter().all(|other| iou(*other, sample.bbox) <= 0.5) {
                    shown.push(sample.bbox);
                    unknown += 1;
                    real += usize::from(sample.is_object);
                }
            }
        }
        let share = if unknown > 0 { format!("{:.1}", 100.0 * real as f64 / f64::from(unknown)) } else { "-".into() };
        let counts = [right, wrong, nothing, unknown].map(|n| n.to_string());
        rows.push([vec![format!("{limit:.2}")], counts.to_vec(), vec![share]].concat());
        for (what, count) in [("right", right), ("wrong", wrong), ("unknown", unknown)] {
            figure(format!("unknown_below_{limit:.2}/{what}"), f64::from(count));
        }
    }
    table(&rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(class: usize, left: f64, ignored: bool) -> Object {
        Object { class, bbox: [left, 0.0, 10.0, 10.0], mask: None, ignored }
    }

    fn find(class: usize, left: f64, score: f64) -> Find {
        Find { class, bbox: [left, 0.0, 10.0, 10.0], mask: None, score }
    }

    #[test]
    fn each_place_is_judged_by_its_likeliest_class_once() {
        let objects = [object(0, 0.0, false), object(1, 40.0, false), object(0, 80.0, true)];
        let finds = [
            find(0, 1.0, 0.9),   // right
            find(1, 1.0, 0.4),   // the same place, weaker: left out
            find(0, 2.0, 0.5),   // a double: wrong, and on an instrument
            find(0, 41.0, 0.6),  // of another class: wrong, and on an instrument
            find(1, 60.0, 0.3),  // nothing there
            find(0, 81.0, 0.8),  // a crowd: left out
            find(0, 20.0, 0.01), // below the floor
        ];
        let mut out = Vec::new();
        of_picture(0, &objects, &finds, &[0.95, 0.95, 0.9, 0.9, 0.5, 0.9, 0.02], &mut out);
        let got: Vec<(f64, bool, bool)> = out.iter().map(|s| (s.score, s.is_right, s.is_object)).collect();
        assert_eq!(got, [(0.9, true, true), (0.6, false, true), (0.5, false, true), (0.3, false, false)]);
    }
}
