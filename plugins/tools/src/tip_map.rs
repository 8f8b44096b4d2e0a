//! Tips that a detector finds next to its boxes: the output `tips` of a network of this project.

use panoscope_node::{Result, error};

use crate::letterbox::Placement;
use crate::session::Tensor;

/// Name of the output: 1 x 3 x rows x columns. The channels are the score of a tip near a cell, 0 to 1, and its column and row in px of the input.
const OUTPUT: &str = "tips";
/// Channels of the output.
const CHANNELS: usize = 3;
/// Distance outside its box within which a tip may be: a share of the box's size, and px of the input.
const OUTSIDE_SHARE: f32 = 0.1;
const OUTSIDE_PX: f32 = 4.0;

/// Separates the output `tips` from the other outputs of a network.
pub fn split<'a, 'b>(outputs: &'b [Tensor<'a>]) -> (&'b [Tensor<'a>], Option<&'b Tensor<'a>>) {
    match outputs.split_last() {
        Some((last, rest)) if last.name == OUTPUT && !rest.is_empty() => (rest, Some(last)),
        _ => (outputs, None),
    }
}

/// Checks the shape of the output `tips`.
///
/// # Errors
/// The output is not 1 x 3 x rows x columns in 32 bits.
pub fn check(tensor: &Tensor<'_>) -> Result<()> {
    match (tensor.data.floats(), &tensor.shape[..]) {
        (Some(_), [1, CHANNELS, rows, columns]) if rows * columns > 0 => Ok(()),
        _ => Err(error!("{tensor}: expected tips as 1 x {CHANNELS} x rows x columns of 32-bit numbers")),
    }
}

/// The tips of one run, copied, because boxes are chosen after the run.
#[derive(Default)]
pub struct TipMap {
    values: Vec<f32>,
    columns: usize,
    placement: Option<Placement>,
}

impl TipMap {
    /// Copies an output that [`check`] accepted. `placement`: of the image in the input.
    pub fn copy(&mut self, tensor: &Tensor<'_>, placement: &Placement) {
        self.values.clear();
        self.placement = Some(*placement);
        if let (Some(values), [.., columns]) = (tensor.data.floats(), &tensor.shape[..]) {
            self.values.extend_from_slice(values);
            self.columns = *columns;
        }
    }

    /// The tip with the highest score in a box (left, top, right, bottom, px of the image): column and row in px of the image, and score. The
    /// position is the mean of the cells around the best one, weighted by their scores. `None` if no cell has its tip in the box.
    pub fn in_box(&self, [x0, y0, x1, y1]: [f32; 4]) -> Option<[f32; 3]> {
        let placement = self.placement.as_ref()?;
        let cells = self.values.len() / CHANNELS;
        let (scores, places) = self.values.split_at(cells);
        let (columns, rows) = places.split_at(cells);
        let [sx, sy] = placement.scale;
        let (margin_x, margin_y) =
            (OUTSIDE_SHARE * (x1 - x0) + OUTSIDE_PX / sx, OUTSIDE_SHARE * (y1 - y0) + OUTSIDE_PX / sy);
        let tip_of = |cell: usize| {
            let (x, y) = placement.back(*columns.get(cell)?, *rows.get(cell)?);
            let is_inside =
                (x0 - margin_x..=x1 + margin_x).contains(&x) && (y0 - margin_y..=y1 + margin_y).contains(&y);
            let score = *scores.get(cell)?;
            (is_inside && score.is_finite()).then_some([x, y, score.clamp(0.0, 1.0)])
        };
        let tips = (0..cells).filter_map(|cell| tip_of(cell).map(|tip| (cell, tip)));
        let (best, [.., score]) = tips.max_by(|(_, a), (_, b)| a[2].total_cmp(&b[2]))?;
        let [best_row, best_column] = [best / self.columns, best % self.columns];
        let mut sum = [0.0_f32; 3];
        for row in best_row.saturating_sub(1)..=best_row + 1 {
            for column in best_column.saturating_sub(1)..=(best_column + 1).min(self.columns - 1) {
                if let Some([x, y, weight]) = tip_of(row * self.columns + column) {
                    sum = [sum[0] + weight * x, sum[1] + weight * y, sum[2] + weight];
                }
            }
        }
        (sum[2] > 0.0).then(|| [sum[0] / sum[2], sum[1] / sum[2], score])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::letterbox::Fit;
    use crate::session::Values;

    /// 4 x 6 cells of 8 px, each with its own centre as tip, and these scores.
    fn map(scores: &[(usize, f32)]) -> TipMap {
        let mut values = vec![0.0; 3 * 24];
        for cell in 0..24 {
            values[24 + cell] = 8.0 * (cell % 6) as f32 + 4.0;
            values[48 + cell] = 8.0 * (cell / 6) as f32 + 4.0;
        }
        scores.iter().for_each(|(cell, score)| values[*cell] = *score);
        let mut map = TipMap::default();
        let tensor = Tensor { name: OUTPUT, shape: vec![1, 3, 4, 6], data: Values::Float(&values) };
        assert!(check(&tensor).is_ok());
        // An image of 96 x 64 px in an input of 48 x 32.
        map.copy(&tensor, &Placement::new(96, 64, (48, 32), Fit::Centre));
        map
    }

    #[test]
    fn the_best_tip_of_a_box_is_found_in_px_of_the_image() {
        // Cell 8 (row 1, column 2) is centred at (20, 12) of the input, at (40, 24) of the image; cell 22 is stronger and outside of the first box.
        let map = map(&[(8, 0.6), (22, 0.9)]);
        assert_eq!(map.in_box([20.0, 10.0, 60.0, 40.0]), Some([40.0, 24.0, 0.6]));
        assert_eq!(map.in_box([0.0, 0.0, 96.0, 64.0]), Some([72.0, 56.0, 0.9]));
        assert_eq!(map.in_box([200.0, 200.0, 220.0, 220.0]), None);
        assert_eq!(TipMap::default().in_box([0.0, 0.0, 96.0, 64.0]), None);
    }

    #[test]
    fn neighbouring_cells_move_the_tip_and_bad_numbers_do_not() {
        let [x, y, score] = map(&[(8, 0.6), (9, 0.3), (2, f32::NAN)]).in_box([0.0, 0.0, 96.0, 64.0]).expect("a tip");
        assert!(
            (x - (0.6 * 40.0 + 0.3 * 56.0) / 0.9).abs() < 1e-3 && (y - 24.0).abs() < 1e-3 && score == 0.6,
            "{x} {y}"
        );
        let odd = Tensor { name: OUTPUT, shape: vec![1, 2, 4, 6], data: Values::Float(&[0.0; 48]) };
        assert!(check(&odd).is_err());
    }
}
