//! Keypoints of boxes, from pose exports of YOLO or a map of tips: tips, and a table of all keypoints.

use panoscope_node::abi::{Detection, Tip};
use panoscope_node::{Result, Slot, Table, TableData};

use crate::candidates::Candidate;
use crate::export_kind::ExportKind;
use crate::letterbox::Placement;
use crate::session::Tensor;
use crate::tip_map::TipMap;

/// Columns of the table of keypoints.
const COLUMNS: [&str; 5] = ["box", "keypoint", "x_px", "y_px", "score"];
/// Maximum number of keypoints of a box.
const MAX_COUNT: usize = 256;
/// Keypoints of a box whose tip is in a map of tips.
const TIP: KeypointShape = KeypointShape { count: 1, numbers: 3 };

/// Number of keypoints per box, and of values per keypoint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KeypointShape {
    count: usize,
    /// 2 (position) or 3 (position and score).
    numbers: usize,
}

impl KeypointShape {
    /// Parses `[2, 3]`, which exports write under `kpt_shape`; `None` if the text is malformed.
    pub fn from_metadata(text: &str) -> Option<Self> {
        let inner = text.trim().strip_prefix('[')?.strip_suffix(']')?;
        let (count, numbers) = inner.split_once(',')?;
        let shape = Self { count: count.trim().parse().ok()?, numbers: numbers.trim().parse().ok()? };
        ((1..=MAX_COUNT).contains(&shape.count) && matches!(shape.numbers, 2 | 3)).then_some(shape)
    }

    /// Number of values per box.
    pub fn len(self) -> usize {
        self.count * self.numbers
    }

    /// Whether boxes have no keypoints.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }
}

/// The keypoints of the boxes of one run.
#[derive(Default)]
pub struct Keypoints {
    shape: KeypointShape,
    /// Row of each box in the network's output.
    rows: Vec<u32>,
    /// Position (x, y in px of the image) and score of all keypoints of each row.
    points: Vec<[f32; 3]>,
    table: Vec<f64>,
    /// Tips of the last run, if the network has a map of tips.
    map: Option<TipMap>,
}

impl Keypoints {
    /// Starts without boxes. `has_map`: whether the network has a map of tips, which replaces keypoints of the boxes.
    pub fn new(shape: KeypointShape, has_map: bool) -> Self {
        let shape = if has_map { TIP } else { shape };
        Self { shape, map: has_map.then(TipMap::default), ..Self::default() }
    }

    /// Copies the map of tips of the run; `placement`: of the image in the input.
    pub fn copy_map(&mut self, tips: Option<&Tensor<'_>>, placement: &Placement) {
        if let (Some(map), Some(tips)) = (&mut self.map, tips) {
            map.copy(tips, placement);
        }
    }

    /// Finds the tip of each box in the map of tips, if there is one.
    pub fn find_tips(&mut self, candidates: &[Candidate]) {
        let Some(map) = &self.map else { return };
        self.rows.clear();
        self.points.clear();
        for candidate in candidates {
            if let Some(tip) = map.in_box(candidate.corners) {
                self.rows.push(candidate.row);
                self.points.push(tip);
            }
        }
    }

    /// Collects the keypoints of `candidates` from the outputs that they were decoded from.
    pub fn collect(
        &mut self,
        outputs: &[Tensor<'_>],
        kind: ExportKind,
        candidates: &[Candidate],
        placement: &Placement,
    ) {
        self.rows.clear();
        self.points.clear();
        let is_read = !self.shape.is_empty() && self.map.is_none();
        let Some(tensor) = outputs.first().filter(|_| is_read) else { return };
        let (Some(values), [_, second, third]) = (tensor.data.floats(), &tensor.shape[..]) else { return };
        let KeypointShape { count, numbers } = self.shape;
        for candidate in candidates {
            let row = candidate.row as usize;
            let number = |index: usize| match kind {
                ExportKind::EndToEnd => values.get(row * third + 6 + index),
                _ => values.get((second.saturating_sub(self.shape.len()) + index) * third + row),
            };
            self.rows.push(candidate.row);
            for keypoint in 0..count {
                let at = |offset: usize| number(keypoint * numbers + offset).copied().unwrap_or(f32::NAN);
                let (x, y) = placement.back(at(0), at(1));
                let score = if numbers == 3 { at(2).clamp(0.0, 1.0) } else { candidate.score };
                self.points.push([x, y, score]);
            }
        }
    }

    /// Keypoints of a row of the output: x, y in px of the image, and score.
    fn of_row(&self, row: u32) -> &[[f32; 3]] {
        let index = self.rows.iter().position(|have| *have == row);
        let count = self.shape.count;
        index.and_then(|index| self.points.get(index * count..(index + 1) * count)).unwrap_or(&[])
    }

    /// Writes the tips of the first box, and the table of all boxes. `items` are the boxes of `candidates`.
    pub fn write(
        &mut self,
        candidates: &[Candidate],
        items: &[Detection],
        tips: [&mut Slot<'_, Tip>; 4],
        table: &mut Slot<'_, TableData>,
    ) -> Result<()> {
        if self.shape.is_empty() {
            return Ok(());
        }
        if let (Some(candidate), Some(item)) = (candidates.first(), items.first()) {
            for (tip, &[x, y, score]) in tips.into_iter().zip(self.of_row(candidate.row)) {
                if x.is_finite() && y.is_finite() {
                    tip.set(Tip {
                        u_px: f64::from(x),
                        v_px: f64::from(y),
                        xyz_mm: [f64::NAN; 3],
                        score: f64::from(score),
                        class_index: item.class_index,
                        xyz_valid: 0,
                        track_id: item.track_id,
                    })?;
                }
            }
        }
        if !table.is_read() {
            return Ok(());
        }
        let mut rows = std::mem::take(&mut self.table);
        rows.clear();
        for (index, candidate) in candidates.iter().enumerate() {
            for (keypoint, point) in self.of_row(candidate.row).iter().enumerate() {
                rows.extend([index as f64, keypoint as f64]);
                rows.extend(point.iter().map(|value| f64::from(*value)));
            }
        }
        let made = table.set_table(&COLUMNS, &rows);
        self.table = rows;
        made
    }
}

/// The first keypoint of box `index` in a table of keypoints: column and row, px, and score. `None` if the table has no such row, or other columns.
pub fn tip_in_table(table: &Table<'_>, index: usize) -> Option<[f64; 3]> {
    if !table.names().eq(COLUMNS) {
        return None;
    }
    let row = table.rows().find(|row| matches!(row, [of, keypoint, ..] if *of == index as f64 && *keypoint == 0.0))?;
    let [_, _, x, y, score] = row else { return None };
    (x.is_finite() && y.is_finite()).then_some([*x, *y, *score])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_sensible_shapes_are_read() {
        assert_eq!(KeypointShape::from_metadata("[2, 3]"), Some(KeypointShape { count: 2, numbers: 3 }));
        assert_eq!(KeypointShape::from_metadata(" [17,2] ").map(KeypointShape::len), Some(34));
        for text in ["", "[]", "[2]", "[2, 4]", "[0, 3]", "[99999, 3]", "[-1, 3]", "2, 3", "[2, 3, 3]"] {
            assert_eq!(KeypointShape::from_metadata(text), None, "{text}");
        }
    }
}
