//! `data_set`: the images of a public data set with its calibration and ground truth. The layout of the folders identifies the data set.

mod truth;

use std::path::PathBuf;

use panoscope_data::data_sets::{DataSetError, Found, Labels, Pictures, Sequence, Stacked, find};
use panoscope_node::abi::{Calibration, Tip};
use panoscope_node::{
    Bgr8, Context, Depth, Disparity, LabeledDetections, LabeledInstances, NoPorts, Node, NodeError, NodeInfo, Open,
    Params, Ports, Result, Slot, Validation,
};

use crate::boxes::Boxes;
use crate::capture::{Capture, Part};
use crate::playing::Playing;
use crate::settings::{OnDamage, Pace, Settings, Split};
use crate::source::SourceName;
use truth::TruthMaps;

/// Maximum number of names that a message lists.
const LISTED: usize = 8;

/// Outputs, named as those of `phantom`. An output stays empty if the data set does not provide it.
#[derive(Ports)]
pub struct Out<'f> {
    /// Left view, or the only one.
    pub left: Slot<'f, Bgr8>,
    /// Right view.
    pub right: Slot<'f, Bgr8>,
    /// Calibration of both views, with the rectification that the ground truth refers to.
    pub calibration: Slot<'f, Calibration>,
    /// True disparity of the left rectified view, px; NaN where unknown.
    pub disparity: Slot<'f, Disparity>,
    /// True depth of the left rectified view, mm; NaN where unknown.
    pub depth: Slot<'f, Depth>,
    /// True boxes in the left view as stored, not rectified.
    pub detections: Slot<'f, LabeledDetections>,
    /// True boxes and masks in the left view as stored, if the data set has masks.
    pub instances: Slot<'f, LabeledInstances>,
    /// Always empty, because none of these data sets has tips. It exists so that graphs for the phantom's ground truth run unchanged.
    pub tip: Slot<'f, Tip>,
}

/// Parameters of `data_set`.
#[derive(Params)]
pub struct DataSetParams {
    /// Folder of one data set or of several; `panoscope import FOLDER` lists what is found there.
    #[param(default = "", reopen, file)]
    folder: String,
    /// Name of a sequence, as `panoscope import` lists it. Empty: the first one.
    #[param(default = "", reopen)]
    sequence: String,
    /// Starts again at the end.
    #[param(default = false, reopen)]
    r#loop: bool,
    /// Frames per second of media time. 0: the times in videos, and 30 per second for images.
    #[param(default = 0.0, range = 0.0..=1000.0, unit = "Hz", reopen)]
    rate_hz: f64,
    /// When to hold frames back to their rate.
    #[param(default = "auto")]
    pace: Pace,
    /// How a damaged image is handled.
    #[param(default = "fail")]
    on_damage: OnDamage,
    /// How the pictures are played.
    #[param(flatten)]
    playing: Playing,
}

/// The `data_set` node.
pub struct DataSet {
    sequence: Sequence,
    /// Reads the images.
    capture: Capture,
    settings: Settings,
    /// Index of the calibration set that `capture` uses now.
    calibration: Option<usize>,
    truth: TruthMaps,
    boxes: Boxes,
}

impl DataSetParams {
    fn search(&self, graph_dir: &std::path::Path) -> std::result::Result<(PathBuf, Found), DataSetError> {
        let folder = graph_dir.join(self.folder.trim());
        let found = find(&folder)?;
        Ok((folder, found))
    }

