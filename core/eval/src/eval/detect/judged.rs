//! Evaluation of a model on a case.

use super::find::Node;
use super::folds;
use super::reliability::Outcome;
use super::truth::Truth;
use panoscope_imaging::detect::{Find, Scores};

/// Evaluation of a model on a case.
pub struct JudgeInputs {
    pub case: String,
    pub node: Node,
    pub truth: Truth,
    /// Image by image.
    pub finds: Vec<Vec<Find>>,
    pub boxes: Scores,
    /// Bounds of the boxes' AP at 0.5, for frames of the data set of the folds.
    pub bounds: Option<folds::Bounds>,
    /// Scores of the outlines, if both ground truth and model have them.
    pub masks: Option<Scores>,
    /// Median time of the node.
    pub ms: f64,
}

impl JudgeInputs {
    /// Outcome of each find above the minimum score, with its class.
    pub fn outcomes(&self) -> Vec<(usize, Outcome)> {
        let objects: Vec<_> = self.truth.pictures.iter().map(|p| p.objects.clone()).collect();
        folds::outcomes(&objects, &self.finds)
    }

    /// The outcomes of one class, or of all.
    pub fn of_class<'a>(
        &self,
        outcomes: &'a [(usize, Outcome)],
        class: Option<usize>,
    ) -> impl Iterator<Item = Outcome> + use<'a> {
        outcomes.iter().filter(move |(k, _)| class.is_none_or(|c| c == *k)).map(|(_, outcome)| *outcome)
    }
}
