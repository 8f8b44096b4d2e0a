//! VOC: one XML file per image.

use super::LabelError;

/// An object.
#[derive(Clone, Debug, PartialEq)]
pub struct VocObject {
    /// Its class.
    pub name: String,
    /// Left, top, right, bottom in px of the stated size.
    pub corners: [f64; 4],
    /// Whether it is marked as difficult.
    pub is_difficult: bool,
}

/// Annotation of an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Voc {
    /// Width and height in the file, px; each `None` if missing.
    pub size: [Option<f64>; 2],
    /// Boxes with their classes, one per `object` element.
    pub objects: Vec<VocObject>,
}

/// Reads the text of an annotation.
///
/// # Errors
/// The text is not XML, or an object has no name or no box.
pub fn voc(text: &str) -> Result<Voc, LabelError> {
    // The parser calls itself for each level.
    if levels(text) > MAX_LEVELS {
        return Err(LabelError::Deep { most: MAX_LEVELS });
    }
    let tree = roxmltree::Document::parse(text).map_err(|error| LabelError::Xml { reason: error.to_string() })?;
    let child = |node: roxmltree::Node<'_, '_>, name: &str| {
        node.children().find(|c| c.has_tag_name(name)).and_then(|c| c.text()).map(|t| t.trim().to_owned())
    };
    let number = |node: roxmltree::Node<'_, '_>, element: &'static str| -> Result<f64, LabelError> {
        let text = child(node, element).ok_or(LabelError::Missing { element })?;
        let value = text.parse().ok().filter(|v: &f64| v.is_finite());
        value.ok_or(LabelError::Number { element, text })
    };
    let declared = tree.root_element().children().find(|c| c.has_tag_name("size"));
    let side = |name| declared.and_then(|node| number(node, name).ok()).filter(|v| *v > 0.0);
    let mut found = Voc { size: [side("width"), side("height")], objects: Vec::new() };
    for node in tree.descendants().filter(|n| n.has_tag_name("object")) {
        let missing = |element| LabelError::Missing { element };
        let name = child(node, "name").ok_or_else(|| missing("name"))?;
        let bounds = node.children().find(|c| c.has_tag_name("bndbox")).ok_or_else(|| missing("bndbox"))?;
        let [x0, y0, x1, y1] = ["xmin", "ymin", "xmax", "ymax"].map(|element| number(bounds, element));
        let is_difficult = child(node, "difficult").is_some_and(|t| t == "1");
        found.objects.push(VocObject { name, corners: [x0?, y0?, x1?, y1?], is_difficult });
    }
    Ok(found)
}

/// Maximum nesting of elements; an annotation has four levels.
const MAX_LEVELS: usize = 100;

/// Maximum nesting of a text's elements. Comments, declarations and quoted values are skipped as the parser does.
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

#[cfg(test)]
mod tests {
    use super::{VocObject, levels, voc};

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

    #[test]
    fn boxes_and_what_does_not_count_are_read() {
        let text = "<annotation><size><width>40</width><height>30</height></size>\
                    <object><name> grasper </name><difficult>1</difficult>\
                    <bndbox><xmin>1</xmin><ymin>2</ymin><xmax>11.5</xmax><ymax>22</ymax></bndbox></object></annotation>";
        let found = voc(text).expect("an annotation");
        assert_eq!(found.size, [Some(40.0), Some(30.0)]);
        let object = VocObject { name: "grasper".to_owned(), corners: [1.0, 2.0, 11.5, 22.0], is_difficult: true };
        assert_eq!(found.objects, [object]);
        let error = voc(&text.replace("<xmax>11.5", "<xmax>far")).expect_err("no number").to_string();
        assert_eq!(error, "<xmax> is \"far\"");
        assert!(voc("<annotation><object/></annotation>").is_err() && voc("boxes").is_err());
        assert!(voc(&"<a>".repeat(5000)).is_err());
    }
}
