//! What a network answers, as boxes in the picture: decoding of each kind of export, and non-maximum suppression.

use crate::export_kind::ExportKind;
use crate::letterbox::Placement;
use crate::model::Tensor;

/// A box before suppression, in px of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Left, top, right, bottom.
    pub corners: [f32; 4],
    /// 0..1.
    pub score: f32,
    /// Class number.
    pub class_index: u32,
    /// Row of the network's answer it came from.
    pub row: u32,
}

impl Candidate {
    /// A box given by corners in px of the network's input, carried back into a picture of `picture` px (width, height). What is not finite, or
    /// empty in the picture, is no box.
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
        is_box.then(|| Self { corners, score: score.min(1.0), class_index, row: row as u32 })
    }
}

/// Strides of anchor-free heads.
const STRIDES: [usize; 3] = [8, 16, 32];

fn sigmoid(v: f32) -> f32 {
    1.0 / (1.0 + (-v).exp())
}

/// The best class of a row and its score.
fn best(scores: impl Iterator<Item = f32>) -> (u32, f32) {
    scores.enumerate().fold((0, f32::NEG_INFINITY), |b, (i, s)| if s > b.1 { (i as u32, s) } else { b })
}

/// Collects candidates above `score`, in the picture's pixels.
pub struct Decoder<'a> {
    /// What kind of export answered.
    pub kind: ExportKind,
    /// Width and height in px of the network's input.
    pub input: (usize, usize),
    /// Where the picture lay in it.
    pub placement: Placement,
    /// Width and height in px of the picture.
    pub picture: (usize, usize),
    /// Lowest score kept.
    pub min_score: f32,
    /// Where they go.
    pub out: &'a mut Vec<Candidate>,
}

