//! `read_labels`: true boxes from VOC or YOLO files, in step with the pictures that they belong to.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use panoscope_node::abi::Detection;
use panoscope_node::{
    AnyImage, Context, LabeledDetections, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Slot,
};
use panoscope_truth::labels;

use crate::series::Series;
use panoscope_calibration::pictures::is_image;

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
    /// Class names, in the order of the data set as far as it gives one.
    classes: Vec<String>,
    items: Vec<Detection>,
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

fn is_yolo(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("txt"))
}

fn is_labels(path: &Path) -> bool {
    let is_list = path.file_name().is_some_and(|name| name == "classes.txt");
    (is_yolo(path) && !is_list) || path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("xml"))
}

/// Names of a YOLO set: beside the labels, or in the folders above, where data.yaml stands.
fn yolo_classes(file: &Path) -> Vec<String> {
    let names = file.ancestors().skip(1).take(4).map(labels::yolo_names);
    names.into_iter().find(|names| !names.is_empty()).unwrap_or_default()
}

impl ReadLabels {
    fn class(&mut self, name: &str) -> u32 {
        let at = self.classes.iter().position(|known| known == name).unwrap_or_else(|| {
            self.classes.push(name.to_owned());
            self.classes.len() - 1
        });
        at as u32
    }

    /// Reads a file of labels; `width` and `height` of the picture in px.
    fn read(&mut self, file: &Path, width: f64, height: f64) -> Result<()> {
        let wrong = |cause: &dyn std::fmt::Display| NodeError::new(format!("{}: {cause}", file.display()));
        let text = std::fs::read_to_string(file).map_err(|error| wrong(&error))?;
        let item = |[x, y, w, h]: [f64; 4], score: f32, class_index: u32| Detection {
            x_px: x as f32,
            y_px: y as f32,
            width_px: w as f32,
            height_px: h as f32,
            score,
            class_index,
            track_id: -1,
        };
        if is_yolo(file) {
            for object in labels::yolo(&text).map_err(|error| match error {
                labels::LabelError::Line { line } => wrong(&format!("line {line}: {error}")),
                other => wrong(&other),
            })? {
                let name = self.classes.get(object.class).cloned();
                let class = self.class(&name.unwrap_or_else(|| format!("class {}", object.class)));
                let [x, y, w, h] = object.bounds();
                self.items.push(item([x * width, y * height, w * width, h * height], 1.0, class));
            }
            return Ok(());
        }
        let found = labels::voc(&text).map_err(|error| wrong(&error))?;
        // Boxes are in px of the size that the file names, which need not be the picture's any more.
        let (sx, sy) = (found.size[0].map_or(1.0, |w| width / w), found.size[1].map_or(1.0, |h| height / h));
        for object in found.objects {
            let class = self.class(&object.name.replace('\n', " "));
            let [x0, y0, x1, y1] = object.corners;
            let score = if object.is_difficult { 0.0 } else { 1.0 };
            self.items.push(item([x0 * sx, y0 * sy, (x1 - x0) * sx, (y1 - y0) * sy], score, class));
        }
        Ok(())
    }
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
        let first = labels.files().first().filter(|file| is_yolo(file));
        let classes = first.map_or_else(Vec::new, |file| yolo_classes(file));
        if params.pictures.trim().is_empty() {
            return Ok(Self { series: labels, by_name: None, classes, items: Vec::new() });
        }
        let by_name = labels.files().iter().map(|file| (stem(file), file.clone())).collect();
        let series = Series::open(&params.pictures, open.graph_dir(), "picture", is_image).map_err(wrong)?;
        Ok(Self { series, by_name: Some(by_name), classes, items: Vec::new() })
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
        self.items.clear();
        if let Some(file) = file {
            self.read(&file, size.0 as f64, size.1 as f64)?;
        }
        out.detections.set_detections(&self.items, &self.classes.join("\n"), size)
    }
}
