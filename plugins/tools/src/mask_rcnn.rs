//! `mask_rcnn`: boxes with a mask each, from torchvision's and Detectron2's exports of Mask R-CNN (He et al. 2017; thesis, chapter 5) and from
//! YOLO exports that segment.

use std::path::{Path, PathBuf};

use panoscope_imaging::SharedMut;
use panoscope_imaging::lit::HeldMask;
use panoscope_node::abi::{Detection, Scalar};
use panoscope_node::detections::mask_len;
use panoscope_node::{
    AnyImage, Choice, Context, Image, LabeledInstances, Mask, Node, NodeInfo, Open, Parallel, Params, Ports, Result,
    Slot, TextPacket, Validation, error,
};

use crate::candidates::{Candidate, Decoder, Suppression, iou, keep_lit, suppress};
use crate::export_kind::ExportKind;
use crate::finite::{Rows, count_bad};
use crate::letterbox::{BORDER, Fit, PixelForm, Placement};
use crate::pictures::{self, Familiarity, Unlike};
use crate::provider::Provider;
use crate::session::{Tensor, Values, list_text};
use crate::track::Tracker;
use crate::yolo::{Damage, Network, check_labels, detection, picture_of};

/// Input ports of `mask_rcnn`.
#[derive(Ports)]
pub struct In<'f> {
    /// Image to search, bgr8 or gray8.
    image: AnyImage<'f>,
    /// Nonzero where the image is illuminated. Instances whose boxes are more than half outside are dropped. Unconnected: the whole image.
    mask: Option<Image<'f, Mask>>,
}

/// Output ports of `mask_rcnn`.
#[derive(Ports)]
pub struct Out<'f> {
    /// Boxes and masks in px of the image, highest score first, with their labels.
    instances: Slot<'f, LabeledInstances>,
    /// How unlike the model's training images the last images are, smoothed, as a share of the model's limit. From 1 on the model is unreliable for
    /// such images. Empty if the model has no image statistics. Metric `unlike` is 1 while it is above.
    unlikeness: Slot<'f, Scalar>,
    /// Message for a screen while the images are too unlike the training images; otherwise empty text.
    text: Slot<'f, TextPacket>,
}

/// Family of the export.
#[derive(Choice, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// Recognised from the shapes of the outputs and the model's metadata.
    Auto,
    /// Red first, 0..1; class 0 is background; masks of the whole image or of 28 px.
    Torchvision,
    /// Blue first, 0..255; masks of 28 px.
    Detectron2,
    /// YOLOv8 and later with mask prototypes.
    YoloSeg,
}

