//! VOC: one XML file a picture, lists of names in `ImageSets`.

use std::path::Path;

use super::{Picture, Truth, files, picture_called, size_of};
use crate::error::{Context, EvalError, FileAction, OnFile, Result, bail};
use crate::eval::detect::score::Object;
use crate::session::{Session, note};

pub fn read(session: &dyn Session, folder: &Path, split: Option<&str>) -> Result<Truth> {
    let annotations = folder.join("Annotations");
    let names: Vec<String> = match split {
        None => files(&annotations, &["xml"])
            .iter()
            .filter_map(|f| Some(f.file_stem()?.to_string_lossy().into_owned()))
            .collect(),
        Some(split) => {
            let places = [folder.join("ImageSets"), folder.join("ImageSets/Main")];
            let list = places.iter().map(|p| p.join(format!("{split}.txt"))).find(|f| f.is_file());
            let list = list.with_context(|| format!("{} has no ImageSets/{split}.txt", folder.display()))?;
            let text = std::fs::read_to_string(&list).on_file(FileAction::Read, &list)?;
            text.lines().filter_map(|l| l.split_whitespace().next()).map(str::to_owned).collect()
        }
    };
    let pictures = [folder.join("JPEGImages"), annotations.clone(), folder.to_owned()];
    let mut truth = Truth::default();
    // Fixes the order of the classes and names those that no picture shows.
    if let Ok(list) = std::fs::read_to_string(folder.join("class_list.txt")) {
        for line in list.lines() {
            if let Some(name) = line.split_whitespace().last() {
                truth.class(name);
            }
        }
    }
    let mut absent = 0;
    for name in &names {
        let file = annotations.join(format!("{name}.xml"));
        let Some(path) = picture_called(&pictures, name).filter(|_| file.is_file()) else {
            absent += 1;
            continue;
        };
        let text = std::fs::read_to_string(&file).on_file(FileAction::Read, &file)?;
        let picture =
            one(&mut truth, &text, path).with_context(|| format!("{} is no VOC annotation", file.display()))?;
        truth.pictures.push(picture);
    }
    if absent > 0 {
        note!(session, "{}: {absent} of {} named pictures are not there", folder.display(), names.len());
    }
    if truth.pictures.is_empty() {
        bail!("{} holds no picture with an annotation", folder.display());
    }
    Ok(truth)
}

/// Most elements in each other; an annotation has four.
const MOST_LEVELS: usize = 100;

/// Most elements of a text that are open at once. Comments, declarations and quoted values are skipped as the parser does.
fn levels(text: &str) -> usize {
    let (mut rest, mut open, mut most) = (text, 0usize, 0);
    let behind = |text: &'_ str, mark: &str| text.find(mark).map(|at| at + mark.len());
    while let Some(at) = rest.find('<') {
        rest = &rest[at..];
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
        if let Some((begin, end)) = skipped.iter().find(|(begin, _)| rest.starts_with(begin)) {
            let Some(len) = behind(&rest[begin.len()..], end) else { return most };
            rest = &rest[begin.len() + len..];
            continue;
        }
        let mut quote = None;
        let end = rest.char_indices().find(|&(_, c)| match (quote, c) {
            (None, '>') => true,
            (None, '"' | '\'') => {
                quote = Some(c);
                false
            }
            (Some(q), c) if q == c => {
                quote = None;
                false
            }
            _ => false,
        });
        let Some((end, _)) = end else { return most };
        match &rest[..end] {
            tag if tag.starts_with("</") => open = open.saturating_sub(1),
            tag if tag.starts_with("<!") || tag.ends_with('/') => {}
            _ => open += 1,
        }
        most = most.max(open);
        rest = &rest[end..];
    }
    most
}

fn one(truth: &mut Truth, text: &str, path: std::path::PathBuf) -> Result<Picture> {
    // The parser calls itself for each level.
    if levels(text) > MOST_LEVELS {
        bail!("its elements stand in each other more than {MOST_LEVELS} deep");
    }
    let tree = roxmltree::Document::parse(text).map_err(|error| EvalError::Input { reason: error.to_string() })?;
    let child = |node: roxmltree::Node<'_, '_>, name: &str| {
        node.children().find(|c| c.has_tag_name(name)).and_then(|c| c.text()).map(|t| t.trim().to_owned())
    };
    let number = |node: roxmltree::Node<'_, '_>, name: &str| -> Result<f64> {
        let text = child(node, name).with_context(|| format!("<{name}> is missing"))?;
        text.parse().ok().filter(|v: &f64| v.is_finite()).with_context(|| format!("<{name}> is {text:?}"))
    };
    let (width, height) = size_of(&path)?;
    // Boxes are in px of the size that the file names, which need not be the picture's any more.
    let declared = tree.root_element().children().find(|c| c.has_tag_name("size"));
    let scale = |name: &str, real: usize| {
        let declared = declared.and_then(|node| number(node, name).ok()).filter(|v| *v > 0.0);
        declared.map_or(1.0, |declared| real as f64 / declared)
    };
    let (sx, sy) = (scale("width", width), scale("height", height));
    let mut objects = Vec::new();
    for node in tree.descendants().filter(|n| n.has_tag_name("object")) {
        let name = child(node, "name").context("an object has no <name>")?;
        let bounds = node.children().find(|c| c.has_tag_name("bndbox")).context("an object has no <bndbox>")?;
        let [x0, y0, x1, y1] = ["xmin", "ymin", "xmax", "ymax"].map(|k| number(bounds, k));
        let (x0, y0, x1, y1) = (x0? * sx, y0? * sy, x1? * sx, y1? * sy);
        let bbox = [x0, y0, x1 - x0, y1 - y0];
        if bbox.iter().any(|px| !px.is_finite()) {
            bail!("the <bndbox> of `{name}` reaches to infinity");
        }
        let ignored = child(node, "difficult").is_some_and(|t| t == "1");
        let class = truth.class(&name);
        objects.push(Object { class, bbox, mask: None, ignored });
    }
    Ok(Picture { path, width, height, objects })
}

#[cfg(test)]
mod tests {
    use super::levels;

    #[test]
    fn levels_are_those_of_the_parser() {
        assert_eq!(levels("<a><b/><c x=\"/>\"></c><d><e/></d></a>"), 2);
        assert_eq!(levels("<?xml v='>'?><!-- <a><a> --><a><![CDATA[</a></a>]]><b></b></a>"), 2);
        assert_eq!(levels(&"<a>".repeat(5000)), 5000);
        // What looks like an end in a quoted value ends nothing.
        assert_eq!(levels(&"<a b='</a>' c=\"/>\">".repeat(40)), 40);
        assert_eq!(levels("no XML"), 0);
        assert_eq!(levels("<a><b"), 1);
    }
}
