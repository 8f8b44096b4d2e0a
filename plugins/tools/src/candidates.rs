//! Boxes from a network's outputs: decoding of each kind of export, and non-maximum suppression.

use panoscope_imaging::lit::HeldMask;

use crate::export_kind::ExportKind;
use crate::letterbox::Placement;
use crate::session::Tensor;

/// Why the outputs do not fit the kind of export.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum DecodeError {
    /// The network has no outputs.
    #[error("the network returned nothing")]
    NoOutput,
    /// The first output is not a tensor of 32-bit floats.
    #[error("the network's first output is not an f32 tensor")]
    NotFloat,
    /// The number of dimensions does not fit the kind.
    #[error("the output of a {kind} network must have three dimensions")]
    Dimensions { kind: &'static str },
    /// The number of rows does not fit the size of the input.
    #[error("{rows} rows of {values} values do not fit a YOLOX input of {width}x{height}")]
    YoloxRows { rows: usize, values: usize, width: usize, height: usize },
    /// The length of the rows does not fit the kind.
    #[error("{rows} boxes of {values} values do not fit the output of a {kind} network")]
    Rows { kind: &'static str, rows: usize, values: usize },
    /// A DETR network lacks one of its two outputs.
    #[error("a DETR network must have the outputs logits 1xNxC and boxes 1xNx4")]
    DetrOutputs,
    /// An output of a DETR network has another type of values.
    #[error("logits and boxes of a DETR network must be f32")]
    DetrType,
    /// The outputs of a DETR network have different lengths.
    #[error("logits and boxes of a DETR network must have the same number of rows")]
    DetrRows,
}

/// A box before suppression, in px of the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Left, top, right, bottom.
    pub corners: [f32; 4],
    /// Confidence, 0 to 1.
    pub score: f32,
    /// Confidence that there is any object, 0 to 1; equal to the score if the family has no such output.
    pub objectness: f32,
    /// Index of the class.
    pub class_index: u32,
    /// Index of the row in the network's output.
    pub row: u32,
}

impl Candidate {
    /// Converts a box given by corners in px of the network's input to an image of `picture` px (width, height). `None` when it is not finite, or
    /// empty inside the image.
    pub fn placed(
        placement: &Placement,
        picture: (usize, usize),
        corners: [f32; 4],
        score: f32,
        class_index: u32,
        row: usize,
    ) -> Option<Self> {
        let ((x0, y0), (x1, y1)) = (placement.back(corners[0], corners[1]), placement.back(corners[2], corners[3]));
        let (w, h) = (picture.0 as f32, picture.1 as f32);
        let corners = [x0.clamp(0.0, w), y0.clamp(0.0, h), x1.clamp(0.0, w), y1.clamp(0.0, h)];
        let is_box =
            [x0, y0, x1, y1].iter().all(|v| v.is_finite()) && corners[2] > corners[0] && corners[3] > corners[1];
        let score = score.min(1.0);
        is_box.then_some(Self { corners, score, objectness: score, class_index, row: row as u32 })
    }
}

/// Strides of anchor-free heads.
const STRIDES: [usize; 3] = [8, 16, 32];

fn sigmoid(v: f32) -> f32 {
    1.0 / (1.0 + (-v).exp())
}

/// Index and score of the best class of a row.
fn best(scores: impl Iterator<Item = f32>) -> (u32, f32) {
    scores.enumerate().fold((0, f32::NEG_INFINITY), |b, (i, s)| if s > b.1 { (i as u32, s) } else { b })
}

/// Collects candidates above a score, in px of the image.
pub struct Decoder<'a> {
    /// Kind of export.
    pub kind: ExportKind,
    /// Width and height of the network's input, px.
    pub input: (usize, usize),
    /// Placement of the image in the input.
    pub placement: Placement,
    /// Width and height of the image, px.
    pub picture: (usize, usize),
    /// Minimum score of candidates.
    pub min_score: f32,
    /// Minimum objectness at which a candidate is kept whatever its score; infinite: none. For families without objectness, none.
    pub min_objectness: f32,
    /// The candidates; new ones are appended.
    pub out: &'a mut Vec<Candidate>,
}

