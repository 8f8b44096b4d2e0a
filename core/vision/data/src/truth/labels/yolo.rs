//! YOLO: one text file per image; class numbers, positions in shares of the image.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::LabelError;

/// Upper bound of class numbers.
const MAX_CLASSES: usize = 10_000;

/// Numbers beyond are px. Boxes and outlines may reach a little beyond the image.
const MAX_SHARE: f64 = 2.0;

/// Shape of an object.
#[derive(Clone, Debug, PartialEq)]
pub enum YoloShape {
    /// Left, top, width, height, in shares of the image's width and height.
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
    /// Shape of the object.
    pub shape: YoloShape,
}

impl YoloObject {
    /// Left, top, width and height in shares, around the outline if it has one.
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
/// A line is neither a box nor a polygon, or has px instead of shares.
pub fn yolo(text: &str) -> Result<Vec<YoloObject>, LabelError> {
    let mut objects = Vec::new();
    for (index, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let values: Option<Vec<f64>> =
            line.split_whitespace().map(|v| v.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        let values = values
            .filter(|v| v.len() >= 5 && v.len() % 2 == 1 && (0.0..MAX_CLASSES as f64).contains(&v[0]))
            .ok_or(LabelError::Line { line: index + 1 })?;
        if let Some(value) = values[1..].iter().find(|value| value.abs() > MAX_SHARE) {
            return Err(LabelError::NoShare { line: index + 1, value: value.to_string() });
        }
        let shape = match values[..] {
            [_, x, y, w, h] => YoloShape::Box([x - w / 2.0, y - h / 2.0, w, h]),
            _ => YoloShape::Polygon(values[1..].as_chunks::<2>().0.to_vec()),
        };
        objects.push(YoloObject { class: values[0] as usize, line: index + 1, shape });
    }
    Ok(objects)
}

/// Names by class number: one per line in classes.txt, or `names:` in data.yaml (else the only YAML file): a list or a
/// map, in brackets or below it. A number that the map leaves out is called `class N`. Empty without either file.
pub fn yolo_names(folder: &Path) -> Vec<String> {
    if let Ok(text) = std::fs::read_to_string(folder.join("classes.txt")) {
        return text.lines().map(|l| l.trim().to_owned()).filter(|l| !l.is_empty()).collect();
    }
    std::fs::read_to_string(folder.join("data.yaml"))
        .or_else(|error| only_yaml(folder).map_or(Err(error), std::fs::read_to_string))
        .map(|text| names_in_yaml(&text))
        .unwrap_or_default()
}

fn only_yaml(folder: &Path) -> Option<PathBuf> {
    let is_yaml = |p: &PathBuf| p.extension().is_some_and(|e| e == "yaml" || e == "yml");
    let mut all = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path()).filter(is_yaml);
    all.next().filter(|_| all.next().is_none())
}

fn names_in_yaml(text: &str) -> Vec<String> {
    let clean = |t: &str| t.trim().trim_matches(['\'', '"']).to_owned();
    let mut lines = text.lines().map(|l| l.split(" #").next().unwrap_or(l)).skip_while(|l| !l.starts_with("names:"));
    let Some(first) = lines.next().and_then(|l| l.strip_prefix("names:")).map(str::trim) else { return Vec::new() };
    let entries: Vec<String> = if first.starts_with(['[', '{']) {
        // Up to the closing bracket, which may be on a later line.
        let all = std::iter::once(first).chain(lines).collect::<Vec<_>>().join(" ");
        let inside = all[1..].split([']', '}']).next().unwrap_or_default();
        inside.split(',').map(|entry| entry.trim().to_owned()).filter(|entry| !entry.is_empty()).collect()
    } else {
        let below = lines.filter(|l| !l.trim().is_empty()).take_while(|l| l.starts_with([' ', '-', '\t']));
        below.map(|l| l.trim().trim_start_matches('-').trim().to_owned()).collect()
    };
    let mut names: BTreeMap<usize, String> = BTreeMap::new();
    for (index, entry) in entries.iter().enumerate() {
        let numbered = entry.split_once(':').and_then(|(key, name)| Some((clean(key).parse().ok()?, clean(name))));
        let (number, name) = numbered.unwrap_or_else(|| (index, clean(entry)));
        if number < MAX_CLASSES {
            names.insert(number, name);
        }
    }
    let count = names.last_key_value().map_or(0, |(last, _)| last + 1);
    (0..count).map(|number| names.remove(&number).unwrap_or_else(|| format!("class {number}"))).collect()
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
        assert_eq!(yolo("\n0 30 0.5 0.1 0.1"), Err(LabelError::NoShare { line: 2, value: "30".to_owned() }));
        assert!(yolo("0 1.01 0.99 0.1 0.1").is_ok());
    }

    #[test]
    fn names_are_read_from_every_form_of_yaml() {
        let wanted = ["grasper", "hook", "class 2", "clip applier"];
        for text in [
            "nc: 4\nnames: {0: grasper, 1: 'hook', 3: clip applier}\n",
            "names: {3: clip applier,\n  1: \"hook\", 0: grasper}  # ours\nnc: 4\n",
            "names:\n  3: clip applier\n\n  0: grasper # the left one\n  1: hook\nnc: 4\n",
            "names: [grasper, 'hook', \"class 2\",\n  clip applier]\n",
            "names:\n- grasper\n- hook\n- class 2\n- 'clip applier'\npath: .\n",
        ] {
            assert_eq!(names_in_yaml(text), wanted, "{text}");
        }
        assert!(names_in_yaml("nc: 3\n").is_empty() && names_in_yaml("names: []\n").is_empty());
        assert_eq!(names_in_yaml("names: {99999999: far}\n"), Vec::<String>::new());
    }
}
