//! `yolo`: a detector of any common family, on the newest image (thesis, chapter 5).

use std::path::PathBuf;

use panoscope_imaging::lit::HeldMask;
use panoscope_node::abi::{Detection, Scalar, Tip};
use panoscope_node::{
    AnyImage, Bgr8, Choice, Context, Gray8, Image, LabeledDetections, Mask, Node, NodeInfo, Open, Parallel, Params,
    Ports, Result, Slot, TableData, TextPacket, Validation, View, error,
};
use serde::Deserialize;

use crate::calibration::{Calibration, Rule};
use crate::candidates::{Candidate, Decoder, Suppression, keep_lit, suppress};
use crate::export_kind::{ExportKind, recognise};
use crate::finite::count_bad;
use crate::keypoints::{KeypointShape, Keypoints};
use crate::labels;
use crate::letterbox::Letterbox;
use crate::model::Model;
use crate::pictures::{self, Familiarity, Unlike};
use crate::provider::Provider;
use crate::tip_map;
use crate::track::Tracker;

/// Input ports of `yolo`.
#[derive(Ports)]
pub struct In<'f> {
    /// Image to search, bgr8 or gray8.
    image: AnyImage<'f>,
    /// Nonzero where the image is illuminated. Boxes that are more than half outside are dropped. Unconnected: the whole image.
    mask: Option<Image<'f, Mask>>,
}

/// Output ports of `yolo`.
#[derive(Ports)]
pub struct Out<'f> {
    /// Boxes in px of the image, highest score first, with their labels. If the model has a calibration, scores are probabilities, and the last label
    /// is `unknown`: an instrument of uncertain kind.
    detections: Slot<'f, LabeledDetections>,
    /// How unlike the model's training images the last images are, smoothed, as a share of the model's limit. From 1 on the model is unreliable for
    /// such images. Empty if the model has no image statistics. Metric `unlike` is 1 while it is above.
    unlikeness: Slot<'f, Scalar>,
    /// Message for a screen while the images are too unlike the training images; otherwise empty text.
    text: Slot<'f, TextPacket>,
    /// First keypoint of the box with the highest score, in px, without a position in space. Empty if the model outputs no keypoints or finds
    /// nothing.
    tip0: Slot<'f, Tip>,
    /// Second keypoint of that box.
    tip1: Slot<'f, Tip>,
    /// Third keypoint of that box.
    tip2: Slot<'f, Tip>,
    /// Fourth keypoint of that box.
    tip3: Slot<'f, Tip>,
    /// All keypoints of all boxes, one per row: index of its box in `detections`, index of the keypoint, position in px, score. Empty if the model
    /// outputs no keypoints. The shipped detector has one keypoint, the tip; connect it to `keypoints` of `tool_tip`.
    keypoints: Slot<'f, TableData>,
}

/// Families of exports.
#[derive(Choice, Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// Recognised from shapes and metadata.
    #[default]
    Auto,
    /// YOLOX as its tools export it: boxes relative to the grid.
    Yolox,
    /// YOLOX with boxes decoded inside.
    YoloxDecoded,
    /// YOLOv5 and v7: three anchors per cell.
    Yolov5,
    /// YOLOv8 and later, without non-maximum suppression inside; the metadata state whether it outputs keypoints.
    Yolov8,
    /// Corners, score, class: YOLOv10, YOLO26.
    EndToEnd,
    /// DETR family.
    Detr,
}

impl Layout {
    /// The named kind of export, if it is not `auto`. `keypoints`: number of keypoint values per box.
    pub(crate) fn kind(self, keypoints: usize) -> Option<ExportKind> {
        match self {
            Self::Auto => None,
            Self::Yolox => Some(ExportKind::YoloxRaw),
            Self::YoloxDecoded => Some(ExportKind::YoloxDecoded),
            Self::Yolov5 => Some(ExportKind::YoloV5),
            Self::Yolov8 => Some(ExportKind::YoloV8 { extra: keypoints }),
            Self::EndToEnd => Some(ExportKind::EndToEnd),
            Self::Detr => Some(ExportKind::Detr),
        }
    }
}