impl Decoder<'_> {
    /// Adds a box given by corners in px of the input.
    fn push(&mut self, corners: [f32; 4], score: f32, class_index: u32, row: usize) {
        self.out.extend(Candidate::placed(&self.placement, self.picture, corners, score, class_index, row));
    }

    fn push_centre(&mut self, b: [f32; 4], score: f32, class_index: u32, row: usize) {
        self.push(
            [b[0] - b[2] / 2.0, b[1] - b[3] / 2.0, b[0] + b[2] / 2.0, b[1] + b[3] / 2.0],
            score,
            class_index,
            row,
        );
    }

    /// Adds a row of objectness and classes if its score or its objectness is high enough.
    fn push_object(&mut self, b: [f32; 4], objectness: f32, class: u32, p: f32, row: usize) {
        let score = objectness * p;
        if score > self.min_score || objectness > self.min_objectness {
            let before = self.out.len();
            self.push_centre(b, score, class, row);
            self.out[before..].iter_mut().for_each(|c| c.objectness = objectness.min(1.0));
        }
    }

    /// Decodes `outputs`. Checks the shapes again, because a network of variable size may change them.
    ///
    /// # Errors
    /// The outputs do not fit the kind.
    pub fn decode(&mut self, outputs: &[Tensor<'_>]) -> Result<(), DecodeError> {
        self.out.clear();
        let first = outputs.first().ok_or(DecodeError::NoOutput)?;
        let floats = first.data.floats().ok_or(DecodeError::NotFloat)?;
        match self.kind {
            ExportKind::YoloxRaw => self.yolox(floats, &first.shape),
            ExportKind::YoloxDecoded | ExportKind::YoloV5 => self.rows(floats, &first.shape),
            ExportKind::YoloV8 { extra } => self.columns(floats, &first.shape, extra),
            ExportKind::EndToEnd => self.end_to_end(floats, &first.shape),
            ExportKind::Detr => self.detr(outputs),
        }
    }

    fn yolox(&mut self, values: &[f32], shape: &[usize]) -> Result<(), DecodeError> {
        let [.., rows, len] = *shape else { return Err(DecodeError::Dimensions { kind: "YOLOX" }) };
        let cells: usize = STRIDES.iter().map(|s| (self.input.0 / s) * (self.input.1 / s)).sum();
        if rows != cells || len < 6 || values.len() < rows * len {
            let (width, height) = self.input;
            return Err(DecodeError::YoloxRows { rows, values: len, width, height });
        }
        let least = self.min_score.min(self.min_objectness);
        let mut row = 0;
        for stride in STRIDES {
            let (columns, lines) = (self.input.0 / stride, self.input.1 / stride);
            let s = stride as f32;
            for y in 0..lines {
                for x in 0..columns {
                    let v = &values[row * len..(row + 1) * len];
                    // Exports carry sigmoid inside (all scores within 0..1); raw logits are not offered by the tools.
                    if v[4] > least {
                        let (class, p) = best(v[5..].iter().copied());
                        if v[4] * p > self.min_score || v[4] > self.min_objectness {
                            let b = [(v[0] + x as f32) * s, (v[1] + y as f32) * s, v[2].exp() * s, v[3].exp() * s];
                            self.push_object(b, v[4], class, p, row);
                        }
                    }
                    row += 1;
                }
            }
        }
        Ok(())
    }

    fn rows(&mut self, values: &[f32], shape: &[usize]) -> Result<(), DecodeError> {
        let [.., rows, len] = *shape else { return Err(DecodeError::Dimensions { kind: "YOLOv5" }) };
        if len < 6 || values.len() < rows * len {
            return Err(DecodeError::Rows { kind: "YOLOv5", rows, values: len });
        }
        for (row, v) in values.chunks_exact(len).enumerate() {
            if v[4] > self.min_score.min(self.min_objectness) {
                let (class, p) = best(v[5..].iter().copied());
                self.push_object([v[0], v[1], v[2], v[3]], v[4], class, p, row);
            }
        }
        Ok(())
    }

    fn columns(&mut self, values: &[f32], shape: &[usize], extra: usize) -> Result<(), DecodeError> {
        let [.., len, rows] = *shape else { return Err(DecodeError::Dimensions { kind: "YOLOv8" }) };
        if len < 5 + extra || values.len() < rows * len {
            return Err(DecodeError::Rows { kind: "YOLOv8", rows, values: len });
        }
        for row in 0..rows {
            let at = |k: usize| values[k * rows + row];
            let (class, score) = best((4..len - extra).map(at));
            if score > self.min_score {
                self.push_centre([at(0), at(1), at(2), at(3)], score, class, row);
            }
        }
        Ok(())
    }

    fn end_to_end(&mut self, values: &[f32], shape: &[usize]) -> Result<(), DecodeError> {
        let [.., rows, len] = *shape else { return Err(DecodeError::Dimensions { kind: "end-to-end" }) };
        if len < 6 || values.len() < rows * len {
            return Err(DecodeError::Rows { kind: "end-to-end", rows, values: len });
        }
        for (row, v) in values.chunks_exact(len).enumerate() {
            if v[4] > self.min_score && v[5] >= 0.0 {
                self.push([v[0], v[1], v[2], v[3]], v[4], v[5] as u32, row);
            }
        }
        Ok(())
    }

    fn detr(&mut self, outputs: &[Tensor<'_>]) -> Result<(), DecodeError> {
        let of = |boxes: bool| outputs.iter().find(|t| (t.shape.last() == Some(&4)) == boxes && t.shape.len() == 3);
        let (Some(logits), Some(boxes)) = (of(false), of(true)) else {
            return Err(DecodeError::DetrOutputs);
        };
        let (Some(scores), Some(places)) = (logits.data.floats(), boxes.data.floats()) else {
            return Err(DecodeError::DetrType);
        };
        let classes = logits.shape[2];
        if classes == 0 || logits.shape[1] != boxes.shape[1] {
            return Err(DecodeError::DetrRows);
        }
        let (w, h) = (self.input.0 as f32, self.input.1 as f32);
        for (row, (s, b)) in scores.chunks_exact(classes).zip(places.chunks_exact(4)).enumerate() {
            let (class, logit) = best(s.iter().copied());
            let score = sigmoid(logit);
            if score > self.min_score {
                self.push_centre([b[0] * w, b[1] * h, b[2] * w, b[3] * h], score, class, row);
            }
        }
        Ok(())
    }
}

/// Intersection over union of two boxes (left, top, right, bottom).
pub fn iou(a: &[f32; 4], b: &[f32; 4]) -> f32 {
    let w = (a[2].min(b[2]) - a[0].max(b[0])).max(0.0);
    let h = (a[3].min(b[3]) - a[1].max(b[1])).max(0.0);
    let area = |c: &[f32; 4]| (c[2] - c[0]) * (c[3] - c[1]);
    let union = area(a) + area(b) - w * h;
    if union > 0.0 { w * h / union } else { 0.0 }
}

/// Minimum illuminated share of a box.
const MIN_LIT: f32 = 0.5;

/// Drops boxes of which more than half is dark, in an image of `size` px. A mask of another size drops none.
pub fn keep_lit(candidates: &mut Vec<Candidate>, lit: &HeldMask, size: (usize, usize)) {
    if let Some(lit) = lit.part().filter(|lit| lit.size() == size) {
        candidates.retain(|candidate| lit.share_of(candidate.corners) >= MIN_LIT);
    }
}

/// Parameters of non-maximum suppression.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Suppression {
    /// Overlap (intersection over union) above which the box with the lower score is dropped.
    pub max_overlap: f32,
    /// Boxes of different classes also suppress each other.
    pub is_agnostic: bool,
    /// Maximum number of boxes.
    pub max_boxes: usize,
    /// Class of boxes whose kind is unknown: any other box suppresses them, whatever its score, and they suppress no other.
    pub unknown: Option<u32>,
}

