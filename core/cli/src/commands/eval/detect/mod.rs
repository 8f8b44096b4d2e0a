//! `panoscope eval detect`: detectors and segmenters beside true boxes, outlines and tips (thesis, chapter 5).
//!
//! Pictures go through the real nodes, run by the engine; what they find is judged by COCO's and VOC's rules ([`score`]).

mod find;
mod mask;
mod phantom;
mod picture;
mod score;
mod selfcheck;
mod tables;
mod truth;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use self::find::Node;
pub use self::find::{Scratch, quoted};
use self::phantom::Tips;
use self::score::{Find, Scores, Shape, score};
use self::truth::Truth;
use crate::commands::bench::record::Figure;
use crate::terminal::{raw, table, tell};

/// Where the models that ship stand, seen from the repository and from an installed folder.
const MODELS: &str = "plugins/tools/models";

/// Another program that judges the same finds.
#[derive(Clone, Copy, clap::ValueEnum)]
enum SelfCheck {
    /// COCO's own tools for Python.
    Pycocotools,
}

/// Arguments of `eval detect`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Only these cases; may be given again. Without it all: `test` (official test split), `left_out` (whole operations that the
    /// model never saw), `polygons` (real frames with outlines), `phantom` (held-out scenes), `tips` (tips on the phantom).
    #[arg(long, value_parser = CASES)]
    case: Vec<String>,
    /// Detector; else the one that ships.
    #[arg(long, value_name = "FILE.onnx")]
    model: Option<PathBuf>,
    /// Segmenter; else the one that ships.
    #[arg(long, value_name = "FILE.onnx")]
    masks: Option<PathBuf>,
    /// Detector trained without the operations of --left-out, for the case `left_out`.
    #[arg(long, value_name = "FILE.onnx")]
    left_out_model: Option<PathBuf>,
    /// Operations of the case `left_out`.
    #[arg(long, value_delimiter = ',', default_value = "v02,v08", value_name = "NAMES")]
    left_out: Vec<String>,
    /// Own truth instead of the cases: a COCO or VIA file, or a folder of VOC, labelme or YOLO truth. Judges --model, and --masks where it is given.
    #[arg(long, value_name = "PATH")]
    truth: Option<PathBuf>,
    /// Which split of --truth: a list of VOC's ImageSets, a COCO file, a YOLO folder.
    #[arg(long, value_name = "NAME")]
    split: Option<String>,
    /// Folder of the pictures of --truth, where they are not beside it.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Folder of data sets, searched before the usual ones. May be given again.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    /// Sets a parameter of the node, as in a graph file. May be given again.
    #[arg(long, value_name = "PARAM=VALUE")]
    set: Vec<String>,
    /// Judges the same finds with another program, and fails where figures differ in the fourth decimal.
    #[arg(long, value_enum, value_name = "PROGRAM")]
    selfcheck: Option<SelfCheck>,
    /// Python of --selfcheck.
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: PathBuf,
    /// Folder for pictures: curves, confusions, contact sheets of the worst misses.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Writes tables 5.1 to 5.5 of the thesis as Markdown; `-` shows them.
    #[arg(long, value_name = "FILE.md")]
    tables: Option<PathBuf>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

const CASES: [&str; 5] = ["test", "left_out", "polygons", "phantom", "tips"];

/// A model judged on a case.
struct Judged {
    case: String,
    node: Node,
    truth: Truth,
    finds: Vec<Vec<Find>>,
    boxes: Scores,
    masks: Option<Scores>,
    ms: f64,
}

/// What the cases share.
struct Judge<'a> {
    arguments: &'a Arguments,
    folders: Vec<PathBuf>,
    judged: Vec<Judged>,
    figures: Vec<Figure>,
}

/// A model that ships: beside the program when installed, else in the repository.
pub fn shipped(name: &str) -> Option<PathBuf> {
    let program = std::env::current_exe().ok();
    let folders = program.iter().flat_map(|p| p.ancestors().skip(1).take(4)).map(Path::to_owned);
    let mut all = std::iter::once(PathBuf::new()).chain(folders);
    all.find_map(|f| Some(f.join(MODELS).join(name)).filter(|p| p.is_file()))
}

