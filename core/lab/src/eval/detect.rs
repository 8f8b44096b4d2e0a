//! `panoscope eval detect`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use panoscope_eval::Session;
use panoscope_eval::eval::detect::{self, Options, folds};
use panoscope_eval::figures::Figure;

use panoscope_cli::terminal::raw;

/// Another program that evaluates the same detections.
#[derive(Clone, Copy, clap::ValueEnum)]
enum SelfCheck {
    /// COCO's own tools for Python.
    Pycocotools,
}

/// Arguments of `eval detect`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Cases to run; repeatable. Default: all of `test` (official test split), `left_out` (whole operations that the
    /// model never saw), `polygons` (real frames with outlines), `phantom` (held-out scenes), `tips` (tips on the
    /// phantom), `no_instruments` (boxes, outlines and tips per 100 images without instruments).
    #[arg(long, value_parser = detect::CASES)]
    case: Vec<String>,
    /// Detector; default: the shipped one.
    #[arg(long, value_name = "FILE.onnx")]
    model: Option<PathBuf>,
    /// Segmenter; default: the shipped one.
    #[arg(long, value_name = "FILE.onnx")]
    masks: Option<PathBuf>,
    /// Detector trained without the operations of --left-out, for the case `left_out`.
    #[arg(long, value_name = "FILE.onnx")]
    left_out_model: Option<PathBuf>,
    /// Operations of the case `left_out`.
    #[arg(long, value_delimiter = ',', default_value = "v02,v08", value_name = "NAMES")]
    left_out: Vec<String>,
    /// Scores stored predictions instead of a model: a folder with `foldN.json` of each fold, as `train_detector.py
    /// --fold N` writes them. Gives mAP at 0.5 on the operations that each training never saw, mean and worst fold,
    /// with intervals, and the calibration of scores.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["case", "model", "masks", "left_out_model", "split", "images", "set", "selfcheck", "tables"])]
    folds: Option<PathBuf>,
    /// A second folder of that kind; --folds is compared with it on the same frames.
    #[arg(long, value_name = "DIR", requires = "folds")]
    beside: Option<PathBuf>,
    /// Folds to evaluate, without mean and worst; repeatable.
    #[arg(long, value_name = "NAME", requires = "folds")]
    only_fold: Vec<String>,
    /// File of folds; default: the shipped one.
    #[arg(long, value_name = "FILE.toml", requires = "folds")]
    fold_file: Option<PathBuf>,
    /// Writes the calibration of the scores that --folds finds, for `export_detector.py --calibration`.
    #[arg(long, value_name = "FILE.json", requires = "folds")]
    calibration: Option<PathBuf>,
    /// Precision that the limit of each class in that file guarantees, 0 to 1.
    #[arg(long, value_name = "SHARE", requires = "folds", default_value_t = 0.9, value_parser = share)]
    precision: f64,
    /// Your own ground truth instead of the cases: a COCO or VIA file, or a folder of VOC, labelme or YOLO files.
    /// Evaluates --model and, if given, --masks.
    #[arg(long, value_name = "PATH")]
    truth: Option<PathBuf>,
    /// Split of --truth: a list of VOC's ImageSets, a COCO file, a YOLO folder.
    #[arg(long, value_name = "NAME")]
    split: Option<String>,
    /// Folder of the images of --truth, if they are not next to it. With the case `no_instruments`: your own images
    /// without instruments, instead of rendered ones and those of the data sets.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Folder of data sets, searched before the default ones; repeatable.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    /// Sets a parameter of the node, as in a graph file. Repeatable.
    #[arg(long, value_name = "PARAM=VALUE")]
    set: Vec<String>,
    /// Evaluates the same detections with another program, and fails if figures differ in the fourth decimal.
    #[arg(long, value_enum, value_name = "PROGRAM")]
    selfcheck: Option<SelfCheck>,
    /// Python of --selfcheck.
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: PathBuf,
    /// Folder for images: curves, confusions, reliability diagrams, contact sheets of the worst misses.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Writes tables 5.1 to 5.5 of the thesis as Markdown; `-` shows them.
    #[arg(long, value_name = "FILE.md")]
    tables: Option<PathBuf>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

/// Why a text is not a share.
#[derive(Debug, thiserror::Error)]
enum ShareError {
    #[error(transparent)]
    Number(#[from] std::num::ParseFloatError),
    #[error("above 0 and below 1 was expected")]
    Range,
}

fn share(text: &str) -> Result<f64, ShareError> {
    let value: f64 = text.parse()?;
    if value > 0.0 && value < 1.0 { Ok(value) } else { Err(ShareError::Range) }
}

impl Arguments {
    fn options(&self) -> Options {
        Options {
            cases: self.case.clone(),
            model: self.model.clone(),
            masks: self.masks.clone(),
            held_out_model: self.left_out_model.clone(),
            held_out: self.left_out.clone(),
            truth: self.truth.clone(),
            split: self.split.clone(),
            images: self.images.clone(),
            data: self.data.clone(),
            settings: self.set.clone(),
            python: self.python.clone(),
            pictures: self.pictures.clone(),
            selfcheck: self.selfcheck.map(|SelfCheck::Pycocotools| detect::SelfCheck::Pycocotools),
        }
    }
}

/// Evaluates, and writes the thesis's tables if requested.
pub fn judge(session: &dyn Session, arguments: &Arguments) -> Result<Vec<Figure>> {
    if let Some(predictions) = &arguments.folds {
        let options = folds::Options {
            predictions: predictions.clone(),
            beside: arguments.beside.clone(),
            fold_file: arguments.fold_file.clone(),
            only: arguments.only_fold.clone(),
            data: arguments.data.clone(),
            truth: arguments.truth.clone(),
            pictures: arguments.pictures.clone(),
            calibration: arguments.calibration.clone(),
            precision: arguments.precision,
        };
        return Ok(folds::judge(session, &options)?);
    }
    let judgement = detect::judge(session, &arguments.options())?;
    if let Some(path) = &arguments.tables {
        let text = judgement.tables();
        if path == Path::new("-") {
            raw(&text);
        } else {
            std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
        }
    }
    Ok(judgement.figures)
}
