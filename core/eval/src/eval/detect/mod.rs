//! Detectors and segmenters compared with true boxes, outlines and tips (thesis, chapter 5).
//!
//! Images are processed by the real nodes, run by the engine; the detections are scored by COCO's and VOC's rules
//! ([`score`]).

mod find;
pub mod folds;
mod judged;
mod no_instruments;
mod phantom;
mod picture;
mod real_tips;
pub mod reliability;
mod selfcheck;
mod tables;
#[doc(hidden)]
pub mod truth;

use std::path::{Path, PathBuf};

use self::find::Node;
use self::judged::JudgeInputs;
use self::phantom::Tips;
use self::truth::Truth;
use crate::error::{EvalError, Result, bail};
use crate::figures::Figure;
use crate::inputs::{Folder, create, shipped_model, wants};
use crate::session::{Session, check_cancelled, note};
use panoscope_engine::text_table::table;
use panoscope_imaging::detect::{Shape, score};

/// Another program that evaluates the same detections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SelfCheck {
    /// COCO's own tools for Python.
    Pycocotools,
}

/// Options of [`judge`].
#[derive(Clone, Debug)]
pub struct Options {
    /// The cases to evaluate; if empty, all: `test` (official test split), `left_out` (whole operations that the model
    /// never saw), `polygons` (real frames with outlines), `phantom` (held-out scenes), `tips` (tips on the phantom),
    /// `no_instruments` (false finds).
    pub cases: Vec<String>,
    /// Detector; default: the shipped one.
    pub model: Option<PathBuf>,
    /// Segmenter; default: the shipped one.
    pub masks: Option<PathBuf>,
    /// Detector trained without the operations of --left-out, for the case `left_out`.
    pub held_out_model: Option<PathBuf>,
    /// Operations of the case `left_out`.
    pub held_out: Vec<String>,
    /// Ground truth instead of the cases: a COCO or VIA file, or a folder of VOC, labelme or YOLO files. Evaluates
    /// --model and, if given, --masks.
    pub truth: Option<PathBuf>,
    /// Split of --truth: a list of VOC's ImageSets, a COCO file, a YOLO folder.
    pub split: Option<String>,
    /// Folder of the images of --truth, if they are not next to it; of the case `no_instruments` its own images.
    pub images: Option<PathBuf>,
    /// Folders of data sets, searched before the default ones.
    pub data: Vec<PathBuf>,
    /// Sets a parameter of the node, as in a graph file.
    pub settings: Vec<String>,
    /// Evaluates the same detections with another program, and fails if figures differ in the fourth decimal.
    pub selfcheck: Option<SelfCheck>,
    /// Python of --selfcheck.
    pub python: PathBuf,
    /// Folder for images: curves, confusions, contact sheets of the worst misses.
    pub pictures: Option<PathBuf>,
}

/// Names of the cases.
pub const CASES: [&str; 6] = ["test", "left_out", "polygons", "phantom", "tips", "no_instruments"];

/// Default folders of data sets.
fn usual_data() -> impl Iterator<Item = PathBuf> {
    ["target/data", "../shared/data", "../shared/data/instances"].into_iter().map(PathBuf::from)
}

/// State shared by the cases.
struct Judge<'a> {
    session: &'a dyn Session,
    options: &'a Options,
    folders: Vec<PathBuf>,
    judged: Vec<JudgeInputs>,
    figures: Vec<Figure>,
}