impl Judge<'_> {
    fn detector(&self) -> Option<PathBuf> {
        self.arguments.model.clone().or_else(|| shipped("instruments.onnx"))
    }

    fn segmenter(&self) -> Option<PathBuf> {
        self.arguments.masks.clone().or_else(|| shipped("instrument_masks.onnx"))
    }

    /// A data set in the folders that are searched, or words that it is skipped.
    fn data(&self, case: &str, name: &str) -> Option<PathBuf> {
        let found = self.folders.iter().map(|f| f.join(name)).find(|p| p.is_dir());
        if found.is_none() {
            let looked: Vec<String> = self.folders.iter().map(|f| f.display().to_string()).collect();
            tell!("skipped: {case}: there is no {name} in {}; name its folder with --data", looked.join(", "));
        }
        found
    }

    fn model(&self, case: &str, model: Option<PathBuf>, option: &str) -> Option<PathBuf> {
        if model.is_none() {
            tell!("skipped: {case}: no model; name one with {option}");
        }
        model
    }

    /// Runs, scores, draws, compares; adds figures.
    fn one(&mut self, case: &str, node: Node, model: &Path, truth: Truth) -> Result<()> {
        let found = find::run(node, model, &truth, &self.arguments.set)?;
        let objects: Vec<_> = truth.pictures.iter().map(|p| p.objects.clone()).collect();
        let classes = truth.classes.len();
        let boxes = score(&objects, &found.finds, classes, Shape::Box);
        let with_masks = node == Node::MaskRcnn && truth.has_masks();
        let masks = with_masks.then(|| score(&objects, &found.finds, classes, Shape::Mask));
        if self.arguments.selfcheck.is_some() {
            selfcheck::compare(&self.arguments.python, &truth, &found.finds, Shape::Box, &boxes)?;
            if let Some(masks) = &masks {
                selfcheck::compare(&self.arguments.python, &truth, &found.finds, Shape::Mask, masks)?;
            }
        }
        let judged = Judged { case: case.to_owned(), node, truth, finds: found.finds, boxes, masks, ms: found.ms };
        self.draw(&judged)?;
        self.tell(&judged, model);
        self.judged.push(judged);
        Ok(())
    }

    fn draw(&self, j: &Judged) -> Result<()> {
        let Some(folder) = &self.arguments.pictures else { return Ok(()) };
        let (shape, scores) = match &j.masks {
            Some(masks) => (Shape::Mask, masks),
            None => (Shape::Box, &j.boxes),
        };
        let file = |what: &str| folder.join(format!("{}_{}_{what}.png", j.case, j.node.name()));
        let title = format!("{} on {} ({} frames)", j.node.name(), j.case, j.truth.pictures.len());
        picture::curves(&file("curves"), &title, &j.truth.classes, scores)?;
        let counts = picture::confusion(&j.truth, &j.finds, shape);
        picture::confusion_picture(&file("confusion"), &title, &j.truth.classes, &counts)?;
        picture::sheet(&file("misses"), &j.truth, &j.finds, shape, false)?;
        picture::sheet(&file("first"), &j.truth, &j.finds, shape, true)
    }

    /// Shows a table of classes and notes the figures.
    fn tell(&mut self, j: &Judged, model: &Path) {
        let words =
            ["class", "truth", "found", "AP50", "AP", "AP50 VOC", "best F1", "at score", "mask AP50", "mask AP"];
        let mut rows = vec![words.map(str::to_owned).to_vec()];
        let percent = |v: f64| if v.is_nan() { "-".to_owned() } else { format!("{:.1} %", v * 100.0) };
        for (k, (name, c)) in j.truth.classes.iter().zip(&j.boxes.classes).enumerate() {
            let m = j.masks.as_ref().map(|m| &m.classes[k]);
            rows.push(vec![
                name.clone(),
                c.truths.to_string(),
                c.finds.to_string(),
                percent(c.ap[0]),
                percent(c.mean_ap()),
                percent(c.voc),
                percent(c.best_f1.0),
                format!("{:.2}", c.best_f1.1),
                m.map_or_else(String::new, |m| percent(m.ap[0])),
                m.map_or_else(String::new, |m| percent(m.mean_ap())),
            ]);
        }
        tell!("{} on {}: {} frames, {:.1} ms each", model.display(), j.case, j.truth.pictures.len(), j.ms);
        raw(&table(&rows));
        let input =
            format!("{}, {} frames", model.file_name().unwrap_or_default().to_string_lossy(), j.truth.pictures.len());
        let mut figure = |name: String, value: f64| {
            if !value.is_nan() {
                self.figures.push(Figure::new(&name, value, "1", &input));
            }
        };
        let case = &j.case;
        if j.node == Node::Yolo {
            // The one figure that has a name of its own.
            let name = if case == "left_out" { "map50_left_out".to_owned() } else { format!("map50/{case}") };
            figure(name, j.boxes.ap_at(0));
            figure(format!("map50_voc/{case}"), j.boxes.voc());
            figure(format!("map/{case}"), j.boxes.ap());
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
        let truth = truth::read(&folder, Some("test"), None)?;
        self.one("test", Node::Yolo, &model, truth)
    }

    fn left_out(&mut self) -> Result<()> {
        let Some(folder) = self.data("left_out", "m2cai16-tool-locations") else { return Ok(()) };
        let model = self.arguments.left_out_model.clone();
        let Some(model) = self.model("left_out", model, "--left-out-model (trained with --without)") else {
            return Ok(());
        };
        let mut truth = truth::read(&folder, Some("trainval"), None)?.only(&self.arguments.left_out);
        let more = truth::read(&folder, Some("test"), None)?.only(&self.arguments.left_out);
        truth.pictures.extend(more.ordered(&truth.classes).pictures);
        if truth.pictures.is_empty() {
            anyhow::bail!("no frame is of the operations {}", self.arguments.left_out.join(", "));
        }
        self.one("left_out", Node::Yolo, &model, truth)
    }

    fn polygons(&mut self) -> Result<()> {
        let Some(folder) = self.data("polygons", "cholec_polygons") else { return Ok(()) };
        let Some(model) = self.model("polygons", self.segmenter(), "--masks") else { return Ok(()) };
        self.one("polygons", Node::MaskRcnn, &model, truth::read(&folder, None, None)?)
    }

    fn phantom(&mut self) -> Result<()> {
        let Some(model) = self.model("phantom", self.segmenter(), "--masks") else { return Ok(()) };
        let scratch = Scratch::new("phantom")?;
        let truth = phantom::frames(&scratch)?;
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
            let tips = phantom::tips(from)?;
            let found = tips.errors_px.len();
            tell!(
                "tips from {name}: {found} of {} found, median {:.1} px, {:.2} mm",
                tips.seen,
                Tips::median(&tips.errors_px),
                Tips::median(&tips.errors_mm)
            );
            let one = |k: &(&str, usize, usize, f64)| format!("{} {}/{} {:.1} px", k.0, k.2, k.1, k.3);
            tell!("  {}", tips.kinds.iter().map(one).collect::<Vec<_>>().join(", "));
            let input = format!("phantom 640x360, one instrument, {} tips", tips.seen);
            let mut figure = |what: &str, value: f64, unit| {
                if !value.is_nan() {
                    self.figures.push(Figure::new(&format!("{what}/{name}"), value, unit, &input));
                }
            };
            figure("tip_error_px", Tips::median(&tips.errors_px), "px");
            figure("tip_error_mm", Tips::median(&tips.errors_mm), "mm");
            figure("tip_found", found as f64 / tips.seen.max(1) as f64, "1");
        }
        Ok(())
    }

    /// The truth that was named.
    fn given(&mut self, path: &Path) -> Result<()> {
        let a = self.arguments;
        let truth = truth::read(path, a.split.as_deref(), a.images.as_deref())?;
        let case = a.split.clone().unwrap_or_else(|| "given".to_owned());
        if let Some(model) = a.masks.as_ref() {
            self.one(&case, Node::MaskRcnn, model, truth.clone())?;
        }
        let model = self.detector().filter(|_| a.model.is_some() || a.masks.is_none());
        if let Some(model) = model {
            return self.one(&case, Node::Yolo, &model, truth);
        }
        if a.masks.is_none() {
            tell!("skipped: {case}: no model; name one with --model or --masks");
        }
        Ok(())
    }
}

