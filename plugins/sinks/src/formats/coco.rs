//! Detections and instances as the COCO data set writes them (cocodataset.org, "Data format", object detection).

use std::fmt::Write;

use panoscope_formats::json;
use panoscope_node::{Detections, Instances};

/// Collects the annotations of a run. Image ids are tick numbers, category ids are class index + 1, as in COCO.
#[derive(Debug, Default)]
pub struct Coco {
    images: String,
    annotations: String,
    categories: Vec<String>,
    ticks: u64,
    count: u64,
}

/// Run lengths of an uncompressed COCO mask: column by column, beginning with the zeros. `mask` holds rows padded to
/// whole bytes, most significant bit first.
pub fn run_lengths(mask: &[u8], width: usize, height: usize) -> Vec<u32> {
    let stride = width.div_ceil(8);
    let mut out = Vec::new();
    let (mut run, mut set) = (0, false);
    for x in 0..width {
        for y in 0..height {
            let bit = mask.get(y * stride + x / 8).is_some_and(|byte| byte >> (7 - x % 8) & 1 == 1);
            if bit != set {
                out.push(run);
                (run, set) = (0, bit);
            }
            run += 1;
        }
    }
    out.push(run);
    out
}

impl Coco {
    /// Ticks taken so far.
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Takes the boxes of tick `seq`, whose picture is called `file_name`.
    pub fn push_detections(&mut self, seq: u64, file_name: &str, detections: &Detections<'_>) {
        self.push(seq, file_name, detections, None);
    }

    /// Takes boxes and masks of tick `seq`, whose picture is called `file_name`.
    pub fn push_instances(&mut self, seq: u64, file_name: &str, instances: &Instances<'_>) {
        self.push(seq, file_name, &instances.detections(), Some(instances));
    }

    fn push(&mut self, seq: u64, file_name: &str, detections: &Detections<'_>, masks: Option<&Instances<'_>>) {
        let (width, height) = detections.image_size();
        for (index, label) in detections.labels().enumerate() {
            if index >= self.categories.len() {
                self.categories.push(label.to_owned());
            }
        }
        let out = &mut self.images;
        if !out.is_empty() {
            out.push_str(",\n");
        }
        let _ = write!(out, "{{\"id\":{seq},\"width\":{width},\"height\":{height},\"file_name\":");
        json::string(out, file_name);
        out.push('}');
        let out = &mut self.annotations;
        for (index, item) in detections.items().iter().enumerate() {
            if !out.is_empty() {
                out.push_str(",\n");
            }
            self.count += 1;
            let category = u64::from(item.class_index) + 1;
            let _ = write!(out, "{{\"id\":{},\"image_id\":{seq},\"category_id\":{category},\"bbox\":[", self.count);
            for (at, value) in [item.x_px, item.y_px, item.width_px, item.height_px].into_iter().enumerate() {
                if at > 0 {
                    out.push(',');
                }
                float(out, value);
            }
            out.push_str("],\"area\":");
            match masks {
                Some(instances) => {
                    let counts = run_lengths(instances.mask(index), width, height);
                    let area: u32 = counts.iter().skip(1).step_by(2).sum();
                    let _ =
                        write!(out, "{area},\"segmentation\":{{\"size\":[{height},{width}],\"counts\":{counts:?}}}");
                }
                None => float(out, item.width_px * item.height_px),
            }
            out.push_str(",\"iscrowd\":0,\"score\":");
            float(out, item.score);
            if item.track_id >= 0 {
                let _ = write!(out, ",\"track_id\":{}", item.track_id);
            }
            out.push('}');
        }
        self.ticks += 1;
    }

    /// The whole file.
    pub fn text(&self) -> String {
        let mut out = String::with_capacity(self.images.len() + self.annotations.len() + 256);
        out.push_str("{\"images\":[\n");
        out.push_str(&self.images);
        out.push_str("\n],\"annotations\":[\n");
        out.push_str(&self.annotations);
        out.push_str("\n],\"categories\":[\n");
        for (index, name) in self.categories.iter().enumerate() {
            if index > 0 {
                out.push_str(",\n");
            }
            let _ = write!(out, "{{\"id\":{},\"name\":", index + 1);
            json::string(&mut out, name);
            out.push('}');
        }
        out.push_str("\n]}\n");
        out
    }
}

fn float(out: &mut String, value: f32) {
    if value.is_finite() {
        let _ = write!(out, "{value}");
    } else {
        out.push_str("null");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_run_down_the_columns() {
        // 3 x 2: row 0 = 1 0 1, row 1 = 1 1 0.
        assert_eq!(run_lengths(&[0b1010_0000, 0b1100_0000], 3, 2), [0, 2, 1, 2, 1]);
        assert_eq!(run_lengths(&[0, 0], 3, 2), [6]);
        assert_eq!(run_lengths(&[], 3, 2), [6], "a missing mask is an empty one");
    }
}
