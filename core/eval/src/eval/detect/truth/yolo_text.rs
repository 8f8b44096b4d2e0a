//! YOLO: `images/SPLIT`, `labels/SPLIT/NAME.txt` with class, centre and size in shares of the picture, or class and a polygon; names in
//! `data.yaml`, `classes.txt` or numbers.

use std::path::Path;

use super::{Picture, Truth, files, outlined, size_of};
use crate::error::{Context, FileAction, OnFile, Result, bail};
use crate::eval::detect::mask::Mask;
use crate::eval::detect::score::Object;

/// Names by number: `names: [a, b]`, or a list or map below `names:` in data.yaml; or one a line in classes.txt.
fn names(folder: &Path) -> Vec<String> {
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

pub fn read(folder: &Path, split: Option<&str>) -> Result<Truth> {
    let part = |kind: &str| split.map_or_else(|| folder.join(kind), |s| folder.join(kind).join(s));
    let pictures = files(&part("images"), &["jpg", "jpeg", "png"]);
    if pictures.is_empty() {
        bail!("{} holds no pictures", part("images").display());
    }
    let mut truth = Truth::default();
    let names = names(folder);
    for name in &names {
        truth.class(name);
    }
    for path in pictures {
        let (width, height) = size_of(&path)?;
        let (w, h) = (width as f64, height as f64);
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let label = part("labels").join(format!("{stem}.txt"));
        let mut objects = Vec::new();
        // A picture without a file of labels shows nothing.
        let text = if label.is_file() {
            std::fs::read_to_string(&label).on_file(FileAction::Read, &label)?
        } else {
            String::new()
        };
        for (number, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
            let wrong = || {
                format!(
                    "{}:{}: expected `class x y width height` or `class x y x y x y ...`",
                    label.display(),
                    number + 1
                )
            };
            let values: Option<Vec<f64>> =
                line.split_whitespace().map(|v| v.parse().ok().filter(|v: &f64| v.is_finite())).collect();
            let values = values
                .filter(|v| v.len() >= 5 && v.len() % 2 == 1 && (0.0..10_000.0).contains(&v[0]))
                .with_context(wrong)?;
            let index = values[0] as usize;
            let class = truth.class(names.get(index).map_or(&format!("class {index}"), |n| n));
            if let [_, x, y, bw, bh] = values[..] {
                let bbox = [(x - bw / 2.0) * w, (y - bh / 2.0) * h, bw * w, bh * h];
                if bbox.iter().any(|px| !px.is_finite()) {
                    bail!("{}:{}: the box reaches to infinity", label.display(), number + 1);
                }
                objects.push(Object { class, bbox, mask: None, ignored: false });
            } else {
                let points: Vec<[f64; 2]> = values[1..].chunks_exact(2).map(|p| [p[0] * w, p[1] * h]).collect();
                let mut mask = Mask::new(width, height);
                mask.add_polygon(&points);
                objects.extend(outlined(class, mask, false));
            }
        }
        truth.pictures.push(Picture { path, width, height, objects });
    }
    Ok(truth)
}