/// Judges; `None` when the arguments are wrong.
pub fn judge(arguments: &Arguments) -> Result<Option<Vec<Figure>>> {
    for model in [&arguments.model, &arguments.masks, &arguments.left_out_model].into_iter().flatten() {
        if !model.is_file() {
            tell!("error: there is no model {}", model.display());
            return Ok(None);
        }
    }
    let usual = ["target/data", "../shared/data", "../shared/data/instances"];
    let folders = arguments.data.iter().cloned().chain(usual.map(PathBuf::from)).collect();
    if let Some(folder) = &arguments.pictures {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    let mut judge = Judge { arguments, folders, judged: Vec::new(), figures: Vec::new() };
    if let Some(path) = &arguments.truth {
        judge.given(path)?;
    } else {
        for case in CASES.iter().filter(|c| arguments.case.is_empty() || arguments.case.iter().any(|a| a == *c)) {
            match *case {
                "test" => judge.test()?,
                "left_out" => judge.left_out()?,
                "polygons" => judge.polygons()?,
                "phantom" => judge.phantom()?,
                _ => judge.tips()?,
            }
            if crate::interrupt::asked() {
                anyhow::bail!("interrupted");
            }
        }
    }
    if let Some(path) = &arguments.tables {
        let text = tables::all(&judge.judged);
        if path == Path::new("-") {
            raw(&text);
        } else {
            std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
        }
    }
    Ok(Some(judge.figures))
}
