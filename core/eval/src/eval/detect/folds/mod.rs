//! A detector on whole operations that its training never saw, from stored predictions: mAP at 0.5 of each fold, their
//! mean and the worst one.

mod calibrate;
mod file;
mod predictions;
mod resample;

use std::path::{Path, PathBuf};

pub(super) use self::calibrate::{FLOOR, outcomes};
use self::file::{Folds, SHIPPED};
use self::resample::{Blocks, RESAMPLES, interval, resampled};
use super::picture;
use super::truth::{self, Truth};
use crate::error::{EvalError, Result, bail};
use crate::figures::Figure;
use crate::inputs::{create, wants};
use crate::session::{Session, check_cancelled, note};
use panoscope_engine::text_table::table;
use panoscope_imaging::detect::{Find, Object, Ranking, Scores, Shape, mean, score};

/// Options of [`judge`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder with `foldN.json` of each fold.
    pub predictions: PathBuf,
    /// A second folder of that kind, with which the first one is compared frame by frame.
    pub beside: Option<PathBuf>,
    /// File of folds; default: the shipped one.
    pub fold_file: Option<PathBuf>,
    /// Only these folds, without a mean and a worst one; if empty, all.
    pub only: Vec<String>,
    /// Folders of data sets, searched before the usual ones.
    pub data: Vec<PathBuf>,
    /// The data set itself, instead of the one that the file of folds names.
    pub truth: Option<PathBuf>,
    /// Folder for images of each fold: curves, class confusions, contact sheets of the worst misses; and a reliability
    /// diagram of all.
    pub pictures: Option<PathBuf>,
    /// File for the calibration of a model that is exported.
    pub calibration: Option<PathBuf>,
    /// Precision, 0 to 1, that the limits of the classes in that file guarantee.
    pub precision: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            predictions: PathBuf::new(),
            beside: None,
            fold_file: None,
            only: Vec::new(),
            data: Vec::new(),
            truth: None,
            pictures: None,
            calibration: None,
            precision: 0.9,
        }
    }
}

/// A fold scored.
struct Fold {
    name: String,
    frames: usize,
    blocks: usize,
    scores: Scores,
    /// COCO's AP at 0.5 per resample and class.
    samples: Vec<Vec<f64>>,
    /// Scores and resamples of the compared folder, on the same resamples.
    beside: Option<(Scores, Vec<Vec<f64>>)>,
    /// Boxes with their scores, for the calibration.
    boxes: Vec<calibrate::Sample>,
}

/// Reads all splits of the data set.
fn read_truth(session: &dyn Session, folds: &Folds, options: &Options) -> Result<Truth> {
    let folder = match &options.truth {
        Some(folder) => folder.clone(),
        None => {
            let folders: Vec<PathBuf> = options.data.iter().cloned().chain(super::usual_data()).collect();
            let Some(folder) = crate::inputs::find(&folders, &folds.data) else {
                let looked: Vec<String> = folders.iter().map(|f| f.display().to_string()).collect();
                let reason =
                    format!("there is no {} in {}: name its folder with --data", folds.data, looked.join(", "));
                return Err(EvalError::Options { reason });
            };
            folder
        }
    };
    let mut all = Truth::default();
    for split in &folds.splits {
        let part = truth::read(session, &folder, Some(split), None)?;
        if all.pictures.is_empty() {
            all = part;
        } else {
            let known = all.classes.len();
            let part = part.ordered(&all.classes);
            all.classes.extend_from_slice(&part.classes[known..]);
            all.pictures.extend(part.pictures);
        }
    }
    if let Some(picture) = all.pictures.iter().find(|p| folds.fold_of(&p.operation()).is_none()) {
        bail!(
            "{}: operation {} of {} is in no fold: add it to one",
            folds.path().display(),
            picture.operation(),
            folder.display()
        );
    }
    Ok(all)
}