impl Judge<'_> {
    fn detector(&self) -> Option<PathBuf> {
        self.options.model.clone().or_else(|| shipped_model("instruments.onnx"))
    }

    fn segmenter(&self) -> Option<PathBuf> {
        self.options.masks.clone().or_else(|| shipped_model("instrument_masks.onnx"))
    }

    /// Finds a data set in the searched folders, or reports that it is skipped.
    fn data(&self, case: &str, name: &str) -> Option<PathBuf> {
        let found = self.folders.iter().map(|f| f.join(name)).find(|p| p.is_dir());
        if found.is_none() {
            let looked: Vec<String> = self.folders.iter().map(|f| f.display().to_string()).collect();
            note!(
                self.session,
                "skipped: {case}: there is no {name} in {}; name its folder with --data",
                looked.join(", ")
            );
        }
        found
    }

    fn model(&self, case: &str, model: Option<PathBuf>, option: &str) -> Option<PathBuf> {
        if model.is_none() {
            note!(self.session, "skipped: {case}: no model; name one with {option}");
        }
        model
    }

    /// Runs, scores, draws, compares; adds figures.
    fn one(&mut self, case: &str, node: Node, model: &Path, truth: Truth) -> Result<()> {
        self.judge(case, node, model, truth, false)
    }

    /// [`Self::one`] for frames of the data set of the folds: `with_bounds` adds bounds of AP50.
    fn judge(&mut self, case: &str, node: Node, model: &Path, truth: Truth, with_bounds: bool) -> Result<()> {
        let found = find::run(self.session, node, model, &truth, &self.options.settings)?;
        let objects: Vec<_> = truth.pictures.iter().map(|p| p.objects.clone()).collect();
        let classes = truth.classes.len();
        let boxes = score(&objects, &found.finds, classes, Shape::Box);
        let with_masks = node == Node::MaskRcnn && truth.has_masks();
        let masks = with_masks.then(|| score(&objects, &found.finds, classes, Shape::Mask));
        if self.options.selfcheck.is_some() {
            selfcheck::compare(self.session, &self.options.python, &truth, &found.finds, Shape::Box, &boxes)?;
            if let Some(masks) = &masks {
                selfcheck::compare(self.session, &self.options.python, &truth, &found.finds, Shape::Mask, masks)?;
            }
        }
        let bounds = if with_bounds { folds::bounds(self.session, &truth, &objects, &found.finds)? } else { None };
        let (case, finds, ms) = (case.to_owned(), found.finds, found.ms);
        let judged = JudgeInputs { case, node, truth, finds, boxes, bounds, masks, ms };
        self.draw(&judged)?;
        self.report(&judged, model);
        self.judged.push(judged);
        Ok(())
    }

    fn draw(&self, j: &JudgeInputs) -> Result<()> {
        let Some(folder) = &self.options.pictures else { return Ok(()) };
        let (shape, scores) = match &j.masks {
            Some(masks) => (Shape::Mask, masks),
            None => (Shape::Box, &j.boxes),
        };
        let file = |what: &str| folder.join(format!("{}_{}_{what}.png", j.case, j.node.name()));
        let title = format!("{} on {} ({} frames)", j.node.name(), j.case, j.truth.pictures.len());
        picture::curves(&file("curves"), &title, &j.truth.classes, scores)?;
        let counts = picture::confusion(&j.truth, &j.finds, shape);
        picture::confusion_picture(&file("confusion"), &title, &j.truth.classes, &counts)?;
        if j.node == Node::Yolo {
            let found = j.outcomes();
            let series = |name: &str, class: Option<usize>| picture::Reliability {
                name: name.to_owned(),
                before: j.of_class(&found, class).collect(),
                after: Vec::new(),
            };
            let classes = j.truth.classes.iter().enumerate().map(|(k, name)| series(name, Some(k)));
            let all: Vec<_> = std::iter::once(series("all", None)).chain(classes).collect();
            picture::reliability(&file("reliability"), &title, &all)?;
        }
        picture::sheet(&file("misses"), &j.truth, &j.finds, shape, false)?;
        picture::sheet(&file("first"), &j.truth, &j.finds, shape, true)
    }

    /// Reports a table of classes and adds the figures.
    fn report(&mut self, j: &JudgeInputs, model: &Path) {
        let words = [
            "class",
            "truth",
            "found",
            "AP50",
            "AP",
            "AP50 VOC",
            "best F1",
            "at score",
            "score error",
            "mask AP50",
            "mask AP",
        ];
        let outcomes = j.outcomes();
        let error = |class| reliability::expected_error(j.of_class(&outcomes, class));
        let mut rows = vec![words.map(str::to_owned).to_vec()];
        let percent = |v: f64| if v.is_nan() { "-".to_owned() } else { format!("{:.1} %", v * 100.0) };
        for (k, (name, c)) in j.truth.classes.iter().zip(&j.boxes.classes).enumerate() {
            let m = j.masks.as_ref().map(|m| &m.classes[k]);
            rows.push(vec![
                name.clone(),
                c.truths.to_string(),
                c.finds.to_string(),
                j.bounds
                    .as_ref()
                    .map_or_else(|| percent(c.ap[0]), |b| format!("{} %", folds::words(c.ap[0], b.classes[k]))),
                percent(c.mean_ap()),
                percent(c.voc),
                percent(c.best_f1.0),
                format!("{:.2}", c.best_f1.1),
                percent(error(Some(k))),
                m.map_or_else(String::new, |m| percent(m.ap[0])),
                m.map_or_else(String::new, |m| percent(m.mean_ap())),
            ]);
        }
        note!(
            self.session,
            "{} on {}: {} frames, {:.1} ms each",
            model.display(),
            j.case,
            j.truth.pictures.len(),
            j.ms
        );
        self.session.table(&table(&rows));
        note!(
            self.session,
            "expected calibration error of boxes of {} and more, all classes: {}",
            folds::FLOOR,
            percent(error(None))
        );
        if let Some(bounds) = &j.bounds {
            note!(
                self.session,
                "mAP50 and what 95 % of samples of blocks of frames lie between: {} %",
                folds::words(j.boxes.ap_at(0), bounds.mean)
            );
        }
        let input =
            format!("{}, {} frames", model.file_name().unwrap_or_default().to_string_lossy(), j.truth.pictures.len());
        self.add_figures(j, &input, error(None));
    }

    /// Adds the figures of a model; `calibration_error` is that of all classes.
    fn add_figures(&mut self, j: &JudgeInputs, input: &str, calibration_error: f64) {
        let mut figure = |name: String, value: f64| {
            if !value.is_nan() {
                self.figures.push(Figure::new(&name, value, "1", input));
            }
        };
        let case = &j.case;
        if j.node == Node::Yolo {
            // The only figure with a separate name.
            let name = if case == "left_out" { "map50_left_out".to_owned() } else { format!("map50/{case}") };
            if let Some(bounds) = &j.bounds {
                figure(format!("{name}_low"), bounds.mean[0]);
                figure(format!("{name}_high"), bounds.mean[1]);
            }
            figure(name, j.boxes.ap_at(0));
            figure(format!("map50_voc/{case}"), j.boxes.voc());
            figure(format!("map/{case}"), j.boxes.ap());
            figure(format!("calibration_error/{case}"), calibration_error);
            for (name, c) in j.truth.classes.iter().zip(&j.boxes.classes) {
                figure(format!("ap50/{case}/{name}"), c.ap[0]);
            }
        } else {
            figure(format!("mask_box_ap50/{case}"), j.boxes.ap_at(0));
            if let Some(m) = &j.masks {
                figure(format!("mask_ap/{case}"), m.ap());
                figure(format!("mask_ap50/{case}"), m.ap_at(0));
                for (name, c) in j.truth.classes.iter().zip(&m.classes) {
                    figure(format!("mask_ap50/{case}/{name}"), c.ap[0]);
                }
            }
        }
    }

    fn test(&mut self) -> Result<()> {
        let Some(folder) = self.data("test", "m2cai16-tool-locations") else { return Ok(()) };
        let Some(model) = self.model("test", self.detector(), "--model") else { return Ok(()) };
        let truth = truth::read(self.session, &folder, Some("test"), None)?;
        self.judge("test", Node::Yolo, &model, truth, true)
    }

    fn held_out(&mut self) -> Result<()> {
        let Some(folder) = self.data("left_out", "m2cai16-tool-locations") else { return Ok(()) };
        let model = self.options.held_out_model.clone();
        let Some(model) = self.model("left_out", model, "--left-out-model (trained with --without)") else {
            return Ok(());
        };
        let mut truth = truth::read(self.session, &folder, Some("trainval"), None)?.only(&self.options.held_out);
        let more = truth::read(self.session, &folder, Some("test"), None)?.only(&self.options.held_out);
        truth.pictures.extend(more.ordered(&truth.classes).pictures);
        if truth.pictures.is_empty() {
            bail!("no frame belongs to the operations {}", self.options.held_out.join(", "));
        }
        self.judge("left_out", Node::Yolo, &model, truth, true)
    }

    fn polygons(&mut self) -> Result<()> {
        let Some(folder) = self.data("polygons", "cholec_polygons") else { return Ok(()) };
        let Some(model) = self.model("polygons", self.segmenter(), "--masks") else { return Ok(()) };
        self.one("polygons", Node::MaskRcnn, &model, truth::read(self.session, &folder, None, None)?)
    }

    fn phantom(&mut self) -> Result<()> {
        let Some(model) = self.model("phantom", self.segmenter(), "--masks") else { return Ok(()) };
        let scratch = Folder::new("panoscope-phantom")?;
        let truth = phantom::frames(self.session, &scratch)?;
        self.one("phantom", Node::MaskRcnn, &model, truth)
    }

    fn tips(&mut self) -> Result<()> {
        let mut cases = vec![("true_masks", phantom::From::TrueMasks)];
        let (masks, boxes) = (self.segmenter(), self.detector());
        if let Some(model) = &masks {
            cases.push(("masks", phantom::From::Model(Node::MaskRcnn, model)));
        }
        if let Some(model) = &boxes {
            cases.push(("boxes", phantom::From::Model(Node::Yolo, model)));
        }
        for (name, from) in cases {
            let tips = phantom::tips(self.session, from)?;
            self.report_tips(name, &tips, &format!("phantom 640x360, one instrument, {} tips", tips.seen));
        }
        let Some(folder) = self.data("tips on real pictures", "cholec_polygons") else { return Ok(()) };
        let truth = truth::read(self.session, &folder, None, None)?;
        for (name, node, model) in [("real_masks", Node::MaskRcnn, masks), ("real_boxes", Node::Yolo, boxes)] {
            let Some(model) = model else { continue };
            let tips = real_tips::run(self.session, &truth, node, &model)?;
            self.report_tips(
                name,
                &tips,
                &format!("{} real pictures, {} ends of outlines", truth.pictures.len(), tips.seen),
            );
        }
        Ok(())
    }

    /// Counts what the nodes find in images without instruments.
    fn no_instruments(&mut self) -> Result<()> {
        let scratch = Folder::new("panoscope-empty")?;
        let mut sources = Vec::new();
        if let Some(own) = &self.options.images {
            sources.push(("images", no_instruments::folder(own, false)?));
        } else {
            sources.push(("rendered", no_instruments::rendered(self.session, &scratch)?));
            for (path, name) in no_instruments::FOLDERS {
                if let Some(folder) = self.data("no_instruments", path) {
                    sources.push((name, no_instruments::folder(&folder, true)?));
                }
            }
        }
        let models = [self.detector(), self.segmenter()];
        for (name, mut truth) in sources {
            let models = models.each_ref().map(Option::as_deref);
            let found = no_instruments::run(self.session, &mut truth, models, &self.options.settings)?;
            if let Some(folder) = &self.options.pictures {
                no_instruments::draw(folder, name, &truth, &found)?;
            }
            let frames = truth.pictures.len();
            for (what, finds) in [("boxes", &found.boxes), ("masks", &found.masks)] {
                let (count, with, classes) = no_instruments::counts(&truth, finds);
                self.report_false(&format!("{what}/{name}"), (count, with), frames, &classes);
            }
            for (what, count) in ["box_tips", "mask_tips"].iter().zip(found.tips) {
                self.report_false(&format!("{what}/{name}"), (count, count), frames, "");
            }
            check_cancelled(self.session)?;
        }
        Ok(())
    }

    /// Reports `count` false finds, in `with` of `frames` images, and adds them per 100 images.
    fn report_false(&mut self, name: &str, (count, with): (usize, usize), frames: usize, classes: &str) {
        let [low, high] = no_instruments::interval(with, frames).map(|share| 100.0 * share);
        let share = 100.0 * with as f64 / frames.max(1) as f64;
        note!(
            self.session,
            "false {name}: {count} in {with} of {frames} images ({share:.1} %, 95 % interval {low:.1} to {high:.1} %) {classes}"
        );
        let input = format!("{frames} images without instruments");
        let per_hundred = 100.0 * count as f64 / frames.max(1) as f64;
        self.figures.push(Figure::new(&format!("false_{name}"), per_hundred, "1/100 images", &input));
    }

    fn report_tips(&mut self, name: &str, tips: &Tips, input: &str) {
        let found = tips.errors_px.len();
        let in_space = if tips.errors_mm.is_empty() {
            String::new()
        } else {
            format!(", {:.2} mm", Tips::median(&tips.errors_mm))
        };
        note!(
            self.session,
            "tips from {name}: {found} of {} found, median {:.1} px{in_space}",
            tips.seen,
            Tips::median(&tips.errors_px)
        );
        let one = |k: &(String, usize, usize, f64)| format!("{} {}/{} {:.1} px", k.0, k.2, k.1, k.3);
        note!(self.session, "  {}", tips.kinds.iter().map(one).collect::<Vec<_>>().join(", "));
        let mut figure = |what: &str, value: f64, unit| {
            if !value.is_nan() {
                self.figures.push(Figure::new(&format!("{what}/{name}"), value, unit, input));
            }
        };
        figure("tip_error_px", Tips::median(&tips.errors_px), "px");
        figure("tip_error_mm", Tips::median(&tips.errors_mm), "mm");
        figure("tip_found", found as f64 / tips.seen.max(1) as f64, "1");
    }

    /// Evaluates the given ground truth.
    fn given(&mut self, path: &Path) -> Result<()> {
        let a = self.options;
        let truth = truth::read(self.session, path, a.split.as_deref(), a.images.as_deref())?;
        let case = a.split.clone().unwrap_or_else(|| "given".to_owned());
        if let Some(model) = a.masks.as_ref() {
            self.one(&case, Node::MaskRcnn, model, truth.clone())?;
        }
        let model = self.detector().filter(|_| a.model.is_some() || a.masks.is_none());
        if let Some(model) = model {
            return self.one(&case, Node::Yolo, &model, truth);
        }
        if a.masks.is_none() {
            note!(self.session, "skipped: {case}: no model; name one with --model or --masks");
        }
        Ok(())
    }
}