/// Parameters of `mask_rcnn`.
#[derive(Params)]
pub struct MaskRcnnParams {
    /// ONNX file of the network.
    #[param(default = "models/instrument_masks.onnx", reopen, must_exist, shipped)]
    model: PathBuf,
    /// Family of the export.
    #[param(default = "auto", reopen)]
    family: Family,
    /// Minimum score of an instance.
    #[param(default = 0.5, range = 0.001..=1.0, step = 0.01, unit = "ratio")]
    min_score: f32,
    /// Minimum share of an instance's class in the sum of the scores of all classes at its place. Below it the class is reported as `unknown`, an
    /// instrument of uncertain kind, with that sum as score. 0 always names the class with the highest score. On rendered instruments 0.4 makes a
    /// third of the outlines `unknown`, on real ones hardly any.
    #[param(default = 0.0, range = 0.0..=1.0, step = 0.01, unit = "ratio", reopen)]
    unknown_below: f32,
    /// Overlap (intersection over union) above which the box with the lower score is dropped, within a class.
    #[param(default = 0.5, range = 0.05..=1.0, step = 0.05, unit = "ratio")]
    max_overlap: f32,
    /// Minimum probability of a pixel of the mask.
    #[param(default = 0.5, range = 0.01..=0.99, step = 0.01, unit = "ratio")]
    mask_threshold: f32,
    /// Maximum number of instances in the output.
    #[param(default = 20, range = 1..=200)]
    max_instances: usize,
    /// File with the names of the classes, one per line. Empty: the names in the model file.
    #[param(default = "", reopen)]
    labels: PathBuf,
    /// Width of the network's input, for models that accept any size.
    #[param(default = 640, range = 32..=4096, step = 32, unit = "px", reopen)]
    input_width: usize,
    /// Height of the network's input, for models that accept any size.
    #[param(default = 480, range = 32..=4096, step = 32, unit = "px", reopen)]
    input_height: usize,
    /// Gives each tool a number (`track_id`) that it keeps over time.
    #[param(default = true)]
    track: bool,
    /// Gives a tracked tool the class that it had most often: votes are weighted by score, and their weight halves after this time. 0: the class in
    /// each image.
    #[param(default = 0.0, range = 0.0..=60.0, step = 0.1, unit = "s")]
    vote_s: f32,
    /// Time constant of the smoothing of `unlikeness`.
    #[param(default = 2.0, range = 0.0..=60.0, step = 0.1, unit = "s")]
    unlike_s: f32,
    /// What happens to the instruments while `unlikeness` is 1 or more.
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

/// Finds tools and their outlines.
pub struct MaskRcnn {
    network: Network,
    path: PathBuf,
    family: Family,
    /// Index of the class `unknown`, if the label table has it.
    unknown: Option<u32>,
    familiarity: Familiarity,
    candidates: Vec<Candidate>,
    /// Probabilities per candidate, one map after the other: full-size or small maps, or sums of prototypes.
    maps: Vec<f32>,
    map_size: (usize, usize),
    /// Buffers of painting: position of each column of a box in its map, and a row of the map for each task.
    places: Vec<CellPosition>,
    lines: Vec<f32>,
    items: Vec<Detection>,
    bits: Vec<u8>,
    tracker: Tracker,
    lit: HeldMask,
}

/// The four outputs of a Mask R-CNN, identified in any order.
struct NetworkOutputs<'a> {
    boxes: &'a [f32],
    scores: &'a [f32],
    labels: Option<&'a [i64]>,
    masks: &'a [f32],
    map_size: (usize, usize),
    count: usize,
}

fn sort_out<'a>(path: &Path, outputs: &[Tensor<'a>]) -> Result<NetworkOutputs<'a>> {
    let floats = |rank: usize, last: Option<usize>| {
        outputs.iter().find_map(|t| {
            let fits = t.shape.len() == rank && last.is_none_or(|n| t.shape.last() == Some(&n));
            t.data.floats().filter(|_| fits).map(|data| (t.shape.clone(), data))
        })
    };
    let masks = floats(4, None).or_else(|| floats(3, None));
    let (Some((shape, boxes)), Some((_, scores)), Some((mask_shape, masks))) =
        (floats(2, Some(4)), floats(1, None), masks)
    else {
        return Err(error!(
            "{} returns {}; expected boxes Nx4, scores N, labels N and masks Nx1xHxW",
            path.display(),
            list_text(outputs)
        ));
    };
    let labels = outputs
        .iter()
        .find_map(|t| if let Values::Int(l) = t.data { Some(l).filter(|_| t.shape.len() == 1) } else { None });
    let count = shape[0];
    let [.., height, width] = mask_shape[..] else {
        return Err(error!("{}: the masks have no height and width", path.display()));
    };
    let whole = boxes.len() >= 4 * count
        && scores.len() >= count
        && labels.is_none_or(|l| l.len() >= count)
        && width.checked_mul(height).and_then(|n| n.checked_mul(count)).is_some_and(|n| masks.len() >= n);
    if !whole {
        return Err(error!("{}: boxes, scores and masks do not have the same number of rows", path.display()));
    }
    Ok(NetworkOutputs { boxes, scores, labels, masks, map_size: (width, height), count })
}

/// Rows of a mask per task.
const ROWS_PER_CHUNK: usize = 32;

/// Position of a pixel along one side of a map: between cell `first` and the next, counted from a cell of zeros before the map.
#[derive(Clone, Copy, Default)]
struct CellPosition {
    first: u32,
    share: f32,
}

