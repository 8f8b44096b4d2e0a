//! VIA, the VGG Image Annotator (Dutta and Zisserman 2019): one JSON file for all images, with polygons, polylines,
//! rectangles, circles and ellipses.
//!
//! Reads projects of version 2 (`_via_img_metadata`) and exported annotations (regions are a list), and exports of
//! version 1 (regions are a map with numbers as keys). The class is the value of the only region attribute, or of the
//! one called `class`, `label`, `name`, `type`, `tool` or `instrument`.

use std::path::Path;

use serde_json::{Map, Value};

use super::{Picture, Truth, outlined, size_of};
use crate::error::{Context, Result, bail};
use panoscope_imaging::detect::Mask;

const PROJECT: &str = "_via_img_metadata";
/// Attributes that name a class if a region has several.
const CLASS: [&str; 6] = ["class", "label", "name", "type", "tool", "instrument"];
/// Corners that circles and ellipses are drawn with.
const ROUND: usize = 96;

/// The images of a file, if it is one of VIA.
pub fn pictures(value: &Value) -> Option<&Map<String, Value>> {
    let map = value.as_object()?;
    if let Some(project) = map.get(PROJECT) {
        return project.as_object();
    }
    let is_picture = |value: &Value| value.get("filename").is_some() && value.get("regions").is_some();
    (!map.is_empty() && map.values().all(is_picture)).then_some(map)
}

/// Reads the images of `path`, which lie in `folder` or in `images` in it. Each error names the file, the image and
/// the region, counted from 1.
///
/// # Errors
/// An image is missing, a region of an unknown or damaged shape, or without a class.
pub fn read(path: &Path, pictures: &Map<String, Value>, folder: &Path) -> Result<Truth> {
    let mut truth = Truth::default();
    for (key, entry) in pictures {
        let Some(name) = entry.get("filename").and_then(Value::as_str) else {
            bail!("{}: the entry `{key}` has no `filename`", path.display());
        };
        let at = |what: &str| format!("{}: picture `{name}`{what}", path.display());
        let places = [folder.join(name), folder.join("images").join(name)];
        let Some(file) = places.into_iter().find(|place| place.is_file()) else {
            bail!("{} is not in {}: give its folder with --images", at(""), folder.display());
        };
        let (width, height) = size_of(&file)?;
        let regions: Vec<&Value> = match entry.get("regions") {
            Some(Value::Array(list)) => list.iter().collect(),
            Some(Value::Object(map)) => {
                // Numbers as text: `10` comes after `9`.
                let mut numbered: Vec<(usize, &Value)> =
                    map.iter().enumerate().map(|(k, (key, region))| (key.parse().unwrap_or(k), region)).collect();
                numbered.sort_by_key(|(number, _)| *number);
                numbered.into_iter().map(|(_, region)| region).collect()
            }
            None | Some(Value::Null) => Vec::new(),
            Some(_) => bail!("{}", at(": `regions` is neither a list nor a map")),
        };
        let mut objects = Vec::new();
        for (number, region) in regions.into_iter().enumerate() {
            let here = || at(&format!(", region {}", number + 1));
            let Some(corners) = corners(region).with_context(here)? else { continue };
            let class = truth.class(&class_of(region).with_context(here)?);
            let mut mask = Mask::new(width, height);
            mask.add_polygon(&corners);
            match outlined(class, mask, false) {
                Some(object) => objects.push(object),
                None => bail!("{}: its outline has no pixel inside the image of {width}x{height} px", here()),
            }
        }
        truth.pictures.push(Picture { path: file, width, height, objects });
    }
    Ok(truth)
}

/// The name of a region's class.
fn class_of(region: &Value) -> Result<String> {
    let attributes = region.get("region_attributes").and_then(Value::as_object);
    let attributes =
        attributes.filter(|all| !all.is_empty()).context("it has no `region_attributes`: add its class")?;
    let known = || CLASS.iter().find_map(|name| attributes.iter().find(|(key, _)| key.eq_ignore_ascii_case(name)));
    let (key, value) = match attributes.iter().next() {
        Some(only) if attributes.len() == 1 => only,
        _ => known().with_context(|| {
            let keys: Vec<&str> = attributes.keys().map(String::as_str).collect();
            format!("of its attributes {} none is called {}", keys.join(", "), CLASS.join(", "))
        })?,
    };
    let name = match value {
        Value::String(text) => text.trim().to_owned(),
        Value::Number(number) => number.to_string(),
        // Checkboxes: {"grasper": true}.
        Value::Object(boxes) => {
            let ticked: Vec<&str> =
                boxes.iter().filter(|(_, on)| on.as_bool() == Some(true)).map(|(name, _)| name.as_str()).collect();
            match ticked[..] {
                [one] => one.to_owned(),
                _ => bail!("{} boxes of `{key}` are ticked; tick exactly one", ticked.len()),
            }
        }
        _ => bail!("`{key}` is not the name of a class"),
    };
    if name.is_empty() || name == "undefined" {
        bail!("`{key}` is empty: enter its class");
    }
    Ok(name)
}

/// The outline of a region, px; none for a point, which has no area.
fn corners(region: &Value) -> Result<Option<Vec<[f64; 2]>>> {
    let shape = region.get("shape_attributes").and_then(Value::as_object).context("it has no `shape_attributes`")?;
    let kind = shape.get("name").and_then(Value::as_str).context("its shape has no `name`")?;
    let number = |name: &str| -> Result<f64> {
        let value = shape.get(name).and_then(Value::as_f64);
        value.with_context(|| format!("its {kind} has no number `{name}`"))
    };
    let length = |name: &str| -> Result<f64> {
        let value = number(name)?;
        if value > 0.0 { Ok(value) } else { bail!("`{name}` of its {kind} is {value}; it must be above 0") }
    };
    let round = |rx: f64, ry: f64, turn: f64| -> Result<Vec<[f64; 2]>> {
        let (cx, cy) = (number("cx")?, number("cy")?);
        let (sin, cos) = turn.sin_cos();
        let corner = |k: usize| {
            let (s, c) = (std::f64::consts::TAU * k as f64 / ROUND as f64).sin_cos();
            [cx + rx * c * cos - ry * s * sin, cy + rx * c * sin + ry * s * cos]
        };
        Ok((0..ROUND).map(corner).collect())
    };
    Ok(Some(match kind {
        "polygon" | "polyline" => {
            let list = |name: &str| -> Result<Vec<f64>> {
                let list = shape.get(name).and_then(Value::as_array);
                let numbers = list.and_then(|list| list.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>());
                numbers.with_context(|| format!("its {kind} has no list of numbers `{name}`"))
            };
            let (xs, ys) = (list("all_points_x")?, list("all_points_y")?);
            if xs.len() != ys.len() || xs.len() < 3 {
                bail!("its {kind} has {} x and {} y: at least three of both are needed", xs.len(), ys.len());
            }
            xs.into_iter().zip(ys).map(|(x, y)| [x, y]).collect()
        }
        "rect" => {
            let (x, y, width, height) = (number("x")?, number("y")?, length("width")?, length("height")?);
            vec![[x, y], [x + width, y], [x + width, y + height], [x, y + height]]
        }
        "circle" => round(length("r")?, length("r")?, 0.0)?,
        "ellipse" => {
            let turn = shape.get("theta").and_then(Value::as_f64).unwrap_or(0.0);
            round(length("rx")?, length("ry")?, turn)?
        }
        "point" => return Ok(None),
        other => bail!("a shape `{other}` is not known: polygon, polyline, rect, circle and ellipse are"),
    }))
}