/// Result of [`judge`].
pub struct Judgement {
    /// All figures.
    pub figures: Vec<Figure>,
    judged: Vec<JudgeInputs>,
}

impl Judgement {
    /// Tables 5.1 to 5.5 of the thesis as Markdown.
    pub fn tables(&self) -> String {
        tables::all(&self.judged)
    }
}

/// Evaluates the models on each requested case whose data is available, or on the given ground truth.
///
/// # Errors
/// A model is missing, a file has the wrong content, a run fails, a self-check disagrees, or the session is cancelled.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Judgement> {
    for model in [&options.model, &options.masks, &options.held_out_model].into_iter().flatten() {
        if !model.is_file() {
            return Err(EvalError::Options { reason: format!("there is no model {}", model.display()) });
        }
    }
    let folders = options.data.iter().cloned().chain(usual_data()).collect();
    create(options.pictures.as_deref())?;
    let mut judge = Judge { session, options, folders, judged: Vec::new(), figures: Vec::new() };
    if let Some(path) = &options.truth {
        judge.given(path)?;
    } else {
        for case in CASES.iter().filter(|case| wants(&options.cases, case)) {
            match *case {
                "test" => judge.test()?,
                "left_out" => judge.held_out()?,
                "polygons" => judge.polygons()?,
                "phantom" => judge.phantom()?,
                "no_instruments" => judge.no_instruments()?,
                _ => judge.tips()?,
            }
            check_cancelled(session)?;
        }
    }
    Ok(Judgement { figures: judge.figures, judged: judge.judged })
}
