//! Checks a network's outputs for values that are not finite. Otherwise a broken network would detect nothing without an error.

use std::path::{Path, PathBuf};

use crate::session::Tensor;

/// The outputs of the network are unusable.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{path} is broken: {bad} of {values} values of its output `{output}` are NaN or infinite, {extent}; export the network again, or try it in full precision (f32)",
    path = path.display()
)]
pub struct BrokenNetwork {
    /// File of the network.
    pub path: PathBuf,
    /// Name of the output.
    pub output: String,
    /// Number of values that are not finite.
    pub bad: usize,
    /// Number of all values of the output.
    pub values: usize,
    /// Extent of the damage, as text.
    pub extent: &'static str,
}

/// Whether a value makes its box unusable. Minus infinity is valid: a certain "no" of a classifier.
fn is_bad(value: &f32) -> bool {
    value.is_nan() || *value == f32::INFINITY
}

/// Memory layout of the rows of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rows {
    /// Row by row: `... x rows x values`.
    Whole,
    /// Column by column: `... x values x rows` (YOLOv8 and later).
    Columns,
}

/// Counts the values of boxes, scores and logits that are NaN or infinite.
///
/// # Errors
/// No row of an output is usable, or no value of a map of masks or prototypes is finite.
pub fn count_bad(path: &Path, outputs: &[Tensor<'_>], rows: Rows) -> Result<usize, BrokenNetwork> {
    let mut total = 0;
    for tensor in outputs {
        let Some(values) = tensor.data.floats().filter(|values| !values.is_empty()) else { continue };
        let broken = |bad: usize, extent: &'static str| {
            let output = tensor.name.to_owned();
            Err(BrokenNetwork { path: path.to_owned(), output, bad, values: values.len(), extent })
        };
        if !values.iter().any(|value| value.is_finite()) {
            return broken(values.len(), "that is all of them");
        }
        // Masks and prototypes are large, and partial damage shows only in the mask concerned.
        if tensor.shape.len() > 3 {
            continue;
        }
        let bad = values.iter().filter(|value| is_bad(value)).count();
        total += bad;
        if bad > 0 && !has_usable_row(values, &tensor.shape, rows) {
            return broken(bad, "some in each row");
        }
    }
    Ok(total)
}

fn has_usable_row(values: &[f32], shape: &[usize], rows: Rows) -> bool {
    let last = shape.last().copied().unwrap_or(1).max(1);
    match rows {
        _ if shape.len() < 2 => values.iter().any(|value| !is_bad(value)),
        Rows::Whole => values.chunks(last).any(|row| !row.iter().any(is_bad)),
        Rows::Columns => (0..last).any(|row| !values.iter().skip(row).step_by(last).any(is_bad)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::Values;

    fn count(values: &[f32], shape: &[usize], rows: Rows) -> Result<usize, BrokenNetwork> {
        let tensor = Tensor { name: "out", shape: shape.to_vec(), data: Values::Float(values) };
        count_bad(Path::new("m.onnx"), &[tensor], rows)
    }

    #[test]
    fn single_bad_values_are_counted_and_broken_answers_refused() {
        let (nan, inf) = (f32::NAN, f32::INFINITY);
        assert_eq!(count(&[1.0, 2.0, 3.0, 4.0], &[1, 2, 2], Rows::Whole), Ok(0));
        assert_eq!(count(&[1.0, 2.0, nan, inf], &[1, 2, 2], Rows::Whole), Ok(2));
        let error = count(&[1.0, nan, 3.0, inf], &[1, 2, 2], Rows::Whole).unwrap_err().to_string();
        assert!(
            error.starts_with("m.onnx is broken: 2 of 4 values of its output `out` are NaN or infinite"),
            "{error}"
        );
        // The same numbers in columns: the first row is 1 and 3, sound.
        assert_eq!(count(&[1.0, nan, 3.0, inf], &[1, 2, 2], Rows::Columns), Ok(2));
        assert!(count(&[nan, 1.0, 1.0, nan], &[1, 2, 2], Rows::Columns).is_err());
        assert!(count(&[nan; 16], &[1, 1, 4, 4], Rows::Whole).unwrap_err().to_string().contains("all of them"));
        assert_eq!(count(&[nan, 1.0], &[1, 1, 1, 2], Rows::Whole), Ok(0), "a mask that is partly damaged");
        // Nothing found, and a class that is ruled out.
        assert_eq!(count(&[], &[0, 4], Rows::Whole), Ok(0));
        assert_eq!(count(&[f32::NEG_INFINITY, 1.0], &[1, 1, 2], Rows::Whole), Ok(0));
        assert!(count(&[f32::NEG_INFINITY; 2], &[1, 1, 2], Rows::Whole).is_err());
        assert_eq!(count(&[nan, 0.5], &[2], Rows::Whole), Ok(1));
    }
}
