//! Outputs of a network that are boxes.

use std::path::Path;

use panoscope_node::abi::Detection;
use panoscope_node::{LabeledDetections, Result, Slot};

use super::OnnxParams;
use super::maps::Frame;
use super::table::{OutputPort, PortTable};
use crate::candidates::{Candidate, Decoder, Suppression, suppress};
use crate::export_kind::{ExportKind, recognise};
use crate::finite::count_bad;
use crate::labels;
use crate::session::Tensor;
use crate::yolo::detection;

/// Decodes the boxes of a network.
pub struct Detector {
    /// Names of its outputs.
    outputs: Vec<String>,
    kind: ExportKind,
    classes: usize,
    labels: String,
    candidates: Vec<Candidate>,
    items: Vec<Detection>,
    bad: usize,
    left_out: usize,
}

fn own<'a>(outputs: &[String], tensors: &[Tensor<'a>]) -> Vec<Tensor<'a>> {
    tensors.iter().filter(|tensor| outputs.iter().any(|name| name == tensor.name)).cloned().collect()
}

impl Detector {
    /// Recognises the family of the outputs of the model at `path` that the table names as detections, from a run on an input of `size` px; `None` if
    /// there are none.
    pub fn new(
        path: &Path,
        table: &PortTable,
        tensors: &[Tensor<'_>],
        size: (usize, usize),
        end_to_end: bool,
    ) -> Result<Option<Self>> {
        let rules = || table.outputs.iter().filter(|(_, rule)| rule.port == OutputPort::Detections);
        let outputs: Vec<String> = rules().map(|(name, _)| name.clone()).collect();
        if outputs.is_empty() {
            return Ok(None);
        }
        let own = own(&outputs, tensors);
        let named = rules().find_map(|(_, rule)| rule.family.kind(0));
        let kind = named.map_or_else(|| recognise(path, size, end_to_end, 0, &own), Ok)?;
        count_bad(path, &own, kind.rows())?;
        let classes = kind.classes(&own);
        let (labels, candidates, items) = (String::new(), Vec::new(), Vec::new());
        Ok(Some(Self { outputs, kind, classes, labels, candidates, items, bad: 0, left_out: 0 }))
    }

    /// Sets the names of the classes, see [`labels::table`].
    pub fn with_labels(self, path: &Path, metadata: Option<&str>, file: &Path) -> Result<Self> {
        Ok(Self { labels: labels::table(path, metadata, file, self.classes)?, ..self })
    }

    /// Number of values of the last run that were not finite.
    pub fn bad(&self) -> usize {
        self.bad
    }

    /// Number of boxes of the last run that `max_boxes` left out.
    pub fn left_out(&self) -> usize {
        self.left_out
    }

    /// Decodes the boxes of one run.
    pub fn find(&mut self, path: &Path, tensors: &[Tensor<'_>], frame: &Frame, params: &OnnxParams) -> Result<()> {
        let own = own(&self.outputs, tensors);
        self.bad = count_bad(path, &own, self.kind.rows())?;
        let mut decoder = Decoder {
            kind: self.kind,
            input: frame.input,
            placement: frame.placement,
            picture: frame.image,
            min_score: params.min_score,
            min_objectness: f32::INFINITY,
            out: &mut self.candidates,
        };
        decoder.decode(&own)?;
        let suppression = Suppression {
            max_overlap: params.max_overlap,
            is_agnostic: false,
            max_boxes: params.max_boxes,
            unknown: None,
        };
        self.left_out = suppress(&mut self.candidates, &suppression);
        self.items.clear();
        self.items.extend(self.candidates.iter().map(detection));
        Ok(())
    }

    /// Writes the output.
    pub fn write(&self, slot: &mut Slot<'_, LabeledDetections>, image: (usize, usize)) -> Result<()> {
        slot.set_detections(&self.items, &self.labels, image)
    }
}