impl CellPosition {
    /// The position of a coordinate in cells, whose centres are integers. Outside the map the value is that of the zeros around it.
    fn new(at: f32, cells: usize) -> Self {
        if at > -1.0 && at < cells as f32 {
            let low = at.floor();
            return Self { first: (low + 1.0) as u32, share: at - low };
        }
        Self::default()
    }
}

/// The area that a map covers.
#[derive(Clone, Copy, PartialEq)]
enum Covers {
    /// Its own box.
    Box,
    /// The network's whole input.
    Input(Placement, (usize, usize)),
}

impl MaskRcnn {
    /// Paints the bit masks of all items: most significant bit first, rows padded to whole bytes. Each map is enlarged bilinearly, rows first.
    fn paint(&mut self, covers: Covers, size: (usize, usize), threshold: f32, pool: &dyn Parallel) {
        let len = mask_len(size.0, size.1);
        let row_bytes = size.0.div_ceil(8);
        self.bits.clear();
        self.bits.resize(len * self.items.len(), 0);
        let (width, height) = self.map_size;
        if width == 0 || height == 0 {
            return;
        }
        let line_len = width + 2;
        self.lines.resize(size.1.div_ceil(ROWS_PER_CHUNK) * line_len, 0.0);
        for (i, item) in self.items.iter().enumerate() {
            let map = &self.maps[i * width * height..(i + 1) * width * height];
            let columns =
                item.x_px.max(0.0) as usize..((item.x_px + item.width_px).ceil().max(0.0) as usize).min(size.0);
            let rows = item.y_px.max(0.0) as usize..((item.y_px + item.height_px).ceil().max(0.0) as usize).min(size.1);
            let along = |axis: usize, px: f32| match covers {
                Covers::Box if axis == 0 => (px - item.x_px) / item.width_px * width as f32 - 0.5,
                Covers::Box => (px - item.y_px) / item.height_px * height as f32 - 0.5,
                Covers::Input(p, input) => {
                    let (cells, side) = if axis == 0 { (width, input.0) } else { (height, input.1) };
                    (px * p.scale[axis] + p.offset[axis]) * cells as f32 / side as f32 - 0.5
                }
            };
            self.places.clear();
            self.places.extend(columns.clone().map(|x| CellPosition::new(along(0, x as f32 + 0.5), width)));
            let places = &self.places;
            let bits = SharedMut::new(&mut self.bits[i * len..(i + 1) * len]);
            let lines = SharedMut::new(&mut self.lines);
            pool.run(rows.len().div_ceil(ROWS_PER_CHUNK), &|chunk| {
                // SAFETY: one line for each chunk.
                let line = unsafe { lines.part(chunk * line_len, line_len) };
                let first = rows.start + chunk * ROWS_PER_CHUNK;
                for y in first..(first + ROWS_PER_CHUNK).min(rows.end) {
                    let at = CellPosition::new(along(1, y as f32 + 0.5), height);
                    mix(map, (width, height), at, line);
                    // SAFETY: one row, painted by this chunk alone.
                    let row = unsafe { bits.part(y * row_bytes, row_bytes) };
                    for (x, place) in columns.clone().zip(places) {
                        let pair = &line[place.first as usize..][..2];
                        let inside = pair[0] + place.share * (pair[1] - pair[0]) >= threshold;
                        row[x / 8] |= u8::from(inside) << (7 - x % 8);
                    }
                }
            });
        }
    }
}