/// Parameters of `yolo`.
#[derive(Params)]
pub struct YoloParams {
    /// ONNX file of the network.
    #[param(default = "models/instruments.onnx", reopen, must_exist, shipped)]
    model: PathBuf,
    /// Family of the export.
    #[param(default = "auto", reopen)]
    layout: Layout,
    /// Minimum score of a box.
    #[param(default = 0.3, range = 0.001..=1.0, step = 0.01, unit = "ratio")]
    min_score: f32,
    /// Converts scores to the probability that a box and its class are correct, if the model has a calibration. Off: scores as the network outputs
    /// them, and no `unknown`.
    #[param(default = true)]
    calibrated: bool,
    /// Minimum probability of a box's class, given that the box is on an instrument. Below it the class is reported as `unknown`, with the
    /// probability of any instrument as score. 0 always names the most probable class. Takes effect if the model's calibration includes objectness.
    #[param(default = 0.5, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    unknown_below: f32,
    /// Applies the minimum probability of each class that the model contains, at which the share of correct boxes was as large as requested at its
    /// export, if it is above `min_score`.
    #[param(default = false)]
    class_limits: bool,
    /// Overlap (intersection over union) above which the box with the lower score is dropped.
    #[param(default = 0.5, range = 0.05..=1.0, step = 0.05, unit = "ratio")]
    max_overlap: f32,
    /// Boxes of different classes also suppress each other.
    #[param(default = false)]
    class_agnostic: bool,
    /// Maximum number of boxes in the output.
    #[param(default = 50, range = 1..=1000)]
    max_boxes: usize,
    /// File with the names of the classes, one per line. Empty: the names in the model file.
    #[param(default = "", reopen)]
    labels: PathBuf,
    /// Width of the network's input, for models that accept any size.
    #[param(default = 640, range = 32..=4096, step = 32, unit = "px", reopen)]
    input_width: usize,
    /// Height of the network's input, for models that accept any size.
    #[param(default = 640, range = 32..=4096, step = 32, unit = "px", reopen)]
    input_height: usize,
    /// Gives each tool a number (`track_id`) that it keeps over time.
    #[param(default = true)]
    track: bool,
    /// Gives a tracked tool the class that it had most often: votes are weighted by score, and their weight halves after this time. 0: the class in
    /// each image. Best with boxes of one class per tool (`class_agnostic`).
    #[param(default = 0.0, range = 0.0..=60.0, step = 0.1, unit = "s")]
    vote_s: f32,
    /// Time constant of the smoothing of `unlikeness`.
    #[param(default = 2.0, range = 0.0..=60.0, step = 0.1, unit = "s")]
    unlike_s: f32,
    /// What happens to the boxes while `unlikeness` is 1 or more.
    #[param(default = "keep")]
    unlike: Unlike,
    /// Number of threads of the network; 0 uses as many as the host has.
    #[param(default = 0, range = 0..=64, reopen)]
    threads: usize,
    /// Execution provider: the processor, or an accelerator if ONNX Runtime's library supports it and finds a device. Otherwise the processor is
    /// used, with a warning.
    #[param(default = "cpu", reopen)]
    provider: Provider,
}

/// Label of an instrument of uncertain kind.
pub const UNKNOWN: &str = "unknown";

/// What detectors and segmenters share: a model, its input, its labels.
pub(crate) struct Network {
    pub model: Model,
    pub letterbox: Letterbox,
    pub labels: String,
    pub path: PathBuf,
    pub damage: Damage,
}

/// Warns once of values that are not finite, and once of boxes that were left out.
#[derive(Default)]
pub(crate) struct Damage {
    is_warned: bool,
    is_limit_said: bool,
}

impl Damage {
    /// Reports `bad` values of one run that are NaN or infinite: rows with such values give no boxes.
    pub fn report(&mut self, cx: &Context<'_>, path: &std::path::Path, bad: usize) {
        cx.metric("bad_values", bad as f64);
        if bad > 0 && !self.is_warned {
            self.is_warned = true;
            cx.warn(&format!(
                "{} returned {bad} values that are NaN or infinite; rows with such values give no boxes (metric `bad_values` counts them)",
                path.display()
            ));
        }
    }

    /// Reports the boxes of one run that `max`, the value of the parameter `param`, left out.
    pub fn report_left_out(&mut self, cx: &Context<'_>, left_out: usize, (param, max): (&str, usize)) {
        cx.metric("left_out", left_out as f64);
        if left_out > 0 && !self.is_limit_said {
            self.is_limit_said = true;
            cx.warn(&format!("{left_out} boxes beyond `{param}` = {max} were left out (metric `left_out` counts them); raise `{param}` or `min_score`"));
        }
    }
}

