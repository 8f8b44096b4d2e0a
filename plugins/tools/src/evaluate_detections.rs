//! `evaluate_detections`: detected boxes compared with the true ones, counted since the start.

use panoscope_imaging::detect::{Find, Object, Tally, normal_name};
use panoscope_node::abi::Scalar;
use panoscope_node::{Context, Detections, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData, Validation};

use crate::yolo::UNKNOWN;

/// Input ports of `evaluate_detections`.
#[derive(Ports)]
pub struct In<'f> {
    /// Boxes to evaluate. A tick without them counts as no detection.
    detections: Option<Detections<'f>>,
    /// True boxes, such as `detections` of the phantom or of `read_labels`. An object with a score of 0 is ignored.
    truth: Detections<'f>,
}

/// Outputs, counted over all ticks since the start: the last ones are those of the run. NaN where the divisor is 0.
#[derive(Ports)]
pub struct Out<'f> {
    /// Percentage of the detections of at least `min_score` that match an object of their class with an overlap of 0.5.
    precision_pct: Slot<'f, Scalar>,
    /// Percentage of the objects that are matched by such a detection.
    recall_pct: Slot<'f, Scalar>,
    /// COCO's average precision at an overlap of 0.5, over all scores, mean of the classes that have objects.
    ap50_pct: Slot<'f, Scalar>,
    /// A row for each class in the order of `truth`'s labels, further classes after them: `class`, `objects`, `detections` of at least `min_score`,
    /// `hits`, and the three numbers above.
    table: Slot<'f, TableData>,
}

/// Parameters of `evaluate_detections`.
#[derive(Params)]
pub struct EvaluateDetectionsParams {
    /// Minimum score of a detection that counts for precision and recall.
    #[param(default = 0.5, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_score: f64,
}

/// Columns of the table.
const COLUMNS: [&str; 7] = ["class", "objects", "detections", "hits", "precision_pct", "recall_pct", "ap50_pct"];
/// Maximum number of classes that are distinguished.
const MAX_CLASSES: usize = 1000;

/// The `evaluate_detections` node.
#[derive(Default)]
pub struct EvaluateDetections {
    /// Normalised class names, in order of first appearance.
    names: Vec<String>,
    tally: Tally,
    objects: Vec<Object>,
    finds: Vec<Find>,
    rows: Vec<f64>,
}

impl EvaluateDetections {
    /// Index of a class by its name; new names are added.
    fn class(&mut self, label: &str) -> usize {
        let name = normal_name(label);
        self.names.iter().position(|known| *known == name).unwrap_or_else(|| {
            if self.names.len() < MAX_CLASSES {
                self.names.push(name);
            }
            self.names.len() - 1
        })
    }
}

fn bounds(item: &panoscope_node::abi::Detection) -> [f64; 4] {
    [item.x_px, item.y_px, item.width_px, item.height_px].map(f64::from)
}

