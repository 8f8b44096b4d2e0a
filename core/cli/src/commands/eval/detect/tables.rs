//! Tables 5.1 to 5.5 of the thesis, from our own data and measurements, as Markdown.

use std::fmt::Write;

use super::picture::confusion;
use super::score::{Scores, Shape};
use super::truth::Truth;
use super::{Judged, Node};

fn row(out: &mut String, cells: &[String]) {
    let _ = writeln!(out, "| {} |", cells.join(" | "));
}

fn head(out: &mut String, title: &str, cells: &[String]) {
    let _ = writeln!(out, "\n{title}\n");
    row(out, cells);
    row(out, &vec!["---".to_owned(); cells.len()]);
}

fn percent(value: f64) -> String {
    if value.is_nan() { "-".to_owned() } else { format!("{:.1} %", value * 100.0) }
}

/// Pictures in which a class is seen, and its objects.
fn counts(truth: &Truth, class: usize) -> (usize, usize) {
    let of = |p: &super::truth::Picture| p.objects.iter().filter(|o| o.class == class && !o.ignored).count();
    (truth.pictures.iter().filter(|p| of(p) > 0).count(), truth.pictures.iter().map(of).sum())
}

fn data(out: &mut String, title: &str, list: &[&Judged]) {
    let Some(first) = list.first() else { return };
    let mut cells = vec!["tool".to_owned()];
    cells.extend(list.iter().map(|j| format!("{}: frames", j.case)));
    cells.extend(list.iter().map(|j| format!("{}: instruments", j.case)));
    head(out, title, &cells);
    for (class, name) in first.truth.classes.iter().enumerate() {
        let all: Vec<(usize, usize)> = list.iter().map(|j| counts(&j.truth, class)).collect();
        let mut cells = vec![name.clone()];
        cells.extend(all.iter().map(|c| c.0.to_string()));
        cells.extend(all.iter().map(|c| c.1.to_string()));
        row(out, &cells);
    }
    let mut cells = vec!["all".to_owned()];
    cells.extend(list.iter().map(|j| j.truth.pictures.len().to_string()));
    cells.extend(list.iter().map(|j| j.truth.pictures.iter().map(|p| p.objects.len()).sum::<usize>().to_string()));
    row(out, &cells);
}

fn found(out: &mut String, title: &str, list: &[&Judged], shape: Shape) {
    let Some(first) = list.first() else { return };
    let mut cells = vec!["tool".to_owned()];
    cells.extend(list.iter().map(|j| format!("{}: right, another tool, missed, false", j.case)));
    head(out, title, &cells);
    let tables: Vec<_> = list.iter().map(|j| confusion(&j.truth, &j.finds, shape)).collect();
    let n = first.truth.classes.len();
    for (class, name) in first.truth.classes.iter().enumerate() {
        let mut cells = vec![name.clone()];
        for t in &tables {
            let right = t[class][class];
            let other: usize = t[class][..n].iter().sum::<usize>() - right;
            cells.push(format!("{right}, {other}, {}, {}", t[class][n], t[n][class]));
        }
        row(out, &cells);
    }
}

fn precision(out: &mut String, title: &str, list: &[(&Judged, &str, &Scores)]) {
    let Some((first, _, _)) = list.first() else { return };
    let mut cells = vec!["tool".to_owned()];
    for (j, what, _) in list {
        cells.extend([format!("{}, {what}: AP50", j.case), format!("{}, {what}: AP50-95", j.case)]);
    }
    head(out, title, &cells);
    for (class, name) in first.truth.classes.iter().enumerate() {
        let mut cells = vec![name.clone()];
        for (_, _, s) in list {
            let c = s.classes.get(class);
            cells.push(percent(c.map_or(f64::NAN, |c| c.ap[0])));
            cells.push(percent(c.map_or(f64::NAN, super::score::ClassScore::mean_ap)));
        }
        row(out, &cells);
    }
    let mut cells = vec!["mean".to_owned()];
    for (_, _, s) in list {
        cells.extend([percent(s.ap_at(0)), percent(s.ap())]);
    }
    row(out, &cells);
    let mut cells = vec!["median time a frame".to_owned()];
    for (j, _, _) in list {
        cells.extend([format!("{:.1} ms", j.ms), String::new()]);
    }
    row(out, &cells);
}

/// All tables of what was judged.
pub fn all(judged: &[Judged]) -> String {
    let of = |node: Node| -> Vec<&Judged> { judged.iter().filter(|j| j.node == node).collect() };
    let (boxes, masks) = (of(Node::Yolo), of(Node::MaskRcnn));
    let mut out = String::from(
        "# Tables 5.1 to 5.5, rebuilt\n\nFrames of each case are what lies on this machine; nothing is copied from the thesis.\n",
    );
    data(&mut out, "## Table 5.1: frames and instruments, boxes", &boxes);
    found(&mut out, "## Table 5.2: detections at score 0.3 and overlap 0.5", &boxes, Shape::Box);
    let list: Vec<_> = boxes.iter().map(|j| (*j, "boxes", &j.boxes)).collect();
    precision(&mut out, "## Table 5.3: average precision of the detector", &list);
    data(&mut out, "## Table 5.4: frames and instruments, outlines", &masks);
    let mut list = Vec::new();
    for j in &masks {
        list.push((*j, "boxes", &j.boxes));
        list.extend(j.masks.as_ref().map(|m| (*j, "masks", m)));
    }
    precision(&mut out, "## Table 5.5: average precision of the segmenter", &list);
    out
}