impl Network {
    pub fn open(
        open: &Open<'_>,
        model: &std::path::Path,
        threads: usize,
        size: (usize, usize),
        provider: Provider,
    ) -> Result<Self> {
        let threads = if threads == 0 { open.pool().threads() } else { threads };
        // Paths come resolved against the graph file's folder.
        let path = model.to_owned();
        let model = Model::open(model, threads, size, provider)?;
        provider.warn_if_refused(open, &path, model.refused());
        Ok(Self { model, letterbox: Letterbox::default(), labels: String::new(), path, damage: Damage::default() })
    }

    /// Fills the label table, see [`labels::table`].
    pub fn name_classes(&mut self, file: &std::path::Path, classes: usize) -> Result<()> {
        self.labels = labels::table(self.model.path(), self.model.metadata("names"), file, classes)?;
        Ok(())
    }

    /// Adds the class [`UNKNOWN`] to the label table, if it is `wanted`; returns its index.
    pub fn add_unknown(&mut self, wanted: bool) -> Option<u32> {
        let index = self.labels.lines().count() as u32;
        wanted.then(|| {
            self.labels.push('\n');
            self.labels.push_str(UNKNOWN);
            index
        })
    }
}

/// Reports a file of labels that cannot be used.
pub(crate) fn check_labels(check: &mut Validation<'_>, file: &std::path::Path) {
    if !file.as_os_str().is_empty()
        && let Err(error) = labels::from_file(file)
    {
        check.error("labels", error.to_string(), "");
    }
}

/// Finds tools in an image.
pub struct Yolo {
    network: Network,
    kind: ExportKind,
    calibration: Option<Calibration>,
    /// Index of the class `unknown`, if the label table has it.
    unknown: Option<u32>,
    familiarity: Familiarity,
    keypoints: Keypoints,
    candidates: Vec<Candidate>,
    items: Vec<Detection>,
    lit: HeldMask,
    tracker: Tracker,
}

/// Pixels of an image of either format.
pub(crate) fn picture_of<'f>(image: &AnyImage<'f>) -> Result<View<'f, u8>> {
    if let Some(bgr) = image.as_plane::<Bgr8>() {
        return Ok(bgr.view());
    }
    match image.as_plane::<Gray8>() {
        Some(gray) => Ok(gray.view()),
        None => Err(error!("`image` is neither bgr8 nor gray8")),
    }
}

pub(crate) fn detection(c: &Candidate) -> Detection {
    let [x0, y0, x1, y1] = c.corners;
    Detection {
        x_px: x0,
        y_px: y0,
        width_px: x1 - x0,
        height_px: y1 - y0,
        score: c.score,
        class_index: c.class_index,
        track_id: -1,
    }
}