impl Node for EvaluateDetections {
    const INFO: NodeInfo = NodeInfo::compute(
        "evaluate_detections",
        "tools",
        "Compares boxes with the true ones: precision, recall and average precision since the start.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = EvaluateDetectionsParams;

    fn validate(_: &EvaluateDetectionsParams, check: &mut Validation<'_>) {
        if check.is_connected("detections") == Some(false) {
            check.node_error("`detections` is not connected: there is nothing to evaluate", "connect it");
        }
    }

    fn open(_: &Open<'_>, _: &EvaluateDetectionsParams) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &EvaluateDetectionsParams,
    ) -> Result<()> {
        input.truth.labels().for_each(|label| {
            self.class(label);
        });
        let (mut objects, mut finds) = (std::mem::take(&mut self.objects), std::mem::take(&mut self.finds));
        objects.clear();
        finds.clear();
        for item in input.truth.items() {
            let class = self.class(input.truth.label(item.class_index));
            objects.push(Object { class, bbox: bounds(item), mask: None, ignored: item.score <= 0.0 });
        }
        if let Some(detections) = &input.detections {
            for item in detections.items() {
                let label = detections.label(item.class_index);
                // An instrument whose kind is not sure is neither a right nor a wrong find of any class.
                if label == UNKNOWN && !self.names.iter().any(|name| name == UNKNOWN) {
                    continue;
                }
                let class = self.class(label);
                finds.push(Find { class, bbox: bounds(item), mask: None, score: f64::from(item.score) });
            }
        }
        self.tally.add(&objects, &finds);
        (self.objects, self.finds) = (objects, finds);
        // Scores are f32: 0.9 as f32 is not less than 0.9 as the user means it.
        let min_score = f64::from(params.min_score as f32);
        self.rows.clear();
        for class in 0..self.names.len() {
            let rates = self.tally.class(class, min_score);
            let counts = [class, rates.truths, rates.finds, rates.hits].map(|n| n as f64);
            self.rows.extend(counts);
            self.rows.extend([rates.precision(), rates.recall(), rates.ap50].map(|share| 100.0 * share));
        }
        let all = self.tally.all(min_score);
        let [precision, recall, ap50] = [all.precision(), all.recall(), all.ap50].map(|share| 100.0 * share);
        cx.metric("ap50_pct", ap50);
        out.precision_pct.set_scalar("precision", precision, "%")?;
        out.recall_pct.set_scalar("recall", recall, "%")?;
        out.ap50_pct.set_scalar("AP at 0.5", ap50, "%")?;
        out.table.set_table(&COLUMNS, &self.rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_node::abi::Detection;
    use panoscope_node::harness::{Harness, HarnessError};

    fn at(left: f32, class_index: u32, score: f32) -> Detection {
        Detection { x_px: left, y_px: 0.0, width_px: 10.0, height_px: 10.0, score, class_index, track_id: -1 }
    }

    #[test]
    fn precision_recall_and_average_precision_grow_with_the_pictures() -> std::result::Result<(), HarnessError> {
        let mut node = Harness::<EvaluateDetections>::from_toml("params = { min_score = 0.4 }")?;
        // The model writes its classes in another order and with other capitals.
        let (labels, found_labels) = ("Hook\ngrasper", "Grasper\nhook\nclip");
        node.input_detections("truth", &[at(0.0, 0, 1.0), at(20.0, 1, 1.0)], labels, (100, 50));
        let found = [at(1.0, 1, 0.9), at(50.0, 1, 0.95), at(21.0, 0, 0.2)];
        let out = node.input_detections("detections", &found, found_labels, (100, 50)).process()?;
        let number = |port: &str| out.value::<Scalar>(port).map(|scalar| scalar.value);
        assert_eq!((number("precision_pct")?, number("recall_pct")?), (50.0, 50.0));
        // hook: a wrong one before the right one, precision 1/2 at every recall. grasper: right, whatever its score.
        assert!((number("ap50_pct")? - 75.0).abs() < 1e-9, "{}", number("ap50_pct")?);
        let rows: Vec<Vec<f64>> = out.table("table")?.rows().map(<[f64]>::to_vec).collect();
        assert_eq!(rows[0][..6], [0.0, 1.0, 2.0, 1.0, 50.0, 100.0]);
        assert_eq!((rows[1][..4].to_vec(), rows[1][5]), (vec![1.0, 1.0, 0.0, 0.0], 0.0));
        // Of an unknown kind: neither right nor wrong, and no class of its own.
        let (precision, classes) = (number("precision_pct")?, rows.len());
        node.input_detections("truth", &[], labels, (100, 50));
        let unknown = [at(60.0, 2, 0.9)];
        let out = node.input_detections("detections", &unknown, "hook\ngrasper\nunknown", (100, 50)).process()?;
        assert_eq!(
            (out.value::<Scalar>("precision_pct")?.value, out.table("table")?.rows().count()),
            (precision, classes)
        );
        // Nothing is found in the second picture; an object that is too difficult does not count.
        node.input_detections("truth", &[at(0.0, 0, 1.0), at(30.0, 0, 0.0)], labels, (100, 50));
        let out = node.process_empty(&["detections"])?;
        let recall = out.value::<Scalar>("recall_pct")?.value;
        assert!((recall - 100.0 / 3.0).abs() < 1e-9, "{recall}");
        Ok(())
    }
}
