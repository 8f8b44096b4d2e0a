//! Boxes of objects in a picture, as VOC and YOLO write them: one file for each picture.

mod voc;
mod yolo;

pub use voc::{Voc, VocObject, voc};
pub use yolo::{YoloObject, YoloShape, yolo, yolo_names};

/// Why a text gives no boxes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LabelError {
    /// The XML is deeper than an annotation can be.
    #[error("its elements stand in each other more than {most} deep")]
    Deep {
        /// Maximum number of levels.
        most: usize,
    },
    /// The text is no XML.
    #[error("{reason}")]
    Xml {
        /// The parser's words.
        reason: String,
    },
    /// An element is missing.
    #[error("<{element}> is missing")]
    Missing {
        /// The element.
        element: &'static str,
    },
    /// An element holds no finite number.
    #[error("<{element}> is {text:?}")]
    Number {
        /// The element.
        element: &'static str,
        /// What it holds.
        text: String,
    },
    /// A line of YOLO is neither a box nor a polygon.
    #[error("expected `class x y width height` or `class x y x y x y ...`")]
    Line {
        /// The line, from 1.
        line: usize,
    },
}
