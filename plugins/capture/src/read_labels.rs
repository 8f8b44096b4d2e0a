//! `read_labels`: true boxes from VOC or YOLO files, in step with the pictures that they belong to.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use panoscope_calibration::pictures::is_image;
use panoscope_node::{
    AnyImage, Context, LabeledDetections, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Slot,
};
use panoscope_truth::labels;

use crate::boxes::{self, Boxes};
use crate::series::Series;

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Picture of the source, such as `left` of `capture`. The labels with its number are read; boxes are scaled to its size.
    image: AnyImage<'f>,
}

/// Outputs. Empty behind the last file.
#[derive(Ports)]
pub struct Out<'f> {
    /// The true boxes: score 1, or 0 for objects that are marked as difficult.
    detections: Slot<'f, LabeledDetections>,
}

/// Parameters.
#[derive(Params)]
pub struct ReadLabelsParams {
    /// Folder or pattern (labels/*.txt, Annotations/*.xml) of YOLO or VOC labels. The n-th file in the order of their numbers belongs to the n-th
    /// picture.
    #[param(default = "", reopen, file)]
    path: String,
    /// Folder or pattern of the pictures, as in the source. With it labels belong to the picture of their name, and a picture without labels shows
    /// nothing; without it there must be a file for every picture.
    #[param(default = "", reopen, file)]
    pictures: String,
    /// Starts with the first file again behind the last one, as `loop` of `capture`.
    #[param(default = false)]
    r#loop: bool,
}

/// See the module.
pub struct ReadLabels {
    /// Labels, or pictures where they are given.
    series: Series,
    /// Labels by the name of their picture.
    by_name: Option<BTreeMap<String, PathBuf>>,
    boxes: Boxes,
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

fn is_labels(path: &Path) -> bool {
    let is_list = path.file_name().is_some_and(|name| name == "classes.txt");
    (boxes::is_yolo(path) && !is_list) || path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("xml"))
}

/// Names of a YOLO set: beside the labels, or in the folders above, where data.yaml stands.
fn yolo_classes(file: &Path) -> Vec<String> {
    let names = file.ancestors().skip(1).take(4).map(labels::yolo_names);
    names.into_iter().find(|names| !names.is_empty()).unwrap_or_default()
}

impl Node for ReadLabels {
    const INFO: NodeInfo = NodeInfo::blocking(
        "read_labels",
        "source",
        "Reads true boxes from VOC or YOLO files, those of one picture after the other.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ReadLabelsParams;

    fn open(open: &Open<'_>, params: &ReadLabelsParams) -> Result<Self> {
        let wrong = |error: crate::series::SeriesError| NodeError::new(error.to_string());
        let labels = Series::open(&params.path, open.graph_dir(), "file of labels", is_labels).map_err(wrong)?;
        let first = labels.files().first().filter(|file| boxes::is_yolo(file));
        let boxes = Boxes::new(first.map_or_else(Vec::new, |file| yolo_classes(file)));
        if params.pictures.trim().is_empty() {
            return Ok(Self { series: labels, by_name: None, boxes });
        }
        let by_name = labels.files().iter().map(|file| (stem(file), file.clone())).collect();
        let series = Series::open(&params.pictures, open.graph_dir(), "picture", is_image).map_err(wrong)?;
        Ok(Self { series, by_name: Some(by_name), boxes })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &ReadLabelsParams,
    ) -> Result<()> {
        let Some((_, file)) = self.series.of_tick(cx, params.r#loop) else { return Ok(()) };
        let file = match &self.by_name {
            Some(by_name) => by_name.get(&stem(file)).cloned(),
            None => Some(file.to_owned()),
        };
        let size = (input.image.width(), input.image.height());
        self.boxes.clear();
        if let Some(file) = file {
            self.boxes.read(&file, size)?;
        }
        self.boxes.write(&mut out.detections, size)
    }
}
