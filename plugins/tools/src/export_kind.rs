//! Recognises a model's kind of export from the shapes of its outputs and its metadata.

use std::path::{Path, PathBuf};

use crate::finite::Rows;
use crate::letterbox::{BORDER, Fit, PixelForm};
use crate::session::{Tensor, list_text};

/// The outputs match no known kind of export.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{path} returns {shapes} for an image of {width}x{height}; expected 1x{cells}x(5+C) (YOLOX), 1x{anchors}x(5+C) (YOLOv5), 1x(4+C)x{cells} (YOLOv8 and later), 1xNx6 (end to end) or logits 1xNxC with boxes 1xNx4 (DETR); name the kind with `layout`, or with `family` in a table of `onnx`",
    path = path.display(), anchors = 3 * cells
)]
pub struct UnknownKind {
    /// File of the model.
    pub path: PathBuf,
    /// Names and shapes of its outputs, as text.
    pub shapes: String,
    /// Columns of its input, px.
    pub width: usize,
    /// Rows of its input, px.
    pub height: usize,
    /// Number of cells that an anchor-free head has for this input.
    pub cells: usize,
}

/// A family of exports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportKind {
    /// YOLOX: 1 x N x (5 + C), centres and sizes relative to the grid.
    YoloxRaw,
    /// YOLOX with `decode_in_inference`: 1 x N x (5 + C), in px of the input.
    YoloxDecoded,
    /// YOLOv5, v7: 1 x N x (5 + C), three anchors per cell.
    YoloV5,
    /// YOLOv8, 9, 11, 12: 1 x (4 + C + extra) x N; the -seg forms with mask coefficients, the -pose forms with keypoints.
    YoloV8 {
        /// Number of mask coefficients or keypoint values at the end of each column.
        extra: usize,
    },
    /// YOLOv10, YOLO26: 1 x N x (6 + keypoints), corners, score, class.
    EndToEnd,
    /// DETR family: logits 1 x N x C and boxes 1 x N x 4, as shares of the input.
    Detr,
}

impl ExportKind {
    /// Pixel form that the family expects.
    pub fn pixel_form(self) -> PixelForm {
        let unit = PixelForm { rgb: true, mean: [0.0; 3], gain: [1.0 / 255.0; 3], fit: Fit::Centre, border: BORDER };
        match self {
            Self::YoloxRaw | Self::YoloxDecoded => PixelForm { rgb: false, gain: [1.0; 3], fit: Fit::Corner, ..unit },
            Self::Detr => PixelForm { fit: Fit::Stretch, ..unit },
            _ => unit,
        }
    }

    /// Memory layout of the rows of an output.
    pub fn rows(self) -> Rows {
        if matches!(self, Self::YoloV8 { .. }) { Rows::Columns } else { Rows::Whole }
    }

    /// Number of classes, from the shapes of the outputs.
    pub fn classes(self, outputs: &[Tensor<'_>]) -> usize {
        let last = |i: usize| outputs.get(i).and_then(|t| t.shape.last().copied()).unwrap_or(0);
        match self {
            Self::YoloxRaw | Self::YoloxDecoded | Self::YoloV5 => last(0).saturating_sub(5),
            Self::YoloV8 { extra } => {
                let rows = outputs.first().and_then(|t| t.shape.get(1).copied()).unwrap_or(0);
                rows.saturating_sub(4 + extra)
            }
            Self::EndToEnd => 0,
            Self::Detr => outputs.iter().find_map(|t| t.shape.last().copied().filter(|&n| n != 4)).unwrap_or(0),
        }
    }
}

/// Total number of cells of an anchor-free head.
fn cells(input: (usize, usize)) -> usize {
    [8, 16, 32].iter().map(|s| (input.0 / s) * (input.1 / s)).sum()
}

/// Recognises the kind from the outputs of the model at `path` for an image of `input` px (width, height). `end_to_end`: the metadata state that
/// suppression is included. `keypoints`: number of keypoint values per box by the metadata, 0 if there are none.
///
/// # Errors
/// The shapes match no known kind.
pub fn recognise(
    path: &Path,
    input: (usize, usize),
    end_to_end: bool,
    keypoints: usize,
    outputs: &[Tensor<'_>],
) -> Result<ExportKind, UnknownKind> {
    let n = cells(input);
    let unknown = || {
        let (width, height) = input;
        Err(UnknownKind { path: path.to_owned(), shapes: list_text(outputs), width, height, cells: n })
    };
    let ranks: Vec<&[usize]> = outputs.iter().map(|t| t.shape.as_slice()).collect();
    match ranks[..] {
        [[1, rows, len]]
            if *len == 6 + keypoints && (end_to_end || (*rows <= 1000 && *rows != n && *rows != 3 * n)) =>
        {
            Ok(ExportKind::EndToEnd)
        }
        [[1, len, rows]] if keypoints > 0 && *rows == n && *len > 4 + keypoints => {
            Ok(ExportKind::YoloV8 { extra: keypoints })
        }
        [[1, rows, len]] if *rows == n && *len > 5 => Ok(ExportKind::YoloxRaw),
        [[1, rows, len], ..] if *rows == 3 * n && *len > 5 => Ok(ExportKind::YoloV5),
        [[1, len, rows]] if *rows == n && *len > 4 => Ok(ExportKind::YoloV8 { extra: 0 }),
        // Boxes with mask coefficients, and the prototypes they weight.
        [[1, len, rows], [1, masks, _, _]] if *rows == n && *len > 4 + *masks => {
            Ok(ExportKind::YoloV8 { extra: *masks })
        }
        [[1, a, x], [1, b, y]] if a == b && (*x == 4) != (*y == 4) => Ok(ExportKind::Detr),
        _ => unknown(),
    }
}