/// A row of the map interpolated between two of its rows, with a zero before and after it.
fn mix(map: &[f32], (width, height): (usize, usize), at: CellPosition, line: &mut [f32]) {
    let row = |index: usize| (1..=height).contains(&index).then(|| &map[(index - 1) * width..index * width]);
    let first = at.first as usize;
    let share = at.share;
    line[0] = 0.0;
    line[width + 1] = 0.0;
    let out = &mut line[1..=width];
    match (row(first), row(first + 1)) {
        (Some(upper), Some(lower)) => {
            out.iter_mut().zip(upper).zip(lower).for_each(|((o, a), b)| *o = a + share * (b - a));
        }
        (Some(upper), None) => out.iter_mut().zip(upper).for_each(|(o, a)| *o = a * (1.0 - share)),
        (None, Some(lower)) => out.iter_mut().zip(lower).for_each(|(o, b)| *o = b * share),
        (None, None) => out.fill(0.0),
    }
}

/// Overlap (intersection over union) from which boxes of different classes are of one instrument.
const ONE_PLACE: f32 = 0.6;

/// Sum of the scores of all classes at a place, of each class the highest.
fn score_at(candidates: &[Candidate], corners: [f32; 4]) -> f32 {
    let here = |candidate: &&Candidate| iou(&candidate.corners, &corners) >= ONE_PLACE;
    let is_best = |candidate: &&Candidate| {
        let better = |other: &&Candidate| other.class_index == candidate.class_index && other.score > candidate.score;
        !candidates.iter().filter(here).any(|other| better(&other))
    };
    candidates.iter().filter(here).filter(is_best).map(|candidate| candidate.score).sum()
}

/// Gives a candidate the class `unknown` if its own has too small a share in `any`, the sum of the scores of all classes.
fn name_unsure(candidate: &mut Candidate, any: f32, unknown_below: f32, unknown: u32) {
    if candidate.score < unknown_below * any {
        (candidate.class_index, candidate.score) = (unknown, any.min(1.0));
    }
}

/// Memory layout of the boxes: segmenting YOLO exports return them in columns.
fn rows_of(is_yolo: bool) -> Rows {
    if is_yolo { Rows::Columns } else { Rows::Whole }
}

fn pixel_form(family: Family) -> PixelForm {
    let unit = PixelForm { rgb: true, mean: [0.0; 3], gain: [1.0 / 255.0; 3], fit: Fit::Corner, border: BORDER };
    match family {
        Family::Detectron2 => PixelForm { rgb: false, gain: [1.0; 3], ..unit },
        Family::YoloSeg => ExportKind::YoloV8 { extra: 32 }.pixel_form(),
        _ => unit,
    }
}

/// Decodes the outputs of one run to candidates, with a map of probabilities for each.
struct Decoding<'a, 'f> {
    cx: &'a Context<'f>,
    params: &'a MaskRcnnParams,
    path: &'a Path,
    net: (usize, usize),
    placement: Placement,
    size: (usize, usize),
    unknown: Option<u32>,
    damage: &'a mut Damage,
    candidates: &'a mut Vec<Candidate>,
    maps: &'a mut Vec<f32>,
    map_size: &'a mut (usize, usize),
    lit: &'a HeldMask,
}