fn judge_fold(name: &str, folds: &Folds, truth: &Truth, options: &Options, seed: u64) -> Result<Fold> {
    let operations = folds.folds.get(name).map_or(&[][..], Vec::as_slice);
    let truth = truth.only(operations);
    if truth.pictures.is_empty() {
        bail!("no frame belongs to the operations {} of fold {name}", operations.join(", "));
    }
    let objects: Vec<_> = truth.pictures.iter().map(|p| p.objects.clone()).collect();
    let classes = truth.classes.len();
    let (mut scores, mut rankings, mut boxes) = (Vec::new(), Vec::new(), Vec::new());
    for folder in std::iter::once(&options.predictions).chain(&options.beside) {
        let predicted = predictions::read(folder, folds, name, &truth)?;
        let finds = &predicted.finds;
        let scored = score(&objects, finds, classes, Shape::Box);
        if scores.is_empty() {
            boxes = calibrate::samples(&objects, &predicted);
            options.pictures.as_ref().map_or(Ok(()), |folder| draw(folder, name, &truth, finds, &scored))?;
        }
        scores.push(scored);
        rankings.push(Ranking::new(&objects, finds, classes));
    }
    let blocks = Blocks::of(&truth.pictures, folds)?;
    let frames = truth.pictures.len();
    let mut samples = resampled(&rankings, &blocks, frames, seed);
    let beside = (scores.len() > 1).then(|| scores.pop().zip(samples.pop())).flatten();
    let (Some(scores), Some(samples)) = (scores.pop(), samples.pop()) else {
        bail!("no predictions of fold {name}");
    };
    Ok(Fold { name: name.to_owned(), frames, blocks: blocks.len(), scores, samples, beside, boxes })
}

/// 95 % intervals of the resampled average precisions at 0.5, and of their mean.
pub(super) struct Bounds {
    pub classes: Vec<[f64; 2]>,
    pub mean: [f64; 2],
}

/// Bounds for frames of the data set of the shipped file of folds, drawn from its blocks; `None`, with a note, if that
/// file is not installed. `objects` are those of `truth`, image by image.
///
/// # Errors
/// The file is damaged, or an image is not named like one of the data set.
pub(super) fn bounds(
    session: &dyn Session,
    truth: &Truth,
    objects: &[Vec<Object>],
    finds: &[Vec<Find>],
) -> Result<Option<Bounds>> {
    if !Folds::ships() {
        note!(session, "skipped: bounds of AP50: there is no {SHIPPED} here");
        return Ok(None);
    }
    let blocks = Blocks::of(&truth.pictures, &Folds::read(None)?)?;
    let ranking = Ranking::new(objects, finds, truth.classes.len());
    let samples = resampled(&[ranking], &blocks, truth.pictures.len(), 1).pop().unwrap_or_default();
    let class = |k: usize| interval(samples.iter().map(|sample| sample[k]));
    let classes = (0..truth.classes.len()).map(class).collect();
    Ok(Some(Bounds { classes, mean: interval(means(&samples).into_iter()) }))
}

/// Draws curves, confusions and contact sheets of a fold.
fn draw(folder: &Path, name: &str, truth: &Truth, finds: &[Vec<Find>], scores: &Scores) -> Result<()> {
    let file = |what: &str| folder.join(format!("fold{name}_{what}.png"));
    let title = format!("fold {name} ({} frames)", truth.pictures.len());
    picture::curves(&file("curves"), &title, &truth.classes, scores)?;
    let counts = picture::confusion(truth, finds, Shape::Box);
    picture::confusion_picture(&file("confusion"), &title, &truth.classes, &counts)?;
    picture::sheet(&file("misses"), truth, finds, Shape::Box, false)
}

/// Mean over the classes with ground truth, per resample.
fn means(samples: &[Vec<f64>]) -> Vec<f64> {
    samples.iter().map(|classes| mean(classes.iter().copied())).collect()
}

