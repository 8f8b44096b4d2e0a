//! Detections and instances as the COCO data set writes them (cocodataset.org, "Data format", object detection).

use std::fmt::Write;
use std::io::{self, BufRead, Seek};

use panoscope_data::formats::json;
use panoscope_node::{Detections, Instances};

/// Writes one line of a journal for each tick, and the final file from the journal, so that memory does not grow with the run. Image ids are tick
/// numbers, category ids are class index + 1, as in COCO.
///
/// A line is a JSON object with new `categories`, the `image`, and its `annotations`.
#[derive(Debug, Default)]
pub struct Coco {
    categories: Vec<String>,
    ticks: u64,
    count: u64,
}

/// Marks where a part of a line begins. Inside a JSON string the quotes would be escaped.
const IMAGE: &str = "\"image\":";
const ANNOTATIONS: &str = ",\"annotations\":[";
const LINE_END: &str = "]}\n";

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

    /// Appends the line of tick `seq` to `out`: boxes of the image called `file_name`.
    pub fn push_detections(&mut self, out: &mut String, seq: u64, file_name: &str, detections: &Detections<'_>) {
        self.push(out, seq, file_name, detections, None);
    }

    /// Appends the line of tick `seq` to `out`: boxes and masks of the image called `file_name`.
    pub fn push_instances(&mut self, out: &mut String, seq: u64, file_name: &str, instances: &Instances<'_>) {
        self.push(out, seq, file_name, &instances.detections(), Some(instances));
    }

    fn push(
        &mut self,
        out: &mut String,
        seq: u64,
        file_name: &str,
        detections: &Detections<'_>,
        masks: Option<&Instances<'_>>,
    ) {
        let (width, height) = detections.image_size();
        out.push_str("{\"categories\":[");
        for (index, label) in detections.labels().enumerate().skip(self.categories.len()) {
            self.categories.push(label.to_owned());
            category(out, index, label);
        }
        let _ = write!(out, "],{IMAGE}{{\"id\":{seq},\"width\":{width},\"height\":{height},\"file_name\":");
        json::string(out, file_name);
        out.push('}');
        out.push_str(ANNOTATIONS);
        for (index, item) in detections.items().iter().enumerate() {
            if index > 0 {
                out.push(',');
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
        out.push_str(LINE_END);
        self.ticks += 1;
    }

    /// Writes the final file from the lines of its journal.
    ///
    /// # Errors
    /// Those of `journal` and `out`.
    pub fn write(&self, mut journal: impl BufRead + Seek, mut out: impl io::Write) -> io::Result<()> {
        out.write_all(b"{\"images\":[\n")?;
        copy(&mut journal, &mut out, |line| Some(line.split_once(IMAGE)?.1.split_once(ANNOTATIONS)?.0))?;
        out.write_all(b"\n],\"annotations\":[\n")?;
        copy(&mut journal, &mut out, |line| line.split_once(ANNOTATIONS)?.1.strip_suffix(LINE_END))?;
        out.write_all(b"\n],\"categories\":[\n")?;
        let mut categories = String::new();
        for (index, name) in self.categories.iter().enumerate() {
            category(&mut categories, index, name);
        }
        out.write_all(categories.as_bytes())?;
        out.write_all(b"\n]}\n")
    }
}

/// Writes one part of every line, separated by commas.
fn copy(
    journal: &mut (impl BufRead + Seek),
    out: &mut impl io::Write,
    part: impl Fn(&str) -> Option<&str>,
) -> io::Result<()> {
    journal.rewind()?;
    let (mut line, mut is_first) = (String::new(), true);
    while journal.read_line(&mut line)? > 0 {
        // A full disk may leave half of a line at the end.
        let part = if line.ends_with(LINE_END) { part(&line) } else { None };
        if let Some(part) = part.filter(|part| !part.is_empty()) {
            out.write_all(if is_first { b"" } else { b",\n" })?;
            out.write_all(part.as_bytes())?;
            is_first = false;
        }
        line.clear();
    }
    Ok(())
}

/// Appends category number `index`, after a comma if `out` already holds one.
fn category(out: &mut String, index: usize, name: &str) {
    if out.ends_with('}') {
        out.push(',');
    }
    let _ = write!(out, "{{\"id\":{},\"name\":", index + 1);
    json::string(out, name);
    out.push('}');
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
