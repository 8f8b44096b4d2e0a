//! Boxes of objects in an image, in the formats of VOC and YOLO: one file for each image.

mod voc;
mod yolo;

pub use voc::{Voc, VocObject, voc};
pub use yolo::{YoloObject, YoloShape, yolo, yolo_names};

/// A text without valid boxes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LabelError {
    /// The XML is nested too deeply.
    #[error("its elements are nested more than {most} levels deep")]
    Deep {
        /// Maximum number of levels.
        most: usize,
    },
    /// The text is not XML.
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
    /// An element is not a finite number.
    #[error("<{element}> is {text:?}")]
    Number {
        /// The element.
        element: &'static str,
        /// Its content.
        text: String,
    },
    /// Numbers of YOLO are px instead of shares of the image.
    #[error("{value} is not a share of the image, 0 to 1: divide numbers in px by the image's width or height")]
    NoShare {
        /// The line, from 1.
        line: usize,
        /// The number.
        value: String,
    },
    /// A line of YOLO is neither a box nor a polygon.
    #[error("expected `class x y width height` or `class x y x y x y ...`")]
    Line {
        /// The line, from 1.
        line: usize,
    },
}