impl Node for Yolo {
    const INFO: NodeInfo = NodeInfo::blocking("yolo", "tools", "Finds surgical tools with a detector network.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = YoloParams;

    fn validate(params: &YoloParams, check: &mut Validation<'_>) {
        check_labels(check, &params.labels);
    }

    fn open(open: &Open<'_>, params: &YoloParams) -> Result<Self> {
        let size = (params.input_width, params.input_height);
        let mut network = Network::open(open, &params.model, params.threads, size, params.provider)?;
        network.model.refuse_tasks(
            &["obb", "classify"],
            "`yolo` reads upright boxes and keypoints; export a model that detects",
        )?;
        // One run on a gray picture gives the shapes of the outputs and warms the network up.
        let (w, h) = network.model.input_size();
        let gray = vec![0.5f32; 3 * w * h];
        let path = network.model.path().to_owned();
        let end_to_end = network.model.metadata("end2end").is_some_and(|v| v.eq_ignore_ascii_case("true"));
        let pose = network.model.metadata("kpt_shape").and_then(KeypointShape::from_metadata).unwrap_or_default();
        let chosen = params.layout.kind(pose.len());
        let (kind, classes, channels, has_tips) = network.model.run(&gray, |outputs| -> Result<_> {
            let (outputs, tips) = tip_map::split(outputs);
            tips.map_or(Ok(()), |tips| tip_map::check(tips).map_err(|e| error!("{}: {e}", path.display())))?;
            let (outputs, features) = pictures::split(outputs);
            let kind = chosen.map_or_else(|| recognise(&path, (w, h), end_to_end, pose.len(), outputs), Ok)?;
            count_bad(&path, outputs, kind.rows())?;
            let channels = features.and_then(|tensor| tensor.shape.get(1).copied());
            Ok((kind, kind.classes(outputs), channels, tips.is_some()))
        })??;
        network.name_classes(&params.labels, classes)?;
        let calibration =
            Calibration::read(classes.max(network.labels.lines().count()), |key| network.model.metadata(key))
                .map_err(|e| error!("{}: {e}", network.path.display()))?;
        let familiarity =
            Familiarity::new(&network.model, channels).map_err(|e| error!("{}: {e}", network.path.display()))?;
        let unknown = network.add_unknown(calibration.as_ref().is_some_and(|c| c.objectness.is_some()));
        Ok(Self {
            network,
            kind,
            calibration,
            unknown,
            familiarity,
            keypoints: Keypoints::new(pose, has_tips),
            candidates: Vec::new(),
            items: Vec::new(),
            lit: HeldMask::default(),
            tracker: Tracker::default(),
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &YoloParams) -> Result<()> {
        let picture = picture_of(&input.image)?;
        let size = self.network.model.input_size();
        let form = self.kind.pixel_form();
        let placement = self.network.letterbox.fit(picture, size, &form, cx.pool());
        let rule = self.calibration.as_ref().filter(|_| params.calibrated).map(|calibration| Rule {
            calibration,
            min_score: params.min_score,
            unknown_below: params.unknown_below,
            unknown: self.unknown.unwrap_or(u32::MAX),
            own_limits: params.class_limits,
        });
        let (min_score, min_objectness) = rule.map_or((params.min_score, f32::INFINITY), |rule| rule.floors());
        let mut decoder = Decoder {
            kind: self.kind,
            input: size,
            placement,
            picture: (picture.width, picture.height),
            min_score,
            min_objectness,
            out: &mut self.candidates,
        };
        let Network { model, letterbox, labels, path, damage } = &mut self.network;
        let rows = self.kind.rows();
        let (familiarity, keypoints, kind) = (&mut self.familiarity, &mut self.keypoints, self.kind);
        let (bad, unlikeness) = model.run(&letterbox.input, |outputs| -> Result<_> {
            let (outputs, tips) = tip_map::split(outputs);
            let (outputs, features) = pictures::split(outputs);
            let unlikeness = familiarity.unlikeness(features, placement.size);
            let bad = count_bad(path, outputs, rows)?;
            decoder.decode(outputs)?;
            keypoints.collect(outputs, kind, decoder.out, &placement);
            keypoints.copy_map(tips, &placement);
            Ok((bad, unlikeness))
        })??;
        damage.report(cx, path, bad);
        if let Some(unlikeness) = unlikeness {
            let smoothed = familiarity.add(cx, path, unlikeness, params.unlike_s);
            out.unlikeness.set_scalar("unlikeness", f64::from(smoothed), "")?;
        }
        if out.text.is_read() {
            out.text.set_text(familiarity.message(params.unlike))?;
        }
        if familiarity.drops(params.unlike) {
            self.candidates.clear();
        }
        if let Some(rule) = &rule {
            rule.apply(&mut self.candidates);
        }
        self.lit.update(input.mask.as_ref().map(Image::view));
        keep_lit(&mut self.candidates, &self.lit, (picture.width, picture.height));
        let suppression = Suppression {
            max_overlap: params.max_overlap,
            is_agnostic: params.class_agnostic,
            max_boxes: params.max_boxes,
            unknown: self.unknown,
        };
        let left_out = suppress(&mut self.candidates, &suppression);
        damage.report_left_out(cx, left_out, ("max_boxes", params.max_boxes));
        self.keypoints.find_tips(&self.candidates);
        self.items.clear();
        self.items.extend(self.candidates.iter().map(detection));
        if params.track {
            self.tracker.follow(&mut self.items, cx.tick().capture_ns, params.vote_s, self.unknown);
        }
        let tips = [&mut out.tip0, &mut out.tip1, &mut out.tip2, &mut out.tip3];
        self.keypoints.write(&self.candidates, &self.items, tips, &mut out.keypoints)?;
        out.detections.set_detections(&self.items, labels, (picture.width, picture.height))
    }
}
