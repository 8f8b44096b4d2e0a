//! `read_labels`: true boxes from VOC or YOLO files, in step with the images that they belong to.

use std::path::Path;

use panoscope_data::truth::labels;
use panoscope_node::{
    AnyImage, Context, LabeledDetections, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Slot,
};

use crate::boxes::{self, Boxes};
use crate::series::Series;

/// Input ports of `read_labels`.
#[derive(Ports)]
pub struct In<'f> {
    /// Image of the source, such as `left` of `capture`. The labels with its number are read; boxes are scaled to its size.
    image: AnyImage<'f>,
}

/// Outputs. Empty after the last file.
#[derive(Ports)]
pub struct Out<'f> {
    /// The true boxes, with score 1, or 0 for objects that are marked as difficult.
    detections: Slot<'f, LabeledDetections>,
}

/// Parameters of `read_labels`.
#[derive(Params)]
pub struct ReadLabelsParams {
    /// Folder or pattern (labels/*.txt, Annotations/*.xml) of YOLO or VOC labels.
    #[param(default = "", reopen, file)]
    path: String,
    /// Folder or pattern of the images, as in the source. With it, labels are matched to images by name, else by number, and an image without labels
    /// shows nothing. Without it, the n-th file by number belongs to the n-th image, and no number may be missing.
    #[param(default = "", reopen, file)]
    pictures: String,
    /// Repeats the files from the first one, as `loop` of `capture`.
    #[param(default = false)]
    r#loop: bool,
}

/// The `read_labels` node.
pub struct ReadLabels {
    series: Series,
    boxes: Boxes,
}

fn is_labels(path: &Path) -> bool {
    let is_list = path.file_name().is_some_and(|name| name == "classes.txt");
    (boxes::is_yolo(path) && !is_list) || path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("xml"))
}

/// Class names of a YOLO set, from the data.yaml in the folder of the labels or in one above it.
fn yolo_classes(file: &Path) -> Vec<String> {
    let names = file.ancestors().skip(1).take(4).map(labels::yolo_names);
    names.into_iter().find(|names| !names.is_empty()).unwrap_or_default()
}

impl Node for ReadLabels {
    const INFO: NodeInfo = NodeInfo::blocking(
        "read_labels",
        "source",
        "Reads true boxes from VOC or YOLO files, one image after the other.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ReadLabelsParams;

    fn open(open: &Open<'_>, params: &ReadLabelsParams) -> Result<Self> {
        let series = Series::open((&params.path, &params.pictures), open.graph_dir(), "file of labels", is_labels)
            .map_err(|error| NodeError::new(error.to_string()))?;
        let first = series.files().next().filter(|file| boxes::is_yolo(file));
        let boxes = Boxes::new(first.map_or_else(Vec::new, |file| yolo_classes(file)));
        Ok(Self { series, boxes })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &ReadLabelsParams,
    ) -> Result<()> {
        let Some((_, file)) = self.series.of_tick(cx, params.r#loop) else { return Ok(()) };
        let size = (input.image.width(), input.image.height());
        self.boxes.clear();
        if let Some(file) = file {
            self.boxes.read(file, size)?;
        }
        self.boxes.write(&mut out.detections, size)
    }
}