/// Maximum number of boxes beyond `max_boxes` that are counted.
const MAX_COUNTED: usize = 1000;

/// Non-maximum suppression: keeps the best of overlapping boxes, highest score first. Ties go to the earlier row, so that the result does not depend
/// on the sort. Returns how many further boxes `max_boxes` left out, up to a thousand.
pub fn suppress(candidates: &mut Vec<Candidate>, rule: &Suppression) -> usize {
    let is_unknown = |c: &Candidate| Some(c.class_index) == rule.unknown;
    let best_first = |a: &Candidate, b: &Candidate| b.score.total_cmp(&a.score).then(a.row.cmp(&b.row));
    candidates.sort_unstable_by(|a, b| is_unknown(a).cmp(&is_unknown(b)).then(best_first(a, b)));
    // A bad network returns thousands of boxes: the best of them are enough to find `max_boxes`.
    candidates.truncate(3000);
    let mut retained = 0;
    for i in 0..candidates.len() {
        let c = candidates[i];
        let any = rule.is_agnostic || is_unknown(&c);
        let free = candidates[..retained]
            .iter()
            .all(|k| (!any && k.class_index != c.class_index) || iou(&k.corners, &c.corners) <= rule.max_overlap);
        if free {
            candidates[retained] = c;
            retained += 1;
            if retained == rule.max_boxes + MAX_COUNTED {
                break;
            }
        }
    }
    let left_out = retained.saturating_sub(rule.max_boxes);
    candidates.truncate(retained - left_out);
    candidates.sort_unstable_by(best_first);
    left_out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f32, score: f32, class_index: u32) -> Candidate {
        Candidate { corners: [x, 0.0, x + 10.0, 10.0], score, objectness: score, class_index, row: x as u32 }
    }

    #[test]
    fn boxes_beyond_the_limit_are_counted() {
        let rule = Suppression { max_overlap: 0.5, is_agnostic: false, max_boxes: 2, unknown: None };
        let apart =
            |count: usize| (0..count).map(|i| at(20.0 * i as f32, 0.9 - 0.01 * i as f32, 1)).collect::<Vec<_>>();
        let mut five = apart(5);
        // One more lies on the best.
        five.push(at(1.0, 0.2, 1));
        assert_eq!(suppress(&mut five, &rule), 3);
        assert_eq!(five, apart(2));
        assert_eq!(suppress(&mut apart(2), &rule), 0);
        let mut many: Vec<Candidate> = (0..2500).map(|i| at(20.0 * i as f32, 0.5, 1)).collect();
        assert_eq!((suppress(&mut many, &rule), many.len()), (1000, 2));
    }

    #[test]
    fn a_box_of_unknown_class_gives_way_to_any_named_one() {
        let rule = Suppression { max_overlap: 0.5, is_agnostic: false, max_boxes: 9, unknown: Some(7) };
        let left = |mut list: Vec<Candidate>, rule: &Suppression| {
            suppress(&mut list, rule);
            list.iter().map(|c| (c.corners[0] as i32, c.class_index)).collect::<Vec<_>>()
        };
        // On the named one, though it is surer; beside it it stays, and stands first by its score.
        assert_eq!(left(vec![at(0.0, 0.4, 1), at(1.0, 0.9, 7)], &rule), [(0, 1)]);
        assert_eq!(left(vec![at(0.0, 0.4, 1), at(20.0, 0.9, 7), at(21.0, 0.8, 7)], &rule), [(20, 7), (0, 1)]);
        // Other classes stand on each other as before.
        assert_eq!(left(vec![at(0.0, 0.4, 1), at(1.0, 0.9, 2)], &rule), [(1, 2), (0, 1)]);
        let none = Suppression { unknown: None, ..rule };
        assert_eq!(left(vec![at(0.0, 0.4, 1), at(1.0, 0.9, 7)], &none), [(1, 7), (0, 1)]);
    }
}