impl Decoder<'_> {
    /// A box given by corners in px of the input.
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

    /// Decodes `outputs`; shapes were checked when the kind was found out, and are checked again here because networks with
    /// free sizes may answer anything.
    pub fn decode(&mut self, outputs: &[Tensor<'_>]) -> Result<(), String> {
        self.out.clear();
        let first = outputs.first().ok_or("the network answered nothing")?;
        let floats = first.data.floats().ok_or("the network's first output is no f32 tensor")?;
        match self.kind {
            ExportKind::YoloxRaw => self.yolox(floats, &first.shape),
            ExportKind::YoloxDecoded | ExportKind::YoloV5 => self.rows(floats, &first.shape),
            ExportKind::YoloV8 { masks } => self.columns(floats, &first.shape, masks),
            ExportKind::EndToEnd => self.end_to_end(floats, &first.shape),
            ExportKind::Detr => self.detr(outputs),
        }
    }

    fn yolox(&mut self, values: &[f32], shape: &[usize]) -> Result<(), String> {
        let [.., rows, len] = *shape else { return Err("a YOLOX answer has three dimensions".into()) };
        let cells: usize = STRIDES.iter().map(|s| (self.input.0 / s) * (self.input.1 / s)).sum();
        if rows != cells || len < 6 || values.len() < rows * len {
            return Err(format!(
                "{rows} rows of {len} values do not fit a YOLOX input of {}x{}",
                self.input.0, self.input.1
            ));
        }
        let mut row = 0;
        for stride in STRIDES {
            let (columns, lines) = (self.input.0 / stride, self.input.1 / stride);
            let s = stride as f32;
            for y in 0..lines {
                for x in 0..columns {
                    let v = &values[row * len..(row + 1) * len];
                    // Exports carry sigmoid inside (all scores within 0..1); raw logits are not offered by the tools.
                    if v[4] > self.min_score {
                        let (class, p) = best(v[5..].iter().copied());
                        let score = v[4] * p;
                        if score > self.min_score {
                            let b = [(v[0] + x as f32) * s, (v[1] + y as f32) * s, v[2].exp() * s, v[3].exp() * s];
                            self.push_centre(b, score, class, row);
                        }
                    }
                    row += 1;
                }
            }
        }
        Ok(())
    }

    fn rows(&mut self, values: &[f32], shape: &[usize]) -> Result<(), String> {
        let [.., rows, len] = *shape else { return Err("a YOLOv5 answer has three dimensions".into()) };
        if len < 6 || values.len() < rows * len {
            return Err(format!("{rows} rows of {len} values are no YOLOv5 answer"));
        }
        for (row, v) in values.chunks_exact(len).enumerate() {
            if v[4] > self.min_score {
                let (class, p) = best(v[5..].iter().copied());
                if v[4] * p > self.min_score {
                    self.push_centre([v[0], v[1], v[2], v[3]], v[4] * p, class, row);
                }
            }
        }
        Ok(())
    }

    fn columns(&mut self, values: &[f32], shape: &[usize], masks: usize) -> Result<(), String> {
        let [.., len, rows] = *shape else { return Err("a YOLOv8 answer has three dimensions".into()) };
        if len < 5 + masks || values.len() < rows * len {
            return Err(format!("{len} values of {rows} boxes are no YOLOv8 answer"));
        }
        for row in 0..rows {
            let at = |k: usize| values[k * rows + row];
            let (class, score) = best((4..len - masks).map(at));
            if score > self.min_score {
                self.push_centre([at(0), at(1), at(2), at(3)], score, class, row);
            }
        }
        Ok(())
    }

    fn end_to_end(&mut self, values: &[f32], shape: &[usize]) -> Result<(), String> {
        let [.., rows, len] = *shape else { return Err("an end-to-end answer has three dimensions".into()) };
        if len < 6 || values.len() < rows * len {
            return Err(format!("{rows} rows of {len} values are no end-to-end answer"));
        }
        for (row, v) in values.chunks_exact(len).enumerate() {
            if v[4] > self.min_score && v[5] >= 0.0 {
                self.push([v[0], v[1], v[2], v[3]], v[4], v[5] as u32, row);
            }
        }
        Ok(())
    }

    fn detr(&mut self, outputs: &[Tensor<'_>]) -> Result<(), String> {
        let of = |boxes: bool| outputs.iter().find(|t| (t.shape.last() == Some(&4)) == boxes && t.shape.len() == 3);
        let (Some(logits), Some(boxes)) = (of(false), of(true)) else {
            return Err("a DETR answer has logits 1xNxC and boxes 1xNx4".into());
        };
        let (Some(scores), Some(places)) = (logits.data.floats(), boxes.data.floats()) else {
            return Err("logits and boxes of a DETR answer are f32".into());
        };
        let classes = logits.shape[2];
        if classes == 0 || logits.shape[1] != boxes.shape[1] {
            return Err("logits and boxes of a DETR answer have as many rows".into());
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

/// Intersection over union.
pub fn iou(a: &[f32; 4], b: &[f32; 4]) -> f32 {
    let w = (a[2].min(b[2]) - a[0].max(b[0])).max(0.0);
    let h = (a[3].min(b[3]) - a[1].max(b[1])).max(0.0);
    let area = |c: &[f32; 4]| (c[2] - c[0]) * (c[3] - c[1]);
    let union = area(a) + area(b) - w * h;
    if union > 0.0 { w * h / union } else { 0.0 }
}

/// Keeps the best of each heap of boxes, highest score first, `max` at most. `agnostic` lets boxes of different classes displace each
/// other. Ties go to the earlier row, so that the result does not depend on the sort.
pub fn suppress(candidates: &mut Vec<Candidate>, iou_limit: f32, agnostic: bool, max: usize) {
    candidates.sort_unstable_by(|a, b| b.score.total_cmp(&a.score).then(a.row.cmp(&b.row)));
    // A network gone wild answers thousands: the strongest of them are enough to find `max`.
    candidates.truncate(3000);
    let mut kept = 0;
    for i in 0..candidates.len() {
        let c = candidates[i];
        let free = candidates[..kept]
            .iter()
            .all(|k| (!agnostic && k.class_index != c.class_index) || iou(&k.corners, &c.corners) <= iou_limit);
        if free {
            candidates[kept] = c;
            kept += 1;
            if kept == max {
                break;
            }
        }
    }
    candidates.truncate(kept);
}