/// A value with its bounds as text, in percent.
pub(super) fn words(value: f64, [low, high]: [f64; 2]) -> String {
    if value.is_nan() {
        return "-".to_owned();
    }
    format!("{:.1} ({:.1} to {:.1})", 100.0 * value, 100.0 * low, 100.0 * high)
}

/// Aggregates the figures of all folds to one value.
type Pick = fn(&[f64]) -> f64;
const TOGETHER: [(&str, Pick); 2] =
    [("mean", |v| mean(v.iter().copied())), ("worst", |v| v.iter().copied().fold(f64::NAN, f64::min))];

struct Report<'a> {
    classes: &'a [String],
    folds: &'a [Fold],
    /// Whether these are all the folds.
    is_whole: bool,
    input: String,
    figures: Vec<Figure>,
}

impl Report<'_> {
    fn figure(&mut self, name: &str, value: f64, bounds: [f64; 2]) {
        for (name, value) in
            [(name.to_owned(), value), (format!("{name}_low"), bounds[0]), (format!("{name}_high"), bounds[1])]
        {
            if !value.is_nan() {
                self.figures.push(Figure::new(&name, value, "1", &self.input));
            }
        }
    }

    /// Table of classes and folds, `value` and its resamples taken from each fold; with figures `measure/case/class`.
    fn classes(&mut self, measure: &str) -> String {
        let mut head = vec!["class".to_owned()];
        head.extend(self.folds.iter().map(|f| format!("fold {}, {} frames", f.name, f.frames)));
        if self.is_whole {
            head.push("mean of folds".to_owned());
        }
        let mut rows = vec![head];
        for (k, class) in self.classes.to_vec().iter().enumerate() {
            let mut row = vec![class.clone()];
            let mut values = Vec::new();
            for fold in self.folds {
                let (value, bounds) = (fold.scores.classes[k].ap[0], interval(fold.samples.iter().map(|s| s[k])));
                row.push(words(value, bounds));
                self.figure(&format!("{measure}/fold{}/{class}", fold.name), value, bounds);
                values.push(value);
            }
            if self.is_whole {
                let drawn = (0..RESAMPLES).map(|n| mean(self.folds.iter().map(|f| f.samples[n][k])));
                let (value, bounds) = (mean(values.into_iter()), interval(drawn));
                row.push(words(value, bounds));
                self.figure(&format!("{measure}/mean/{class}"), value, bounds);
            }
            rows.push(row);
        }
        let mut row = vec!["mAP50".to_owned()];
        row.extend(self.folds.iter().map(|f| words(f.scores.ap_at(0), interval(means(&f.samples).into_iter()))));
        if self.is_whole {
            row.push(String::new());
        }
        rows.push(row);
        table(&rows)
    }

    /// Figures of `measure` for each fold and for all of them, from a value per fold and its resamples; with a line of
    /// text.
    fn folds(&mut self, measure: &str, values: &[f64], drawn: &[Vec<f64>]) -> String {
        for (fold, (value, samples)) in self.folds.iter().zip(values.iter().zip(drawn)) {
            self.figure(&format!("{measure}/fold{}", fold.name), *value, interval(samples.iter().copied()));
        }
        let mut parts = Vec::new();
        let is_whole = self.is_whole;
        for (name, pick) in TOGETHER.iter().filter(|_| is_whole) {
            let samples = (0..RESAMPLES).map(|n| pick(&drawn.iter().map(|s| s[n]).collect::<Vec<_>>()));
            let (value, bounds) = (pick(values), interval(samples));
            self.figure(&format!("{measure}/{name}"), value, bounds);
            parts.push(format!("{name} {}", words(value, bounds)));
        }
        parts.join(", ")
    }
}

