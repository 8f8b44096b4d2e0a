//! `intrinsics.txt` and `extrinsics.txt` of the rectified Hamlyn sequences: rows of numbers, lengths in mm.
//!
//! The first file holds the camera matrix of both rectified views in three rows of three or four numbers, the second one rotation and translation
//! between them in rows of four (Recasens et al., "Endo-Depth-and-Motion", 2021). The views are rectified: the length of the translation is the
//! baseline, and the rotation has to be none.

use panoscope_abi::Calibration;

use crate::calibration::error::Mistake;
use crate::calibration::rectified::{self, View};

/// Largest entry of the rotation away from the unit matrix.
const TURN: f64 = 0.01;

/// Numbers of a row with its line; `None` for a line with anything else.
fn row(line: &str) -> Option<Vec<f64>> {
    let numbers: Option<Vec<f64>> =
        line.split([' ', '\t', ',']).filter(|word| !word.is_empty()).map(|word| word.trim().parse().ok()).collect();
    numbers.filter(|numbers| !numbers.is_empty() && numbers.iter().all(|number| number.is_finite()))
}

/// Whether a text is rows of three or four numbers, three rows at least.
pub(crate) fn is(text: &str) -> bool {
    let mut lines = text.lines().filter(|line| !line.trim().is_empty()).take(5);
    let is_row = |line: &str| row(line).is_some_and(|numbers| matches!(numbers.len(), 3 | 4));
    (0..3).all(|_| lines.next().is_some_and(is_row)) && lines.all(is_row)
}

/// The first three rows.
fn rows(text: &str, columns: usize) -> Result<[Vec<f64>; 3], Mistake> {
    let mut rows = Vec::new();
    for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).take(3) {
        let at = |what: &str| Mistake { line: number + 1, column: 1, what: what.to_owned() };
        let numbers = row(line).ok_or_else(|| at("the line holds something else than numbers"))?;
        if numbers.len() < columns {
            return Err(at(&format!("the row holds {} numbers, {columns} are needed", numbers.len())));
        }
        rows.push(numbers);
    }
    rows.try_into().map_err(|_| Mistake::whole("three rows of numbers are needed: the file is cut off"))
}

/// The packet of both files, in any order; a mistake comes with the index of its file.
pub(crate) fn packet(texts: [&str; 2]) -> Result<Calibration, (usize, Mistake)> {
    // A camera matrix has 0 below its focal lengths; a rotation near the unit matrix has no number above 1 there.
    let is_intrinsics = |text: &str| rows(text, 3).is_ok_and(|rows| rows[0][0] > 10.0);
    let first = usize::from(!is_intrinsics(texts[0]));
    let blame = |index: usize| move |mistake: Mistake| (index, mistake);
    let k = rows(texts[first], 3).map_err(blame(first))?;
    let pose = rows(texts[1 - first], 4).map_err(blame(1 - first))?;
    if !is_intrinsics(texts[first]) {
        return Err((first, Mistake::whole("this is not a camera matrix: its focal length is below 10 px")));
    }
    let unit = |row: usize, column: usize| f64::from(u8::from(row == column));
    let turned = (0..9).find(|index| (pose[index / 3][index % 3] - unit(index / 3, index % 3)).abs() > TURN);
    if turned.is_some() {
        let what = "the right camera is turned against the left one: views of this data set are rectified, their rotation is the unit matrix";
        return Err((1 - first, Mistake { line: 1, column: 1, what: what.to_owned() }));
    }
    let baseline_mm = pose.iter().map(|row| row[3] * row[3]).sum::<f64>().sqrt();
    let view = View { size: (0, 0), focal: (k[0][0], k[1][1]), centre: (k[0][2], k[1][2]) };
    Ok(rectified::packet(view, view, baseline_mm))
}