    /// Settings of the node `capture` that reads the images.
    fn settings(&self, sequence: &Sequence) -> Settings {
        let mut settings = Settings::of_files();
        (settings.r#loop, settings.rate_hz) = (self.r#loop, self.rate_hz);
        (settings.pace, settings.on_damage) = (self.pace, self.on_damage);
        settings.crop = sequence.crop.map_or_else(Vec::new, |crop| crop.map(f64::from).to_vec());
        if let Pictures::Video { stacked, .. } = sequence.pictures {
            settings.split = match stacked {
                Stacked::TopBottom => Split::TopBottom,
                Stacked::SideBySide => Split::SideBySide,
            };
        }
        settings
    }
}

/// The sources of a sequence.
fn sources(sequence: &Sequence) -> Vec<SourceName> {
    match &sequence.pictures {
        Pictures::Video { file, .. } => vec![SourceName::Video(file.clone())],
        Pictures::Files { left, right } => {
            let views = [left, right].into_iter().filter(|files| !files.is_empty());
            views.map(|files| SourceName::Images(files.clone())).collect()
        }
    }
}

/// What a sequence lacks for an output that is read, as text; `None` if nothing.
fn lacks(sequence: &Sequence, output: &str) -> Option<&'static str> {
    let has_calibration = sequence.calibration.is_some();
    let has_masks = matches!(sequence.labels, Some(Labels::Masks(_)));
    match output {
        "right" if sequence.views() < 2 => Some("the sequence has one view"),
        "calibration" if !has_calibration => Some("the sequence has no calibration"),
        "disparity" | "depth" if sequence.truth.is_none() => Some("the sequence has no ground-truth maps"),
        "disparity" | "depth" => truth::lacks(sequence, output),
        "detections" if sequence.labels.is_none() => Some("the sequence has no labels"),
        "instances" if !has_masks => Some("the sequence has no masks"),
        _ => None,
    }
}

impl Node for DataSet {
    const INFO: NodeInfo = NodeInfo::blocking(
        "data_set",
        "source",
        "Images of SCARED, Hamlyn, StereoMIS, EndoVis, KITTI, Middlebury, CholecSeg8k, VOC and YOLO folders, with their calibration and truth.",
    )
    .source();
    type In<'f> = NoPorts;
    type Out<'f> = Out<'f>;
    type Params = DataSetParams;

    fn validate(params: &DataSetParams, check: &mut Validation<'_>) {
        if params.folder.trim().is_empty() {
            return check.error("folder", "no folder is given", "give one, as in folder = \"/data/SCARED\"");
        }
        let (folder, found) = match params.search(check.graph_dir()) {
            Ok(found) => found,
            Err(error) => return check.error("folder", error.to_string(), ""),
        };
        let sequence = match found.sequence(&folder, &params.sequence) {
            Ok(sequence) => sequence,
            Err(error @ DataSetError::NoSequence { .. }) => {
                return check.error("sequence", error.to_string(), "`panoscope import FOLDER` lists all of them");
            }
            Err(error) => return check.error("folder", error.to_string(), ""),
        };
        let needs_calibration =
            ["calibration", "disparity", "depth"].iter().any(|port| check.is_read(port) != Some(false));
        let first = sequence.calibration.as_ref().filter(|_| needs_calibration);
        if let Some(Err(error)) = first.map(|files| files.read(0)) {
            check.error("folder", format!("calibration: {error}"), "unpack or download this file again");
        }
        for output in ["right", "calibration", "disparity", "depth", "detections", "instances"] {
            if check.is_read(output) == Some(true)
                && let Some(why) = lacks(sequence, output)
            {
                let message = format!("output `{output}` is connected but stays empty: {why} (`{}`)", sequence.name);
                check.node_warning(
                    message,
                    "select another sequence: `panoscope import FOLDER` shows what each one has",
                );
            }
        }
    }