/// Scores the predictions of each fold; with a second folder also the gain over it, on the same frames.
///
/// # Errors
/// A fold is missing or was predicted by a training that saw its frames, a file has the wrong content, the data set is
/// not there, or the session is cancelled.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    for folder in std::iter::once(&options.predictions).chain(&options.beside) {
        if !folder.is_dir() {
            let reason = format!("there is no folder {} with predictions of folds", folder.display());
            return Err(EvalError::Options { reason });
        }
    }
    let file = Folds::read(options.fold_file.as_deref())?;
    if let Some(unknown) = options.only.iter().find(|name| !file.folds.contains_key(*name)) {
        let known: Vec<&str> = file.folds.keys().map(String::as_str).collect();
        let reason = format!("{} has no fold {unknown}; it has {}", file.path().display(), known.join(", "));
        return Err(EvalError::Options { reason });
    }
    create(options.pictures.as_deref())?;
    let truth = read_truth(session, &file, options)?;
    let mut folds = Vec::new();
    for (index, name) in file.folds.keys().enumerate() {
        if wants(&options.only, name) {
            folds.push(judge_fold(name, &file, &truth, options, 1 + index as u64)?);
        }
        check_cancelled(session)?;
    }
    let mut figures = report(session, &truth.classes, &folds, folds.len() == file.folds.len(), options);
    let boxes: Vec<&[calibrate::Sample]> = folds.iter().map(|fold| fold.boxes.as_slice()).collect();
    let wanted = calibrate::Wanted {
        classes: &truth.classes,
        input: &input_of(&folds, options),
        precision: options.precision,
        pictures: options.pictures.as_deref(),
        file: options.calibration.as_deref(),
    };
    figures.extend(calibrate::report(session, &boxes, &wanted)?);
    Ok(figures)
}

/// Input of the figures.
fn input_of(folds: &[Fold], options: &Options) -> String {
    format!(
        "{}, {} frames in {} blocks",
        short(&options.predictions),
        folds.iter().map(|f| f.frames).sum::<usize>(),
        folds.iter().map(|f| f.blocks).sum::<usize>()
    )
}

fn short(folder: &Path) -> String {
    folder.file_name().unwrap_or(folder.as_os_str()).to_string_lossy().into_owned()
}

fn report(session: &dyn Session, classes: &[String], folds: &[Fold], is_whole: bool, options: &Options) -> Vec<Figure> {
    let input = input_of(folds, options);
    let mut report = Report { classes, folds, is_whole, input, figures: Vec::new() };
    let values: Vec<f64> = folds.iter().map(|f| f.scores.ap_at(0)).collect();
    let drawn: Vec<Vec<f64>> = folds.iter().map(|f| means(&f.samples)).collect();
    let line = report.folds("map50_left_out", &values, &drawn);
    for fold in folds {
        let name = format!("map50_voc_left_out/fold{}", fold.name);
        report.figures.push(Figure::new(&name, fold.scores.voc(), "1", &report.input));
    }
    let text = report.classes("ap50_left_out");
    note!(
        session,
        "AP at 0.5 in % on operations left out, with the bounds of 95 % of {RESAMPLES} samples of blocks of frames"
    );
    session.table(&text);
    if is_whole {
        note!(session, "mAP50 over {} folds: {line}", folds.len());
    }
    if let Some(other) = &options.beside {
        let gains: Vec<(f64, Vec<f64>)> = folds
            .iter()
            .filter_map(|f| {
                let (scores, samples) = f.beside.as_ref()?;
                let drawn = means(&f.samples).iter().zip(means(samples)).map(|(a, b)| a - b).collect();
                Some((f.scores.ap_at(0) - scores.ap_at(0), drawn))
            })
            .collect();
        let (values, drawn): (Vec<f64>, Vec<Vec<f64>>) = gains.into_iter().unzip();
        let line = report.folds("map50_left_out_gain", &values, &drawn);
        let each: Vec<String> = folds
            .iter()
            .zip(values.iter().zip(&drawn))
            .map(|(f, (v, d))| format!("fold {} {}", f.name, words(*v, interval(d.iter().copied()))))
            .chain(is_whole.then_some(line))
            .collect();
        note!(session, "gain over {}, in points: {}", short(other), each.join(", "));
    }
    report.figures
}
