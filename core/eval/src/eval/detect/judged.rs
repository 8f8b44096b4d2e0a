//! A model judged on a case.

use super::find::Node;
use super::truth::Truth;
use panoscope_imaging::detect::{Find, Scores};

/// A model judged on a case.
pub struct JudgeInputs {
    pub case: String,
    pub node: Node,
    pub truth: Truth,
    /// Picture by picture.
    pub finds: Vec<Vec<Find>>,
    pub boxes: Scores,
    /// Where both truth and model have outlines.
    pub masks: Option<Scores>,
    /// Median time of the node.
    pub ms: f64,
}