    fn open(open: &Open<'_>, params: &DataSetParams) -> Result<Self> {
        if params.folder.trim().is_empty() {
            return Err(NodeError::new("`folder` is empty: give the folder of a data set"));
        }
        let wrong = |error: DataSetError| NodeError::new(error.to_string());
        let (folder, found) = params.search(open.graph_dir()).map_err(wrong)?;
        let sequence = found.sequence(&folder, &params.sequence).map_err(wrong)?.clone();
        if params.sequence.trim().is_empty() && found.sequences.len() > 1 {
            let others: Vec<&str> = found.sequences.iter().skip(1).take(LISTED).map(|s| s.name.as_str()).collect();
            open.info(&format!(
                "`{}` is the first of {} sequences; others are {}",
                sequence.name,
                found.sequences.len(),
                others.join(", ")
            ));
        }
        for remark in &sequence.remarks {
            open.info(&format!("{}, {}: {remark}", sequence.data_set, sequence.name));
        }
        let settings = params.settings(&sequence);
        let names = sources(&sequence);
        // A change of the folder or the sequence begins at the first picture, everything else goes on.
        let text = |view: usize| format!("view {view} of {} in {}", sequence.name, folder.display());
        let texts = (0..names.len()).map(text).collect();
        let capture = Capture::of_sources(open, &settings, &names, texts, None)?;
        let boxes = Boxes::new(sequence.labels.as_ref().map_or_else(Vec::new, |labels| labels.classes().to_vec()));
        Ok(Self { sequence, capture, settings, calibration: None, truth: TruthMaps::default(), boxes })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Out<'f>, params: &DataSetParams) -> Result<()> {
        (self.settings.pace, self.settings.on_damage) = (params.pace, params.on_damage);
        self.settings.playing = params.playing;
        let Some(parts) = self.capture.take(cx, &self.settings)? else { return Ok(()) };
        let picture = usize::try_from(self.capture.picture_index()).unwrap_or(usize::MAX);
        let needs_calibration = out.calibration.is_read() || out.disparity.is_read() || out.depth.is_read();
        if needs_calibration {
            let calibration = self.calibration_of(cx, picture, &parts)?;
            if out.calibration.is_read()
                && let Some(calibration) = calibration
            {
                out.calibration.set(calibration)?;
            }
            if let (Some(map), Some(part)) = (&self.sequence.truth, parts.first()) {
                let read = [out.disparity.is_read(), out.depth.is_read()];
                self.truth.prepare(map, picture, calibration.as_ref(), (part.rect.width, part.rect.height), read)?;
                self.truth.write(&mut out.disparity, &mut out.depth)?;
            }
        }
        self.write_labels(picture, &parts, &mut out)?;
        for Part { view, source, rect } in parts {
            let slot = if view == 0 { &mut out.left } else { &mut out.right };
            self.capture.write(slot, source, rect)?;
        }
        Ok(())
    }

    fn save_state(&self) -> Option<Vec<u8>> {
        self.capture.save_state()
    }

    fn load_state(&mut self, state: &[u8]) -> Result<()> {
        self.capture.load_state(state)
    }
}

impl DataSet {
    /// Calibration of an image, with the rectification that a `rectify` node will use.
    fn calibration_of(&mut self, cx: &Context<'_>, picture: usize, parts: &[Part]) -> Result<Option<Calibration>> {
        let Some(files) = &self.sequence.calibration else { return Ok(None) };
        let set = files.set_of(picture);
        if self.calibration != Some(set) {
            self.calibration = None;
            let mut read = files.read(picture).map_err(|error| NodeError::new(format!("calibration: {error}")))?;
            if let (Some(calibration), [left, right]) = (&mut read, parts) {
                // Files without a size belong to views of any.
                for (camera, Part { rect, .. }) in [(&mut calibration.left, left), (&mut calibration.right, right)] {
                    if camera.width == 0 {
                        (camera.width, camera.height) = (rect.width as u32, rect.height as u32);
                    }
                }
            }
            self.capture.set_calibration(read);
            self.calibration = Some(set);
        }
        let Some(calibration) = self.capture.calibration_for(cx, parts)? else { return Ok(None) };
        self.truth.with_rectification(calibration).map(Some)
    }

    fn write_labels(&mut self, picture: usize, parts: &[Part], out: &mut Out<'_>) -> Result<()> {
        let (Some(labels), Some(Part { rect, .. })) = (&self.sequence.labels, parts.first()) else { return Ok(()) };
        if !out.detections.is_read() && !out.instances.is_read() {
            return Ok(());
        }
        let size = (rect.width, rect.height);
        self.boxes.clear();
        match labels {
            Labels::Boxes { files, .. } => {
                if let Some(Some(file)) = files.get(picture) {
                    self.boxes.read(file, size)?;
                }
            }
            Labels::Masks(masks) => {
                // A picture without a mask is not one without instruments.
                let Some(files) = masks.files.get(picture).filter(|files| !files.is_empty()) else { return Ok(()) };
                let stored = self.capture.stored_size();
                for file in files {
                    self.boxes.read_mask(file, stored, *rect)?;
                }
                if out.instances.is_read() {
                    self.boxes.write_instances(&mut out.instances, size)?;
                }
            }
        }
        if out.detections.is_read() { self.boxes.write(&mut out.detections, size) } else { Ok(()) }
    }
}