impl Decoding<'_, '_> {
    fn begin(&mut self, outputs: &[Tensor<'_>], is_yolo: bool) -> Result<()> {
        let bad = count_bad(self.path, outputs, rows_of(is_yolo))?;
        self.damage.report(self.cx, self.path, bad);
        self.maps.clear();
        self.candidates.clear();
        Ok(())
    }

    /// Minimum score of a class that may count.
    fn floor(&self) -> f32 {
        self.params.min_score / self.unknown.map_or(1.0, |classes| classes as f32)
    }

    /// Drops weak, dark and overlapping candidates.
    fn keep_best(&mut self) {
        self.candidates.retain(|candidate| candidate.score > self.params.min_score);
        let suppression = Suppression {
            max_overlap: self.params.max_overlap,
            is_agnostic: false,
            max_boxes: self.params.max_instances,
            unknown: self.unknown,
        };
        keep_lit(self.candidates, self.lit, self.size);
        let left_out = suppress(self.candidates, &suppression);
        self.damage.report_left_out(self.cx, left_out, ("max_instances", self.params.max_instances));
    }

    /// A YOLO export: each map is a sum of prototypes.
    fn yolo(&mut self, outputs: &[Tensor<'_>]) -> Result<Covers> {
        self.begin(outputs, true)?;
        let [_, prototypes] = outputs else { return Err(error!("the model returns no prototypes")) };
        let [1, masks, height, width] = prototypes.shape[..] else {
            return Err(error!("the prototypes are {:?}; expected 1xMxHxW", prototypes.shape));
        };
        let (Some(boxes), Some(shapes)) = (outputs[0].data.floats(), prototypes.data.floats()) else {
            return Err(error!("boxes and prototypes must be f32"));
        };
        let (len, rows, area) = (outputs[0].shape[1], outputs[0].shape[2], width * height);
        let classes = len.saturating_sub(4 + masks).max(1);
        let mut decoder = Decoder {
            kind: ExportKind::YoloV8 { extra: masks },
            input: self.net,
            placement: self.placement,
            picture: self.size,
            min_score: self.floor(),
            min_objectness: f32::INFINITY,
            out: self.candidates,
        };
        decoder.decode(outputs)?;
        if let Some(unknown) = self.unknown {
            for candidate in self.candidates.iter_mut() {
                let score_of = |class: usize| boxes[(4 + class) * rows + candidate.row as usize];
                let any = (0..classes).map(score_of).sum();
                name_unsure(candidate, any, self.params.unknown_below, unknown);
            }
        }
        self.keep_best();
        *self.map_size = (width, height);
        for c in self.candidates.iter() {
            let start = self.maps.len();
            self.maps.resize(start + area, 0.0);
            for m in 0..masks {
                let share = boxes[(len - masks + m) * rows + c.row as usize];
                let plane = &shapes[m * area..(m + 1) * area];
                self.maps[start..].iter_mut().zip(plane).for_each(|(sum, p)| *sum += share * p);
            }
            self.maps[start..].iter_mut().for_each(|v| *v = 1.0 / (1.0 + (-*v).exp()));
        }
        Ok(Covers::Input(self.placement, self.net))
    }

    /// A Mask R-CNN export: each box has its own map.
    fn rcnn(&mut self, outputs: &[Tensor<'_>], family: Family) -> Result<Covers> {
        self.begin(outputs, false)?;
        let answer = sort_out(self.path, outputs)?;
        // Class 0 of torchvision is background and never returned.
        let first_class = i64::from(family == Family::Torchvision);
        for row in 0..answer.count {
            let (b, score) = (&answer.boxes[4 * row..4 * row + 4], answer.scores[row]);
            let class = answer.labels.map_or(0, |l| l[row] - first_class);
            if score > self.floor() && class >= 0 {
                let corners = [b[0], b[1], b[2], b[3]];
                self.candidates.extend(Candidate::placed(
                    &self.placement,
                    self.size,
                    corners,
                    score,
                    class as u32,
                    row,
                ));
            }
        }
        if let Some(unknown) = self.unknown {
            // Each class has a row of its own.
            let sums: Vec<f32> = self.candidates.iter().map(|here| score_at(self.candidates, here.corners)).collect();
            for (candidate, any) in self.candidates.iter_mut().zip(sums) {
                name_unsure(candidate, any, self.params.unknown_below, unknown);
            }
        }
        self.keep_best();
        *self.map_size = answer.map_size;
        let area = answer.map_size.0 * answer.map_size.1;
        for c in self.candidates.iter() {
            self.maps.extend_from_slice(&answer.masks[c.row as usize * area..(c.row as usize + 1) * area]);
        }
        Ok(if answer.map_size == self.net { Covers::Input(self.placement, self.net) } else { Covers::Box })
    }
}

impl Node for MaskRcnn {
    const INFO: NodeInfo =
        NodeInfo::blocking("mask_rcnn", "tools", "Finds surgical tools with their outlines by a segmenting network.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = MaskRcnnParams;

    fn validate(params: &MaskRcnnParams, check: &mut Validation<'_>) {
        check_labels(check, &params.labels);
    }

    fn open(open: &Open<'_>, params: &MaskRcnnParams) -> Result<Self> {
        let size = (params.input_width, params.input_height);
        let mut network = Network::open(open, &params.model, params.threads, size, params.provider)?;
        network.model.refuse_tasks(
            &["detect", "pose", "obb", "classify"],
            "`mask_rcnn` reads boxes with masks; for boxes or keypoints use `yolo`",
        )?;
        let (w, h) = network.model.input_size();
        let gray = vec![0.5f32; 3 * w * h];
        let named = network.model.metadata("family").map(str::to_owned);
        let path = network.model.path().to_owned();
        let (family, classes, channels) = network.model.run(&gray, |outputs| -> Result<_> {
            let (outputs, features) = pictures::split(outputs);
            let channels = features.and_then(|tensor| tensor.shape.get(1).copied());
            let segments = matches!(outputs, [boxes, _] if boxes.shape.len() == 3);
            count_bad(&path, outputs, rows_of(segments))?;
            if let [boxes, prototypes] = outputs
                && let ([1, len, _], [1, masks, _, _]) = (&boxes.shape[..], &prototypes.shape[..])
                && matches!(params.family, Family::Auto | Family::YoloSeg)
            {
                return Ok((Family::YoloSeg, len.saturating_sub(4 + masks), channels));
            }
            let answer = sort_out(&path, outputs)?;
            let family = match (params.family, named.as_deref()) {
                (Family::Auto, Some("detectron2")) => Family::Detectron2,
                (Family::Auto, Some("torchvision")) => Family::Torchvision,
                // Detectron2's masks have to be pasted here; torchvision pastes them itself unless its export disables that.
                (Family::Auto, _) if answer.map_size.0 <= 56 && answer.map_size != (w, h) => Family::Detectron2,
                (Family::Auto, _) => Family::Torchvision,
                (asked, _) => asked,
            };
            Ok((family, 0, channels))
        })??;
        network.name_classes(&params.labels, classes)?;
        let familiarity = Familiarity::new(&network.model, channels).map_err(|e| error!("{}: {e}", path.display()))?;
        let unknown = network.add_unknown(params.unknown_below > 0.0 && network.labels.lines().count() > 1);
        Ok(Self {
            path: network.model.path().to_owned(),
            network,
            family,
            unknown,
            familiarity,
            candidates: Vec::new(),
            maps: Vec::new(),
            map_size: (0, 0),
            places: Vec::new(),
            lines: Vec::new(),
            items: Vec::new(),
            bits: Vec::new(),
            tracker: Tracker::default(),
            lit: HeldMask::default(),
        })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &MaskRcnnParams,
    ) -> Result<()> {
        let picture = picture_of(&input.image)?;
        let size = (picture.width, picture.height);
        let net = self.network.model.input_size();
        let placement = self.network.letterbox.fit(picture, net, &pixel_form(self.family), cx.pool());
        self.lit.update(input.mask.as_ref().map(Image::view));
        let Self { network: Network { model, letterbox, damage, .. }, path, familiarity, .. } = self;
        let mut unlikeness = None;
        let mut decoding = Decoding {
            cx,
            params,
            path,
            net,
            placement,
            size,
            unknown: self.unknown,
            damage,
            candidates: &mut self.candidates,
            maps: &mut self.maps,
            map_size: &mut self.map_size,
            lit: &self.lit,
        };
        let family = self.family;
        let covers = model.run(&letterbox.input, |outputs| -> Result<Covers> {
            let (outputs, features) = pictures::split(outputs);
            unlikeness = familiarity.unlikeness(features, placement.size);
            if family == Family::YoloSeg { decoding.yolo(outputs) } else { decoding.rcnn(outputs, family) }
        })??;
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
        self.items.clear();
        self.items.extend(self.candidates.iter().map(detection));
        if params.track {
            self.tracker.follow(&mut self.items, cx.tick().capture_ns, params.vote_s, self.unknown);
        }
        self.paint(covers, size, params.mask_threshold, cx.pool());
        out.instances.set_instances(&self.items, &self.network.labels, size, &self.bits)
    }
}
