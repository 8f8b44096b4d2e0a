//! YOLO: one text file a picture; class numbers, places in shares of the picture.

use std::path::Path;

use super::LabelError;

/// What marks an object.
#[derive(Clone, Debug, PartialEq)]
pub enum YoloShape {
    /// Left, top, width, height, in shares of the picture's width and height.
    Box([f64; 4]),
    /// Corners of an outline, in shares of width and height.
    Polygon(Vec<[f64; 2]>),
}

/// An object.
#[derive(Clone, Debug, PartialEq)]
pub struct YoloObject {
    /// Number of its class, from 0.
    pub class: usize,
    /// Line of the text, from 1.
    pub line: usize,
    /// Where it is.
    pub shape: YoloShape,
}

impl YoloObject {
    /// Left, top, width and height in shares, around the outline where it has one.
    pub fn bounds(&self) -> [f64; 4] {
        match &self.shape {
            YoloShape::Box(bounds) => *bounds,
            YoloShape::Polygon(points) => {
                let side = |axis: usize| {
                    let values = || points.iter().map(|p| p[axis]);
                    (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
                };
                let ((x0, x1), (y0, y1)) = (side(0), side(1));
                [x0, y0, x1 - x0, y1 - y0]
            }
        }
    }
}

/// Reads the text of a file of labels.
///
/// # Errors
/// A line is neither a box nor a polygon.
pub fn yolo(text: &str) -> Result<Vec<YoloObject>, LabelError> {
    let mut objects = Vec::new();
    for (index, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let values: Option<Vec<f64>> =
            line.split_whitespace().map(|v| v.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        let values = values
            .filter(|v| v.len() >= 5 && v.len() % 2 == 1 && (0.0..10_000.0).contains(&v[0]))
            .ok_or(LabelError::Line { line: index + 1 })?;
        let shape = match values[..] {
            [_, x, y, w, h] => YoloShape::Box([x - w / 2.0, y - h / 2.0, w, h]),
            _ => YoloShape::Polygon(values[1..].as_chunks::<2>().0.to_vec()),
        };
        objects.push(YoloObject { class: values[0] as usize, line: index + 1, shape });
    }
    Ok(objects)
}

/// Names by class number: one a line in classes.txt, `names: [a, b]` or a list or map below `names:` in data.yaml. Empty without either.
pub fn yolo_names(folder: &Path) -> Vec<String> {
    if let Ok(text) = std::fs::read_to_string(folder.join("classes.txt")) {
        return text.lines().map(|l| l.trim().to_owned()).filter(|l| !l.is_empty()).collect();
    }
    let Ok(text) = std::fs::read_to_string(folder.join("data.yaml")) else { return Vec::new() };
    let clean = |t: &str| t.trim().trim_matches(['\'', '"']).to_owned();
    let mut lines = text.lines().skip_while(|l| !l.starts_with("names:"));
    let Some(first) = lines.next().and_then(|l| l.strip_prefix("names:")) else { return Vec::new() };
    let first = first.trim();
    if let Some(list) = first.strip_prefix('[') {
        return list.trim_end_matches(']').split(',').map(clean).collect();
    }
    let below = lines.take_while(|l| l.starts_with([' ', '-', '\t']));
    below
        .map(|l| {
            clean(l.trim().trim_start_matches('-').split_once(':').map_or(l.trim().trim_start_matches('-'), |(_, n)| n))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_and_outlines_are_read_and_other_lines_named() {
        let objects = yolo("1 0.5 0.5 0.2 0.4\n\n0 0.1 0.1 0.3 0.1 0.3 0.5\n").expect("labels");
        assert_eq!((objects[0].class, objects[0].shape.clone()), (1, YoloShape::Box([0.4, 0.3, 0.2, 0.4])));
        assert_eq!((objects[1].line, objects[1].class), (3, 0));
        let [x, y, w, h] = objects[1].bounds();
        assert!((x - 0.1).abs() + (y - 0.1).abs() + (w - 0.2).abs() + (h - 0.4).abs() < 1e-12);
        for wrong in ["0 1 2 3", "a 1 2 3 4", "0 1 2 3 4 5", "-1 1 2 3 4", "0 1 2 3 inf"] {
            assert_eq!(yolo(&format!("\n{wrong}")), Err(LabelError::Line { line: 2 }), "{wrong}");
        }
    }
}
