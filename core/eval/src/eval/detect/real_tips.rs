//! Distance of found tips from the ends of labelled outlines, on real images.

use std::path::Path;

use super::find::Node;
use super::phantom::{Tips, place, read_lines, seq};
use super::truth::Truth;
use crate::error::Result;
use crate::inputs::Folder;
use crate::run::{self, Plan};
use crate::session::Session;
use panoscope_imaging::detect::Mask;

/// Tolerance of the distance from the image's border of the entry of an outline, px.
const ENTRY_PX: usize = 4;
/// Minimum distance from the entry of pixels of the outline's end, as a share of the maximum.
const END_SHARE: f64 = 0.97;

/// End of an outline: the mean of the pixels that are farthest from the entry, the part nearest to the image's border
/// or to the rim of a round image, where the shaft enters. Between open jaws the end is a point of the longer one or
/// between both. `None` for an empty outline.
fn end_of(mask: &Mask) -> Option<[f64; 2]> {
    let [x0, y0, width, height] = mask.bounds();
    let columns = x0 as usize..(x0 + width).ceil() as usize;
    let rows = y0 as usize..(y0 + height).ceil() as usize;
    let pixels = || columns.clone().flat_map(|x| rows.clone().map(move |y| (x, y))).filter(|(x, y)| mask.at(*x, *y));
    let mean = |of: &mut dyn Iterator<Item = (usize, usize)>| {
        let (count, x, y) = of.fold((0.0, 0.0, 0.0), |(n, a, b), (x, y)| (n + 1.0, a + x as f64, b + y as f64));
        [x / count, y / count]
    };
    let to_border = |(x, y): (usize, usize)| x.min(y).min(mask.width - 1 - x).min(mask.height - 1 - y);
    let nearest = pixels().map(to_border).min()?;
    let entry = mean(&mut pixels().filter(|at| to_border(*at) <= nearest + ENTRY_PX));
    let away = |(x, y): (usize, usize)| (x as f64 - entry[0]).hypot(y as f64 - entry[1]);
    let longest = pixels().map(away).fold(0.0, f64::max);
    Some(mean(&mut pixels().filter(|at| away(*at) >= END_SHARE * longest)))
}

/// Finds the tip of each labelled class in each image of `truth`, from the boxes or the outlines of a model. A tip
/// counts as found in an image if the node returns one for that class; its error is the distance to the nearest end of
/// that class.
pub fn run(session: &dyn Session, truth: &Truth, node: Node, model: &Path) -> Result<Tips> {
    let scratch = Folder::new("panoscope-tips")?;
    let inputs = node.tip_inputs("files.left");
    // A second between pictures: each is judged for itself.
    let mut text = format!(
        "mode = \"batch\"\nplugins = [\"capture\", \"tools\", \"sinks\"]\n\
         [nodes.files]\ntype = \"capture\"\nparams = {{ left = {}, pace = \"off\", rate_hz = 1.0 }}\n{}",
        toml::Value::String(truth.file_list()),
        node.text("files.left", model),
    );
    for (class, name) in truth.classes.iter().enumerate() {
        text += &format!(
            "[nodes.tip{class}]\ntype = \"tool_tip\"\ninputs = {{ {inputs} }}\nparams = {{ class = {} }}\n\
             [nodes.out{class}]\ntype = \"write_table\"\ninputs = {{ tip = \"tip{class}.tip\" }}\nparams = {{ path = \"tip{class}.jsonl\" }}\n",
            toml::Value::String(name.clone()),
        );
    }
    let path = scratch.path().join("eval.toml");
    let frames = Some(truth.pictures.len() as u64);
    run::run(session, &Plan { text: &text, path: &path, frames, ..Plan::default() })?;
    let mut tips = Tips::default();
    for (class, name) in truth.classes.iter().enumerate() {
        let found = read_lines(&scratch.path().join(format!("tip{class}.jsonl")))?;
        let before = tips.count();
        for (number, picture) in truth.pictures.iter().enumerate() {
            let own = picture.objects.iter().filter(|object| object.class == class);
            let ends: Vec<[f64; 2]> = own.filter_map(|object| end_of(object.mask.as_ref()?)).collect();
            if ends.is_empty() {
                continue;
            }
            tips.seen += 1;
            let line = found.iter().find(|line| seq(line) == Some(number as u64));
            let Some((uv, _)) = line.and_then(place) else { continue };
            let distances = ends.iter().map(|end| (end[0] - uv[0]).hypot(end[1] - uv[1]));
            tips.errors_px.push(distances.fold(f64::INFINITY, f64::min));
        }
        tips.end_kind(name, before);
    }
    Ok(tips)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_an_outline_is_far_from_where_it_enters() {
        // A shaft from the left border with an end at column 60, row 20.
        let mut shaft = Mask::new(100, 50);
        shaft.add_polygon(&[[0.0, 18.0], [60.0, 18.0], [60.0, 22.0], [0.0, 22.0]]);
        let [x, y] = end_of(&shaft).expect("an end");
        assert!((x - 59.0).abs() < 2.0 && (y - 20.0).abs() < 1.0, "{x} {y}");
        // One that comes from the upper rim of a round picture.
        let mut inside = Mask::new(100, 50);
        inside.add_polygon(&[[70.0, 8.0], [74.0, 8.0], [64.0, 36.0], [60.0, 36.0]]);
        let [x, y] = end_of(&inside).expect("an end");
        assert!((x - 62.0).abs() < 2.5 && (y - 35.0).abs() < 1.5, "{x} {y}");
        assert_eq!(end_of(&Mask::new(100, 50)), None);
    }
}
